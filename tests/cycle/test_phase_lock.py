"""The phase lock follows a controller's grid through late, lost and shifted telegrams."""

import random
from collections.abc import Iterator

import pytest

from linemate.daemon.cycle.clock.phase_lock import (
    AFRESH,
    GUESSED,
    LASTING,
    LEARNT,
    MARGIN_NS,
    TOLERANCE,
    WINDOW,
    CycleEstimate,
    Lead,
    PhaseLock,
)

MS = 1_000_000
START = 7_000_000_000_123
T = 12 * MS


def late_arrivals(period_ns: float, count: int, seed: int = 1) -> Iterator[tuple[int, int]]:
    """Grid lines and arrivals: mostly a few us late, now and then a ms."""
    draw = random.Random(seed)
    for n in range(count):
        line = START + round(n * period_ns)
        late = draw.expovariate(1 / 8_000) + (draw.random() < 0.02) * draw.uniform(0, 1.5e6)
        yield line, line + round(late)


def test_before_the_first_telegram_nothing_is_expected_and_nothing_refused() -> None:
    estimate = CycleEstimate(4 * MS)
    assert estimate.expected_ns() is None
    assert estimate.measured_ns is None
    assert estimate.refusal is None
    assert estimate.period_ns == 4 * MS


@pytest.mark.parametrize("cycle_ms", [1, 2, 4, 12])
@pytest.mark.parametrize("drift", [0.0, 80e-6, -80e-6, 0.03, -0.03])
def test_the_next_telegram_is_predicted_within_some_microseconds(
    cycle_ms: int, drift: float
) -> None:
    period = cycle_ms * MS * (1.0 + drift)
    estimate = CycleEstimate(cycle_ms * MS)
    errors = []
    for n, (line, stamp) in enumerate(late_arrivals(period, 3000)):
        expected = estimate.expected_ns()
        if expected is not None and n > 200:
            errors.append(expected - line)
        estimate.add(stamp)
    # Above the grid by at most what the earliest of a window is late, below it hardly.
    assert max(errors) < 20_000
    assert min(errors) > -20_000
    assert estimate.measured_ns == pytest.approx(period, rel=2e-5)
    assert estimate.refusal is None


def test_a_late_telegram_moves_nothing() -> None:
    estimate = CycleEstimate(4 * MS)
    for n in range(100):
        estimate.add(START + n * 4 * MS)
    estimate.add(START + 100 * 4 * MS + 1_700_000)
    assert estimate.expected_ns() == START + 101 * 4 * MS


def test_lost_telegrams_are_counted_by_their_ipoc_and_not_by_time() -> None:
    estimate = CycleEstimate(4 * MS)
    n = 0
    for _ in range(60):
        step = 3 if n % 7 == 0 else 1
        n += step
        estimate.add(START + n * 4 * MS, step)
    assert estimate.period_ns == 4 * MS
    assert estimate.expected_ns() == START + (n + 1) * 4 * MS
    assert estimate.expected_ns(ahead=5) == START + (n + 5) * 4 * MS


def test_a_controller_that_pauses_is_followed_again_after_a_few_telegrams() -> None:
    estimate = CycleEstimate(4 * MS)
    for n in range(500):
        estimate.add(START + n * 4 * MS)
    moved = START + 500 * 4 * MS + 3 * MS
    for n in range(AFRESH):
        estimate.add(moved + n * 4 * MS)
    assert estimate.expected_ns() == moved + AFRESH * 4 * MS
    assert estimate.relocks == 1
    assert estimate.period_ns == 4 * MS


def test_a_period_that_was_measured_is_kept_by_guesses_from_delayed_telegrams() -> None:
    draw, guesses = random.Random(3), 0
    estimate = CycleEstimate(12 * MS)
    for n in range(200):
        estimate.add(START + n * 12 * MS)
    for n in range(200, 400):
        estimate.add(START + n * 12 * MS + round(draw.expovariate(1.0 / (42 * MS))))
        if estimate.measured_ns is None:
            assert estimate.period_ns == pytest.approx(12 * MS, rel=TOLERANCE)
            guesses += 1
    assert guesses > 50
    estimate.restart()
    for n in range(8):
        estimate.add(START + n * 13 * MS)
    assert estimate.period_ns == pytest.approx(13 * MS)


def test_a_controller_that_stalled_for_cycles_is_followed_from_its_next_telegram() -> None:
    estimate = CycleEstimate(4 * MS)
    for n in range(500):
        estimate.add(START + n * 4 * MS)
    moved = START + 500 * 4 * MS + 21 * MS
    estimate.add(moved)
    assert estimate.expected_ns() == moved + 4 * MS
    assert estimate.period_ns == 4 * MS


