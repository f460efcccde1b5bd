"""A body that sways on a conveyor which stops and starts, and recordings of it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from traces import CAMERA, CYCLE_S, trace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.settings import CameraNoise
from linemate.daemon.identification import scene_fit
from linemate.daemon.identification.scene_fit import Views
from linemate.daemon.identification.trace import Images, Trace

SPEED = 0.106
RAMPS = ((6.0, -0.104), (14.0, 0.104), (22.0, -0.104))
SECONDS = 30.0
PITCH = 0.1  # of the conveyor's chain [m]
ARM_RATE = 2.0  # of a camera that moves [rad/s]


@dataclass(frozen=True)
class Body:
    """A body on a conveyor that stops and starts, as it really is."""

    frequency_hz: float = 1.2
    gain: float = 1.0
    damping: float = 0.02
    lateral: float = 0.4e-3
    stamp_error: float = 0.004
    ramps: tuple[tuple[float, float], ...] = RAMPS
    chain: float = 0.0  # amplitude of the error of the conveyor's chain [m]
    axis: int = 1  # of c, along which the body sways
    late: float = 0.0  # of the distance sensor's readings [s]
    arm: float = 0.0  # amplitude with which the camera moves along the line [m]
    seed: int = 0


def acceleration(body: Body, t: float) -> float:
    return sum(a for begin, a in body.ramps if begin <= t < begin + SPEED / abs(a))


def moved(body: Body, times: Array) -> tuple[Array, Array]:
    """Position of the unit and sway of the body (n,) at times, integrated step by step."""
    w = 2.0 * math.pi * body.frequency_hz
    per_metre = 2.0 * math.pi / PITCH

    def rates(t: float, y: Array) -> list[float]:
        a = acceleration(body, t)
        a -= body.chain * (per_metre * y[1]) ** 2 * math.sin(per_metre * y[0])
        force = -body.gain * a - 2.0 * body.damping * w * y[3] - w * w * y[2]
        return [y[1], acceleration(body, t), y[3], force]

    found = solve_ivp(rates, (0.0, SECONDS + 1.0), (0.0, SPEED, 0.0, 0.0),
                      max_step=0.02, dense_output=True).sol(times)  # fmt: skip
    return found[0] + body.chain * np.sin(per_metre * found[0]), found[2]


def recorded(body: Body) -> Trace:
    """A camera that stands before the conveyor's path, and a distance sensor."""
    rng = np.random.default_rng(body.seed)
    exposures = np.arange(0.2, SECONDS, 0.025)
    unit, swayed = moved(body, exposures + body.stamp_error)
    place = np.column_stack((0.0 * unit, unit, 0.5 + 0.0 * unit))
    place[:, body.axis] += swayed
    deviations = np.tile((body.lateral, body.lateral, 2.0 * body.lateral, 1e-3, 1e-3, 1e-3),
                         (len(unit), 1))  # fmt: skip
    tcp = np.zeros((round((SECONDS + 1.0) / CYCLE_S), 6))
    tcp[:, 1] = body.arm * np.sin(ARM_RATE * CYCLE_S * np.arange(len(tcp)))
    place[:, 1] -= body.arm * np.sin(ARM_RATE * (exposures + body.stamp_error))
    images = Images(
        exposures,
        exposures + 0.1,
        place - CAMERA[0] + deviations[:, :3] * rng.normal(size=(len(unit), 3)),
        np.tile(np.eye(3), (len(unit), 1, 1)),
        deviations,
    )
    stamps = np.arange(0.0, SECONDS + 1.0, CYCLE_S)
    readings = np.round(moved(body, stamps)[0] + 0.3e-3 * rng.normal(size=len(stamps)), 3)
    return trace(tcp=tcp, images=images, distances=np.column_stack((stamps + body.late, readings)))


def viewed(traces: Sequence[Trace]) -> tuple[list[Views], list[int]]:
    per_trace = [scene_fit.views(each, CAMERA, CameraNoise()) for each in traces]
    seen = [view for views in per_trace for view in views]
    return seen, [i for i, views in enumerate(per_trace) for _ in views]
