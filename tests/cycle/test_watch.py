"""Time-outs and debounce, cycle by cycle in virtual time."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.cycle.states import Link, Machine, Signals, State
from linemate.daemon.cycle.watch import Facts, Watch, observe

CYCLE_NS = 4_000_000
CYCLES_NS = (1_000_000, 4_000_000, 12_000_000)
SETTINGS = WatchSettings(healthy_cycles=10)


class Run:
    """Cycles one after another at a fixed period."""

    def __init__(self, state: State = State.IDLE, cycle_ns: int = CYCLE_NS) -> None:
        self.cycle_ns = cycle_ns
        self.watch = Watch()
        self.machine = Machine(state)
        self.now_ns = 1_000_000_000
        self.signals = Signals()

    def cycle(self, telegram: bool = True, **facts: Any) -> Signals:
        self.now_ns += self.cycle_ns
        given_facts = structs.replace(Facts(self.now_ns, telegram), **facts)  # type: ignore[arg-type]
        self.watch, self.signals = observe(self.watch, given_facts, self.machine, SETTINGS)
        return self.signals

    def healthy(self) -> "Run":
        for _ in range(SETTINGS.healthy_cycles + 1):
            self.cycle()
        assert self.signals.link is Link.HEALTHY
        return self


def test_a_new_link_must_prove_itself_before_it_counts_as_healthy() -> None:
    run = Run()
    links = [run.cycle().link for _ in range(SETTINGS.healthy_cycles)]
    assert set(links[:-1]) == {Link.UNPROVEN}
    assert links[-1] is Link.HEALTHY


def test_a_hole_while_proving_begins_the_count_again() -> None:
    run = Run()
    for _ in range(SETTINGS.healthy_cycles - 1):
        run.cycle()
    run.cycle(telegram=False)
    links = [run.cycle().link for _ in range(SETTINGS.healthy_cycles)]
    assert links.count(Link.HEALTHY) == 1


def silent_until(run: Run, link: Link) -> float:
    """Return how long no telegram comes before the link is judged so [s]."""
    begun_ns = run.now_ns
    for _ in range(2000):
        if run.cycle(telegram=False).link is link:
            return (run.now_ns - begun_ns) * 1e-9
    raise AssertionError(link)


@pytest.mark.parametrize("cycle_ns", CYCLES_NS)
@pytest.mark.parametrize(
    ("state", "doubtful_s", "lost_s"),
    [
        (State.TRACK, SETTINGS.missed_s, SETTINGS.link_lost_s),
        (State.CONTACT, SETTINGS.missed_in_contact_s, SETTINGS.link_lost_in_contact_s),
        (State.RETREAT, SETTINGS.missed_in_contact_s, SETTINGS.link_lost_in_contact_s),
    ],
)
def test_a_silent_link_is_doubtful_and_then_lost_after_the_same_time_at_any_cycle(
    state: State, doubtful_s: float, lost_s: float, cycle_ns: int
) -> None:
    for link, after_s in ((Link.UNPROVEN, doubtful_s), (Link.LOST, lost_s)):
        silent_s = silent_until(Run(state, cycle_ns).healthy(), link)
        assert after_s <= silent_s + 1e-9 < after_s + cycle_ns * 1e-9 + 2e-9


@pytest.mark.parametrize("cycle_ns", CYCLES_NS)
def test_140_ms_without_telegrams_change_nothing_in_contact(cycle_ns: int) -> None:
    run = Run(State.CONTACT, cycle_ns).healthy()
    silent = [run.cycle(telegram=False).link for _ in range(140_000_000 // cycle_ns)]
    assert set(silent) == {Link.HEALTHY}
    assert run.cycle().link is Link.HEALTHY


@pytest.mark.parametrize(
    ("state", "unled_s", "link"),
    [
        (State.TRACK, 0.05, Link.HEALTHY),
        (State.TRACK, 0.06, Link.UNPROVEN),
        (State.CONTACT, 0.14, Link.HEALTHY),
        (State.CONTACT, 0.15, Link.UNPROVEN),
    ],
)
def test_a_robot_that_got_no_setpoints_is_as_doubtful_as_one_that_sent_no_telegrams(
    state: State, unled_s: float, link: Link
) -> None:
    run = Run(state).healthy()
    assert run.cycle(unled_s=unled_s).link is link


def test_a_lost_link_must_prove_itself_again() -> None:
    run = Run(State.CONTACT).healthy()
    silent_until(run, Link.LOST)
    assert run.cycle().link is Link.UNPROVEN


@pytest.mark.parametrize("cycle_ns", CYCLES_NS)
@pytest.mark.parametrize(
    ("state", "limit_s"),
    [(State.TRACK, SETTINGS.leak_s), (State.CONTACT, 2.0 * SETTINGS.missed_in_contact_s)],
)
def test_telegrams_missing_now_and_then_fill_the_bucket_in_the_same_time(
    state: State, limit_s: float, cycle_ns: int
) -> None:
    run, begun_ns = Run(state, cycle_ns).healthy(), 0
    begun_ns = run.now_ns
    while run.cycle(telegram=bool((run.now_ns // cycle_ns) % 2)).link is Link.HEALTHY:
        assert run.now_ns - begun_ns < 1_000_000_000
    # Half of the telegrams: the level rises by half of the time that passes.
    assert run.now_ns - begun_ns == pytest.approx(2e9 * limit_s, abs=3 * cycle_ns)
    rare = Run(state, cycle_ns).healthy()
    assert {rare.cycle(telegram=bool(k % 5)).link for k in range(200)} == {Link.HEALTHY}


def test_a_new_session_shows_as_a_loss_for_one_cycle() -> None:
    run = Run(State.TRACK).healthy()
    assert run.cycle(new_session=True).link is Link.LOST
    assert run.cycle().link is Link.UNPROVEN


def test_a_position_may_be_older_in_free_space_than_in_contact() -> None:
    for state, bearable_s in ((State.TRACK, 0.3), (State.CONTACT, 0.16)):
        run = Run(state)
        age_ns = round(bearable_s * 1e9)
        assert run.cycle(position_ns=run.now_ns + CYCLE_NS - age_ns).position_fresh
        assert not run.cycle(position_ns=run.now_ns + CYCLE_NS - age_ns - 1000).position_fresh
        assert not run.cycle(position_ns=None).position_fresh


def test_a_tool_that_touches_soon_needs_a_position_as_young_as_one_in_contact() -> None:
    run = Run(State.TRACK)
    for age_s, fresh in ((0.15, True), (0.17, False)):
        position_ns = run.now_ns + CYCLE_NS - round(age_s * 1e9)
        assert run.cycle(position_ns=position_ns, closing=True).position_fresh is fresh
        assert run.cycle(position_ns=position_ns + CYCLE_NS).position_fresh


def test_a_force_is_needed_only_where_there_is_a_sensor() -> None:
    run = Run()
    assert not run.cycle(wrench_ns=None).wrench_fresh
    assert run.cycle(wrench_ns=None, wrench_expected=False).wrench_fresh
    assert run.cycle(wrench_ns=run.now_ns).wrench_fresh


def test_one_cycle_of_contact_changes_nothing() -> None:
    run = Run()
    seen = [run.cycle(contact=shown).contact for shown in (True, False, True, True, False)]
    assert seen == [False, False, False, True, False]


def test_one_sensor_alone_is_borne_for_a_second_while_the_task_runs() -> None:
    for state, bearable_s in ((State.TRACK, 1.0), (State.ARMED, 1.0), (State.CONTACT, 1e6)):
        run = Run(state)
        for age_s in (0.5, 0.999, 1.001, 3.0):
            now_ns = run.now_ns + CYCLE_NS
            signals = run.cycle(position_ns=now_ns, slower_ns=now_ns - round(age_s * 1e9))
            assert signals.position_fresh == (age_s <= bearable_s)
    assert run.cycle(position_ns=run.now_ns, slower_ns=None).position_fresh


@pytest.mark.parametrize(
    "trouble",
    [{"orders": frozenset({"stop"})}, {"fault": True}, {"position_ns": None}, {"wrench_ns": None}],
)
def test_trouble_near_the_object_counts_as_contact_and_elsewhere_does_not(
    trouble: dict[str, Any],
) -> None:
    run = Run(State.TRACK)
    for _ in range(SETTINGS.healthy_cycles + 1):
        run.cycle(position_ns=run.now_ns, wrench_ns=run.now_ns, gap_m=0.001)
    facts = {"position_ns": run.now_ns, "wrench_ns": run.now_ns}
    assert not run.cycle(**facts, gap_m=0.001).contact
    assert run.cycle(**{**facts, **trouble}, gap_m=0.029).contact
    assert not run.cycle(**{**facts, **trouble}, gap_m=0.031).contact
    assert not run.cycle(**{**facts, **trouble}, gap_m=None).contact


def test_a_tool_that_stands_so_near_to_the_object_is_in_contact_without_any_trouble() -> None:
    run = Run(State.HOLD)
    for _ in range(SETTINGS.healthy_cycles + 1):
        signals = run.cycle(position_ns=run.now_ns, wrench_ns=run.now_ns, gap_m=0.031)
    assert not signals.contact
    assert run.cycle(position_ns=run.now_ns, wrench_ns=run.now_ns, gap_m=0.029).contact


def test_missing_telegrams_near_the_object_count_as_contact() -> None:
    run = Run(State.TRACK, CYCLES_NS[-1]).healthy()
    seen = [
        run.cycle(telegram=False, gap_m=0.01, position_ns=run.now_ns, wrench_ns=run.now_ns)
        for _ in range(3)
    ]
    assert [signals.contact for signals in seen] == [False, False, True]


def test_a_robot_that_is_elsewhere_for_five_cycles_in_a_row_is_a_fault() -> None:
    run = Run(State.TRACK)
    assert not any(run.cycle(following_error=True).fault for _ in range(4))
    assert not run.cycle(following_error=False).fault
    seen = [run.cycle(following_error=True).fault for _ in range(6)]
    assert seen == [False] * 4 + [True] * 2
    assert not run.cycle(following_error=False).fault


def test_a_hold_expires_and_the_count_begins_with_the_state() -> None:
    run = Run(State.TRACK)
    for _ in range(5):
        run.cycle()
    run.machine = Machine(State.HOLD)
    run.cycle()
    run.now_ns += 59_900_000_000
    assert not run.cycle().expired
    run.now_ns += 200_000_000
    assert run.cycle().expired
    run.machine = Machine(State.TRACK)
    assert not run.cycle().expired


@given(st.lists(st.booleans(), max_size=300), st.sampled_from(list(State)))
def test_whatever_comes_the_link_is_healthy_only_after_a_proof(
    telegrams: list[bool], state: State
) -> None:
    run = Run(state)
    row = 0
    proved = False
    for telegram in telegrams:
        row = row + 1 if telegram else 0
        link = run.cycle(telegram=telegram).link
        proved = (proved and link is not Link.LOST) or row >= SETTINGS.healthy_cycles
        assert proved or link is not Link.HEALTHY


@given(st.sets(st.sampled_from(["arm", "start", "stop", "retreat", "ack"])))
def test_orders_pass_through_unchanged(orders: set[str]) -> None:
    signals = Run().cycle(orders=frozenset(orders))
    for name in ("arm", "start", "stop", "retreat", "ack"):
        assert getattr(signals, name) == (name in orders)


def retreat_for(seconds: float, **facts: Any) -> Signals:
    run = Run(State.RETREAT).healthy()
    for _ in range(round(seconds / 0.1)):
        run.now_ns += 100_000_000 - CYCLE_NS
        run.cycle(**facts)
    return run.signals


def test_a_retreat_that_waits_for_its_clamp_lasts_as_long_as_a_sensor_shows_the_object() -> None:
    long_s = SETTINGS.longest_retreat_s + 1.0
    assert retreat_for(long_s).expired
    now_ns = 10**12
    seen = {"position_ns": now_ns, "wrench_ns": None}
    felt = {"position_ns": None, "wrench_ns": now_ns}
    assert not retreat_for(long_s, clamped=True, overdue=True, **seen).expired
    assert not retreat_for(long_s, clamped=True, overdue=True, **felt).expired


def test_a_blind_retreat_ends_when_the_clamp_is_overdue() -> None:
    assert not retreat_for(1.0, clamped=True).expired
    assert retreat_for(1.0, clamped=True, overdue=True).expired


def test_a_controller_at_another_period_makes_the_link_doubtful_until_it_is_right() -> None:
    run = Run(State.TRACK).healthy()
    assert run.cycle(wrong_cycle="12.9 ms").link is Link.UNPROVEN
    for _ in range(2 * SETTINGS.healthy_cycles):
        assert run.cycle(wrong_cycle="12.9 ms").link is Link.UNPROVEN
    assert run.cycle().link is Link.HEALTHY


def test_a_fault_in_contact_may_be_left_only_soon_and_by_a_robot_that_rests() -> None:
    run = Run(State.FAULT)
    for settling, expired in ((False, False), (True, True)):
        assert run.cycle(contact=True, settling=settling).expired is expired
    assert not run.cycle(contact=False, settling=True).expired
    run.now_ns += round(SETTINGS.longest_retreat_s * 1e9)
    assert run.cycle(contact=True).expired


def lost_in_motion(gap_m: float | None, state: State = State.TRACK) -> Run:
    """Return a run whose link was lost in motion, with a gap to the object."""
    run = Run(state).healthy()
    while run.cycle(telegram=False, gap_m=gap_m).link is not Link.LOST:
        pass
    run.machine = Machine(State.FAULT, latched=True)
    run.cycle(telegram=False)
    return run


@pytest.mark.parametrize(("gap_m", "withdrawn"), [(0.029, True), (0.031, False), (None, False)])
def test_a_tool_whose_link_was_lost_near_the_object_is_withdrawn_once_it_is_back(
    gap_m: float | None, withdrawn: bool
) -> None:
    for state in (State.TRACK, State.RETREAT):
        signals = lost_in_motion(gap_m, state).cycle()
        assert (signals.contact, signals.expired) == (withdrawn, False)


def test_it_is_not_withdrawn_later_nor_in_a_new_session_nor_before_it_rests() -> None:
    assert lost_in_motion(0.01).cycle(settling=True).expired
    assert not lost_in_motion(0.01).cycle(new_session=True).contact
    late = lost_in_motion(0.01)
    late.now_ns += 1_000_000_000
    assert late.cycle().expired


def test_a_fault_of_a_robot_that_did_not_track_withdraws_nothing() -> None:
    run = Run(State.IDLE).healthy()
    run.cycle(gap_m=0.01)
    run.machine = Machine(State.FAULT, latched=True)
    assert not run.cycle().contact


def approached(run: Run, seconds: float, **facts: Any) -> Signals:
    """Return the signals when an object has come near, some time after the fault."""
    for _ in range(SETTINGS.healthy_cycles):
        run.cycle()
    run.now_ns += round(seconds * 1e9)
    seen = {"gap_m": 0.029, "position_ns": run.now_ns + CYCLE_NS, **facts}
    return run.cycle(**seen)


@pytest.mark.parametrize("state", [State.TRACK, State.CONTACT, State.RETREAT, State.HOLD])
def test_an_object_that_comes_near_a_tool_stopped_by_a_lost_link_makes_it_withdraw(
    state: State,
) -> None:
    for seconds, gap_m, withdrawn in ((59.0, 0.029, True), (0.0, 0.031, False), (0.0, None, False)):
        signals = approached(lost_in_motion(None, state), seconds, gap_m=gap_m)
        assert (signals.contact, signals.expired) == (withdrawn, False)


@pytest.mark.parametrize(
    "trouble", [{"position_ns": None}, {"following_error": True}, {"fault": True}]
)
def test_nothing_is_withdrawn_unseen_or_by_a_robot_that_does_not_do_what_it_is_sent_to(
    trouble: dict[str, Any],
) -> None:
    assert approached(lost_in_motion(None), 5.0).contact
    assert not approached(lost_in_motion(None), 5.0, **trouble).contact


def test_no_tool_is_withdrawn_long_after_its_fault_nor_while_the_robot_settles() -> None:
    assert approached(lost_in_motion(None), SETTINGS.longest_hold_s).expired
    assert approached(lost_in_motion(None), 5.0, settling=True).expired


def test_a_link_that_is_not_proven_again_or_a_new_programme_withdraws_nothing() -> None:
    near: dict[str, Any] = {"gap_m": 0.029}
    unproven = lost_in_motion(None)
    assert not unproven.cycle(position_ns=unproven.now_ns, **near).contact
    restarted = lost_in_motion(None)
    restarted.cycle(new_session=True)
    assert not approached(restarted, 0.0).contact


@pytest.mark.parametrize("state", [State.IDLE, State.HOME, State.FOLLOW])
def test_a_lost_link_outside_the_task_withdraws_nothing(state: State) -> None:
    assert not approached(lost_in_motion(None, state), 0.0).contact


def test_a_fault_without_a_lost_link_withdraws_nothing() -> None:
    run = Run(State.HOLD).healthy()
    run.machine = Machine(State.FAULT, latched=True)
    assert not approached(run, 0.0).contact
