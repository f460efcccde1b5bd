"""Statistics of many runs: median, worst and a distribution-free 95 % interval.

Invariants:
    Pure.
    The interval of a median is of order statistics (binomial); that of a share is Clopper-
        Pearson.
    Fewer than six values have no 95 % interval: even their whole range covers less.
    A missed detection counts as infinite and prints as null.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from scipy.stats import beta, binom

CONFIDENCE = 0.95
MIN_INTERVAL_VALUES = 6  # 2 * 0.5**6 is the first below 5 %

ERRORS = ("control_error", "plan_error", "prediction_error", "total_error")
MEASURES = ("max_mm", "rms_mm", "max_mrad", "rms_mrad")

Figure = dict[str, Any]


def figures(result: Mapping[str, Any]) -> Iterator[tuple[str, float | None]]:
    """Name every figure of a run, e.g. ``control_error.stop.max_mm``.

    A window that the run did not have gives nothing; a missed detection gives None.
    """
    for error in ERRORS:
        for window, values in result[error].items():
            if values is not None:
                yield from ((f"{error}.{window}.{m}", values[m]) for m in MEASURES)
    counts: dict[str, int] = {}
    for entry in result["detection"]:
        kind = entry["event"]
        counts[kind] = counts.get(kind, 0) + 1
        name = kind if counts[kind] == 1 else f"{kind}{counts[kind]}"
        yield f"detection.{name}.perceived_s", entry["perceived_s"]
        yield f"detection.{name}.confirmed_s", entry["confirmed_s"]
    for what, count in result["false_alarms"].items():
        yield f"false_alarms.{what}", float(count)
    if result["contact_force_n"] is not None:
        yield "contact_force_n.max", result["contact_force_n"]["max"]
    yield "limits.violations", float(result["limits"]["violations"])
    yield "telegrams.late", float(result["telegrams"]["late"])
    yield "telegrams.lost", float(result["telegrams"]["lost"])


def summarise(results: Sequence[Mapping[str, Any]]) -> dict[str, Figure]:
    """Summary of one variant's runs, figure by figure, in a fixed order.

    ``assembled`` and ``within_limits`` are shares; their worst is 0 if any run failed.
    """
    by_figure: dict[str, dict[int, float]] = {}
    for result in results:
        for name, value in figures(result):
            by_seed = by_figure.setdefault(name, {})
            by_seed[result["seed"]] = math.inf if value is None else value
    summary = {
        name: share([bool(result[name]) for result in results])
        for name in ("assembled", "within_limits")
    }
    return summary | {name: describe_seeds(values) for name, values in sorted(by_figure.items())}


def describe(values: Sequence[float]) -> Figure:
    """Return median, worst (largest) and 95 % interval of the median, and how many values."""
    low, high = median_interval(values) or (math.inf, math.inf)
    return {
        "median": _finite(_median(sorted(values))),
        "worst": _finite(max(values)),
        "ci95": [_finite(low), _finite(high)],
        "n": len(values),
    }


def describe_seeds(by_seed: Mapping[int, float]) -> Figure:
    """Return ``describe`` of one value a seed, and the seed of the worst."""
    worst = max(by_seed, key=lambda seed: by_seed[seed])
    return describe(list(by_seed.values())) | {"worst_seed": worst}


def seed_text(seeds: Iterable[int]) -> str:
    """Return seeds in order, consecutive ones as a range, e.g. ``0..39,1000``."""
    ranges: list[list[int]] = []
    for seed in sorted(set(seeds)):
        if ranges and seed == ranges[-1][-1] + 1:
            ranges[-1][1:] = [seed]
        else:
            ranges.append([seed])
    return ",".join("..".join(map(str, each)) for each in ranges)


def share(flags: Sequence[bool]) -> Figure:
    """Return the share of true, the worst case, and the share's Clopper-Pearson interval."""
    n, hits = len(flags), sum(flags)
    tail = 0.5 * (1.0 - CONFIDENCE)
    low = float(beta.ppf(tail, hits, n - hits + 1)) if hits else 0.0
    high = float(beta.ppf(1.0 - tail, hits + 1, n - hits)) if hits < n else 1.0
    return {
        "median": round(hits / n, 6),
        "worst": float(hits == n),
        "ci95": [None, None] if n < MIN_INTERVAL_VALUES else [round(low, 6), round(high, 6)],
        "n": n,
    }


def interval_text(ci95: Sequence[float | None], number: Callable[[float | None], str]) -> str:
    """Return `` [low, high]``, empty without an interval."""
    low, high = ci95
    return "" if low is None and high is None else f" [{number(low)}, {number(high)}]"


def median_interval(values: Sequence[float]) -> tuple[float, float] | None:
    """Return the narrowest order statistics that enclose the median with 95 % confidence.

    None for fewer than MIN_INTERVAL_VALUES: no pair of them does.

    Source: David and Nagaraja, Order Statistics, 7.1: P(x_(r) < m < x_(n+1-r)) is the binomial
    probability, n trials of 1/2, of r..n-r.
    """
    ordered, n = sorted(values), len(values)
    rank = int(binom.ppf(0.5 * (1.0 - CONFIDENCE), n, 0.5))
    # The largest rank whose two tails, each P(B <= rank - 1), hold at most 5 %.
    while rank > 0 and 2.0 * binom.cdf(rank - 1, n, 0.5) > 1.0 - CONFIDENCE:
        rank -= 1
    if rank == 0:
        return None
    return ordered[rank - 1], ordered[n - rank]


def _median(ordered: Sequence[float]) -> float:
    middle = len(ordered) // 2
    if len(ordered) % 2:
        return ordered[middle]
    return 0.5 * (ordered[middle - 1] + ordered[middle])


def _finite(value: float) -> float | None:
    return round(value, 6) if math.isfinite(value) else None
