"""Recorded runs made of the plants' own models, whose truth is known."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import butter, filtfilt

from linemate.daemon.core import rotations
from linemate.daemon.identification.trace import Images, Trace
from linemate.simulators.plants import rotation
from linemate.simulators.plants.effector import EffectorPlant
from linemate.simulators.plants.scenario import Axis, Effector
from linemate.simulators.plants.servo_plant import ServoBank

Array = NDArray[np.float64]

CYCLE_S = 0.012
EPOCH_NS = 5_000_000_000


def wander(n: int, axes: int, seed: int, band_hz: float = 1.5, size: float = 0.02) -> Array:
    """Setpoints (n, axes) that wander within a band, from rest."""
    b, a = butter(3, 2.0 * band_hz * CYCLE_S)
    noise = np.random.default_rng(seed).normal(size=(n, axes))
    begun = np.minimum(np.arange(n) * CYCLE_S, 1.0)[:, None]
    path: Array = np.asarray(filtfilt(b, a, noise, axis=0)) * begun * size
    return path - path[0]


def answers(axes: tuple[Axis, ...], commands: Array, substeps: int = 3) -> Array:
    """What the plant's servos answer (n, axes), at the instants of the telegrams."""
    bank = ServoBank(axes, tuple(commands[0]), CYCLE_S, substeps)
    measured = np.zeros_like(commands)
    index = 0
    for k, command in enumerate(commands):
        bank.begin_cycle(k)
        measured[k] = bank.positions
        bank.command(k, 0.0, tuple(command.tolist()))
        for _ in range(substeps):
            bank.advance(index)
            index += 1
    return measured


def no_images() -> Images:
    """A camera that saw nothing."""
    return Images(np.zeros(0), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 6)))


def trace(
    commands: Array | None = None,
    measured: Array | None = None,
    tcp: Array | None = None,
    *,
    distances: Array | None = None,
    images: Images | None = None,
    wrenches: Array | None = None,
    contact: Array | None = None,
) -> Trace:
    """A trace with as much on it as is given."""
    n = len(next(x for x in (commands, tcp, np.zeros((100, 1))) if x is not None))
    return Trace(
        cycle_s=CYCLE_S,
        commands=np.zeros((n, 7)) if commands is None else commands,
        answers=np.zeros((n, 7)) if measured is None else measured,
        robot_times=np.arange(n) * CYCLE_S,
        tcp=np.zeros((n, 6)) if tcp is None else tcp,
        distances=np.zeros((0, 2)) if distances is None else distances,
        images=no_images() if images is None else images,
        wrenches=np.zeros((0, 7)) if wrenches is None else wrenches,
        contact=np.zeros((0, 2)) if contact is None else contact,
        motors=np.zeros((n, 7)),
    )


def quintic(t: Array, begin: float, duration: float) -> Array:
    """A step from 0 to 1 without jerk at its ends."""
    s = np.clip((t - begin) / duration, 0.0, 1.0)
    step: Array = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    return step


def ringing(effector: Effector, seed: int, moves: int = 6, size: float = 0.03) -> Trace:
    """A tool that is moved along and about each of its axes, with rest behind each move."""
    every = 1.6
    n = round(moves * every / CYCLE_S)
    t = np.arange(n) * CYCLE_S
    tcp = np.zeros((n, 6))
    for i in range(moves):
        tcp[:, i % 6] += size * quintic(t, 0.1 + i * every, 0.35)
    fine = np.arange(0.0, t[-1], 0.004)
    path = CubicSpline(t, tcp)(fine)
    plant = EffectorPlant(effector, 0.004)
    rng = np.random.default_rng(seed)
    spread = np.repeat((0.05e-3, 0.2e-3), 3)
    wrenches = np.zeros((len(fine), 7))
    wrenches[:, 0] = fine
    before = _pose(path[0])
    for row, here in zip(wrenches, path, strict=True):
        after = _pose(here)
        plant.swing_free(before, after)
        before = after
        deflection = np.array(plant.deflection) + spread * rng.normal(size=6)
        row[1:] = np.array(effector.stiffness) * deflection
    return trace(tcp=tcp, wrenches=wrenches)


def _pose(row: Array) -> rotation.Pose:
    x, y, z, a, b, c = row.tolist()
    return (x, y, z), rotation.exp((a, b, c))


