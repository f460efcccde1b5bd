"""Sensor noise: distance, camera, force and torque.

Invariants:
- Noise is the residual of a smooth motion over a short window; no model of the station is used.
- Outliers are counted apart and excluded from averages.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from linemate.daemon.core.horizon import Array
from linemate.daemon.identification import scene_fit as scenes
from linemate.daemon.identification.conveyor_motion import find_outliers
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal
from linemate.daemon.identification.scene_fit import Camera, SceneFit, Views
from linemate.daemon.identification.trace import Trace

DISTANCE_WINDOW = 0.3  # the conveyor's motion within it is a parabola [s]
WRENCH_WINDOW = 0.06  # the tool's oscillation within it is a cubic [s]
LEAST = 100
LEAST_VALUES = 5  # different readings, below which the resolution is not seen
MOVING = 5.0  # steps of the resolution within a window
GATE = 5.0
DECIMALS = 7  # used digits of a reading [m]
SLOPE_SHARE = 0.25  # largest deviation of an accepted slope, as a share of it
SLOPE_LEAST = 3e-4  # and in any case [m/m]
LAG_S = 0.05  # width of a class of lags between images [s]
LONGEST_LAG_S = 2.0  # lags beyond it show the fitted scene, not the camera [s]
MOST_SHARE = 0.8  # of a variance that is correlated: the rest is no camera's noise
LEAST_SHARE = 0.05  # of a variance, that correlated noise has to have to be there at all


@dataclass(frozen=True, slots=True)
class NoiseResult:
    """Outcomes about the sensors' noise.

    Attributes:
        distance: deviation of a reading, quantisation included [m].
        resolution: step of the readings [m].
        distance_outliers: share of the readings.
        lateral, lateral_slope, depth_factor, angle, angle_slope: of the camera, as in
            ``CameraNoise`` [m, m/m, 1, rad, rad/m].
        lasting, lasting_s: of the camera's noise that is correlated from image to image, as in
            ``CameraNoise``; ``lateral``, ``depth_factor`` and ``angle`` are without it.
        honesty: the camera's errors over those it states.
        camera_outliers: share of the images.
        force, torque: deviation of a reading, mean of the axes [N, Nm].
    """

    distance: Outcome
    resolution: Outcome
    distance_outliers: Outcome
    lateral: Outcome
    lateral_slope: Outcome
    depth_factor: Outcome
    angle: Outcome
    angle_slope: Outcome
    lasting: Outcome
    lasting_s: Outcome
    honesty: Outcome
    camera_outliers: Outcome
    force: Outcome
    torque: Outcome


def identify_noise(
    traces: Sequence[Trace], scene: SceneFit | None, seen: Sequence[Views], camera: Camera
) -> NoiseResult:
    """Return the noise of every sensor."""
    distance, resolution, wild = distance_noise([trace.distances for trace in traces])
    lateral, slope, depth, angle, angle_slope, lasting, lasting_s, honesty, wild_images = (
        camera_noise(scene, seen, camera)
    )
    force, torque = wrench_noise(traces)
    return NoiseResult(
        distance=distance,
        resolution=resolution,
        distance_outliers=wild,
        lateral=lateral,
        lateral_slope=slope,
        depth_factor=depth,
        angle=angle,
        angle_slope=angle_slope,
        lasting=lasting,
        lasting_s=lasting_s,
        honesty=honesty,
        camera_outliers=wild_images,
        force=force,
        torque=torque,
    )


def distance_noise(recordings: Sequence[Array]) -> tuple[Outcome, Outcome, Outcome]:
    """Return deviation, resolution and share of outliers of the distance sensor.

    Args:
        recordings: (d, 2) times [s] and readings [m] each.
    """
    long = [readings for readings in recordings if len(readings) >= LEAST]
    if not long:
        refusal = Refusal("fewer than a hundred readings of the distance sensor")
        return refusal, refusal, refusal
    wild = [find_outliers(readings[:, 1]) for readings in long]
    total = sum(len(readings) for readings in long)
    distinct = np.unique(np.round(np.concatenate([r[:, 1] for r in long]), DECIMALS))
    if len(distinct) < LEAST_VALUES:
        hidden = Refusal(
            f"{len(distinct)} different values in {total} readings: "
            "noise hides below the resolution. Let the conveyor move"
        )
        return hidden, hidden, hidden
    step = _resolution(distinct)
    deviation = _distance_deviation([r[~out] for r, out in zip(long, wild, strict=True)], step)
    count = sum(int(out.sum()) for out in wild)
    outliers = Estimate(
        count / total, math.sqrt(max(count, 1)) / total, f"{count} of {total} readings"
    )
    if step is None:
        none = Refusal("no step shows in the readings: it lies below their noise")
        return deviation, none, outliers
    basis = f"all of {total} readings are multiples of it"
    return deviation, Estimate(step, 1e-6, basis), outliers


def _distance_deviation(clean: Sequence[Array], step: float | None) -> Outcome:
    """Return the deviation of a reading, its resolution included.

    While the conveyor stands, a coarse reading repeats and hides its noise. So only windows count
    in which the conveyor moves over several steps.
    """
    windows = [w for r in clean for w in _windows(r[:, 0], r[:, 1:], DISTANCE_WINDOW, 2)]
    moving = [e for e, way in windows if step is None or way > MOVING * step]
    basis = " while the conveyor moves" if step is not None else ""
    if sum(map(len, moving)) < LEAST:
        if step is not None:
            return Refusal(
                f"the conveyor hardly moves: noise hides below the resolution, {1e3 * step:.2g} mm"
            )
        return Refusal("fewer than a hundred readings of the distance sensor")
    e = np.concatenate(moving)[:, 0]
    e = e[np.abs(e) < GATE * max(1.4826 * float(np.median(np.abs(e))), 1e-9)]
    deviation = float(np.sqrt(np.mean(e * e)))
    return Estimate(deviation, deviation / math.sqrt(2.0 * len(e)), f"{len(e)} readings{basis}")


def _resolution(distinct: Array) -> float | None:
    """Return the step of which all differences of ascending readings are multiples, or None."""
    step = float(np.diff(distinct).min())
    off = (distinct - distinct[0]) / step
    if step < 30.0 * 10.0**-DECIMALS or float(np.abs(off - np.round(off)).max()) > 0.1:
        return None
    return float(distinct[-1] - distinct[0]) / round(float(off[-1]))


def _windows(times: Array, values: Array, window: float, order: int) -> list[tuple[Array, float]]:
    """Return residuals (m, d) of polynomials over short windows, and the motion in each window.

    Residuals are scaled for the degrees of freedom of the polynomial.
    """
    windows = []
    begin = 0
    while begin < len(times):
        end = int(np.searchsorted(times, times[begin] + window))
        t, y = times[begin:end], values[begin:end]
        begin = end
        free = len(t) - order - 1
        if free < 3:
            continue
        A = np.vander((t - t.mean()) / window, order + 1)
        smooth = A @ np.linalg.lstsq(A, y, rcond=None)[0]
        scale = math.sqrt(len(t) / free)
        windows.append(((y - smooth) * scale, float(np.ptp(smooth[:, 0]))))
    return windows


def camera_noise(
    scene: SceneFit | None, seen: Sequence[Views], camera: Camera
) -> tuple[Outcome, ...]:
    """Return the camera's outcomes, in the order of ``NoiseResult``."""
    if scene is None:
        return (Refusal("too few images of the object in free space"),) * 9
    errors = np.concatenate(
        [scenes.residuals(scene, i, view, camera) for i, view in enumerate(seen)]
    )
    stated = np.concatenate([view.deviations for view in seen])
    ranges = np.concatenate([view.ranges for view in seen])
    weighed = np.abs(errors / stated)
    scale = 1.4826 * float(np.median(weighed))
    good = weighed.max(axis=1) < GATE * scale
    wild = len(good) - int(good.sum())
    e, d = errors[good], ranges[good]
    basis = f"{len(e)} images from {d.min():.2f} to {d.max():.2f} m"
    position = _growing(e[:, :3], d, basis, depth=True)
    angle = _growing(e[:, 3:], d, basis, depth=False)
    ratio = float(np.sqrt(np.mean((e / stated[good]) ** 2)))
    honesty = Estimate(ratio, ratio / math.sqrt(12.0 * len(e)), basis)
    outliers = Estimate(wild / len(good), math.sqrt(max(wild, 1)) / len(good), basis)
    if not isinstance(position[0], Estimate) or not isinstance(angle[0], Estimate):
        unknown = Refusal("the camera's noise is not known")
        return (*position, *angle, unknown, unknown, honesty, outliers)
    level = np.column_stack([_level(outcomes[:2], ranges) for outcomes in (position, angle)])
    # Along the line of sight other errors are larger.
    units = errors[:, [0, 1, 3, 4, 5]] / level[:, [0, 0, 1, 1, 1]]
    ends = np.cumsum([len(view.times) for view in seen])[:-1]
    blocks = [
        (view.times[kept], rows[kept])
        for view, rows, kept in zip(seen, np.split(units, ends), np.split(good, ends), strict=True)
    ]
    share, lasting_s = correlated_share(blocks)
    position, angle, lasting = _without(position, angle, share)
    return (*position, *angle, lasting, lasting_s, honesty, outliers)


