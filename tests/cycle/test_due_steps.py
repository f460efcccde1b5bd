"""The phase lock: which steps are due, alone and with a controller."""

import itertools
import random
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linemate.daemon.cycle.clock.phase_lock import (
    ATTEND_NS,
    MARGIN_NS,
    MAX_STEPS_AT_ONCE,
    Due,
    DueKind,
    PhaseLock,
)

MS = 1_000_000
START = 7_000_000_000_123
T = 12 * MS


def locked(lead_ns: int = 0) -> PhaseLock:
    """Return a phase lock whose last telegrams came each T, the last one at START."""
    lock = PhaseLock(T, START - T, lead_ns)
    lock.follow(START)
    return lock


def missing(stamp_ns: int) -> Due:
    return Due(DueKind.MISSING, stamp_ns)


def test_while_telegrams_come_no_step_is_due() -> None:
    lock = locked()
    for k in range(1, 100):
        assert lock.wake_ns == START + k * T + T // 2
        assert lock.take_due(START + k * T - 1) == ()
        lock.follow(START + k * T)


def test_a_missing_telegram_makes_its_deadline_step() -> None:
    lock = locked()
    assert lock.take_due(START + T + T // 2) == (missing(START + T),)
    assert lock.wake_ns == START + 2 * T + T // 2


def test_a_late_wake_does_not_move_the_grid() -> None:
    lock = locked()
    for k in range(1, 50):
        assert lock.take_due(lock.wake_ns + T // 3) == (missing(START + k * T),)


@pytest.mark.parametrize("late", [1, 2, 7])
def test_a_telegram_that_comes_after_the_steps_of_later_cycles_makes_none_of_them_again(
    late: int,
) -> None:
    lock = locked()
    for k in range(100):
        lock.follow(START + (k + 1) * T)
    first = START + 101 * T
    came = first + (late - 1) * T + T // 2
    assert lock.take_due(came) == tuple(missing(first + k * T) for k in range(late))
    lock.follow(came, ahead=late - 1)
    assert lock.take_due(came) == ()
    beyond = lock.next_ns
    assert lock.take_due(beyond + T // 2) == (missing(beyond),)
    assert first + (late - 1) * T < beyond <= came + late * T


def test_after_a_stall_every_missed_step_is_made_once_and_in_order() -> None:
    lock = locked()
    due = lock.take_due(START + 5 * T + T // 2)
    assert due == tuple(missing(START + k * T) for k in range(1, 6))
    assert lock.skipped == 0


def test_after_a_long_stall_the_work_is_bounded_and_the_rest_counted() -> None:
    lock = locked()
    due = lock.take_due(START + 1000 * T + T // 2)
    assert len(due) == MAX_STEPS_AT_ONCE
    assert due[-1] == missing(START + 1000 * T)
    assert lock.skipped == 1000 - MAX_STEPS_AT_ONCE
    assert lock.wake_ns == START + 1001 * T + T // 2


def test_the_first_telegram_sets_the_phase_whenever_it_comes() -> None:
    for shift in (-T // 3, 0, T // 3, 7 * T + 5):
        lock = PhaseLock(T, START)
        lock.follow(START + shift)
        assert lock.next_ns == START + shift + T
        assert lock.is_locked


def test_after_the_robot_was_gone_its_next_telegram_sets_the_phase() -> None:
    lock = locked()
    lock.run_free()
    lock.take_due(START + 40 * T)
    lock.follow(START + 40 * T + T // 3)
    assert lock.next_ns == START + 41 * T + T // 3


def test_a_clock_that_rests_wakes_later_counts_every_cycle_and_follows_at_once() -> None:
    lock = locked()
    lock.run_free(1e-9 * 8 * T)
    begun, wake = lock.next_ns, lock.wake_ns
    assert wake == begun + T // 2 + 8 * T
    dues = lock.take_due(wake)
    assert [due.stamp_ns for due in dues] == [begun + k * T for k in range(9)]
    assert lock.skipped == 0
    lock.run_free(1.0)
    assert len(lock.take_due(lock.wake_ns)) == MAX_STEPS_AT_ONCE - 4
    assert lock.skipped == 0
    lock.follow(lock.next_ns)
    assert lock.wake_ns <= lock.next_ns + T // 2


def test_a_step_is_prepared_once_ahead_of_its_telegram() -> None:
    lead = 3 * MS
    lock = locked(lead)
    assert lock.wake_ns == START + T - lead
    assert lock.take_due(START + T - lead + 70_000) == (Due(DueKind.PREPARE, START + T),)
    assert lock.take_due(START + T - 1) == ()
    lock.follow(START + T)
    assert lock.wake_ns == START + 2 * T - lead


def test_between_a_preparation_and_its_telegram_there_is_time_for_everything_else() -> None:
    lead = 3 * MS
    lock = locked(lead)
    lock.take_due(START + T - lead)
    assert lock.attend(START + T - ATTEND_NS - 1) is None
    assert lock.wake_ns == START + T - ATTEND_NS
    assert lock.attend(START + T - ATTEND_NS) == START + T
    assert lock.attend(START + T) is None
    assert lock.wake_ns == START + T + T // 2
    lock.follow(START + T)
    assert lock.wake_ns == START + 2 * T - lead


def test_a_telegram_whose_reply_is_not_made_is_not_waited_for() -> None:
    assert locked().attend(START + T) is None
    assert locked(3 * MS).attend(START + T) is None


@pytest.mark.parametrize("lead", [3 * MS, T * 3 // 4])
def test_a_missing_telegram_and_the_next_preparation_come_in_order(lead: int) -> None:
    due = locked(lead).take_due(START + T + T // 2 - 1)
    assert due == (Due(DueKind.PREPARE, START + T),)
    due = locked(lead).take_due(max(START + 2 * T - lead, START + T + T // 2))
    assert due == (missing(START + T), Due(DueKind.PREPARE, START + 2 * T))


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 3 * T)), max_size=60), st.integers(0, 11))
def test_stamps_rise_by_whole_periods_between_telegrams_in_any_order_of_events(
    events: list[tuple[bool, int]], lead_ms: int
) -> None:
    lock = locked(lead_ms * MS)
    clock_ns = START
    last_ns: int | None = None
    for telegram, wait_ns in events:
        clock_ns += wait_ns
        if telegram:
            lock.follow(clock_ns)
            last_ns = None
            continue
        for due in lock.take_due(clock_ns):
            assert due.stamp_ns <= clock_ns + lock.lead_ns
            if due.kind is DueKind.MISSING:
                assert last_ns is None or (due.stamp_ns - last_ns) % lock.period_ns == 0
                assert last_ns is None or due.stamp_ns > last_ns
                last_ns = due.stamp_ns
        expected_ns = lock.attend(clock_ns)
        assert expected_ns is None or lock.next_ns == expected_ns
        assert lock.wake_ns > clock_ns


# The phase lock against a controller in virtual time.


def wake(lock: PhaseLock, now_ns: int) -> tuple[Due, ...]:
    """Return what is due, and wait for a telegram that is about to come."""
    due = lock.take_due(now_ns)
    lock.attend(now_ns)
    return due


@dataclass
class Controller:
    """A controller, its network, and a daemon that takes time to wake and to step."""

    cycle_ns: int
    lock: PhaseLock
    period: float = 0.0
    seed: int = 1
    step_ns: int = 300_000
    loss: float = 0.0
    prepared: int = 0
    inline: int = 0
    stamps: list[int] = field(default_factory=list)
    missing: list[int] = field(default_factory=list)
    late_ns: list[int] = field(default_factory=list)
    waited_ns: list[int] = field(default_factory=list)

    def run(self, cycles: int, first: int = 0) -> None:
        """Simulate some cycles; time comes from the events alone."""
        draw = random.Random(self.seed)
        period = self.period or self.cycle_ns
        ready_for: int | None = None
        last = first - 1
        busy_ns = 0
        for n in range(first, first + cycles):
            line = START + round(n * period)
            arrival = line + round(draw.expovariate(1 / 15_000))
            lost = draw.random() < self.loss
            end = START + round((n + 0.9) * period) if lost else arrival
            # Everything the clock does before this telegram, or its absence, is over.
            while self.lock.wake_ns <= end:
                woke = max(self.lock.wake_ns + round(draw.expovariate(1 / 20_000)), busy_ns)
                began = self.lock.wake_ns
                dues = self.lock.take_due(woke)
                if not dues and (expected := self.lock.attend(woke)) is not None:
                    # While the daemon waits for a telegram, it does nothing else.
                    self.waited_ns.append(expected - woke)
                for due in dues:
                    if due.kind is DueKind.MISSING:
                        self.missing.append(due.stamp_ns)
                        ready_for = None
                        continue
                    busy_ns = woke + round(self.step_ns * draw.uniform(0.8, 1.2))
                    self.lock.add_cost(busy_ns - began)
                    ready_for = round((due.stamp_ns - START) / period)
                    self.stamps.append(due.stamp_ns - START - round(ready_for * period))
            if lost:
                continue
            if ready_for == n:
                self.prepared += 1
                self.late_ns.append(max(0, busy_ns - arrival))
            else:
                self.inline += 1
            self.lock.follow(arrival, n - last)
            last = n


@pytest.mark.parametrize("cycle_ms", [1, 4, 12])
def test_replies_are_ready_before_their_telegrams_and_no_earlier_than_needed(cycle_ms: int) -> None:
    controller = Controller(cycle_ms * MS, PhaseLock(cycle_ms * MS, START - cycle_ms * MS, None))
    controller.run(4000)
    assert controller.prepared >= 0.999 * 4000
    assert controller.missing == []
    # Made for the instant of the telegram, and ready when it came.
    assert max(map(abs, controller.stamps[100:])) < 20_000
    late = [late for late in controller.late_ns[1000:] if late]
    assert len(late) <= 0.005 * 3000
    lead = controller.lock.lead_ns
    assert 360_000 <= lead <= min(0.75 * cycle_ms * MS, 360_000 + 250_000 + MARGIN_NS)
    assert max(controller.waited_ns) <= ATTEND_NS


def test_a_controllers_own_clock_is_followed() -> None:
    controller = Controller(4 * MS, PhaseLock(4 * MS, START - MS, None), period=4 * MS * 1.02)
    controller.run(3000)
    assert controller.lock.estimate.measured_ns == pytest.approx(4.08 * MS, rel=1e-4)
    assert controller.prepared >= 0.99 * 3000
    assert max(map(abs, controller.stamps[100:])) < 25_000


def test_every_lost_telegram_is_one_step_of_the_clock_and_k_stays_right() -> None:
    controller = Controller(4 * MS, PhaseLock(4 * MS, START - 4 * MS, None), loss=0.05)
    controller.run(4000)
    lost = 4000 - controller.prepared - controller.inline
    assert 150 < lost < 250
    assert len(controller.missing) == lost
    lines = [round((stamp - START) / (4 * MS)) for stamp in controller.missing]
    assert len(set(lines)) == lost
    assert controller.prepared >= 0.99 * (4000 - lost)


@pytest.mark.parametrize("stall_ms", [5, 21, 100])
def test_time_that_the_controller_did_not_count_is_stepped_through_once(stall_ms: int) -> None:
    controller = Controller(4 * MS, PhaseLock(4 * MS, START - 4 * MS, None))
    controller.run(500)
    lock, again = controller.lock, START + 500 * 4 * MS + stall_ms * MS
    made = []
    for n in range(20):
        arrival = again + n * 4 * MS
        while lock.wake_ns <= arrival:
            made += [
                due.stamp_ns for due in wake(lock, lock.wake_ns) if due.kind is DueKind.MISSING
            ]
        lock.follow(arrival)
    assert made == sorted(made)
    assert len(made) <= stall_ms / 4 + 1


def test_without_a_robot_the_clock_steps_alone_and_prepares_nothing() -> None:
    lock = PhaseLock(12 * MS, START, None)
    kinds = []
    for _ in range(50):
        kinds += [due.kind for due in wake(lock, lock.wake_ns)]
    assert kinds == [DueKind.MISSING] * 50


def test_when_the_robot_is_gone_the_grid_goes_on_and_its_return_sets_the_phase() -> None:
    controller = Controller(4 * MS, PhaseLock(4 * MS, START - 4 * MS, None))
    controller.run(500)
    lock = controller.lock
    stamps = [due.stamp_ns for _ in range(40) for due in wake(lock, lock.wake_ns)]
    steps = {b - a for a, b in itertools.pairwise(stamps)}
    assert max(steps) - min(steps - {0}) < 5_000
    lock.run_free()
    back = stamps[-1] + 40 * MS + 1_700_000
    lock.follow(back)
    assert lock.next_ns == back + 4 * MS
    assert lock.is_locked


def test_in_line_nothing_is_prepared() -> None:
    controller = Controller(4 * MS, PhaseLock(4 * MS, START - 4 * MS, 0))
    controller.run(500)
    assert controller.prepared == 0
    assert controller.inline == 500


def test_a_fixed_lead_stays_as_configured() -> None:
    controller = Controller(12 * MS, PhaseLock(12 * MS, START - 12 * MS, 3 * MS), step_ns=MS)
    controller.run(2000)
    assert controller.lock.lead_ns == 3 * MS
    assert controller.prepared >= 0.999 * 2000


def test_a_controller_of_another_cycle_is_refused_and_the_clock_keeps_the_configured_one() -> None:
    lock = PhaseLock(4 * MS, START, None)
    for n in range(60):
        lock.follow(START + n * 12 * MS)
        while lock.wake_ns < START + (n + 1) * 12 * MS:
            wake(lock, lock.wake_ns)
    assert str(lock.estimate.refusal).startswith(
        "the controller's cycle is 12.000 ms, 200.0 % off the 4 ms configured, limit 5 %. "
    )
    assert lock.period_ns == 4 * MS
    lock.follow(START + 61 * 12 * MS, restarts=True)
    assert lock.estimate.refusal is None


@pytest.mark.parametrize("lead_ns", [-1, 4 * MS, 5 * MS])
def test_a_lead_that_does_not_fit_is_refused(lead_ns: int) -> None:
    with pytest.raises(ValueError, match="does not fit"):
        PhaseLock(4 * MS, START, lead_ns)
