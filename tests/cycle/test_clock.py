"""The clock on a real timerfd: a few cycles of a few milliseconds."""

import asyncio
import itertools
import os
import time
from typing import Any

import pytest
from loops import run, until

from linemate.daemon.cycle.clock.clock import Clock, Timer
from linemate.daemon.cycle.clock.pace import Pace
from linemate.daemon.cycle.clock.schedule import ATTEND_NS, Due, Kind

T = 4_000_000


def test_a_timer_expires_once_at_its_time() -> None:
    timer = Timer()
    assert timer.read() == 0
    at_ns = time.monotonic_ns() + 2_000_000
    timer.arm(at_ns)
    while timer.read() == 0:
        assert time.monotonic_ns() < at_ns + 1_000_000_000
    assert time.monotonic_ns() >= at_ns
    assert timer.read() == 0
    timer.close()


def test_a_time_that_has_passed_expires_at_once() -> None:
    timer = Timer()
    timer.arm(-5)
    assert timer.read() == 1
    timer.close()


def test_a_closed_timer_says_so() -> None:
    timer = Timer()
    timer.close()
    with pytest.raises(OSError, match="Bad file descriptor"):
        timer.arm(1)


@pytest.mark.skipif(hasattr(os, "timerfd_create"), reason="Python has its own")
def test_the_timers_own_structure_has_the_kernels_size() -> None:
    from linemate.daemon.cycle.clock.clock import ITIMERSPEC

    assert ITIMERSPEC.size == 32


def test_without_telegrams_the_clock_steps_by_itself_on_its_grid() -> None:
    async def main() -> None:
        stamps: list[int] = []
        began_ns = time.monotonic_ns()
        clock = Clock(
            lambda due: stamps.append(due.stamp_ns),
            lambda error: pytest.fail(str(error)),
            lambda: None,
            Pace.free(T, began_ns),
        )
        clock.open()
        await until(lambda: len(stamps) >= 5)
        clock.close()
        count = len(stamps)
        assert {b - a for a, b in itertools.pairwise(stamps)} == {T}
        assert stamps[0] == began_ns + T
        assert clock.lateness.wakes >= 1
        await asyncio.sleep(2 * T / 1e9)
        assert len(stamps) == count

    run(main())


def test_a_telegram_puts_the_step_off_and_a_preparation_comes_before_it() -> None:
    async def main() -> None:
        told: list[Due] = []
        clock = Clock(
            told.append,
            lambda error: pytest.fail(str(error)),
            lambda: None,
            Pace.free(50 * T, time.monotonic_ns(), 20 * T),
        )
        clock.open()
        stamp_ns = time.monotonic_ns() - 28 * T
        clock.telegram(stamp_ns)
        await until(lambda: bool(told))
        assert told == [Due(Kind.PREPARE, stamp_ns + 50 * T)]
        clock.close()

    run(main())


@pytest.mark.parametrize("lead", [20, 6])
def test_a_telegram_is_waited_for_once_its_step_is_made_and_it_is_about_to_come(lead: int) -> None:
    async def main() -> None:
        told: list[Any] = []
        clock = Clock(
            told.append,
            lambda error: pytest.fail(str(error)),
            lambda: None,
            Pace.free(50 * T, time.monotonic_ns(), lead * T),
            attend=lambda expected_ns: told.append((expected_ns, time.monotonic_ns())),
        )
        clock.open()
        stamp_ns = time.monotonic_ns() - 40 * T
        clock.telegram(stamp_ns)
        await until(lambda: len(told) >= 2)
        clock.close()
        preparation, (expected_ns, now_ns) = told[:2]
        assert preparation == Due(Kind.PREPARE, stamp_ns + 50 * T)
        assert expected_ns == stamp_ns + 50 * T
        assert now_ns >= expected_ns - ATTEND_NS

    run(main())


def test_telegrams_that_wait_are_taken_before_any_is_called_missing() -> None:
    async def main() -> None:
        told: list[Due] = []
        clock: Clock | None = None

        def look() -> None:
            assert clock is not None
            clock.telegram(time.monotonic_ns())

        clock = Clock(
            told.append,
            lambda error: pytest.fail(str(error)),
            look,
            Pace.free(T, time.monotonic_ns()),
        )
        clock.open()
        await until(lambda: clock.lateness.wakes >= 3)
        assert told == []
        clock.close()

    run(main())


def test_what_a_step_raises_is_told_and_the_clock_goes_on() -> None:
    async def main() -> None:
        errors: list[Exception] = []

        def fail(due: Due) -> None:
            raise RuntimeError(str(due.stamp_ns))

        clock = Clock(fail, errors.append, lambda: None, Pace.free(T, time.monotonic_ns()))
        clock.open()
        await until(lambda: len(errors) >= 3)
        clock.close()

    run(main())
