"""Rests of cycle and clock: when they begin, who ends them."""

import time

import pytest
from cycle_station import PERIOD, Station

from linemate.daemon.config.task_file import Task
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle.clock.phase_lock import PhaseLock
from linemate.daemon.cycle.clock.timer import CycleTimer
from linemate.daemon.service.idle_rest import LOOK_NS, IdleRest

AFTER_S = 1.0


class IdleStation:
    """A cycle and its clock, with a robot that stands idle."""

    def __init__(self, parameters: Parameters, task: Task) -> None:
        self.station = Station(parameters, task)
        self.is_used = False
        lock = PhaseLock(PERIOD, self.station.stamp_ns, None)
        self.timer = CycleTimer(lambda _: None, lambda _: None, lambda: None, lock)
        self.rest = IdleRest(self.station.cycle, self.timer, lambda: self.is_used, AFTER_S)
        self.began_ns = time.monotonic_ns()

    def run(self, cycles: int, *, now_s: float) -> None:
        """Answer telegrams, and update the rest at a time after the beginning [s]."""
        for _ in range(cycles):
            stamp_ns = self.station.stamp_ns
            self.station.exchange()
            self.timer.lock.follow(stamp_ns)
            self.rest.update(self.began_ns + round(1e9 * now_s))


@pytest.fixture
def idle(parameters: Parameters, task: Task) -> IdleStation:
    idle = IdleStation(parameters, task)
    idle.run(100, now_s=0.0)
    return idle


def test_a_rest_begins_after_its_time_of_idle_and_slows_the_clock(idle: IdleStation) -> None:
    idle.run(50, now_s=0.9)
    assert not idle.station.cycle.is_resting
    fast_ns = idle.timer.lock.wake_ns
    idle.run(1, now_s=1.5)
    assert idle.station.cycle.is_resting
    assert idle.timer.lock.is_slow
    lock = idle.timer.lock
    assert lock.wake_ns == lock.next_ns + lock.grace_ns + LOOK_NS
    assert fast_ns < lock.next_ns


@pytest.mark.parametrize("is_connected", [False, True])
def test_someone_who_looks_ends_the_rest_and_delays_the_next(
    idle: IdleStation, *, is_connected: bool
) -> None:
    idle.run(50, now_s=1.5)
    assert idle.station.cycle.is_resting
    idle.is_used = is_connected
    if is_connected:
        idle.run(1, now_s=1.6)
    else:
        idle.rest.wake_up()
    assert not idle.station.cycle.is_resting
    assert not idle.timer.lock.is_slow
    assert idle.timer.lock.wake_ns < idle.timer.lock.next_ns
    idle.is_used = False
    # Also after the estimates have settled.
    idle.run(200, now_s=0.9)
    assert idle.station.cycle.settles_s == 0.0
    assert not idle.station.cycle.is_resting


def test_a_period_that_is_not_measured_keeps_the_full_rate(idle: IdleStation) -> None:
    lock = idle.timer.lock
    lock.estimate.restart()
    idle.run(1, now_s=1.5)
    assert lock.estimate.arm_refusal is not None
    assert not idle.station.cycle.is_resting
    idle.run(140, now_s=1.5)
    assert lock.estimate.arm_refusal is None
    assert idle.station.cycle.is_resting


def test_between_looks_a_telegram_of_a_rest_needs_its_reply_alone(idle: IdleStation) -> None:
    idle.run(50, now_s=1.5)
    now_ns = idle.began_ns + 1_500_000_000
    assert idle.rest.is_between_looks(now_ns + LOOK_NS - 1)
    assert not idle.rest.is_between_looks(now_ns + LOOK_NS)
    idle.rest.wake_up()
    assert not idle.rest.is_between_looks(now_ns + 1)