def _level(outcomes: Sequence[Outcome], ranges: Array) -> Array:
    """Return the deviation (m,) at distances (m,)."""
    zero, slope = (o.value if isinstance(o, Estimate) else 0.0 for o in outcomes)
    return np.asarray(zero + slope * ranges)


def correlated_share(blocks: Sequence[tuple[Array, Array]]) -> tuple[Outcome, Outcome]:
    """Return the share of a variance that is correlated from image to image, and for how long [s].

    The fit of ``a exp(-lag / tau)`` to the autocovariance of errors (Gauss-Markov). Independent
    noise is in lag 0 alone, which does not count.

    Args:
        blocks: exposures (m,) [s] and errors (m, n) of variance 1 of each recording.
    """
    classes = round(LONGEST_LAG_S / LAG_S)
    lags, sums, counts = np.zeros(classes), np.zeros(classes), np.zeros(classes)
    images, whole_s = 0, 0.0
    for exposures, seen in blocks:
        order = np.argsort(exposures)
        times, errors = exposures[order], seen[order]
        # Diagonal by diagonal: all pairs of an hour's images would not fit into memory.
        for step in range(1, len(times)):
            late = times[step:] - times[:-step]
            near = late < LONGEST_LAG_S
            if not near.any():
                break
            where = (late[near] / LAG_S).astype(int)
            products = (errors[step:] * errors[:-step])[near].mean(axis=1)
            lags += np.bincount(where, late[near], classes)[:classes]
            sums += np.bincount(where, products, classes)[:classes]
            counts += np.bincount(where, minlength=classes)[:classes]
        images, whole_s = images + len(times), whole_s + float(np.ptp(times))
    known = counts > 0.0
    if images < LEAST or known.sum() < 3:
        refusal = Refusal("fewer than a hundred images of the object in free space")
        return refusal, refusal
    lag, covariance, weight = (
        lags[known] / counts[known],
        sums[known] / counts[known],
        counts[known],
    )
    best = (math.inf, 0.0, LAG_S)
    for tau in np.geomspace(LAG_S, LONGEST_LAG_S, 40):
        shape = np.exp(-lag / tau)
        share = float((weight * shape).dot(covariance) / (weight * shape).dot(shape))
        cost = float(weight.dot((covariance - share * shape) ** 2))
        best = min(best, (cost, share, float(tau)))
    _, share, tau = best
    n = blocks[0][1].shape[1]
    # Values that are correlated over tau count once in 2 tau.
    deviation = math.sqrt(2.0 / (n * whole_s / (2.0 * tau))) * max(share, 1.0 / math.sqrt(images))
    basis = f"{images} images"
    if share < max(LEAST_SHARE, 2.0 * deviation):
        return Estimate(0.0, deviation, basis), Refusal("each image errs by itself")
    share = min(share, MOST_SHARE)
    return Estimate(share, deviation, basis), Estimate(tau, tau * deviation / share, basis)


