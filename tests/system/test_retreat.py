"""Emergency retreats with the tool clamped, judged by the plant's own force and collision."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import pytest

from linemate.daemon.service.states import CLAMP_CLOSED, State
from linemate.simulators.harness import setup
from linemate.simulators.harness.lockstep import Lockstep
from linemate.simulators.plants.scenario import Fault

BEARABLE_N = 100.0
NEVER_S = 1e4
SENSORS = ("distance", "camera", "force_torque")


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
) -> Lived:
    """Run the shipped wheel scenario, seed 0: contact at 5.9 s, standing from 6 to 9 s."""
    made = setup.make("wheel")
    contact = replace(made.scenario.contact, release_s=release_s)
    scenario = replace(made.scenario, faults=faults, contact=contact)
    lockstep = Lockstep(replace(made, scenario=scenario), 0)
    world, due, force = lockstep.world, list(orders), 0.0
    if not is_reported:
        tool_signals = world.digital_in
        world.digital_in = lambda: tool_signals() & 1  # type: ignore[method-assign]
    while lockstep.turn() and world.time_s < until_s:
        if due and world.time_s >= due[0][0]:
            assert lockstep.cycle.order(due.pop(0)[1]) is None
        if world.contact == "clamped":
            stiffness = scenario.effector.stiffness[:3]
            bent = world.deflection()[:3]
            force = max(force, math.hypot(*(k * x for k, x in zip(stiffness, bent, strict=True))))
    machine, collision = lockstep.cycle.machine, world.collision
    reason = None if collision is None else collision.reason
    return Lived(force, reason, world.contact, machine.state, machine.because)


def silent(at_s: float, *links: str) -> tuple[Fault, ...]:
    return tuple(Fault(at_s, link, "silence", 20.0) for link in links)


@pytest.mark.parametrize("release_s", [0.1, 0.3, 1.0])
def test_a_retreat_without_force_waits_until_the_clamp_is_open(release_s: float) -> None:
    lived = live(*silent(7.0, "force_torque"), release_s=release_s)
    assert lived.collision is None
    assert lived.contact == "released"
    assert lived.force_n < BEARABLE_N
    assert lived.state is State.FAULT


@pytest.mark.parametrize(
    ("faults", "orders"),
    [
        pytest.param(silent(5.80, "force_torque"), (), id="force lost as the tool touches"),
        pytest.param(silent(7.0, "distance", "camera"), (), id="position lost"),
        pytest.param(silent(7.0, *SENSORS), (), id="every sensor lost"),
        pytest.param((), ((7.0, "retreat"),), id="ordered to retreat"),
        pytest.param((), ((5.82, "stop"),), id="stopped at the first touch"),
        pytest.param(
            (Fault(7.0, "force_torque", "offset", 0.05, 600.0, 3),), (), id="force beyond the limit"
        ),
    ],
)
def test_no_reason_for_a_retreat_pulls_at_the_clamp(
    faults: tuple[Fault, ...], orders: tuple[tuple[float, str], ...]
) -> None:
    lived = live(*faults, orders=orders)
    assert lived.collision is None
    assert lived.contact == "released"
    assert lived.force_n < BEARABLE_N


@pytest.mark.parametrize(
    ("release_s", "is_reported"),
    [pytest.param(0.3, False, id="signal missing"), pytest.param(NEVER_S, True, id="clamp stuck")],
)
def test_a_clamp_that_is_not_reported_open_is_followed_and_named(
    release_s: float, is_reported: bool
) -> None:
    # The conveyor starts again at 9 s: a tool that stood would be torn off.
    lived = live(
        orders=((7.0, "retreat"),), release_s=release_s, is_reported=is_reported, until_s=14.0
    )
    assert lived.collision is None
    assert lived.force_n < BEARABLE_N
    assert (lived.state, lived.because) == (State.RETREAT, CLAMP_CLOSED)
