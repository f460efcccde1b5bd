"""Single transitions and refusals of the operating states: every line of the table decides."""

from dataclasses import replace
from typing import Any

import pytest

from linemate.daemon.core.inputs import MotionOrder
from linemate.daemon.cycle.states import (
    CLAMP_CLOSED,
    MOVING,
    Link,
    Machine,
    Signals,
    State,
    order,
    refusal,
    transition,
)

GOOD = Signals(link=Link.HEALTHY, position_fresh=True, wrench_fresh=True, ready=True)
EDGES = ("arm", "start", "stop", "retreat", "ack", "home", "follow")


def with_order(name: str) -> Signals:
    flags: dict[str, Any] = {name: True}
    return replace(GOOD, **flags)


def test_a_start_together_with_another_order_does_not_start() -> None:
    for other in ("stop", "retreat", "ack", "arm", "home", "follow"):
        signals = replace(with_order(other), start=True)
        assert transition(Machine(State.ARMED), signals).state is State.IDLE


def test_every_state_orders_a_motion_of_its_own() -> None:
    ordered = {state: order(Machine(state)) for state in MOVING}
    assert ordered == {
        State.TRACK: MotionOrder.TRACK,
        State.CONTACT: MotionOrder.TRACK,
        State.RETREAT: MotionOrder.RETREAT,
        State.HOME: MotionOrder.HOME,
        State.FOLLOW: MotionOrder.FOLLOW,
    }


def test_the_usual_day_runs_through_the_states() -> None:
    machine = Machine()
    reported = []
    for signals in (
        GOOD,
        replace(GOOD, arm=True),
        replace(GOOD, start=True),
        GOOD,
        replace(GOOD, contact=True, ready=False),
        replace(GOOD, contact=True, ready=False),
        replace(GOOD, done=True),
        replace(GOOD, done=True, clear=True),
    ):
        machine = transition(machine, signals)
        reported.append((machine.state, order(machine)))
    assert reported == [
        (State.IDLE, MotionOrder.HOLD),
        (State.ARMED, MotionOrder.HOLD),
        (State.TRACK, MotionOrder.TRACK),
        (State.TRACK, MotionOrder.TRACK),
        (State.CONTACT, MotionOrder.TRACK),
        (State.CONTACT, MotionOrder.TRACK),
        (State.RETREAT, MotionOrder.TRACK),
        (State.IDLE, MotionOrder.HOLD),
    ]


def test_nothing_new_leaves_the_machine_as_it_is() -> None:
    tracking = Machine(State.TRACK)
    assert transition(tracking, GOOD) is tracking


@pytest.mark.parametrize("machine", [Machine(s, latched=s is State.FAULT) for s in State])
def test_an_order_that_would_change_nothing_is_refused_with_a_reason(machine: Machine) -> None:
    for edge in EDGES:
        if edge in {"stop", "retreat"}:
            continue
        changes = transition(machine, with_order(edge)) != transition(machine, GOOD)
        taken = refusal(machine, GOOD, edge) is None
        # A second arm takes ARMED back to IDLE, as any order but start does.
        assert taken == (
            changes
            and (machine.state, edge)
            not in {
                (State.ARMED, "arm"),
                (State.ARMED, "ack"),
                (State.ARMED, "home"),
                (State.ARMED, "follow"),
            }
        )


def test_a_stop_is_taken_in_every_state_and_a_retreat_in_motion() -> None:
    for state in State:
        assert refusal(Machine(state), Signals(), "stop") is None
        assert (refusal(Machine(state), Signals(), "retreat") is None) == (
            state in MOVING | {State.HOLD}
        )


def test_a_refusal_names_everything_that_is_missing() -> None:
    reason = refusal(Machine(State.IDLE), Signals(contact=True), "arm")
    assert reason is not None
    for part in ("robot link is lost", "position", "force", "estimate", "in contact"):
        assert part in reason
    assert refusal(Machine(State.IDLE), GOOD, "dance") == "no such order: dance"
    assert "IDLE" in str(refusal(Machine(State.TRACK), GOOD, "arm"))


@pytest.mark.parametrize(
    ("signals", "reason"),
    [
        (GOOD, None),
        (replace(GOOD, link=Link.UNPROVEN), None),
        (replace(GOOD, link=Link.LOST), "the robot link is lost"),
        (replace(GOOD, overload=True), "overload"),
        (replace(GOOD, fault=True), "the fault is still present"),
        (replace(GOOD, fault=True, overload=True), "overload"),
    ],
)
def test_a_fault_is_acknowledged_once_its_reason_is_gone(
    signals: Signals, reason: str | None
) -> None:
    faulty = Machine(State.FAULT, latched=True)
    assert refusal(faulty, signals, "ack") == reason
    left = transition(faulty, replace(signals, ack=True)).state is State.IDLE
    assert left == (reason is None)


@pytest.mark.parametrize(
    ("machine", "signals", "after"),
    [
        (Machine(State.TRACK), replace(GOOD, link=Link.UNPROVEN), Machine(State.HOLD)),
        (
            Machine(State.TRACK),
            replace(GOOD, link=Link.UNPROVEN, contact=True),
            Machine(State.RETREAT),
        ),
        (
            Machine(State.TRACK),
            replace(GOOD, contact=True, position_fresh=False),
            Machine(State.RETREAT, latched=True),
        ),
        (
            Machine(State.CONTACT),
            replace(GOOD, contact=True, wrench_fresh=False),
            Machine(State.RETREAT, latched=True),
        ),
        (Machine(State.TRACK), replace(GOOD, object_left=True), Machine(State.HOLD)),
        (Machine(State.TRACK), replace(GOOD, done=True), Machine(State.RETREAT, programmed=True)),
        (Machine(State.RETREAT), replace(GOOD, overload=True), Machine(State.RETREAT)),
        (
            Machine(State.RETREAT, programmed=True),
            replace(GOOD, overload=True),
            Machine(State.RETREAT),
        ),
        (Machine(State.RETREAT, programmed=True), GOOD, Machine(State.RETREAT, programmed=True)),
        (Machine(State.RETREAT), replace(GOOD, expired=True), Machine(State.FAULT, latched=True)),
        (Machine(State.HOLD), replace(GOOD, expired=True), Machine(State.FAULT, latched=True)),
        (
            Machine(State.CONTACT),
            replace(GOOD, overdue=True, done=True),
            Machine(State.RETREAT, latched=True),
        ),
        (Machine(State.RETREAT), replace(GOOD, overdue=True), Machine(State.RETREAT, latched=True)),
        (
            Machine(State.RETREAT, latched=True, because=CLAMP_CLOSED),
            replace(GOOD, overdue=True),
            Machine(State.RETREAT, latched=True),
        ),
        (Machine(State.INIT), replace(GOOD, fault=True), Machine(State.FAULT, latched=True)),
    ],
)
def test_a_transition_is_the_one_that_was_agreed_on(
    machine: Machine, signals: Signals, after: Machine
) -> None:
    reached = transition(machine, signals)
    assert reached == after
    # An emergency retreat is not begun again in every cycle.
    assert (reached is machine) == (machine == after)