def test_a_network_that_was_blocked_for_cycles_moves_nothing_for_long() -> None:
    estimate = CycleEstimate(4 * MS)
    for n in range(500):
        estimate.add(START + n * 4 * MS)
    out = START + 505 * 4 * MS - MS
    for n in range(5):
        estimate.add(out + n * 10_000)
    estimate.add(START + 505 * 4 * MS)
    assert estimate.expected_ns() == START + 506 * 4 * MS


@pytest.mark.parametrize("delayed", [12, 20, 33, 60, 100])
@pytest.mark.parametrize("late_ms", [5, 20, 45, 90])
def test_a_grid_learned_from_delayed_telegrams_does_not_last(delayed: int, late_ms: int) -> None:
    estimate = CycleEstimate(12 * MS)
    for n in range(delayed):
        estimate.add(START + n * 12 * MS + late_ms * MS)
    first = delayed + late_ms // 12 + 1
    estimate.add(START + first * 12 * MS, first - delayed + 1)
    for n in range(first + 1, first + 400):
        estimate.add(START + n * 12 * MS)
    assert estimate.refusal is None
    assert estimate.measured_ns == pytest.approx(12 * MS, rel=1e-6)
    assert estimate.expected_ns() == START + (first + 400) * 12 * MS


def test_a_phase_that_comes_earlier_is_followed_at_once() -> None:
    estimate = CycleEstimate(12 * MS)
    for n in range(100):
        estimate.add(START + n * 12 * MS)
    estimate.add(START + 100 * 12 * MS - 2 * MS)
    assert estimate.expected_ns() == START + 101 * 12 * MS - 2 * MS


def test_a_small_shift_is_followed_within_a_window() -> None:
    estimate = CycleEstimate(12 * MS)
    for n in range(1000):
        estimate.add(START + n * 12 * MS)
    for n in range(1000, 1000 + WINDOW):
        estimate.add(START + n * 12 * MS + MS)
    expected = estimate.expected_ns()
    assert expected is not None
    assert abs(expected - (START + (1000 + WINDOW) * 12 * MS + MS)) < 20_000


@pytest.mark.parametrize(
    ("nominal_ms", "real_ms", "refused"),
    [(4, 3.9, False), (4, 4.1, False), (4, 4.21, True), (4, 3.79, True), (4, 12, True),
     (12, 4, True)],
)  # fmt: skip
def test_a_cycle_outside_five_per_cent_is_refused_with_both_figures(
    nominal_ms: int, real_ms: float, refused: bool
) -> None:
    estimate = CycleEstimate(nominal_ms * MS)
    for n in range(80):
        estimate.add(START + round(n * real_ms * MS))
    reason = estimate.refusal
    assert (reason is not None) == refused
    if reason is not None:
        assert f"{real_ms:.3f} ms" in reason
        assert f"{nominal_ms} ms" in reason


def test_a_few_telegrams_are_no_measured_period() -> None:
    estimate = CycleEstimate(4 * MS)
    for n in range(LEARNT):
        estimate.add(START + n * 12 * MS)
        assert estimate.refusal is None
    estimate.add(START + LEARNT * 12 * MS)
    assert estimate.refusal is not None


@pytest.mark.parametrize("apart_ns", [0, 200_000, 3_000 * MS])
def test_two_telegrams_alone_do_not_make_the_clock_race_or_sleep(apart_ns: int) -> None:
    estimate = CycleEstimate(12 * MS)
    estimate.add(START)
    estimate.add(START + apart_ns)
    low, high = (share * estimate.nominal_ns for share in GUESSED)
    assert low <= estimate.period_ns <= high
    expected = estimate.expected_ns()
    assert expected is not None
    assert expected <= START + apart_ns + high


@pytest.mark.parametrize(("nominal_ms", "true_ms"), [(4, 12), (12, 4), (12, 1), (1, 4)])
def test_a_very_different_cycle_is_measured_too(nominal_ms: int, true_ms: int) -> None:
    estimate = CycleEstimate(nominal_ms * MS)
    for n in range(LEARNT + 2 * WINDOW):
        estimate.add(START + n * true_ms * MS)
    assert estimate.measured_ns == pytest.approx(true_ms * MS, rel=1e-6)
    assert estimate.refusal is not None


def test_another_session_begins_with_the_configured_period() -> None:
    estimate = CycleEstimate(4 * MS)
    for n in range(100):
        estimate.add(START + n * 12 * MS)
    estimate.restart()
    assert estimate.refusal is None
    assert estimate.expected_ns() is None
    estimate.add(START)
    assert estimate.expected_ns() == START + 4 * MS


