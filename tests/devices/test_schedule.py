"""Doing things at absolute instants."""

import time
from functools import partial

import pytest
from loops import run, until

from linemate.simulators.devices.schedule import DeviceSchedule

MS = 1_000_000


def test_actions_run_in_the_order_of_their_instants_and_never_early() -> None:
    async def main() -> None:
        schedule = DeviceSchedule()
        ran: list[tuple[int, int]] = []
        schedule.open()
        start_ns = time.monotonic_ns()

        def note(at_ns: int) -> None:
            ran.append((at_ns, time.monotonic_ns()))

        for delay_ms in (30, 10, 20, 10):
            at_ns = start_ns + delay_ms * MS
            schedule.at(at_ns, partial(note, at_ns))
        assert len(schedule) == 4
        await until(lambda: len(ran) == 4)
        schedule.close()
        assert [at_ns for at_ns, _ in ran] == sorted(at_ns for at_ns, _ in ran)
        assert all(now_ns >= at_ns for at_ns, now_ns in ran)

    run(main())


def test_what_is_past_is_done_at_once() -> None:
    async def main() -> None:
        schedule, ran = DeviceSchedule(), []
        schedule.open()
        schedule.at(0, lambda: ran.append(1))
        await until(lambda: bool(ran))
        schedule.close()

    run(main())


def test_an_action_may_add_another() -> None:
    async def main() -> None:
        schedule, ran = DeviceSchedule(), []
        schedule.open()

        def again() -> None:
            ran.append(time.monotonic_ns())
            if len(ran) < 5:
                schedule.at(ran[0] + len(ran) * MS, again)

        schedule.at(time.monotonic_ns(), again)
        await until(lambda: len(ran) == 5)
        schedule.close()

    run(main())


def test_a_fault_in_an_action_is_reported_and_the_rest_goes_on() -> None:
    async def main() -> None:
        errors: list[Exception] = []
        ran: list[int] = []
        schedule = DeviceSchedule(on_error=errors.append)
        schedule.open()
        schedule.at(1, partial(divmod, 1, 0))
        schedule.at(2, lambda: ran.append(1))
        await until(lambda: bool(ran))
        schedule.close()
        assert isinstance(errors[0], ZeroDivisionError)

    run(main())


def test_nothing_runs_after_the_closing() -> None:
    async def main() -> None:
        schedule, ran = DeviceSchedule(), []
        schedule.open()
        schedule.at(time.monotonic_ns() + 5 * MS, lambda: ran.append(1))
        schedule.close()
        with pytest.raises(AssertionError):
            await until(lambda: bool(ran), timeout_s=0.03)

    run(main())


def test_what_is_cancelled_is_not_done() -> None:
    async def main() -> None:
        schedule, ran = DeviceSchedule(), []
        schedule.open()
        now_ns = time.monotonic_ns()
        entry = schedule.at(now_ns + MS, lambda: ran.append("cancelled"))
        schedule.at(now_ns + 5 * MS, lambda: ran.append("done"))
        schedule.cancel(entry)
        assert len(schedule) == 1
        await until(lambda: bool(ran))
        assert ran == ["done"]
        schedule.cancel(entry)  # nothing is left of it
        schedule.close()

    run(main())


def test_what_is_put_on_the_schedule_together_is_done_at_its_instants() -> None:
    async def main() -> None:
        schedule, ran = DeviceSchedule(), []
        schedule.open()
        now_ns = time.monotonic_ns()

        def lay_out() -> None:
            schedule.at(now_ns + 4 * MS, lambda: ran.append(4))
            schedule.at(now_ns + 2 * MS, lambda: ran.append(2))

        schedule.together(lay_out)
        await until(lambda: len(ran) == 2)
        assert ran == [2, 4]
        schedule.close()

    run(main())
