"""The table of operating states, tried with every state and every combination of signals."""

import itertools
from collections.abc import Iterator
from dataclasses import fields, replace

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

NAMES = [field.name for field in fields(Signals)]
QUIET = {State.INIT, State.IDLE, State.ARMED, State.FAULT}


def all_signals(*, home: bool = False, follow: bool = False) -> Iterator[Signals]:
    """Every combination of signals with the orders home and follow, the last flags, or not."""
    for link in Link:
        for bits in itertools.product((False, True), repeat=len(NAMES) - 3):
            yield Signals(link, *bits, home, follow)


WITHOUT_HOME = tuple(all_signals())
HEEDS_HOME = {State.IDLE, State.ARMED}
"""The only states whose rows read the orders home and follow: the others are not tried twice."""


Edges = dict[tuple[Machine, Machine], list[Signals]]


@pytest.fixture(scope="module")
def edges() -> Edges:
    """Every transition from every machine that can be reached: which signals cause it."""
    found: Edges = {}
    waiting, seen = [Machine()], {Machine()}
    while waiting:
        machine = waiting.pop()
        for after, causes in all_transitions(machine):
            found.setdefault((machine, after), []).extend(causes)
            DECIDED.add((machine.state, after.because))
            if after not in seen:
                seen.add(after)
                waiting.append(after)
    return found


DECIDED: set[tuple[State, str]] = set()


def all_transitions(machine: Machine) -> Iterator[tuple[Machine, list[Signals]]]:
    causes: dict[tuple[str, bool], list[Signals]] = {}
    after: dict[tuple[str, bool], Machine] = {}
    heeds = machine.state in HEEDS_HOME
    home = all_signals(home=True) if heeds else ()
    follow = all_signals(follow=True) if heeds else ()
    for signals in itertools.chain(WITHOUT_HOME, home, follow):
        reached = transition(machine, signals)
        key = (reached.because, reached.latched)
        if key not in causes:
            causes[key] = []
            after[key] = reached
        assert reached is machine or reached == after[key]
        causes[key].append(signals)
    for key, signals_of in causes.items():
        yield after[key], signals_of


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
        assert all(s.link is not Link.LOST for s in causes)
        if after.state is State.RETREAT:
            assert all(s.contact and not s.expired for s in causes)
            assert after.latched
            assert not after.programmed
        else:
            assert after.state is State.IDLE
            assert all(s.ack for s in causes)
            assert not any(s.overload or s.fault for s in causes)