def test_the_lead_begins_long_and_settles_a_little_above_the_slowest_of_a_thousand() -> None:
    lead = Lead(4 * MS)
    assert lead.lead_ns == int(0.75 * 4 * MS)
    draw = random.Random(3)
    costs = [round(draw.uniform(200_000, 300_000)) for _ in range(1023)] + [1_200_000]
    draw.shuffle(costs)
    for cost in costs:
        lead.add(cost)
    assert max(c for c in costs if c < MS) + MARGIN_NS == lead.lead_ns


def test_the_lead_forgets_a_bad_time_and_never_exceeds_its_share() -> None:
    lead = Lead(MS)
    for _ in range(64):
        lead.add(5 * MS)
    assert lead.lead_ns == lead.max_ns == int(0.75 * MS)
    for _ in range(2000):
        lead.add(100_000)
    assert lead.lead_ns == 100_000 + MARGIN_NS


def test_a_long_cycle_has_no_longer_lead_than_a_slow_host_needs() -> None:
    assert Lead(12 * MS).max_ns == 4 * MS


@pytest.mark.parametrize("cycle_ms", [4, 12])
def test_a_robot_is_armed_only_at_a_measured_period_near_the_configured_one(cycle_ms: int) -> None:
    for share, good in ((1.0, True), (1.045, True), (0.955, True), (1.075, False), (0.92, False)):
        estimate = CycleEstimate(cycle_ms * MS)
        for n in range(200):
            reason = estimate.arm_refusal
            assert (estimate.measured_ns is None) is (
                reason is not None and "not measured" in reason
            )
            estimate.add(START + round(n * cycle_ms * MS * share))
        assert (estimate.arm_refusal is None) is good
        if not good:
            assert f"{cycle_ms * share:.3f} ms" in str(estimate.arm_refusal)
            assert f"the {cycle_ms} ms configured, limit 5 %. Set the same cycle in" in str(
                estimate.arm_refusal
            )


def test_before_the_period_is_measured_arm_is_refused_with_how_many_telegrams_there_are() -> None:
    estimate = CycleEstimate(12 * MS)
    for n in range(5):
        estimate.add(START + n * 12 * MS)
    assert "not measured yet: 5 of 25 telegrams at 12 ms" in str(estimate.arm_refusal)


def test_a_wrong_period_ends_a_motion_only_once_it_lasts() -> None:
    estimate = CycleEstimate(12 * MS)
    lasting = []
    for n in range(120):
        estimate.add(START + round(n * 12 * MS * 1.075))
        lasting.append(estimate.lasting_refusal is not None)
    first = lasting.index(True)
    assert LEARNT + LASTING - 2 <= first <= LEARNT + LASTING + 2
    assert all(lasting[first:])
    estimate.restart()
    assert estimate.lasting_refusal is None


@pytest.mark.parametrize("cycle_ms", [4, 12])
def test_a_late_telegram_is_dated_with_its_cycle_and_an_early_one_with_itself(
    cycle_ms: int,
) -> None:
    period, draw = cycle_ms * MS, random.Random(cycle_ms)
    errors: list[int] = []
    delays: list[int] = []
    lock = PhaseLock(period, START)
    for n in range(200):
        line = START + n * period
        arrival = line + round(draw.expovariate(4.0 / period))
        if n > 40:
            dated = lock.date(arrival, 1)
            assert dated <= arrival
            errors.append(dated - line)
            delays.append(arrival - line)
        lock.follow(arrival)
    assert sum(map(abs, errors)) < 0.5 * sum(delays)
    assert min(errors) > -period
    early = START + 200 * period - period // 3
    assert lock.date(early, 1) == early
    beyond = START + 200 * period + 200 * MS
    assert lock.date(beyond, 1) == beyond


def test_before_its_phase_is_known_a_telegram_is_dated_with_itself() -> None:
    lock = PhaseLock(4 * MS, START)
    assert lock.date(START + 5 * MS, 1) == START + 5 * MS


def test_the_clock_alone_keeps_the_configured_period_whatever_late_telegrams_seemed_to_say() -> (
    None
):
    period, draw = 4 * MS, random.Random(5)
    for trial in range(20):
        lock = PhaseLock(period, START)
        for n in range(12):
            lock.follow(START + n * period + round(draw.expovariate(1.0 / (6 * MS))))
            assert lock.period_ns == period, trial
        lock.run_free()
        assert lock.period_ns == period
        assert lock.grace_ns == period // 2
