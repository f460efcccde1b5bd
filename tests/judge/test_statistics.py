"""Figures of many runs: known values, coverage, and what missing runs do."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from linemate.simulators.judge import statistics


def test_the_interval_of_a_median_is_the_textbooks() -> None:
    # Tables of order statistics: n = 10 gives ranks 2 and 9, n = 25 ranks 8 and 18, 40: 14, 27.
    assert statistics.median_interval(list(range(1, 11))) == (2, 9)
    assert statistics.median_interval(list(range(1, 26))) == (8, 18)
    assert statistics.median_interval(list(range(1, 41))) == (14, 27)


@given(st.integers(6, 400))
def test_the_interval_is_the_narrowest_that_covers_with_the_confidence(n: int) -> None:
    interval = statistics.median_interval(list(range(1, n + 1)))
    assert interval is not None
    low, high = interval
    assert low + high == n + 1

    def coverage(rank: float) -> float:
        return float(1.0 - 2.0 * binom.cdf(rank - 1, n, 0.5))

    assert coverage(low) >= 0.95
    assert coverage(low + 1) < 0.95 or low + 1 > n / 2


def test_the_interval_covers_the_true_median_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(400):
        interval = statistics.median_interval(rng.exponential(1.0, 40).tolist())
        hits += interval is not None and interval[0] <= math.log(2.0) <= interval[1]
    assert hits >= 0.93 * 400


@pytest.mark.parametrize("n", [1, 2, 5])
def test_fewer_than_six_values_have_no_interval(n: int) -> None:
    values = [float(i) for i in range(n)]
    assert statistics.median_interval(values) is None
    assert statistics.describe(values)["ci95"] == [None, None]
    assert statistics.share([True] * n)["ci95"] == [None, None]
    assert statistics.interval_text([None, None], str) == ""
    assert None not in statistics.describe([*values, *range(6 - n)])["ci95"]


def test_a_missed_detection_is_the_worst_and_prints_as_null() -> None:
    described = statistics.describe([0.2, math.inf, 0.3])
    assert (described["median"], described["worst"]) == (0.3, None)


def test_a_share_of_all_is_not_certain() -> None:
    whole = statistics.share([True] * 40)
    assert (whole["median"], whole["worst"]) == (1.0, 1.0)
    # The rule of three, Clopper and Pearson two-sided: (alpha/2)^(1/n).
    assert whole["ci95"] == [pytest.approx(0.025 ** (1 / 40), abs=1e-6), 1.0]
    assert statistics.share([True, False])["worst"] == 0.0
    assert statistics.share([False] * 6)["ci95"][0] == 0.0


def test_seeds_are_written_as_ranges_and_the_worst_value_names_its_seed() -> None:
    assert statistics.seed_text([3, 0, 1, 1, 7]) == "0..1,3,7"
    assert statistics.seed_text([]) == ""
    described = statistics.describe_seeds({4: 0.2, 9: math.inf, 2: 0.3})
    assert (described["worst_seed"], described["worst"], described["n"]) == (9, None, 3)
