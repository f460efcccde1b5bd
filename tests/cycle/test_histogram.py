"""Durations, counted in buckets."""

from hypothesis import given
from hypothesis import strategies as st

from linemate.daemon.cycle.clock.histogram import Histogram

DURATIONS = st.lists(st.integers(0, 2**38), min_size=1, max_size=200)


@given(DURATIONS, st.sampled_from([0.01, 0.5, 0.9, 0.99, 1.0]))
def test_a_percentile_is_right_within_a_bucket(durations: list[int], share: float) -> None:
    histogram = Histogram()
    for duration in durations:
        histogram.add(duration)
    found = histogram.percentile(share)
    assert found is not None
    within = [d for d in durations if d <= found * 1e9 + 0.5]
    assert len(within) >= share * len(durations)
    shorter = [d for d in durations if d < found * 1e9 / 1.13 - 2]
    assert len(shorter) < max(1.0, share * len(durations))


def test_the_greatest_is_kept_exactly_and_nothing_gives_nothing() -> None:
    histogram = Histogram()
    assert histogram.summary_us() == {"p50": None, "p99": None, "p999": None, "max": None}
    for duration in (100_000, 123_456_789, -5):
        histogram.add(duration)
    assert histogram.summary_us()["max"] == 123456.8
    assert histogram.percentile(1.0) == 0.123456789


def test_whatever_is_longer_than_the_last_bucket_is_counted_too() -> None:
    histogram = Histogram()
    histogram.add(2**60)
    assert histogram.percentile(0.5) is not None