def test_without_an_order_motion_begins_only_to_get_out_of_contact(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        if after.state in MOVING and before.state not in MOVING:
            for s in causes:
                ordered = s.start or s.retreat or s.home or s.follow
                assert ordered or (after.state is State.RETREAT and (s.contact or s.overload))


def test_i3_tracking_begins_by_a_start_with_everything_fresh(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        if after.state is State.TRACK and before.state is not State.TRACK:
            assert before.state in {State.ARMED, State.HOLD}
            assert all(s.start and fit(s) and s.position_fresh and s.wrench_fresh for s in causes)
            assert not any(s.stop or s.retreat or s.fault for s in causes)


def test_i4_contact_with_a_live_link_ends_in_a_retreat(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        if before.state is State.CONTACT and after.state not in {State.CONTACT, State.RETREAT}:
            assert all(s.link is Link.LOST for s in causes)


def test_i5_a_lost_link_ends_in_init_or_fault(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        if any(s.link is Link.LOST for s in causes):
            assert after.state in {State.INIT, State.FAULT}
            assert before.state in QUIET or after.state is State.FAULT


def test_i6_a_latched_fault_is_never_forgotten(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        acknowledged = before.state is State.FAULT and after.state is State.IDLE
        if acknowledged:
            assert not after.latched
            continue
        if before.latched or any(s.fault for s in causes):
            assert after.latched
        if after.state is State.FAULT:
            assert after.latched


def test_i8_trouble_ends_tracking_at_once_and_any_motion_when_time_is_up(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        troubled = [s for s in causes if s.overload or not s.position_fresh or not s.wrench_fresh]
        if before.state in {State.TRACK, State.CONTACT} and troubled:
            assert after.state in {State.RETREAT, State.HOLD, State.FAULT}
        if before.state is State.RETREAT and any(s.clear or s.expired for s in causes):
            assert after.state in QUIET


def test_i14_a_closed_clamp_is_followed_as_long_as_something_shows_the_object(
    edges: Edges,
) -> None:
    for (before, after), causes in edges.items():
        closed = [s for s in causes if s.overdue and not (s.expired or s.clear)]
        if before.state in {State.CONTACT, State.RETREAT} and closed:
            assert after.state is State.RETREAT or all(s.link is Link.LOST for s in closed)


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
            assert all(s.contact and s.position_fresh and s.wrench_fresh for s in causes)


def test_i12_armed_is_entered_by_an_edge_with_everything_fresh(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        if after.state is State.ARMED and before.state is not State.ARMED:
            assert before.state is State.IDLE
            assert all(s.arm and fit(s) and not s.contact and not s.overload for s in causes)


def test_i13_an_operators_stop_and_retreat_are_never_lost(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        if any(s.retreat for s in causes):
            assert after.state not in {State.TRACK, State.CONTACT, State.ARMED, State.HOLD}
            assert after.state not in {State.HOME, State.FOLLOW}
            assert not (after.state is State.RETREAT and after.programmed)
        if any(s.stop for s in causes):
            assert after.state not in {State.TRACK, State.CONTACT, State.ARMED, State.HOME}
            assert after.state is not State.FOLLOW
            assert not (after.state is State.RETREAT and after.programmed)
        if before.state is State.HOLD and any(s.stop for s in causes):
            assert after.state in {State.IDLE, State.RETREAT, State.FAULT}


def test_i15_the_way_home_begins_by_its_order_from_idle_with_force_and_link(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        if after.state is State.HOME and before.state is not State.HOME:
            assert before.state is State.IDLE
            assert not before.latched
            for s in causes:
                assert s.home
                assert s.link is Link.HEALTHY
                assert s.wrench_fresh
                assert not any((s.contact, s.overload, s.fault, s.stop, s.retreat, s.arm))


@pytest.mark.parametrize("state", [state for state in State if state not in HEEDS_HOME])
def test_the_orders_home_and_follow_change_nothing_in_any_other_state(state: State) -> None:
    machines = [Machine(state, *bits) for bits in itertools.product((False, True), repeat=2)]
    for signals in itertools.islice(WITHOUT_HOME, 0, None, 61):
        for ordered in (replace(signals, home=True), replace(signals, follow=True)):
            for machine in machines:
                assert transition(machine, ordered) == transition(machine, signals)


def test_i16_the_way_home_ends_at_once_with_any_trouble(edges: Edges) -> None:
    stays = [
        s for (a, b), causes in edges.items() if a.state is b.state is State.HOME for s in causes
    ]
    for s in stays:
        assert may_go_home(s)
        assert not any((s.stop, s.retreat, s.clear, s.expired, s.object_left))
    assert stays


def test_i17_poses_are_followed_by_an_order_from_idle_with_force_and_link(edges: Edges) -> None:
    for (before, after), causes in edges.items():
        if after.state is State.FOLLOW and before.state is not State.FOLLOW:
            assert before.state is State.IDLE
            assert not before.latched
            for s in causes:
                assert s.follow
                assert may_go_home(s)
                assert not any((s.stop, s.retreat, s.arm, s.home))


def test_i18_following_poses_ends_at_once_with_any_trouble(edges: Edges) -> None:
    stays = [
        s for (a, b), causes in edges.items() if a.state is b.state is State.FOLLOW for s in causes
    ]
    for s in stays:
        assert may_go_home(s)
        assert not any((s.stop, s.retreat, s.clear, s.object_left))
    assert stays


def test_unfit_has_words_exactly_when_a_start_is_impossible() -> None:
    for signals in WITHOUT_HOME[::7]:
        assert (unfit(signals) is None) == fit(signals)


def test_every_row_of_the_table_can_decide(edges: Edges) -> None:
    assert edges
    assert {(row.source, row.because) for row in TABLE} <= DECIDED
