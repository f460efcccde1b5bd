"""Swings of the object: frequency, damping, axis and levers, from images and robot poses.

Invariants:
- Peaks of the spectrum are tried strongest first. Each must be significant against chance.
- ``scene_fit`` then fits everything at once.
- A setting describes a swing about one axis of c. An oblique swing is refused.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2 as chi2_law

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.settings import SwingMode
from linemate.daemon.identification import scene_fit as scenes
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal
from linemate.daemon.identification.scene_fit import Camera, Mode, SceneFit, Views
from linemate.daemon.identification.trace import Mask

SEARCH_HZ = (0.15, 3.0)
MOST = 3  # modes
CHANCE = 1e-4  # probability of a peak by chance
LEAST_ANGLE = 2e-4  # [rad]
PERIODS = 3.0
OBLIQUE = math.radians(10.0)
FREQUENCY_SHARE = 0.02
DAMPING_DEVIATION = 0.01
LEVER_DEVIATION = 0.05  # largest [m/rad], and as a share of the longest lever


@dataclass(frozen=True, slots=True)
class SwingResult:
    """One swing.

    Attributes:
        mode: what goes into an overlay, None if refused.
        frequency_hz, damping, oblique: outcomes; the last one is the angle between the swing's
            axis and the nominal frame's [rad].
        levers: displacement for each radian, three outcomes [m/rad].
    """

    mode: SwingMode | None
    frequency_hz: Outcome
    damping: Outcome
    oblique: Outcome
    levers: tuple[Outcome, Outcome, Outcome]


def find_swings(seen: Sequence[Views], camera: Camera) -> SceneFit | None:
    """Return the fitted scene with every significant swing, None without images."""
    if not seen:
        return None
    scene = SceneFit(
        modes=(),
        rests=tuple(scenes.at_rest(view, camera) for view in seen),
        hand_eye=np.zeros(6),
        stamp_error=0.0,
        late=0.0,
        covariance=np.zeros((0, 0)),
        rest_deviations=np.zeros((0, 6)),
        chi2=1.0,
    )
    scene, kept = scenes.fit(scene, seen, camera)
    for _ in range(MOST):
        grown = _with_strongest(scene, seen, camera, kept)
        if grown is None:
            break
        scene, kept = scenes.fit(grown, seen, camera)
    return scene


def _with_strongest(
    scene: SceneFit, seen: Sequence[Views], camera: Camera, kept: tuple[Mask, ...]
) -> SceneFit | None:
    """Return the scene with one swing more, None if what is left is chance."""
    rows = [_components(scene, i, view, camera, kept[i]) for i, view in enumerate(seen)]
    longest = max(float(np.ptp(t)) for t, _, _ in rows)
    if longest <= 0.0:
        return None
    grid = np.arange(SEARCH_HZ[0], SEARCH_HZ[1], 0.15 / longest)
    grid = grid[grid * longest >= 1.5]
    if not len(grid):
        return None
    gains = np.zeros(len(grid))
    for t, e, sigma in rows:
        weighed = e / sigma
        scale = np.maximum(1.4826 * np.median(np.abs(weighed), axis=0), 1e-9)
        # Sines that are there widen the median itself; chance is judged against no less than 1.
        turns = np.exp(-2j * math.pi * np.outer(grid, t))
        power = np.abs(turns @ (weighed / np.minimum(scale, 2.0))) ** 2 * 2.0 / len(t)
        gains += power.sum(axis=1)
    peak = int(np.argmax(gains))
    if float(chi2_law.sf(gains[peak], 12 * len(rows))) * len(grid) > CHANCE:
        return None
    mode, amplitudes = _first_guess(float(grid[peak]), rows)
    if float(np.abs(np.array(amplitudes)).max()) < LEAST_ANGLE:
        return None
    rests = tuple(
        replace(rest, amplitudes=np.vstack((rest.amplitudes, amplitude)))
        for rest, amplitude in zip(scene.rests, amplitudes, strict=True)
    )
    return replace(scene, modes=(*scene.modes, mode), rests=rests)


Components = tuple[Array, Array, Array]
"""Times since the middle (m,), what is left (m, 6) in c, and its deviations (m, 6)."""


def _components(scene: SceneFit, index: int, view: Views, camera: Camera, kept: Mask) -> Components:
    """Return what the scene leaves of one recording, along and about the axes of c."""
    e = scenes.residuals(scene, index, view, camera)[kept]
    _, R = view.tcp_path.at(view.times[kept])
    R = R @ camera[1]
    variances = view.deviations[kept] ** 2
    in_c = np.empty_like(e)
    sigma = np.empty_like(e)
    for part in (slice(0, 3), slice(3, 6)):
        in_c[:, part] = np.einsum("nij,nj->ni", R, e[:, part])
        sigma[:, part] = np.sqrt(np.einsum("nij,nj->ni", R * R, variances[:, part]))
    sigma[:, 1] = np.hypot(sigma[:, 1], scenes.ALONG)
    in_c -= np.median(in_c, axis=0)
    return view.times[kept] - view.middle, in_c, sigma


def _first_guess(frequency_hz: float, rows: Sequence[Components]) -> tuple[Mode, list[Array]]:
    """Return a mode at a frequency, and its cosine and sine part (2,) in each recording."""
    parts = []
    for t, e, sigma in rows:
        w = 2.0 * math.pi * frequency_hz * t
        A = np.column_stack((np.cos(w), np.sin(w), np.ones_like(t)))
        columns = [
            np.linalg.lstsq(A / s[:, None], y / s, rcond=None)[0][:2]
            for y, s in zip(e.T, sigma.T, strict=True)
        ]
        parts.append(np.array(columns))  # (6, 2)
    together = np.hstack(parts)  # (6, 2 recordings)
    turns = together[3:]
    axis = int(np.argmax(np.sum(turns * turns, axis=1)))
    leading = together[3 + axis]
    # One shape for all recordings: regress every component on the leading turn.
    shape = together @ leading / float(leading @ leading)
    direction, levers = shape[3:].tolist(), shape[:3].tolist()
    direction[axis] = 1.0
    mode = Mode(
        axis, frequency_hz, 0.003, (direction[0], direction[1], direction[2]),
        (levers[0], levers[1], levers[2]),
    )  # fmt: skip
    return mode, [part[3 + axis] for part in parts]


def identify_swings(scene: SceneFit | None, seen: Sequence[Views]) -> tuple[SwingResult, ...]:
    """Return every swing of a fitted scene, or one refusal.

    Args:
        scene: as ``find_swings`` returns it.
        seen: the images it rests on.
    """
    if scene is None:
        return (_refused("too few images of the object in free space"),)
    if not scene.modes:
        longest = max(float(np.ptp(view.times)) for view in seen)
        return (_refused(f"nothing swings beyond the noise in {longest:.0f} s of images"),)
    return tuple(_judged(scene, m, seen) for m in range(len(scene.modes)))


def _refused(reason: str) -> SwingResult:
    refusal = Refusal(reason)
    return SwingResult(None, refusal, refusal, refusal, (refusal, refusal, refusal))


def _judged(scene: SceneFit, m: int, seen: Sequence[Views]) -> SwingResult:
    mode = scene.modes[m]
    part = slice(7 * m, 7 * m + 7)
    deviations = np.sqrt(np.maximum(scene.covariance[part, part].diagonal(), 0.0))
    images = sum(len(view.times) for view in seen)
    longest = max(float(np.ptp(view.times)) for view in seen)
    angle = max(float(np.hypot(*rest.amplitudes[m])) for rest in scene.rests)
    basis = f"{images} images in {len(seen)} recordings, up to {1e3 * angle:.1f} mrad"
    if longest * mode.frequency_hz < PERIODS:
        return _refused(f"too short: {longest:.1f} s of images for {mode.frequency_hz:.2f} Hz")
    if not deviations[0] < FREQUENCY_SHARE * mode.frequency_hz:
        return _refused(f"its frequency is known only to +-{deviations[0]:.2g} Hz")
    first, second = scenes.others(mode.axis)
    tilt = math.atan(math.hypot(mode.direction[first], mode.direction[second]))
    oblique = Estimate(tilt, float(np.hypot(*deviations[2:4])), basis)
    damping = min(max(mode.damping, 0.0), 0.49)
    outcomes = [
        Estimate(value, float(deviation), basis)
        for value, deviation in zip(mode.levers, deviations[4:], strict=True)
    ]
    limit = LEVER_DEVIATION * max(1.0, float(np.abs(mode.levers).max()))
    reason = None
    if tilt > OBLIQUE and tilt > OBLIQUE + 2.0 * oblique.deviation:
        reason = f"its axis lies {math.degrees(tilt):.0f} deg off the nearest of the nominal frame"
    elif float(deviations[4:].max()) > limit:
        reason = f"its levers are known only to +-{float(deviations[4:].max()):.2g} m/rad"
    elif deviations[1] > DAMPING_DEVIATION:
        reason = f"its damping is known only to +-{deviations[1]:.2g}"
    model = None
    if reason is None:
        model = SwingMode(mode.axis, mode.frequency_hz, damping, mode.levers)
    levers: tuple[Outcome, Outcome, Outcome] = (outcomes[0], outcomes[1], outcomes[2])
    if reason is not None:
        levers = (Refusal(reason), Refusal(reason), Refusal(reason))
    return SwingResult(
        model,
        Estimate(mode.frequency_hz, float(deviations[0]), basis),
        Estimate(damping, float(deviations[1]), basis),
        oblique,
        levers,
    )
