"""The clock's whole logic against a controller in virtual time: jitter, losses, stalls, silence."""

import itertools
import random
from dataclasses import dataclass, field

import pytest

from linemate.daemon.cycle.clock.pace import Pace
from linemate.daemon.cycle.clock.phase import MARGIN_NS
from linemate.daemon.cycle.clock.schedule import ATTEND_NS, Due, Kind

MS = 1_000_000
START = 3_000_000_000


def wake(pace: Pace, now_ns: int) -> tuple[Due, ...]:
    """What is due, and whatever telegram is about to come is waited for."""
    due = pace.wake(now_ns)
    pace.attend(now_ns)
    return due


@dataclass
class Station:
    """A controller, its wire, and a daemon that takes time to wake and to step."""

    cycle_ns: int
    pace: Pace
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
        """Live through some cycles; time is only ever taken from the events."""
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
            while self.pace.wake_ns <= end:
                woke = max(self.pace.wake_ns + round(draw.expovariate(1 / 20_000)), busy_ns)
                began = self.pace.wake_ns
                dues = self.pace.wake(woke)
                if not dues and (expected := self.pace.attend(woke)) is not None:
                    # Whoever waits for a telegram does nothing else until it has come.
                    self.waited_ns.append(expected - woke)
                for due in dues:
                    if due.kind is Kind.MISSING:
                        self.missing.append(due.stamp_ns)
                        ready_for = None
                        continue
                    busy_ns = woke + round(self.step_ns * draw.uniform(0.8, 1.2))
                    self.pace.prepared(busy_ns - began)
                    ready_for = round((due.stamp_ns - START) / period)
                    self.stamps.append(due.stamp_ns - START - round(ready_for * period))
            if lost:
                continue
            if ready_for == n:
                self.prepared += 1
                self.late_ns.append(max(0, busy_ns - arrival))
            else:
                self.inline += 1
            self.pace.telegram(arrival, n - last)
            last = n


@pytest.mark.parametrize("cycle_ms", [1, 4, 12])
def test_replies_are_ready_before_their_telegrams_and_no_earlier_than_needed(cycle_ms: int) -> None:
    station = Station(cycle_ms * MS, Pace.free(cycle_ms * MS, START - cycle_ms * MS, None))
    station.run(4000)
    assert station.prepared >= 0.999 * 4000
    assert station.missing == []
    # Made for the instant of the telegram, and ready when it came.
    assert max(map(abs, station.stamps[100:])) < 20_000
    late = [late for late in station.late_ns[1000:] if late]
    assert len(late) <= 0.005 * 3000
    lead = station.pace.schedule.lead_ns
    assert 360_000 <= lead <= min(0.75 * cycle_ms * MS, 360_000 + 250_000 + MARGIN_NS)
    assert max(station.waited_ns) <= ATTEND_NS


def test_a_controllers_own_clock_is_followed() -> None:
    station = Station(4 * MS, Pace.free(4 * MS, START - MS, None), period=4 * MS * 1.02)
    station.run(3000)
    assert station.pace.phase.measured_ns == pytest.approx(4.08 * MS, rel=1e-4)
    assert station.prepared >= 0.99 * 3000
    assert max(map(abs, station.stamps[100:])) < 25_000


def test_every_lost_telegram_is_one_step_of_the_clock_and_k_stays_right() -> None:
    station = Station(4 * MS, Pace.free(4 * MS, START - 4 * MS, None), loss=0.05)
    station.run(4000)
    lost = 4000 - station.prepared - station.inline
    assert 150 < lost < 250
    assert len(station.missing) == lost
    lines = [round((stamp - START) / (4 * MS)) for stamp in station.missing]
    assert len(set(lines)) == lost
    assert station.prepared >= 0.99 * (4000 - lost)


@pytest.mark.parametrize("stall_ms", [5, 21, 100])
def test_time_that_the_controller_did_not_count_is_stepped_through_once(stall_ms: int) -> None:
    station = Station(4 * MS, Pace.free(4 * MS, START - 4 * MS, None))
    station.run(500)
    pace, again = station.pace, START + 500 * 4 * MS + stall_ms * MS
    made = []
    for n in range(20):
        arrival = again + n * 4 * MS
        while pace.wake_ns <= arrival:
            made += [due.stamp_ns for due in wake(pace, pace.wake_ns) if due.kind is Kind.MISSING]
        pace.telegram(arrival)
    assert made == sorted(made)
    assert len(made) <= stall_ms / 4 + 1


