"""The table of operating states, tried with every state and every combination of signals."""

import itertools
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NoReturn, TypeVar

import pytest

from linemate.daemon.core.inputs import MotionOrder
from linemate.daemon.cycle.states import (
    MOVING,
    TABLE,
    Link,
    Machine,
    Signals,
    State,
    fit,
    may_go_home,
    order,
    transition,
    unfit,
)

QUIET = {State.INIT, State.IDLE, State.ARMED, State.FAULT}

T = TypeVar("T")
Question = Callable[[Signals], T]


class UnknownError(Exception):
    """A signal was read whose value is left open."""


class Partial:
    """Signals of which some are known and all others may have any value."""

    def __init__(self, known: dict[str, Any]) -> None:
        self.__dict__.update(known)
        self.known = known

    def __getattr__(self, name: str) -> NoReturn:
        raise UnknownError(name)


def cases(question: Question[T], some: Partial) -> Iterator[tuple[Partial, T]]:
    """Every answer to a question of signals, each with the signals that it depends on.

    Together the cases are every combination of signals: what was not read changes no answer.
    """
    try:
        answer = question(some)  # type: ignore[arg-type]
    except UnknownError as unknown:
        (name,) = unknown.args
        for value in tuple(Link) if name == "link" else (False, True):
            yield from cases(question, Partial({**some.known, name: value}))
    else:
        yield some, answer


Causes = list[Partial]
Edges = dict[tuple[Machine, Machine], Causes]


def always(causes: Causes, holds: Question[bool]) -> bool:
    return all(answer for some in causes for _, answer in cases(holds, some))


def never(causes: Causes, holds: Question[bool]) -> bool:
    return always(causes, lambda s: not holds(s))


@pytest.fixture(scope="module")
def edges() -> Edges:
    """Every transition from every machine that can be reached: which signals cause it."""
    found: Edges = {}
    waiting, seen = [Machine()], {Machine()}
    while waiting:
        machine = waiting.pop()
        for some, after in cases(partial(transition, machine), Partial({})):
            found.setdefault((machine, after), []).append(some)
            DECIDED.add((machine.state, after.because))
            if after not in seen:
                seen.add(after)
                waiting.append(after)
    return found


DECIDED: set[tuple[State, str]] = set()


def is_lost(s: Signals) -> bool:
    return s.link is Link.LOST


def staying(edges: Edges, state: State) -> Causes:
    return [s for (a, b), causes in edges.items() if a.state is b.state is state for s in causes]


def test_the_modes_lead_to_each_other_as_the_design_draws_them(edges: Edges) -> None:
    modes = {(a.state.name, b.state.name) for a, b in edges if a.state is not b.state}
    assert modes == {
        ("INIT", "IDLE"),
        ("INIT", "FAULT"),
        ("IDLE", "INIT"),
        ("IDLE", "ARMED"),
        ("IDLE", "FAULT"),
        ("ARMED", "INIT"),
        ("ARMED", "IDLE"),
        ("ARMED", "TRACK"),
        ("ARMED", "FAULT"),
        ("TRACK", "CONTACT"),
        ("TRACK", "RETREAT"),
        ("TRACK", "HOLD"),
        ("TRACK", "FAULT"),
        ("CONTACT", "RETREAT"),
        ("CONTACT", "FAULT"),
        ("RETREAT", "IDLE"),
        ("RETREAT", "FAULT"),
        ("HOLD", "IDLE"),
        ("HOLD", "TRACK"),
        ("HOLD", "RETREAT"),
        ("HOLD", "FAULT"),
        ("FAULT", "IDLE"),
        ("FAULT", "RETREAT"),
        ("IDLE", "HOME"),
        ("HOME", "IDLE"),
        ("HOME", "FAULT"),
        ("IDLE", "FOLLOW"),
        ("FOLLOW", "IDLE"),
        ("FOLLOW", "FAULT"),
    }


def test_i1_the_step_holds_in_every_quiet_state(edges: Edges) -> None:
    for machine in {after for _, after in edges}:
        held = order(machine) is MotionOrder.HOLD
        assert held == (machine.state in QUIET | {State.HOLD})
        assert held == (machine.state not in MOVING)


def test_i2_a_fault_is_left_by_an_acknowledgement_to_idle_or_out_of_contact_by_a_retreat(
    edges: Edges,
) -> None:
    for (before, after), causes in edges.items():
        if before.state is not State.FAULT or after.state is State.FAULT:
            continue
        assert never(causes, lambda s: s.link is Link.LOST)
        if after.state is State.RETREAT:
            assert always(causes, lambda s: s.contact and not s.expired)
            assert after.latched
            assert not after.programmed
        else:
            assert after.state is State.IDLE
            assert always(causes, lambda s: s.ack and not (s.overload or s.fault))


def test_without_an_order_motion_begins_only_to_get_out_of_contact(edges: Edges) -> None:
    def is_ordered(s: Signals) -> bool:
        return s.start or s.retreat or s.home or s.follow

    for (before, after), causes in edges.items():
        if after.state is State.RETREAT and before.state not in MOVING:
            assert always(causes, lambda s: is_ordered(s) or s.contact or s.overload)
        elif after.state in MOVING and before.state not in MOVING:
            assert always(causes, is_ordered)


