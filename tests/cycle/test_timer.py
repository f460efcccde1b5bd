"""The timer on a real timerfd: a few cycles of a few milliseconds."""

import asyncio
import itertools
import os
import time
from typing import Any

import pytest
from loops import run, until

from linemate.daemon.cycle.clock.phase_lock import ATTEND_NS, Due, DueKind, PhaseLock
from linemate.daemon.cycle.clock.timer import CycleTimer, TimerFd

T = 4_000_000


def test_a_timer_expires_once_at_its_time() -> None:
    timer = TimerFd()
    assert timer.read() == 0
    at_ns = time.monotonic_ns() + 2_000_000
    timer.arm(at_ns)
    while timer.read() == 0:
        assert time.monotonic_ns() < at_ns + 1_000_000_000
    assert time.monotonic_ns() >= at_ns
    assert timer.read() == 0
    timer.close()


def test_a_time_that_has_passed_expires_at_once() -> None:
    timer = TimerFd()
    timer.arm(-5)
    assert timer.read() == 1
    timer.close()


def test_a_closed_timer_says_so() -> None:
    timer = TimerFd()
    timer.close()
    with pytest.raises(OSError, match="Bad file descriptor"):
        timer.arm(1)


@pytest.mark.skipif(hasattr(os, "timerfd_create"), reason="Python has its own")
def test_the_timers_own_structure_has_the_kernels_size() -> None:
    from linemate.daemon.cycle.clock.timer import ITIMERSPEC

    assert ITIMERSPEC.size == 32


def test_without_telegrams_the_clock_steps_by_itself_on_its_grid() -> None:
    async def main() -> None:
        stamps: list[int] = []
        began_ns = time.monotonic_ns()
        timer = CycleTimer(
            lambda due: stamps.append(due.stamp_ns),
            lambda error: pytest.fail(str(error)),
            lambda: None,
            PhaseLock(T, began_ns),
        )
        timer.open()
        await until(lambda: len(stamps) >= 5)
        timer.close()
        count = len(stamps)
        assert {b - a for a, b in itertools.pairwise(stamps)} == {T}
        assert stamps[0] == began_ns + T
        assert timer.lateness.wakes >= 1
        await asyncio.sleep(2 * T / 1e9)
        assert len(stamps) == count

    run(main())


def test_a_telegram_puts_the_step_off_and_a_preparation_comes_before_it() -> None:
    async def main() -> None:
        calls: list[Due] = []
        timer = CycleTimer(
            calls.append,
            lambda error: pytest.fail(str(error)),
            lambda: None,
            PhaseLock(50 * T, time.monotonic_ns(), 20 * T),
        )
        timer.open()
        stamp_ns = time.monotonic_ns() - 28 * T
        timer.lock.follow(stamp_ns)
        timer.arm()
        await until(lambda: bool(calls))
        assert calls == [Due(DueKind.PREPARE, stamp_ns + 50 * T)]
        timer.close()

    run(main())


@pytest.mark.parametrize("lead", [20, 6])
def test_a_telegram_is_waited_for_once_its_step_is_made_and_it_is_about_to_come(lead: int) -> None:
    async def main() -> None:
        calls: list[Any] = []
        timer = CycleTimer(
            calls.append,
            lambda error: pytest.fail(str(error)),
            lambda: None,
            PhaseLock(50 * T, time.monotonic_ns(), lead * T),
            attend=lambda expected_ns: calls.append((expected_ns, time.monotonic_ns())),
        )
        timer.open()
        stamp_ns = time.monotonic_ns() - 40 * T
        timer.lock.follow(stamp_ns)
        timer.arm()
        await until(lambda: len(calls) >= 2)
        timer.close()
        preparation, (expected_ns, now_ns) = calls[:2]
        assert preparation == Due(DueKind.PREPARE, stamp_ns + 50 * T)
        assert expected_ns == stamp_ns + 50 * T
        assert now_ns >= expected_ns - ATTEND_NS

    run(main())


def test_telegrams_that_wait_are_taken_before_any_is_called_missing() -> None:
    async def main() -> None:
        calls: list[Due] = []
        timer: CycleTimer | None = None

        def look() -> None:
            assert timer is not None
            timer.lock.follow(time.monotonic_ns())
            timer.arm()

        timer = CycleTimer(
            calls.append,
            lambda error: pytest.fail(str(error)),
            look,
            PhaseLock(T, time.monotonic_ns()),
        )
        timer.open()
        await until(lambda: timer.lateness.wakes >= 3)
        assert calls == []
        timer.close()

    run(main())


def test_a_wake_before_the_telegram_reads_none_unless_the_one_before_is_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looks: list[int] = []
    waits: list[int] = []
    now_ns = time.monotonic_ns()
    monkeypatch.setattr(time, "monotonic_ns", lambda: now_ns)
    lock = PhaseLock(50 * T, now_ns, 20 * T)
    lock.follow(now_ns - 50 * T + ATTEND_NS // 2)
    timer = CycleTimer(
        lambda _: None, raise_error, lambda: looks.append(1), lock, attend=waits.append
    )
    timer._timer = TimerFd()
    timer._wake()
    assert (len(looks), len(waits)) == (0, 1)
    lock.follow(now_ns - 50 * T + ATTEND_NS)
    lock.take_due(now_ns)
    timer.arm()
    timer._wake()
    assert (len(looks), len(waits)) == (0, 2)
    lock.follow(now_ns - 85 * T, restarts=True)
    assert [due.kind for due in lock.take_due(now_ns - 8 * T)] == [DueKind.MISSING]
    timer.arm()
    timer._wake()
    assert (len(looks), len(waits)) == (1, 2)
    timer._timer.close()


def test_what_a_step_raises_is_reported_and_the_timer_goes_on() -> None:
    async def main() -> None:
        errors: list[Exception] = []

        def fail(due: Due) -> None:
            raise RuntimeError(str(due.stamp_ns))

        timer = CycleTimer(fail, errors.append, lambda: None, PhaseLock(T, time.monotonic_ns()))
        timer.open()
        await until(lambda: len(errors) >= 3)
        timer.close()

    run(main())


def test_a_wake_that_stays_is_armed_once() -> None:
    armed: list[int] = []

    class Fake(TimerFd):
        def __init__(self) -> None:
            pass

        def arm(self, at_ns: int) -> None:
            armed.append(at_ns)

        def read(self) -> int:
            return 1

    lock = PhaseLock(T, time.monotonic_ns())
    timer = CycleTimer(lambda _: None, raise_error, lambda: None, lock, _timer=Fake())
    timer.arm()
    timer.arm()
    assert armed == [lock.wake_ns]
    timer._wake()  # it has expired: the same wake is armed again
    timer.arm()
    assert armed == [lock.wake_ns] * 2
    lock.follow(time.monotonic_ns())
    timer.arm()
    assert armed[2:] == [lock.wake_ns]
    assert armed[2] != armed[1]


def raise_error(error: Exception) -> None:
    raise error