def test_without_a_robot_the_clock_steps_alone_and_prepares_nothing() -> None:
    pace = Pace.free(12 * MS, START, None)
    kinds = []
    for _ in range(50):
        kinds += [due.kind for due in wake(pace, pace.wake_ns)]
    assert kinds == [Kind.MISSING] * 50


def test_when_the_robot_is_gone_the_grid_goes_on_and_its_return_sets_the_phase() -> None:
    station = Station(4 * MS, Pace.free(4 * MS, START - 4 * MS, None))
    station.run(500)
    pace = station.pace
    stamps = [due.stamp_ns for _ in range(40) for due in wake(pace, pace.wake_ns)]
    steps = {b - a for a, b in itertools.pairwise(stamps)}
    assert max(steps) - min(steps - {0}) < 5_000
    pace.run_free()
    back = stamps[-1] + 40 * MS + 1_700_000
    pace.telegram(back)
    assert pace.schedule.next_ns == back + 4 * MS
    assert pace.schedule.locked


def test_in_line_nothing_is_prepared() -> None:
    station = Station(4 * MS, Pace.free(4 * MS, START - 4 * MS, 0))
    station.run(500)
    assert station.prepared == 0
    assert station.inline == 500


def test_a_fixed_lead_stays_as_configured() -> None:
    station = Station(12 * MS, Pace.free(12 * MS, START - 12 * MS, 3 * MS), step_ns=MS)
    station.run(2000)
    assert station.pace.schedule.lead_ns == 3 * MS
    assert station.prepared >= 0.999 * 2000


def test_a_controller_of_another_cycle_is_refused_and_the_clock_keeps_the_configured_one() -> None:
    pace = Pace.free(4 * MS, START, None)
    for n in range(60):
        pace.telegram(START + n * 12 * MS)
        while pace.wake_ns < START + (n + 1) * 12 * MS:
            wake(pace, pace.wake_ns)
    assert str(pace.phase.refusal).startswith(
        "the controller's cycle is 12.000 ms, 200.0 % off the 4 ms configured, limit 5 %. "
    )
    assert pace.schedule.period_ns == 4 * MS
    pace.telegram(START + 61 * 12 * MS, anew=True)
    assert pace.phase.refusal is None


@pytest.mark.parametrize("lead_ns", [-1, 4 * MS, 5 * MS])
def test_a_lead_that_does_not_fit_is_refused(lead_ns: int) -> None:
    with pytest.raises(ValueError, match="does not fit"):
        Pace.free(4 * MS, START, lead_ns)


@pytest.mark.parametrize("cycle_ms", [4, 12])
def test_a_late_telegram_is_dated_with_its_cycle_and_an_early_one_with_itself(
    cycle_ms: int,
) -> None:
    period, draw = cycle_ms * MS, random.Random(cycle_ms)
    errors: list[int] = []
    delays: list[int] = []
    pace = Pace.free(period, START)
    for n in range(200):
        line = START + n * period
        arrival = line + round(draw.expovariate(4.0 / period))
        if n > 40:
            dated = pace.date(arrival, 1)
            assert dated <= arrival
            errors.append(dated - line)
            delays.append(arrival - line)
        pace.telegram(arrival)
    assert sum(map(abs, errors)) < 0.5 * sum(delays)
    assert min(errors) > -period
    early = START + 200 * period - period // 3
    assert pace.date(early, 1) == early
    beyond = START + 200 * period + 200 * MS
    assert pace.date(beyond, 1) == beyond


def test_before_its_phase_is_known_a_telegram_is_dated_with_itself() -> None:
    pace = Pace.free(4 * MS, START)
    assert pace.date(START + 5 * MS, 1) == START + 5 * MS


def test_the_clock_alone_keeps_the_configured_period_whatever_late_telegrams_seemed_to_say() -> (
    None
):
    period, draw = 4 * MS, random.Random(5)
    for trial in range(20):
        pace = Pace.free(period, START)
        for n in range(12):
            pace.telegram(START + n * period + round(draw.expovariate(1.0 / (6 * MS))))
            assert pace.schedule.period_ns == period, trial
        pace.run_free()
        assert pace.schedule.period_ns == period
        assert pace.schedule.grace_ns == period // 2
