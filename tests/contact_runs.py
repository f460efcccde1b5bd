"""Runs of the shipped wheel scenario around contact, with the plant's force and collision."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from linemate.daemon.cycle.states import State
from linemate.simulators.harness import setup
from linemate.simulators.harness.lockstep import Lockstep
from linemate.simulators.plants.scenario import Fault


@dataclass(frozen=True)
class Lived:
    """What became of a run, by the plant's truth."""

    force_n: float
    collision: str | None
    contact: str
    state: State
    because: str


def live(
    *faults: Fault,
    orders: Sequence[tuple[float, str]] = (),
    release_s: float = 0.3,
    until_s: float = 9.0,
    is_reported: bool = True,
    overrides: Sequence[str] = (),
    scenario: str = "wheel",
) -> Lived:
    """Run a shipped scenario, seed 0; "wheel": contact at 5.8 s, standing from 6 to 9 s.

    Args:
        faults: of the sensors and links.
        orders: of the operator, with their times [s].
        release_s: order to release until the clamp is open [s].
        until_s: end of the run [s].
        is_reported: the tool reports that the clamp is open.
        overrides: ``KEY=VALUE`` of the scenario and the task.
        scenario: name of the shipped scenario.
    """
    made = setup.make(scenario, overrides)
    contact = replace(made.scenario.contact, release_s=release_s)
    truth = replace(made.scenario, faults=faults, contact=contact)
    lockstep = Lockstep(replace(made, scenario=truth), 0)
    world, due, force = lockstep.world, list(orders), 0.0
    if not is_reported:
        tool_signals = world.digital_in
        world.digital_in = lambda: tool_signals() & 1  # type: ignore[method-assign]
    while lockstep.turn() and world.time_s < until_s:
        if due and world.time_s >= due[0][0]:
            assert lockstep.cycle.order(due.pop(0)[1]) is None
        if world.contact == "clamped":
            stiffness = truth.effector.stiffness[:3]
            bent = world.deflection()[:3]
            force = max(force, math.hypot(*(k * x for k, x in zip(stiffness, bent, strict=True))))
    machine, collision = lockstep.cycle.machine, world.collision
    reason = None if collision is None else collision.reason
    return Lived(force, reason, world.contact, machine.state, machine.because)
