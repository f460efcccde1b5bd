"""No samples that a sensor can send make a step fail.

The golden recording is stepped again with samples that come otherwise: together with one stamp, as
after a stall of the host, not at all, frozen, or far off. A step that fails is a latched fault.
"""

import random
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from linemate.daemon.core.inputs import Inputs
from linemate.daemon.recording.reader import pieces
from linemate.daemon.recording.step_codec import StepRecord
from linemate.daemon.recording.step_replay import Piece, replay

GOLDEN = Path(__file__).parent / "golden" / "wheel.mcap"
LONGEST = 100  # steps that samples are changed for, and half as many in between
SENSORS = ("distance", "camera", "wrench")

Change = Callable[[Inputs], Inputs]


def stalled(rng: random.Random) -> Change:
    """Return a host that reads all sensors once in some steps: what waited has one stamp."""
    every, waiting = rng.choice((2, 3, 5, 10, 40)), dict.fromkeys(SENSORS, ())

    def change(inputs: Inputs) -> Inputs:
        for name in SENSORS:
            waiting[name] = (*waiting[name], *getattr(inputs, name))[-20:]
        if inputs.k % every:
            return structs.replace(inputs, **dict.fromkeys(SENSORS, ()))
        read = {name: at_once(samples) for name, samples in waiting.items()}
        waiting.update(dict.fromkeys(SENSORS, ()))
        return structs.replace(inputs, **read)

    return change


def at_once(samples: tuple[Any, ...]) -> tuple[Any, ...]:
    if not samples:
        return ()
    last = samples[-1]
    stamps = {
        name: getattr(last, name) for name in ("stamp_ns", "exposure_ns") if hasattr(last, name)
    }
    return tuple(structs.replace(sample, **stamps) for sample in samples)


def silent(rng: random.Random) -> Change:
    names = rng.sample(SENSORS, rng.randint(1, 3))
    return lambda inputs: structs.replace(inputs, **dict.fromkeys(names, ()))


def off(rng: random.Random) -> Change:
    """Return readings with an offset: from a millimetre to far out of the hall."""
    by = rng.choice((1e-3, -0.05, 1.0, -30.0, 99e3))
    newtons = 1e3 * by

    def change(inputs: Inputs) -> Inputs:
        distance = [structs.replace(each, position=each.position + by) for each in inputs.distance]
        camera = [
            structs.replace(each, position=tuple(by + value for value in each.position))
            for each in inputs.camera
        ]
        wrench = [
            structs.replace(each, force=tuple(newtons + value for value in each.force))
            for each in inputs.wrench
        ]
        return structs.replace(
            inputs, distance=tuple(distance), camera=tuple(camera), wrench=tuple(wrench)
        )

    return change


def turned(rng: random.Random) -> Change:
    """Return poses of any orientation, with covariances from none to that of an unknown pose."""

    def change(inputs: Inputs) -> Inputs:
        quaternion = np.random.default_rng(rng.getrandbits(32)).normal(size=4)
        covariance = np.diag(np.full(6, rng.choice((0.0, 1e-300, 1e-9, 1.0, 1e6))))
        pose = {
            "quaternion": tuple((quaternion / np.linalg.norm(quaternion)).tolist()),
            "covariance": tuple(covariance[np.triu_indices(6)].tolist()),
        }
        return structs.replace(
            inputs, camera=tuple(structs.replace(each, **pose) for each in inputs.camera)
        )

    return change


def frozen(rng: random.Random) -> Change:
    """Return sensors that send what they sent first, with new stamps."""
    names = rng.sample(SENSORS, rng.randint(1, 3))
    first: dict[str, Any] = {}
    values = {"distance": ("position",), "camera": ("position", "quaternion")}

    def change(inputs: Inputs) -> Inputs:
        changed: dict[str, tuple[Any, ...]] = {}
        for name in names:
            for sample in getattr(inputs, name):
                kept = first.setdefault(name, sample)
                same = {key: getattr(kept, key) for key in values.get(name, ("force", "torque"))}
                changed[name] = (*changed.get(name, ()), structs.replace(sample, **same))
        return structs.replace(inputs, **changed)

    return change


def elsewhere(rng: random.Random) -> Change:
    """Return a robot that is not where it is commanded, or does not say where it is."""

    def change(inputs: Inputs) -> Inputs:
        if inputs.robot is None or rng.random() < 0.1:
            return structs.replace(inputs, robot=None)
        joints = tuple(value + rng.gauss(0.0, 0.3) for value in inputs.robot.joints)
        robot = structs.replace(inputs.robot, joints=joints, digital_in=rng.randrange(4))
        return structs.replace(inputs, robot=robot, sent=rng.random() < 0.5)

    return change


def changed(how: Callable[[random.Random], Change], seed: int) -> Iterator[Piece]:
    """Yield the golden recording, with samples changed in windows."""
    rng = random.Random(seed)
    change: Change | None = None
    left = 0
    for piece in pieces(GOLDEN):
        if not isinstance(piece, StepRecord):
            yield piece
            continue
        if not left:
            change = how(rng) if change is None else None
            left = rng.randint(1, LONGEST // 2 if change is None else LONGEST)
        left -= 1
        yield piece if change is None else replace(piece, inputs=change(piece.inputs))


@pytest.mark.parametrize("how", [stalled, silent, off, turned, frozen, elsewhere])
def test_no_samples_make_a_step_fail(how: Callable[[random.Random], Change]) -> None:
    steps, moved = 0, []
    for step in replay(changed(how, 0)):
        assert step.failure is None, f"step {step.k}: {step.failure}"
        steps += 1
        if "command" in step.changes:
            moved.append(step.changes["command"][1])
    assert np.isfinite(moved).all()
    assert moved
    assert steps > 900