def test_i3_tracking_begins_by_a_start_with_everything_fresh(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        if after.state is State.TRACK and before.state is not State.TRACK:
            assert before.state in {State.ARMED, State.HOLD}
            assert always(causes, lambda s: s.start and fit(s))
            assert always(causes, lambda s: s.position_fresh and s.wrench_fresh)
            assert never(causes, lambda s: s.stop or s.retreat or s.fault)


def test_i4_contact_with_a_live_link_ends_in_a_retreat(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        if before.state is State.CONTACT and after.state not in {State.CONTACT, State.RETREAT}:
            assert always(causes, is_lost)


def test_i5_a_lost_link_ends_in_init_or_fault(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        if not never(causes, is_lost):
            assert after.state in {State.INIT, State.FAULT}
            assert before.state in QUIET or after.state is State.FAULT


def test_i6_a_latched_fault_is_never_forgotten(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        acknowledged = before.state is State.FAULT and after.state is State.IDLE
        if acknowledged:
            assert not after.latched
            continue
        if before.latched or not never(causes, lambda s: s.fault):
            assert after.latched
        if after.state is State.FAULT:
            assert after.latched


def test_i8_trouble_ends_tracking_at_once_and_any_motion_when_time_is_up(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        ended = after.state in {State.RETREAT, State.HOLD, State.FAULT}
        if before.state in {State.TRACK, State.CONTACT} and not ended:
            assert always(causes, lambda s: s.position_fresh and s.wrench_fresh)
            assert never(causes, lambda s: s.overload)
        if before.state is State.RETREAT and after.state not in QUIET:
            assert never(causes, lambda s: s.clear or s.expired)


def test_i14_a_closed_clamp_is_followed_as_long_as_something_shows_the_object(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        if before.state in {State.CONTACT, State.RETREAT} and after.state is not State.RETREAT:
            assert always(causes, lambda s: is_lost(s) or not s.overdue or s.expired or s.clear)


def test_i9_idle_can_be_reached_from_everywhere(edges: Edges) -> None:
    reached = {m for m, _ in edges if m.state is State.IDLE}
    machines = {m for edge in edges for m in edge}
    while more := {a for a, b in edges if b in reached} - reached:
        reached |= more
    assert reached == machines


def test_i11_contact_is_entered_from_tracking_with_fresh_sensors(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        if after.state is State.CONTACT and before.state is not State.CONTACT:
            assert before.state is State.TRACK
            assert always(causes, lambda s: s.contact and s.position_fresh and s.wrench_fresh)


def test_i12_armed_is_entered_by_an_edge_with_everything_fresh(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        if after.state is State.ARMED and before.state is not State.ARMED:
            assert before.state is State.IDLE
            assert always(causes, lambda s: s.arm and fit(s))
            assert never(causes, lambda s: s.contact or s.overload)


def test_i13_an_operators_stop_and_retreat_are_never_lost(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        if not never(causes, lambda s: s.retreat):
            assert after.state not in {State.TRACK, State.CONTACT, State.ARMED, State.HOLD}
            assert after.state not in {State.HOME, State.FOLLOW}
            assert not (after.state is State.RETREAT and after.programmed)
        if not never(causes, lambda s: s.stop):
            assert after.state not in {State.TRACK, State.CONTACT, State.ARMED, State.HOME}
            assert after.state is not State.FOLLOW
            assert not (after.state is State.RETREAT and after.programmed)
            if before.state is State.HOLD:
                assert after.state in {State.IDLE, State.RETREAT, State.FAULT}


def test_i15_the_way_home_begins_by_its_order_from_idle_with_force_and_link(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        if after.state is State.HOME and before.state is not State.HOME:
            assert before.state is State.IDLE
            assert not before.latched
            assert always(causes, lambda s: s.home and s.link is Link.HEALTHY and s.wrench_fresh)
            assert never(causes, lambda s: s.contact or s.overload or s.fault)
            assert never(causes, lambda s: s.stop or s.retreat or s.arm)


@pytest.mark.parametrize("state", sorted(set(State) - {State.IDLE, State.ARMED}))
def test_the_orders_home_and_follow_change_nothing_in_any_other_state(state: State) -> None:
    for bits in itertools.product((False, True), repeat=2):
        for some, _ in cases(partial(transition, Machine(state, *bits)), Partial({})):
            assert not some.known.keys() & {"home", "follow"}


def test_i16_the_way_home_ends_at_once_with_any_trouble(edges: Edges) -> None:
    stays = staying(edges, State.HOME)
    assert stays
    assert always(stays, may_go_home)
    assert never(stays, lambda s: s.stop or s.retreat or s.clear or s.expired or s.object_left)


def test_i17_poses_are_followed_by_an_order_from_idle_with_force_and_link(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        if after.state is State.FOLLOW and before.state is not State.FOLLOW:
            assert before.state is State.IDLE
            assert not before.latched
            assert always(causes, lambda s: s.follow and may_go_home(s))
            assert never(causes, lambda s: s.stop or s.retreat or s.arm or s.home)


def test_i18_following_poses_ends_at_once_with_any_trouble(edges: Edges) -> None:
    stays = staying(edges, State.FOLLOW)
    assert stays
    assert always(stays, may_go_home)
    assert never(stays, lambda s: s.stop or s.retreat or s.clear or s.object_left)


def test_unfit_has_words_exactly_when_a_start_is_impossible() -> None:
    assert always([Partial({})], lambda s: (unfit(s) is None) == fit(s))


def test_every_row_of_the_table_can_decide(edges: Edges) -> None:
    assert edges
    assert {(row.source, row.because) for row in TABLE} <= DECIDED
