"""The daemon's clock alone in a process, to compare with a C program that only wakes.

Invariants:
    Protocol as ``bench_floor timer``: ``ready``, and on SIGUSR1 ``late COUNT P50 P99 MAX``
        [ns].
"""

import asyncio
import gc
import signal
import sys
import time

from linemate.daemon.config.settings import RealtimeSettings
from linemate.daemon.cycle.clock.phase_lock import Due, PhaseLock
from linemate.daemon.cycle.clock.timer import CycleTimer
from linemate.daemon.service.host import realtime


def between(period_ns: int, now_ns: int) -> PhaseLock:
    """Return a phase lock that runs free and wakes half a period after whole periods.

    The C timer wakes at those, on the same core with the same priority: where both wake at once one
    waits for the other, and is held to be late (ratios of 0.7 and of 3 within a minute).
    """
    whole_ns = now_ns // period_ns * period_ns
    phase_ns = PhaseLock(period_ns, whole_ns).wake_ns % period_ns
    return PhaseLock(period_ns, whole_ns + period_ns // 2 - phase_ns)


async def run(period_ns: int) -> None:
    """Wake until ended."""
    late_ns: list[int] = []

    def woken(_: Due) -> None:
        late_ns.append(timer.lateness.last_ns)

    def print_lateness() -> None:
        in_order, count = sorted(late_ns), len(late_ns)
        late_ns.clear()
        times = (
            (in_order[count // 2], in_order[count - 1 - count // 100], in_order[-1])
            if in_order
            else (0,) * 3
        )
        print("late", count, *times, flush=True)

    def fail(error: Exception) -> None:
        raise error

    timer = CycleTimer(woken, fail, lambda: None, between(period_ns, time.monotonic_ns()))
    asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, print_lateness)
    gc.collect()
    gc.freeze()
    gc.disable()
    timer.open()
    print("ready", flush=True)
    await asyncio.Event().wait()


if __name__ == "__main__":
    # As the bench's daemon, and as the C timer next to it.
    realtime.request_all(RealtimeSettings(lock_memory=True))
    asyncio.run(run(int(sys.argv[1])))
