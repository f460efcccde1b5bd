"""Stops and starts of the conveyor, from the distance sensor: when, how hard and how smooth.

A ramp is a constant acceleration, averaged over a smooth time S: its jerk is a / S. The end of a
stop that coasts out counts as smooth time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from linemate.daemon.core.horizon import Array
from linemate.daemon.identification.conveyor_motion import conveyor, find_outliers
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal, ReportLine
from linemate.daemon.identification.trace import Trace

STEP_S = 0.01  # of the conveyor's motion
LEAST_SPEED = 0.02  # of a conveyor that runs [m/s]
LOW, MIDDLE, HIGH = 0.1, 0.5, 0.9  # shares of that speed: stands, changes, runs
AROUND_S = 0.8  # readings before and after a ramp that its fit uses
LEAST_READINGS = 12  # of a ramp, twice the number of what is fitted
BRIEF_S = 0.4  # ramp that is shorter has no shape that readings show
SAME = 0.2  # accelerations of one class differ by less, as a share
LARGEST_SHARE = 0.2  # deviation of an accepted acceleration, as a share
SMOOTH_S = (0.0, 1.0)  # smooth times that are tried
WALK = 0.0002  # deviation of a chain from its ramp, which a fit does not see [m]


@dataclass(frozen=True, slots=True, eq=False)
class UnitMotion:
    """Motion of the conveyor on a grid of times.

    Attributes:
        times, positions, speeds: (n,) [s, m, m/s].
        ways: (n,) what fitted ramps add to a steady motion [m]. They are free of the readings'
            noise, to which a body that sways would seem to answer.
    """

    times: Array
    positions: Array
    speeds: Array
    ways: Array


@dataclass(frozen=True, slots=True)
class FittedRamp:
    """A stop or a start.

    Attributes:
        begin, end: when the speed leaves the old value and reaches the new one, roughly [s].
    """

    starts: bool
    begin: float
    end: float


@dataclass(frozen=True, slots=True)
class RampClass:
    """Ramps of about the same acceleration.

    Attributes:
        starts: True for starts, False for stops.
        acceleration: magnitude, not signed, of the steady part [m/s^2].
        smooth: time over which the acceleration builds up and fades [s].
    """

    starts: bool
    acceleration: Outcome
    smooth: Outcome


def motion(trace: Trace, delay: float) -> UnitMotion | None:
    """Return the conveyor's motion, None without a distance sensor.

    Args:
        delay: from measuring to arrival of a distance [s].
    """
    if not len(trace.distances):
        return None
    stamps = trace.distances[:, 0] - delay
    times = np.arange(stamps[0], stamps[-1], STEP_S)
    readings = np.column_stack((stamps, trace.distances[:, 1]))
    positions, speeds, known = conveyor(readings, times)
    if not known.any():
        return None
    times = times[known]
    moved = UnitMotion(times, positions[known], speeds[known], np.zeros(len(times)))
    ways = np.zeros(len(times))
    for ramp, span in _spans(trace, delay, moved):
        p = _fitted(trace, ramp, delay, span, moved)[0]
        ways += _added(p, times - ramp.begin)
    return replace(moved, ways=ways)


def find_ramps(moved: UnitMotion) -> list[FittedRamp]:
    """Return stops and starts, in order."""
    running = float(np.quantile(moved.speeds, 0.95)) if len(moved.speeds) else 0.0
    if running < LEAST_SPEED:
        return []
    level = moved.speeds / running
    fast = level > MIDDLE
    ramps = []
    for k in np.flatnonzero(fast[1:] != fast[:-1]) + 1:
        starts = bool(fast[k])
        was = level[:k] < LOW if starts else level[:k] > HIGH
        comes = level[k:] > HIGH if starts else level[k:] < LOW
        if was.any() and comes.any():
            begin = int(np.flatnonzero(was)[-1])
            end = k + int(np.flatnonzero(comes)[0])
            # The thresholds cut off a share of the ramp at either end.
            more = (moved.times[end] - moved.times[begin]) * LOW / (HIGH - LOW)
            ramps.append(FittedRamp(starts, moved.times[begin] - more, moved.times[end] + more))
    return [ramp for i, ramp in enumerate(ramps) if not i or ramp.begin > ramps[i - 1].begin]


def identify_ramps(traces: Sequence[Trace], delay: float) -> tuple[RampClass, ...]:
    """Return the classes of ramps in recordings."""
    fitted: list[tuple[bool, Array, Array]] = []
    for trace in traces:
        moved = motion(trace, delay)
        if moved is None:
            continue
        for ramp, span in _spans(trace, delay, moved):
            _, values, deviations = _fitted(trace, ramp, delay, span, moved)
            fitted.append((ramp.starts, values, deviations))
    if not fitted:
        refusal = Refusal("the distance sensor sees no stop and no start")
        return (RampClass(False, refusal, refusal),)
    return tuple(_judged(group) for group in _classes(fitted))


def _spans(
    trace: Trace, delay: float, moved: UnitMotion
) -> list[tuple[FittedRamp, tuple[float, float]]]:
    """Return the ramps with the times from and to which readings belong to each, if any do."""
    ramps, stamps = find_ramps(moved), trace.distances[:, 0] - delay
    spans = [
        (
            ramp,
            (
                max(ramp.begin - AROUND_S, ramps[i - 1].end if i else -np.inf),
                min(ramp.end + AROUND_S, ramps[i + 1].begin if i + 1 < len(ramps) else np.inf),
            ),
        )
        for i, ramp in enumerate(ramps)
    ]
    # Readings that come in bursts show ramps within ramps: none is left between two of them.
    return [
        (ramp, (begin, end))
        for ramp, (begin, end) in spans
        if np.count_nonzero((stamps >= begin) & (stamps <= end)) >= LEAST_READINGS
    ]


def _classes(fitted: Sequence[tuple[bool, Array, Array]]) -> list[list[tuple[bool, Array, Array]]]:
    groups: list[list[tuple[bool, Array, Array]]] = []
    for each in sorted(fitted, key=lambda pair: (pair[0], -pair[1][0])):
        last = groups[-1][0] if groups else None
        near = last is not None and each[1][0] > (1.0 - SAME) * last[1][0]
        if last is not None and last[0] == each[0] and near:
            groups[-1].append(each)
        else:
            groups.append([each])
    return groups


def _judged(group: Sequence[tuple[bool, Array, Array]]) -> RampClass:
    values = np.array([value for _, value, _ in group])
    stated = np.array([deviation for _, _, deviation in group])
    weights = stated**-2.0
    mean = (weights * values).sum(axis=0) / weights.sum(axis=0)
    off = np.sqrt(((values - mean) ** 2).sum(axis=0) / max(len(group) - 1, 1) / len(group))
    deviation = np.maximum(weights.sum(axis=0) ** -0.5, off if len(group) > 1 else 0.0)
    basis = f"{len(group)} {'starts' if group[0][0] else 'stops'}"
    acceleration: Outcome = Estimate(float(mean[0]), float(deviation[0]), basis)
    if deviation[0] > LARGEST_SHARE * mean[0]:
        acceleration = Refusal(f"known only to +-{deviation[0]:.2g} m/s^2")
    return RampClass(
        group[0][0], acceleration, Estimate(float(mean[1]), float(deviation[1]), basis)
    )


def _fitted(
    trace: Trace, ramp: FittedRamp, delay: float, span: tuple[float, float], moved: UnitMotion
) -> tuple[Array, Array, Array]:
    """Return the fitted ramp, acceleration [m/s^2] and smooth time [s], and their deviations."""
    readings = trace.distances[~find_outliers(trace.distances[:, 1])] - np.array((delay, 0.0))
    inside = (readings[:, 0] >= span[0]) & (readings[:, 0] <= span[1])
    t, x = readings[inside, 0] - ramp.begin, readings[inside, 1]
    before, after = np.interp((span[0], span[1]), moved.times, moved.speeds)
    length = max(ramp.end - ramp.begin, BRIEF_S)
    guess = np.array((float(np.interp(0.0, t, x)), before, after, 0.0, length, 0.1))
    low = np.array((-np.inf, -1.0, -1.0, -AROUND_S, 0.02, SMOOTH_S[0]))
    high = np.array((np.inf, 2.0, 2.0, AROUND_S, 3.0 * length + 1.0, SMOOTH_S[1]))
    scale = np.array((1e-3, 0.1, 0.1, 0.1, 1.0, 0.1))

    def off(values: Array) -> Array:
        left: Array = _ramp(values, t) - x
        return left

    fit = least_squares(off, guess, bounds=(low, high), x_scale=scale)
    p: Array = np.asarray(fit.x)
    left = float(np.sum(fit.fun**2)) / max(len(t) - 6, 1)
    # A chain wanders slowly: its error counts about once in a quarter of a second.
    wander = WALK**2 * 0.25 * len(t) / max(float(np.ptp(t)), 0.25)
    J = fit.jac * scale
    covariance = np.linalg.pinv(J.T @ J, hermitian=True) * np.outer(scale, scale) * (left + wander)
    slope = np.array((0.0, -1.0, 1.0, 0.0, -(p[2] - p[1]) / p[4], 0.0)) / p[4]
    deviation = float(np.sqrt(max(slope @ covariance @ slope, 1e-12)))
    smooth = float(np.sqrt(max(covariance[5, 5], 1e-8)))
    return p, np.array((abs(p[2] - p[1]) / p[4], p[5])), np.array((deviation, smooth))


def _ramp(p: Array, t: Array) -> Array:
    """Return the position (m,): place, speeds before and after, onset, length, smooth time."""
    position: Array = float(p[0]) + float(p[1]) * t + _added(p, t)
    return position


def _added(p: Array, t: Array) -> Array:
    """Return what the ramp adds to the motion before it (m,)."""
    _, before, after, onset, length, smooth = p.tolist()
    S = max(smooth, 1e-4)

    def third(u: Array) -> Array:
        power: Array = np.maximum(u, 0.0) ** 3 / 6.0
        return power

    u = t - onset
    way = third(u) - third(u - S) - third(u - length) + third(u - length - S)
    added: Array = (after - before) / (length * S) * way
    return added


def findings(classes: Sequence[RampClass]) -> list[ReportLine]:
    """Return the lines of the report."""
    lines = []
    for each in classes:
        kind = "start" if each.starts else "stop"
        name = "acceleration" if each.starts else "deceleration"
        lines += [ReportLine(f"conveyor {kind} {name}", "m/s^2", 1.0, each.acceleration)]
        if isinstance(each.acceleration, Estimate):
            lines += [ReportLine(f"conveyor {kind} smooth time", "ms", 1e3, each.smooth)]
    return lines
