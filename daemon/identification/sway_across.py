"""Sway of the body across the line, by the images of stops and starts through the filter.

The sway is smaller than a camera's slow noise, and it adds to the swings, to an error of the stamp
and to a bias that changes with the range. So the images go through the filter that the daemon has
across the conveyor, with one mode more, for each frequency of a grid. What the recordings say of
the gain of that mode is then put together: a gain belongs to all bodies.

Invariants:
- A sway is a swing with the longest lever, without a turn that a camera could see.
- A frequency without a gain beyond chance is none.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from msgspec import structs

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.across.transverse import Transverse
from linemate.daemon.core.tracking.classifiers.sway_bank import interpolated
from linemate.daemon.core.tracking.observation import PoseMeasurement
from linemate.daemon.core.tracking.settings import SwingMode, TrackingSettings
from linemate.daemon.identification.conveyor_ramps import UnitMotion, find_ramps, motion
from linemate.daemon.identification.outcome import Estimate, ReportLine
from linemate.daemon.identification.scene_fit import Camera, Views
from linemate.daemon.identification.trace import Trace

ACROSS = (0, 2)  # axes of c
LONGEST_LEVER = 10.0  # of a swing that only shifts the object [m/rad]
STEP_S = 0.02  # of the filter: a third of a radian of the fastest sway
SEARCH_HZ = (0.4, 2.5)
GRID = 0.06  # of the frequencies that are tried, as a share
DAMPING = 0.02  # of a body on a hanger: 10 s of images of 0.5 mm do not show it
GAIN_DEVIATION = 0.3  # prior of the gain, about 0
WIDENING = 4.0  # of an image's variance: neighbouring images are not independent
CHANCE = 5.0  # log odds of a gain against none; over the grid by chance less than 1 in 10
LEAST_SIGMA = 3.0  # of a gain, in deviations
CARS = 0.04, 0.05  # least spread of the frequency, and deviation of the gain: bodies differ
NEGLIGIBLE = 1e-3  # gain that a mode begins with; the settings take 0 for a mode without one


class _Gain(NamedTuple):
    """Gain of all recordings at one frequency: log odds against none, value, deviation."""

    odds: float
    value: float
    deviation: float


@dataclass(frozen=True, slots=True, eq=False)
class _Recorded:
    """Images of a stretch with a stop or a start.

    Attributes:
        images: time since the recording's begin [s], pose, and position of the unit [m].
        times, speeds: (n,) of the filter's steps, and the unit's speed at them [s, m/s].
    """

    images: list[tuple[float, PoseMeasurement, float]]
    times: Array
    speeds: Array


def identify_across(
    seen: Sequence[Views],
    bodies: Sequence[int],
    traces: Sequence[Trace],
    camera: Camera,
    tracking: TrackingSettings,
) -> list[SwingMode]:
    """Return the sways across the line that stops and starts excite, as swings of the object.

    Args:
        seen: images of stretches of free space.
        bodies: index of the recording of each.
        tracking: with the swings that the object is known to have.
    """
    motions = {i: motion(traces[i], tracking.distance.delay) for i in set(bodies)}
    stretches = [
        _stretch(view, moved, camera)
        for view, body in zip(seen, bodies, strict=True)
        if (moved := motions[body]) is not None and _has_ramp(view, moved)
    ]
    modes: list[SwingMode] = []
    for axis in ACROSS if stretches else ():
        mode = _likeliest_mode(stretches, tracking, axis)
        modes += [] if mode is None else [mode]
    return modes


def across_findings(modes: Sequence[SwingMode]) -> list[ReportLine]:
    """Return the lines of the report on sways across the line."""
    lines = []
    for mode in modes:
        name = "sway across, " + ("x" if mode.levers[0] else "z")
        basis = f"{mode.levers[0] + mode.levers[2]:+.0f} m/rad"
        frequency = Estimate(mode.frequency_hz, mode.spread * mode.frequency_hz, basis)
        gain = Estimate(mode.gain, mode.gain_deviation, basis)
        lines += [
            ReportLine(f"{name}: frequency", "Hz", 1.0, frequency, True),
            ReportLine(f"{name}: gain", "", 1.0, gain, True),
        ]
    return lines


def _has_ramp(view: Views, moved: UnitMotion) -> bool:
    begin, end = float(view.times[0]), float(view.times[-1])
    return any(begin < ramp.begin and ramp.end < end for ramp in find_ramps(moved))


def _stretch(view: Views, moved: UnitMotion, camera: Camera) -> _Recorded:
    """Return the images of a stretch as the filter takes them."""
    p, R = view.tcp_path.at(view.times)
    rates = view.tcp_path.rates(view.times)
    turned = R @ camera[1]
    arms = np.einsum("nij,nj->ni", R, camera[0] + view.positions @ camera[1].T)
    squared = (view.deviations**2).reshape(-1, 2, 3)
    variances = WIDENING * np.einsum("nkj,nij->nki", squared, turned * turned).reshape(-1, 6)
    # What an error of the stamp and a bias for each metre of range add.
    errors = np.zeros((len(p), 6, 4))
    errors[:, :, 0] = rates
    errors[:, :3, 0] += np.cross(rates[:, 3:], arms)
    errors[:, :3, 1:] = np.linalg.norm(view.positions, axis=1)[:, None, None] * turned
    columns = (p + arms, turned @ view.rotations, np.zeros(len(p)), variances, errors)
    poses = [PoseMeasurement(*values) for values in zip(*columns, strict=True)]
    units = np.interp(view.times, moved.times, moved.positions).tolist()
    times = np.arange(view.times[0], view.times[-1] + STEP_S, STEP_S)
    speeds = np.interp(times, moved.times, moved.speeds)
    return _Recorded(list(zip(view.times.tolist(), poses, units, strict=True)), times, speeds)


def _likeliest_mode(
    stretches: Sequence[_Recorded], tracking: TrackingSettings, axis: int
) -> SwingMode | None:
    """Return the likeliest sway along an axis of c, None if it is not beyond chance."""
    count = 1 + math.ceil(math.log(SEARCH_HZ[1] / SEARCH_HZ[0]) / GRID)
    logs = np.log(np.geomspace(*SEARCH_HZ, count))
    gains = [_gain(stretches, tracking, _mode(math.exp(f), axis)) for f in logs.tolist()]
    odds = np.array([each.odds for each in gains])
    best = int(odds.argmax())
    frequency, spread = interpolated(logs, odds, best)
    _, gain, deviation = gains[best]
    if not (odds[best] > CHANCE and LEAST_SIGMA * deviation < abs(gain) <= 2.0):
        return None
    mode = _mode(math.exp(frequency), axis, math.copysign(LONGEST_LEVER, gain))
    return replace(
        mode, spread=max(spread, CARS[0]), gain=abs(gain), gain_deviation=max(deviation, CARS[1])
    )


def _mode(frequency_hz: float, axis: int, lever: float = LONGEST_LEVER) -> SwingMode:
    """Return a sway along an axis of c whose gain is not known."""
    x, y, z = (lever if i == axis else 0.0 for i in range(3))
    return SwingMode(1, frequency_hz, DAMPING, (x, y, z), 0.0, NEGLIGIBLE, GAIN_DEVIATION)


def _gain(stretches: Sequence[_Recorded], tracking: TrackingSettings, mode: SwingMode) -> _Gain:
    filter_ = Transverse(tracking.fusion, (*tracking.swing, mode), tracking.camera)
    prior = GAIN_DEVIATION**-2.0
    information, weighted = prior, 0.0
    for stretch in stretches:
        known = _filtered(filter_, stretch, tracking)
        if known is not None:
            gain, variance = known
            information += max(1.0 / variance - prior, 0.0)
            weighted += gain / variance
    odds = 0.5 * (weighted * weighted / information - math.log(information / prior))
    return _Gain(odds, weighted / information, information**-0.5)


def _filtered(
    model: Transverse, stretch: _Recorded, tracking: TrackingSettings
) -> tuple[float, float] | None:
    """Return the gain of the last mode after all images, and its variance."""
    count = tracking.fusion.initial_images
    if len(stretch.images) <= count:
        return None
    state = model.initial([pose for _, pose, _ in stretch.images[:count]])
    left, i = stretch.images, count
    for t, speed in zip(stretch.times.tolist(), stretch.speeds.tolist(), strict=True):
        if t <= left[count - 1][0]:
            continue
        state = model.predict(state, STEP_S, speed=speed)
        while i < len(left) and left[i][0] <= t:
            exposed, pose, unit = left[i]
            measured = structs.replace(pose, delay=t - exposed)
            state, is_accepted = model.correct(
                state, measured, tracking.camera.gate, is_camera=True
            )
            if is_accepted:
                state = model.doubted(model.correct_along(state, measured, unit))
            i += 1
    return float(state.x[-1]), float(state.P[-1, -1])
