"""MuJoCo stations drawn at random: another body, line, mount and camera for each seed.

No setting of the daemon knows them, but for the conveyor's nominal speed. The ranges were written
down before the first run.

Invariants:
    A seed draws the same station wherever it is run.
    What is not drawn here is drawn by the station itself, as in the row ``mujoco``.
"""

import json
import math
from dataclasses import replace
from random import Random
from typing import Any

from linemate.simulators.lab.world import drawn_line
from linemate.simulators.mujoco_world.mujoco_cell import ArmDrives, Car

WHAT = "another body, line, mount and camera for each seed"
WEIGHED = "the same stations, whose wheel's mass is stated with an error of up to 10 %"
LINE = replace(drawn_line.LINES[drawn_line.NAME], key="station")
"""Up to four stops of 50 to 300 and starts of 13 to 100 mm/s^2, before, in and after contact."""

SPEED = (0.060, 0.150)  # of the conveyor, which the task file states [m/s]
MASS = (300.0, 1500.0)  # of the body [kg]
HANGER = (0.5, 2.0)  # [m]
PENDULUM_HZ, STIFF_HZ = (0.5, 1.2), (2.0, 6.0)  # fore-aft mode: of either range
DAMPING = (0.01, 0.05)
ROUNDING_S = (0.02, 0.4)  # an acceleration builds up within this
MOUNT_SHARE = (0.6, 1.5)  # true stiffness of the mount over the stated one
MOUNT_DAMPING = (0.01, 0.04)
FRICTION = (0.05, 0.4)
PLAY = (0.2e-3, 0.8e-3)  # of a bolt in its hole [m]
GEAR_SHARE = (0.6, 1.5)  # stiffness of the gears over the station's
WHEEL_MASS = "mujoco.tool.wheel_mass"
WEIGHING = (0.9, 1.1)  # stated mass of the wheel over the true one
HAND_EYE = (1.0e-3, 1.0e-3)  # error of the calibration: in any direction [m], about any axis [rad]


def overrides(seed: int) -> tuple[str, ...]:
    """Return what a seed changes of the row ``mujoco``, as ``KEY=VALUE``."""
    random = Random(f"drawn station {seed}")  # noqa: S311 - not for secrets
    speed = random.uniform(*SPEED)
    station = {**_car(random), **_line(random), **_tool(random), **_sensors(random)}
    values: dict[str, Any] = {
        **{f"mujoco.{key}": value for key, value in station.items()},
        "mujoco.arm.stiffness": _gears(random),
        "scenario.conveyor.nominal_speed": speed,
        "task.conveyor.nominal_speed": speed,
    }
    sets = (f"{key}={json.dumps(value)}" for key, value in values.items())
    return (*sets, *drawn_line.stops_and_starts(LINE, seed))


def weighed_overrides(seed: int) -> tuple[str, ...]:
    """Return the same, and the mass of the wheel as an engineer states it."""
    sets = overrides(seed)
    (mass,) = (json.loads(v) for k, _, v in (s.partition("=") for s in sets) if k == WHEEL_MASS)
    error = Random(f"weighed wheel {seed}").uniform(*WEIGHING)  # noqa: S311 - not for secrets
    return (*sets, f"tracking.payload.part_mass={error * mass:.2f}")


def _even(random: Random, low: float, high: float) -> float:
    """Return a value whose logarithm is drawn evenly."""
    return math.exp(random.uniform(math.log(low), math.log(high)))


def _car(random: Random) -> dict[str, Any]:
    mass = _even(random, *MASS)
    modes = random.choice((PENDULUM_HZ, STIFF_HZ)), PENDULUM_HZ
    values: dict[str, Any] = {
        "car.mass": mass,
        "car.inertia": [mass / Car().mass * each for each in Car().inertia],
        "car.hanger": random.uniform(*HANGER),
    }
    for name, hz in zip(("fore_aft", "lateral"), modes, strict=True):
        values[f"car.{name}_hz"] = _even(random, *hz)
        values[f"car.{name}_damping"] = _even(random, *DAMPING)
    return values


def _line(random: Random) -> dict[str, Any]:
    return {
        "line.rounding_s": random.uniform(*ROUNDING_S),
        "line.chain_amplitude": random.uniform(0.0, 1.0e-3),
        "line.wander": random.uniform(0.0, 0.6e-3),
    }


def _tool(random: Random) -> dict[str, Any]:
    return {
        "tool.stiffness_share": _even(random, *MOUNT_SHARE),
        "tool.damping": _even(random, *MOUNT_DAMPING),
        "tool.wheel_mass": random.uniform(18.0, 28.0),
        "tool.friction": random.uniform(*FRICTION),
        "tool.hole_clearance": random.uniform(*PLAY),
        "tool.chamfer": random.uniform(1.5e-3, 2.5e-3),
        "tool.bolt_angle": random.uniform(-0.01, 0.01),
    }


def _gears(random: Random) -> list[float]:
    share = _even(random, *GEAR_SHARE)
    return [share * each for each in ArmDrives().stiffness]


def _sensors(random: Random) -> dict[str, Any]:
    def towards(size: float) -> list[float]:
        """Return a vector of a size in any direction."""
        axes = [random.gauss(0.0, 1.0) for _ in range(3)]
        return [size / math.hypot(*axes) * each for each in axes]

    return {
        "sensors.hand_eye": towards(HAND_EYE[0]),
        "sensors.hand_eye_angle": towards(HAND_EYE[1]),
        "sensors.camera_delay_s": random.uniform(0.05, 0.12),
        "sensors.camera_sigma": _even(random, 0.1e-3, 0.4e-3),
        "sensors.camera_wander": random.uniform(0.0, 0.3e-3),
        "sensors.camera_wander_s": _even(random, 0.2, 1.0),
        "sensors.camera_stamp_s": random.uniform(-5e-3, 5e-3),
        "sensors.camera_range_bias": random.uniform(-3e-3, 3e-3),
        "sensors.distance_delay_s": random.uniform(1e-3, 10e-3),
        "sensors.distance_step": _even(random, 0.1e-3, 1.0e-3),
        "sensors.distance_scale": random.uniform(-2e-3, 2e-3),
    }
