"""Runs of the filter across the conveyor, with an object that swings by its own formula."""

import math
from dataclasses import replace

import numpy as np

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.across.transverse import Transverse
from linemate.daemon.core.tracking.across.transverse_state import TransverseState
from linemate.daemon.core.tracking.observation import PoseMeasurement
from linemate.daemon.core.tracking.settings import CameraNoise, FusionSettings, SwingMode

T0 = 0.012
SPEED = 0.106  # of the conveyor [m/s]
FRAME = 0.025  # of a camera with 40 Hz
MODE = SwingMode()
EXACT = replace(MODE, spread=0.0)
FILTER = Transverse(FusionSettings(), (MODE,))
GATE = CameraNoise().gate
OMEGA = 2.0 * math.pi * MODE.frequency_hz
VARIANCE = np.array((0.3e-3, 0.3e-3, 0.6e-3, 0.8e-3, 0.8e-3, 0.8e-3)) ** 2
OFF = math.radians(23.0) * np.array((0.4, -0.5, 0.768))
PLACE = np.array((-1.06, 0.3, 2.17))


def angle(t: float | Array, amplitude: float = 0.006, phase: float = 0.7) -> Array:
    """The swing (8), written by its own formula: begins at ``phase`` and dies out."""
    decay = np.exp(-MODE.damping * OMEGA * np.asarray(t))
    return np.asarray(amplitude * decay * np.cos(OMEGA * np.asarray(t) + phase))


def seen(
    place: Array, rotation: Array, swing: float, delay: float, noise: Array | None = None
) -> PoseMeasurement:
    """What is measured of an object at rest at ``place`` that is turned by ``swing`` about y."""
    off = np.zeros(6) if noise is None else noise
    position = place + swing * np.array(MODE.levers) + off[:3]
    turned = rotations.exp(off[3:]) @ rotations.exp(np.array((0.0, swing, 0.0))) @ rotation
    return PoseMeasurement(position, turned, delay, VARIANCE)


def run(
    seconds: float,
    *,
    amplitude: float = 0.0,
    delay: float = 0.1,
    jitter: float = 0.0,
    seed: int | None = None,
    rotation: Array | None = None,
) -> TransverseState:
    """A filter that starts as the tracker starts it and then runs at 12 ms with 40 images/s."""
    rng = np.random.default_rng(seed)
    turned = rotations.exp(OFF) if rotation is None else rotation

    def look(now: float) -> PoseMeasurement:
        late = delay + jitter * rng.uniform(-1.0, 1.0)
        noise = rng.normal(0.0, np.sqrt(VARIANCE)) if seed is not None else None
        return seen(PLACE, turned, float(angle(now - late, amplitude)), late, noise)

    state = FILTER.initial([look(-FRAME * i) for i in range(4, -1, -1)])
    due = FRAME
    for k in range(1, round(seconds / T0) + 1):
        state = FILTER.predict(state, T0)
        while due <= k * T0:
            state, taken = FILTER.correct(state, look(k * T0), GATE)
            assert taken
            due += FRAME
    return state


def off(state: TransverseState, rotation: Array) -> float:
    return float(np.linalg.norm(rotations.log(state.rotation @ rotation.T)))
