"""Runs of the step, for its tests."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from cell import AXIS, REST, World, parameters, robot_sample
from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.inputs import Inputs, MotionOrder
from linemate.daemon.core.step_state import Outputs, StepState

P = parameters()
HOME = (*REST, AXIS)
C = P.tracker.reference.nominal


@dataclass(frozen=True, repr=False)
class Assembly:
    """A run, step by step: the state before, the inputs, the outputs."""

    states: list[StepState]
    inputs: list[Inputs]
    outputs: list[Outputs]

    def at(self, task_time: float) -> Outputs:
        """The first outputs at or after a task time."""
        return next(o for o in self.outputs if (o.task_time or 0.0) >= task_time - 1e-9)


def watched(world: World, outcome: Assembly, order: MotionOrder, **changes: Any) -> Outputs:
    inputs = world.inputs(order, **changes)
    outcome.states.append(world.state)
    outcome.inputs.append(inputs)
    outcome.outputs.append(world.take(inputs))
    return outcome.outputs[-1]


@cache
def whole_assembly() -> Assembly:
    """The whole task next to a conveyor that never stops: the tool does what it is asked for."""
    world, outcome = World(P), Assembly([], [], [])
    for _ in range(100):
        watched(world, outcome, MotionOrder.HOLD)
    watched(world, outcome, MotionOrder.TRACK, start=True)
    for _ in range(1700):
        asked = outcome.outputs[-1].digital_out
        robot = robot_sample(world.stamp_ns - world.period_ns, world.joints, asked)
        outputs = watched(world, outcome, MotionOrder.TRACK, robot=robot)
        if outputs.finished:
            break
    return outcome


def text(outputs: Outputs) -> str:
    """Everything that a step says, to the last bit."""
    horizon = None if outputs.horizon is None else outputs.horizon.tobytes()
    return repr((replace(outputs, horizon=None), horizon))


def assert_within(commands: Sequence[Sequence[float]] | Array, cycle_s: float = 0.012) -> None:
    """Position, speed, acceleration and jerk of commands that begin at rest."""
    bounds = P.controller.limits
    rows = np.array([*[commands[0]] * 3, *commands])
    assert np.isfinite(rows).all()
    assert (rows >= bounds.lower - 1e-12).all()
    assert (rows <= bounds.upper + 1e-12).all()
    grain = 8.0 * np.spacing(4.0)
    nib = 4e-6 * bounds.acceleration
    for order, limit in enumerate((bounds.speed, bounds.acceleration, bounds.jerk), 1):
        rates = np.abs(np.diff(rows, n=order, axis=0)) / cycle_s**order
        assert (rates <= limit + nib * cycle_s ** (2 - order) + grain / cycle_s**order).all()


_TRACKING: dict[float, World] = {}


def tracking(seconds: float) -> World:
    """A world whose robot has tracked for some time, past the start position."""
    if seconds not in _TRACKING:
        world = World(P)
        world.run(1.2)
        world.step(MotionOrder.TRACK, start=True)
        for _ in range(round(seconds / P.cycle_s)):
            world.step(MotionOrder.TRACK)
        _TRACKING[seconds] = world
    return _TRACKING[seconds].fork()
