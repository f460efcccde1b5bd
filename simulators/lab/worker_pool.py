"""Calls of one function on all cores or on a cluster, and their progress in the terminal."""

import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TypeVar

from linemate.simulators.harness.processes import die_with

Progress = Callable[[], None]
Item = TypeVar("Item")
Result = TypeVar("Result")

LOCAL = "local"


def spread(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    workers: int | None = None,
    progress: Progress = lambda: None,
    scheduler: str = LOCAL,
) -> list[Result]:
    """Call a module's function with each item, where the scheduler says; see ``execute``."""
    if scheduler != LOCAL:
        from linemate.simulators.harness import cluster

        return cluster.execute(function, items, scheduler, progress)
    wanted = min(workers or len(os.sched_getaffinity(0)), len(items))
    if wanted <= 1:
        return [_noted(function(item), progress) for item in items]
    with _pool(wanted) as pool:
        futures = [pool.submit(function, item) for item in items]
        return [_noted(future.result(), progress) for future in futures]


def _noted(result: Result, progress: Progress) -> Result:
    progress()
    return result


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    # Spawned, not forked: a fork of a process with BLAS threads may hang.
    pool = ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_begin_worker,
        initargs=(os.getpid(),),
    )
    try:
        yield pool
    except BaseException:
        # A run takes many seconds, and its worker ignores Ctrl-C: do not wait for it.
        for worker in multiprocessing.active_children():
            worker.kill()
        raise
    finally:
        pool.shutdown()


def _begin_worker(parent: int) -> None:
    """Leave Ctrl-C to the parent, which ends its workers in order; without it there is no work."""
    die_with(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def progress_bar(total: int, what: str) -> Iterator[Progress]:
    """A bar on standard error, if that is a terminal."""
    if not sys.stderr.isatty() or total < 2 or find_spec("rich") is None:
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Bar(*columns, console=console, transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda: bar.advance(task)