@dataclass(frozen=True)
class Sight:
    """A camera before an object, as it really is."""

    seconds: float = 20.0
    speed: float = 0.0
    swings: tuple[tuple[float, float, tuple[float, ...], tuple[float, ...]], ...] = (
        (0.62, 0.002, (0.0, 0.006, 0.0), (0.9, 0.0, -0.3)),
    )
    """Frequency, damping, amplitude about each axis [rad], lever arm [m]."""
    hand_eye: tuple[float, ...] = (0.0,) * 6
    stamp_error: float = 0.0
    turning: float = 0.15
    moving: float = 0.05
    distance: float = 0.4
    range_swing: float = 0.1
    offset: float = 0.0
    covariance: bool = True
    outliers: float = 0.02
    seed: int = 0
    slow: float = 0.0
    """Errors correlated over 0.5 s, in deviations of the white ones."""


CAMERA = (np.array((-0.10, 0.0, -0.15)), np.eye(3))


def seen(sight: Sight) -> Trace:
    """What is recorded of an object that swings before a tool that moves."""
    rng = np.random.default_rng(sight.seed)
    n = round((sight.seconds + 1.0) / CYCLE_S)
    t = np.arange(n) * CYCLE_S
    tcp = np.zeros((n, 6))
    rates = (0.31, 0.43, 0.23, 0.37, 0.29, 0.19)
    for i, rate in enumerate(rates):
        size = sight.turning if i >= 3 else sight.moving
        if i == 2:
            size = sight.range_swing
        tcp[:, i] = size * np.sin(2.0 * math.pi * rate * t + i)
    tcp[:, 1] += sight.speed * t
    way = CubicSpline(t, tcp)
    exposures = np.arange(0.2, sight.seconds, 0.025)
    truth = exposures + sight.stamp_error
    rest = rotations.exp(np.array((0.1, -0.2, 0.25)))
    positions = np.zeros((len(exposures), 3))
    turned = np.zeros((len(exposures), 3, 3))
    deviations = np.zeros((len(exposures), 6))
    kept = math.exp(-0.025 / 0.5)
    slow = np.zeros(6)
    mount = CAMERA[0] + np.array(sight.hand_eye[:3])
    mounted = CAMERA[1] @ rotations.exp(np.array(sight.hand_eye[3:]))
    for i, (now, pose) in enumerate(zip(truth, way(truth), strict=True)):
        place, body = _object(sight, float(now))
        place += (0.03, 0.02, sight.distance)
        R = rotations.exp(pose[3:])
        far = float(np.linalg.norm(R.T @ (place - pose[:3])))
        eye, view = pose[:3] + R @ mount, R @ mounted
        lateral, angle = 0.25e-3 + 1.2e-3 * far, 0.6e-3 + 4e-3 * far
        deviations[i] = (lateral, lateral, 2.0 * lateral, angle, angle, angle)
        if sight.slow:
            slow = kept * slow + sight.slow * math.sqrt(1.0 - kept**2) * rng.normal(size=6)
        noise = deviations[i] * (rng.normal(size=6) + slow)
        positions[i] = view.T @ (place - eye) + noise[:3]
        if rng.random() < sight.outliers:
            positions[i] += rng.uniform(-0.03, 0.03, 3)
        turned[i] = rotations.exp(noise[3:]) @ view.T @ body @ rest
    stamps = np.arange(0.0, sight.seconds + 1.0, CYCLE_S)
    readings = sight.offset + sight.speed * stamps + 0.25e-3 * rng.normal(size=len(stamps))
    readings = np.round(readings, 3)
    stated = deviations if sight.covariance else np.full_like(deviations, np.nan)
    images = Images(exposures, exposures + 0.1, positions, turned, stated)
    return trace(tcp=tcp, distances=np.column_stack((stamps, readings)), images=images)


def _object(sight: Sight, t: float) -> tuple[Array, Array]:
    body = np.eye(3)
    place = np.array((0.0, sight.speed * t, 0.0))
    for frequency_hz, damping, amplitude, lever in sight.swings:
        w = 2.0 * math.pi * frequency_hz
        angle = math.exp(-damping * w * t) * math.cos(w * t + 0.7)
        turn = rotations.exp(np.array(amplitude) * angle)
        place = place + turn @ np.array(lever) - np.array(lever)
        body = turn @ body
    return place, body


def without(trace_: Trace, **changes: object) -> Trace:
    """A trace with parts exchanged."""
    return replace(trace_, **changes)  # type: ignore[arg-type]
