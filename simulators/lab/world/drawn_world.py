"""Worlds drawn at random: the plant floor with other sizes, stops and bodies for each seed.

No setting of the daemon knows them: they ask what a cell does that the rows of the realistic world
do not have.

Invariants:
    A seed draws the same world wherever it is run.
    Modes of the floor's body that were identified are not stated: a drawn body has others.
    A drawn world keeps to what the floor's commissioning states: the camera sees from
        ``blind_below`` on, the mount is as stiff as stated within 20 %.
"""

import json
import math
from dataclasses import asdict
from functools import cache
from random import Random
from typing import Any

from linemate.daemon.core.tracking.settings import SwaySettings
from linemate.simulators.harness import setup
from linemate.simulators.plants.scenario import Scenario

NAME = "drawn"
WHAT = "the plant floor with sizes, stops and bodies drawn by the seed"
BASE = "plant-floor"
DURATION_S = 45.0  # long enough to wait for a line that stops three times [s]

_ALONG, _ACROSS = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)  # directions of a body's modes, in c


@cache
def _floor() -> Scenario:
    """Return the plant floor, of whose sizes shares are drawn."""
    return setup.make(BASE).scenario


def overrides(seed: int) -> tuple[str, ...]:
    """Return what a seed changes of the plant floor, as ``KEY=VALUE``."""
    random = Random(f"drawn world {seed}")  # noqa: S311 - not for secrets
    values: dict[str, Any] = {
        **_robot(random),
        **_conveyor(random),
        "body.carrier": _carrier(random),
        **_contact(random),
        **_sensors(random),
        "duration_s": DURATION_S,
    }
    truth = (f"scenario.{key}={json.dumps(value)}" for key, value in values.items())
    return (*truth, *_unidentified())


def _unidentified() -> tuple[str, ...]:
    """Return the settings of a body whose modes are not identified, as ``KEY=VALUE``."""
    swings = [asdict(mode) for mode in setup.make(BASE).tracking.swing if mode.gain == 0.0]
    sway = (f"sway.{key}={json.dumps(value)}" for key, value in asdict(SwaySettings()).items())
    return tuple(f"tracking.{each}" for each in (f"swing={json.dumps(swings)}", *sway))


def _share(random: Random) -> float:
    """Return a size as a share of the plant floor's: none, less or up to the harsh floor's."""
    return random.choice((0.0, random.uniform(0.0, 1.0), random.uniform(0.5, 1.5)))


def _even(random: Random, low: float, high: float) -> float:
    """Return a value whose logarithm is drawn evenly."""
    return math.exp(random.uniform(math.log(low), math.log(high)))


def _times(sizes: tuple[float, ...], share: float) -> list[float]:
    return [share * size for size in sizes]


def _robot(random: Random) -> dict[str, Any]:
    effects = _floor().robot.effects
    return {
        "robot.effects.windup.depth": _times(effects.windup.depth, _share(random)),
        "robot.effects.lost_motion": _times(effects.lost_motion, _share(random)),
        "robot.effects.friction.coulomb": _times(effects.friction.coulomb, _share(random)),
    }


def _conveyor(random: Random) -> dict[str, Any]:
    effects, events, t = _floor().conveyor.effects, [], random.uniform(2.5, 13.0)
    for _ in range(random.choice((0, 1, 1, 2, 2, 3))):
        deceleration, stood_s = _even(random, 0.07, 0.2), random.uniform(1.0, 5.0)
        events.append({"kind": "stop", "onset_s": t, "acceleration": deceleration})
        acceleration, ran_s = _even(random, 0.013, 0.06), random.uniform(2.0, 8.0)
        events.append({"kind": "start", "onset_s": t + stood_s, "acceleration": acceleration})
        t += stood_s + ran_s
    return {
        "conveyor.effects.askew": [random.uniform(-3e-3, 3e-3), random.uniform(-1.5e-3, 1.5e-3)],
        "conveyor.effects.sag": effects.sag * _share(random),
        "conveyor.effects.ramp_s": random.uniform(0.0, 0.2),
        "conveyor.effects.coast_s": random.uniform(0.0, 0.2),
        "conveyor.effects.stick_slip": effects.stick_slip * _share(random),
        "conveyor.effects.teeth": random.choice((0, 8, 10, 12, 16)),
        "conveyor.effects.creep_speed": effects.creep_speed * _share(random),
        "conveyor.events": events,
    }


def _carrier(random: Random) -> list[dict[str, Any]]:
    modes = []
    for direction, most in ((_ALONG, 1.2), (_ACROSS, 0.3)):
        if random.random() < 0.8:
            mode = {
                "frequency_hz": _even(random, 0.5, 5.0),
                "damping": _even(random, 0.01, 0.05),
                "drive": random.uniform(0.0, most),
                "mass": _even(random, 300.0, 2000.0),
                "direction": list(direction),
            }
            modes.append(mode)
    return modes


def _contact(random: Random) -> dict[str, Any]:
    return {
        "effector.stiffness": _times(_floor().effector.stiffness, random.uniform(0.8, 1.2)),
        "effector.load.wheel_mass": random.uniform(14.0, 28.0),
        "contact.mating.friction": random.uniform(0.05, 0.35),
        "contact.mating.angle_range": random.uniform(0.0, 0.0175),
    }


def _sensors(random: Random) -> dict[str, Any]:
    def around(half: float, count: int) -> list[float]:
        return [random.uniform(-half, half) for _ in range(count)]

    return {
        "distance.delay_s": random.uniform(0.001, 0.01),
        "distance.effects.slip": random.uniform(0.0, 0.003),
        "distance.effects.drift": _floor().distance.effects.drift * _share(random),
        "camera.blind_below": random.uniform(0.03, 0.06),
        "camera.dropout_rate": random.choice((0.0, random.uniform(0.0, 0.3))),
        "camera.effects.depth_bias": random.uniform(0.0, 3e-3),
        "camera.effects.lateral_bias": around(0.75e-3, 2),
        "camera.effects.blind_before_contact_s": random.choice((0.0, random.uniform(0.0, 0.3))),
        "camera.effects.stamp_bias_s": random.uniform(-0.0075, 0.0075),
        "camera.effects.stamp_jitter_s": random.uniform(0.0, 0.003),
        "camera.effects.mount_offset": around(0.45e-3, 3),
        "camera.effects.mount_rotation": around(0.9e-3, 3),
    }