def _without(
    position: Sequence[Outcome], angle: Sequence[Outcome], share: Outcome
) -> tuple[tuple[Outcome, ...], tuple[Outcome, ...], Outcome]:
    """Return deviations without their correlated part, and that part in units of them."""
    if not isinstance(share, Estimate):
        return tuple(position), tuple(angle), share
    rest = math.sqrt(1.0 - share.value)
    smaller = [
        replace(outcome, value=outcome.value * rest) if isinstance(outcome, Estimate) else outcome
        for outcome in (*position[:2], *angle[:2])
    ]
    depth = position[2]
    if isinstance(depth, Estimate):
        left = max(depth.value**2 - share.value, 0.25 * depth.value**2)
        depth = replace(depth, value=math.sqrt(left) / rest)
    part = math.sqrt(share.value) / rest
    lasting = Estimate(part, share.deviation / max(2.0 * part, 0.1), share.basis)
    return (smaller[0], smaller[1], depth), (smaller[2], smaller[3]), lasting


def _growing(e: Array, d: Array, basis: str, *, depth: bool) -> tuple[Outcome, ...]:
    """Return deviation at distance 0, its slope and, for positions, the factor along z.

    The likelihood of errors that grow with the distance; its curvature gives the deviations.
    """
    centre = float(d.mean())

    def cost(theta: Array) -> float:
        sigma = math.exp(theta[0]) + theta[1] * (d - centre)
        if float(sigma.min()) <= 0.0:
            return 1e12
        factor = math.exp(theta[2]) if depth else 1.0
        total = 0.0
        for i in range(3):
            s = sigma * (factor if i == 2 else 1.0)
            total += float(np.sum(np.log(s) + 0.5 * (e[:, i] / s) ** 2))
        return total

    level = math.log(float(np.sqrt(np.mean(e[:, :2] ** 2))))
    start = np.array((level, 0.0, 0.0))[: 3 if depth else 2]
    solved = minimize(cost, start, method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-6})
    theta = solved.x
    covariance = np.linalg.pinv(_curvature(cost, theta), hermitian=True)
    middle, slope = math.exp(theta[0]), float(theta[1])
    zero = middle - slope * centre
    row = np.array((middle, -centre, 0.0))[: len(theta)]
    deviations = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    deviation_at_zero = float(np.sqrt(max(row @ covariance @ row, 0.0)))
    outcomes: tuple[Outcome, ...]
    limit = max(SLOPE_SHARE * abs(slope), SLOPE_LEAST)
    if deviations[1] > limit or zero <= 0.0:
        refusal = Refusal(
            f"the images lie too close together ({basis}): {1e3 * middle:.2f} at {centre:.2f} m, "
            f"growing by {1e3 * slope:.1f} +-{1e3 * deviations[1]:.1f} a metre [mm or mrad]"
        )
        outcomes = (refusal, refusal)
    else:
        outcomes = (
            Estimate(zero, deviation_at_zero, basis),
            Estimate(slope, float(deviations[1]), basis),
        )
    if depth:
        factor = math.exp(theta[2])
        outcomes = (*outcomes, Estimate(factor, factor * float(deviations[2]), basis))
    return outcomes


