"""Direction, scale and ripple of the conveyor from images of the object by a robot at rest.

    p(t) = p_0 + a s(t) + swings,   s: reading of the distance sensor

The direction is a / |a|, the scale of the sensor |a|. A swing of the body is a sine whose
frequency is found in the residuals; without it, it would tilt the line.

Invariants:
- Pure. Too short a way, and a sensor that counts against the direction of travel, are refused.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import minimum_filter1d

from linemate.daemon.commissioning.postures import StandingPosture
from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.inputs import Inputs
from linemate.daemon.core.tracking.task import PoseFile
from linemate.daemon.identification.conveyor_motion import conveyor
from linemate.daemon.identification.outcome import Refusal

LEAST_WAY = 0.4  # of the object in the images of one posture [m]
LEAST_IMAGES = 60
DIRECTION_DEVIATION = 1.5e-3  # of an accepted direction [rad]
LARGEST_TURN = 0.1  # off the configured direction [rad]
SCALE_ERROR = 0.005  # from which on the sensor's scale is wrong
MOST_SINES = 2
FREQUENCIES_HZ = (0.2, 4.0)
GATE = 4.0
EVERY_S = 0.02  # of the speeds between which a running conveyor is judged
RUNNING = 0.9  # share of the largest speed
RAMP_S = 0.4  # left out at both ends of a running stretch [s]


@dataclass(frozen=True, slots=True, eq=False)
class ConveyorFrame:
    """How the conveyor runs.

    Attributes:
        axis: direction of travel in base, unit vector (3,).
        deviation: of the direction [rad].
        scale: way of the object for 1 m of the distance sensor.
        way: of the object in the images [m].
        residual: root mean square of the images off the line [m].
        speed: of the running conveyor [m/s], by the distance sensor.
        ripple: root mean square of that speed about its mean [m/s].
    """

    axis: Array
    deviation: float
    scale: float
    scale_deviation: float
    way: float
    residual: float
    speed: float
    ripple: float
    images: int


@dataclass(frozen=True, slots=True, eq=False)
class _Track:
    """Object in base over one posture: times (n,) [s], readings (n,) [m], positions (n, 3)."""

    times: Array
    readings: Array
    positions: Array


def find_frame(
    inputs: Sequence[Inputs],
    postures: Sequence[StandingPosture],
    camera: PoseFile,
    expected: Sequence[float],
    delay_s: float,
) -> ConveyorFrame | Refusal:
    """Return the conveyor's frame, or why the recording does not give it.

    Args:
        expected: configured direction of travel in base.
        delay_s: of the distance sensor [s].
    """
    readings = _readings(inputs, delay_s)
    tracks = [
        track
        for posture in postures
        if (track := _track(inputs, posture, camera, readings)) is not None
    ]
    ways = [float(np.ptp(track.readings)) for track in tracks]
    if not ways or max(ways) < LEAST_WAY:
        return Refusal(
            f"the object moved by {max(ways, default=0.0):.2f} m before a robot at rest, at least "
            f"{LEAST_WAY:.1f} m are needed. Let it pass while the camera sees it"
        )
    track = tracks[int(np.argmax(ways))]
    line, covariance, residual, images = _line(track)
    scale = float(np.linalg.norm(line))
    axis = line / scale
    across = np.eye(3) - np.outer(axis, axis)
    deviation = float(np.sqrt(np.trace(across @ covariance @ across))) / scale
    way = scale * float(np.ptp(track.readings))
    along = float(axis @ np.array(expected))
    if along < 0.0:
        return Refusal(
            f"the distance falls as the object travels along {_shown(np.array(expected))}. "
            "Turn the sensor's direction, or conveyor.axis"
        )
    turn = float(np.arccos(min(along, 1.0)))
    if turn > LARGEST_TURN:
        return Refusal(
            f"the object travels {1e3 * turn:.0f} mrad off conveyor.axis, at most "
            f"{1e3 * LARGEST_TURN:.0f} mrad. Check arm.camera_in_tcp, tcp_in_flange and the axis"
        )
    if deviation > DIRECTION_DEVIATION:
        return Refusal(
            f"the direction is known to +-{1e3 * deviation:.1f} mrad, at most "
            f"{1e3 * DIRECTION_DEVIATION:.1f} mrad. Let the object pass for a longer way"
        )
    speed, ripple = _running(readings)
    sigma = float(np.sqrt(axis @ covariance @ axis))
    return ConveyorFrame(
        axis, deviation, scale, sigma, way, residual, speed, ripple, images
    )  # fmt: skip


def _shown(axis: Array) -> str:
    return "(" + ", ".join(f"{part:.3f}" for part in axis) + ")"


def _readings(inputs: Sequence[Inputs], delay_s: float) -> Array:
    """Return times of measuring [s] and readings [m] of the distance sensor (n, 2)."""
    epoch = inputs[0].stamp_ns
    rows = [
        ((sample.stamp_ns - epoch) * 1e-9 - delay_s, sample.position)
        for each in inputs
        for sample in each.distance
    ]
    return np.array(rows).reshape(-1, 2)


def _track(
    inputs: Sequence[Inputs], posture: StandingPosture, camera: PoseFile, readings: Array
) -> _Track | None:
    """Return the object in base over a posture, None with too few images."""
    epoch = inputs[0].stamp_ns
    images = [
        ((image.exposure_ns - epoch) * 1e-9, image.position)
        for each in inputs
        for image in each.camera
    ]
    inside = [(t, p) for t, p in images if posture.begin_s <= t <= posture.end_s]
    if len(inside) < LEAST_IMAGES:
        return None
    times = np.array([t for t, _ in inside])
    seen = np.array([p for _, p in inside])
    mount = rotations.matrix(camera.quaternion)
    in_tcp = np.array(camera.position) + seen @ mount.T
    positions = posture.position + in_tcp @ posture.rotation.T
    where, _, known = conveyor(readings, times)
    if int(known.sum()) < LEAST_IMAGES:
        return None
    return _Track(times[known], where[known], positions[known])


def _line(track: _Track) -> tuple[Array, Array, float, int]:
    """Return the line's slope (3,), its covariance, the residual [m] and the images used."""
    t = track.times - track.times.mean()
    s = track.readings - track.readings.mean()
    columns = [s, np.ones_like(s)]
    kept = np.ones(len(s), dtype=bool)
    for sines in range(MOST_SINES + 1):
        for _ in range(3):
            A = np.column_stack(columns)
            solved = np.linalg.lstsq(A[kept], track.positions[kept], rcond=None)[0]
            left = track.positions - A @ solved
            scale = np.maximum(1.4826 * np.median(np.abs(left[kept]), axis=0), 1e-6)
            kept = (np.abs(left) <= GATE * scale).all(axis=1)
        if sines < MOST_SINES:
            w = 2.0 * np.pi * _loudest(t[kept], left[kept]) * t
            columns += [np.cos(w), np.sin(w)]
    freedom = max(1, int(kept.sum()) - A.shape[1])
    variances = (left[kept] ** 2).sum(axis=0) / freedom
    inflation = _correlation(left[kept])
    slope = float(np.linalg.pinv(A[kept].T @ A[kept])[0, 0])
    covariance = np.diag(variances) * slope * inflation
    residual = float(np.sqrt((left[kept] ** 2).sum(axis=1).mean()))
    return np.asarray(solved[0]), covariance, residual, int(kept.sum())


