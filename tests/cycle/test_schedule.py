"""The sampling schedule in virtual time."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from linemate.daemon.cycle.clock import schedule as scheduling
from linemate.daemon.cycle.clock.schedule import ATTEND_NS, MOST_AT_ONCE, Due, Kind, Schedule

T = 12_000_000
START = 1_000_000_000


def locked(lead_ns: int = 0) -> Schedule:
    """A schedule whose last telegram came at START."""
    return scheduling.on_telegram(scheduling.free(T, START - T, lead_ns), START)


def missing(stamp_ns: int) -> Due:
    return Due(Kind.MISSING, stamp_ns)


def test_while_telegrams_come_the_schedule_does_nothing() -> None:
    now = locked()
    for k in range(1, 100):
        assert scheduling.wake_ns(now) == START + k * T + T // 2
        now, due = scheduling.on_wake(now, START + k * T - 1)
        assert due == ()
        now = scheduling.on_telegram(now, START + k * T)


def test_a_missing_telegram_makes_its_deadline_step() -> None:
    now, due = scheduling.on_wake(locked(), START + T + T // 2)
    assert due == (missing(START + T),)
    assert scheduling.wake_ns(now) == START + 2 * T + T // 2


def test_a_late_wake_does_not_move_the_grid() -> None:
    now = locked()
    for k in range(1, 50):
        wake = scheduling.wake_ns(now)
        now, due = scheduling.on_wake(now, wake + T // 3)
        assert due == (missing(START + k * T),)


def test_after_a_stall_every_missed_step_is_made_once_and_in_order() -> None:
    now, due = scheduling.on_wake(locked(), START + 5 * T + T // 2)
    assert due == tuple(missing(START + k * T) for k in range(1, 6))
    assert now.skipped == 0


def test_after_a_long_stall_the_work_is_bounded_and_the_rest_counted() -> None:
    now, due = scheduling.on_wake(locked(), START + 1000 * T + T // 2)
    assert len(due) == MOST_AT_ONCE
    assert due[-1] == missing(START + 1000 * T)
    assert now.skipped == 1000 - MOST_AT_ONCE
    assert scheduling.wake_ns(now) == START + 1001 * T + T // 2


def test_a_telegram_after_its_deadline_does_not_shift_the_phase_by_much() -> None:
    now, _ = scheduling.on_wake(locked(), START + T + T // 2)
    now = scheduling.on_telegram(now, START + T + T // 2 - 1)
    assert START + 2 * T <= now.next_ns <= START + 2 * T + T // 20


def test_an_early_telegram_sets_the_phase_at_once() -> None:
    now = scheduling.on_telegram(locked(), START + T - 300_000)
    assert now.next_ns == START + 2 * T - 300_000


def test_the_first_telegram_sets_the_phase_whatever_it_was() -> None:
    for shift in (-T // 3, 0, T // 3, 7 * T + 5):
        now = scheduling.on_telegram(scheduling.free(T, START), START + shift)
        assert now.next_ns == START + shift + T
        assert now.locked


def test_after_the_robot_was_gone_its_next_telegram_sets_the_phase() -> None:
    now = scheduling.run_free(locked(), locked().period_ns)
    now, _ = scheduling.on_wake(now, START + 40 * T)
    assert scheduling.on_telegram(now, START + 40 * T + T // 3).next_ns == START + 41 * T + T // 3


def test_a_step_is_prepared_once_ahead_of_its_telegram() -> None:
    lead = 3_000_000
    now = locked(lead)
    assert scheduling.wake_ns(now) == START + T - lead
    now, due = scheduling.on_wake(now, START + T - lead + 70_000)
    assert due == (Due(Kind.PREPARE, START + T),)
    now, due = scheduling.on_wake(now, START + T - 1)
    assert due == ()
    now = scheduling.on_telegram(now, START + T)
    assert scheduling.wake_ns(now) == START + 2 * T - lead


def test_between_a_preparation_and_its_telegram_there_is_time_for_everything_else() -> None:
    lead = 3_000_000
    now, _ = scheduling.on_wake(locked(lead), START + T - lead)
    assert scheduling.attend(now, START + T - ATTEND_NS - 1) == (now, None)
    assert scheduling.wake_ns(now) == START + T - ATTEND_NS
    now, expected_ns = scheduling.attend(now, START + T - ATTEND_NS)
    assert expected_ns == START + T
    assert scheduling.attend(now, START + T) == (now, None)
    assert scheduling.wake_ns(now) == START + T + T // 2


def test_nobody_waits_for_a_telegram_whose_reply_is_not_made() -> None:
    assert scheduling.attend(locked(), START + T) == (locked(), None)
    assert scheduling.attend(locked(3_000_000), START + T)[1] is None


@pytest.mark.parametrize("lead", [3_000_000, T * 3 // 4])
def test_a_missing_telegram_and_the_next_preparation_come_in_order(lead: int) -> None:
    _, due = scheduling.on_wake(locked(lead), START + T + T // 2 - 1)
    assert due == (Due(Kind.PREPARE, START + T),)
    _, due = scheduling.on_wake(locked(lead), max(START + 2 * T - lead, START + T + T // 2))
    assert due == (missing(START + T), Due(Kind.PREPARE, START + 2 * T))


@pytest.mark.parametrize("lead_ns", [-1, T, 2 * T])
def test_a_lead_that_does_not_fit_is_refused(lead_ns: int) -> None:
    with pytest.raises(ValueError, match="does not fit"):
        scheduling.free(T, 0, lead_ns)


@given(st.integers(0, 10**6))
def test_arrival_noise_moves_the_phase_within_its_own_range(seed: int) -> None:
    noise = random.Random(seed)
    now = locked()
    for k in range(1, 300):
        late_ns = noise.randrange(400_000)
        now = scheduling.on_telegram(now, START + k * T + late_ns)
        assert START + (k + 1) * T <= now.next_ns <= START + (k + 1) * T + 400_000


@given(st.floats(0.9999, 1.0001), st.integers(0, 10**6))
def test_a_controller_whose_clock_drifts_is_followed(rate: float, seed: int) -> None:
    noise = random.Random(seed)
    now = locked()
    for k in range(1, 501):
        late_ns = noise.randrange(200_000)
        now = scheduling.on_telegram(now, START + round(k * T * rate) + late_ns)
    assert abs(now.next_ns - START - round(501 * T * rate)) < 300_000


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 3 * T)), max_size=60), st.integers(0, 11))
def test_whatever_happens_stamps_rise_by_whole_cycles_between_telegrams(
    events: list[tuple[bool, int]], lead_ms: int
) -> None:
    now = locked(lead_ms * 1_000_000)
    clock_ns = START
    last_ns: int | None = None
    for telegram, wait_ns in events:
        clock_ns += wait_ns
        if telegram:
            now = scheduling.on_telegram(now, clock_ns)
            last_ns = None
            continue
        now, due = scheduling.on_wake(now, clock_ns)
        for one in due:
            assert one.stamp_ns <= clock_ns + now.lead_ns
            if one.kind is Kind.MISSING:
                assert last_ns is None or (one.stamp_ns - last_ns) % T == 0
                assert last_ns is None or one.stamp_ns > last_ns
                last_ns = one.stamp_ns
        now, expected_ns = scheduling.attend(now, clock_ns)
        assert expected_ns is None or now.next_ns == expected_ns
        assert scheduling.wake_ns(now) > clock_ns


def test_prepared_is_forgotten_with_every_telegram() -> None:
    now = replace(locked(1_000_000), prepared=True, attended=True)
    now = scheduling.on_telegram(now, START + T)
    assert not now.prepared
    assert not now.attended