def _curvature(cost: Callable[[Array], float], theta: Array) -> Array:
    """Return the second derivatives of a cost at its minimum."""
    steps = np.array((1e-2, 1e-5, 1e-2))[: len(theta)]
    n = len(theta)
    H = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            a, b = np.zeros(n), np.zeros(n)
            a[i], b[j] = steps[i], steps[j]
            around = (
                cost(theta + a + b)
                - cost(theta + a - b)
                - cost(theta - a + b)
                + cost(theta - a - b)
            )
            H[i, j] = around / (4.0 * steps[i] * steps[j])
    return H


def wrench_noise(traces: Sequence[Trace]) -> tuple[Outcome, Outcome]:
    """Return the deviation of a force and of a torque, in free space."""
    left: list[Array] = []
    for trace in traces:
        times = trace.wrenches[:, 0]
        free = ~trace.in_contact(times, 0.5)
        windows = _windows(times[free], trace.wrenches[free, 1:], WRENCH_WINDOW, 3)
        left += [e for e, _ in windows]
    e = np.concatenate(left) if left else np.zeros((0, 6))
    if len(e) < LEAST:
        refusal = Refusal("fewer than a hundred wrenches in free space")
        return refusal, refusal
    spread = 1.4826 * np.median(np.abs(e), axis=0)
    keep = (np.abs(e) < GATE * np.maximum(spread, 1e-12)).all(axis=1)
    deviations = np.sqrt(np.mean(e[keep] ** 2, axis=0))
    basis = f"{int(keep.sum())} wrenches in free space"
    count = 3.0 * float(keep.sum())
    force, torque = (float(np.sqrt(np.mean(part**2))) for part in (deviations[:3], deviations[3:]))
    return (
        Estimate(force, force / math.sqrt(2.0 * count), basis),
        Estimate(torque, torque / math.sqrt(2.0 * count), basis),
    )