def _loudest(t: Array, left: Array) -> float:
    """Return the frequency of the largest sine in residuals (n, 3) [Hz]."""
    low = max(FREQUENCIES_HZ[0], 1.0 / float(np.ptp(t)))
    frequencies = np.arange(low, FREQUENCIES_HZ[1], 0.02)
    phases = np.exp(-2j * np.pi * frequencies[:, None] * t)
    power: Array = (np.abs(phases @ left) ** 2).sum(axis=1)
    return float(frequencies[int(power.argmax())])


def _correlation(left: Array) -> float:
    """Return by how much correlated residuals (n, 3) widen a variance."""
    step = float(np.sum(left[1:] * left[:-1])) / max(float(np.sum(left * left)), 1e-30)
    step = min(max(step, 0.0), 0.98)
    return (1.0 + step) / (1.0 - step)


def _running(readings: Array) -> tuple[float, float]:
    """Return mean [m/s] and ripple [m/s] of the running conveyor."""
    times = np.arange(readings[0, 0] + 0.2, readings[-1, 0] - 0.2, EVERY_S)
    _, speeds, known = conveyor(readings, times)
    speeds = speeds[known]
    if not len(speeds):
        return 0.0, 0.0
    fast = speeds > RUNNING * float(np.percentile(speeds, 95))
    # Ramps at both ends of a running stretch are no part of its speed.
    steady = minimum_filter1d(fast.astype(int), 2 * round(RAMP_S / EVERY_S) + 1, mode="constant")
    running = speeds[steady > 0] if steady.any() else speeds[fast]
    return float(running.mean()), float(running.std())
