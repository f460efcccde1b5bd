"""Threads that keep one client of a daemon each, and connect again after a failure.

Invariants:
    * A daemon that does not answer is asked again RETRY_S later.
    * The threads end with the process: to wait for them is a courtesy.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from linemate.daemon.transport.client import Client

RETRY_S: Final = 0.5
END_S: Final = 0.5  # for which an end waits for the threads


@dataclass(slots=True)
class ClientThreads:
    """One thread for each loop, with a client of its own.

    Attributes:
        connect: makes a client of the daemon, for each attempt.
        loops: called with the client; each returns when ``is_ending``.
        on_trouble: called with the reason of a failure, in the loop's thread.
    """

    connect: Callable[[], Client]
    loops: tuple[Callable[[Client], Any], ...]
    on_trouble: Callable[[str], Any]
    _end: threading.Event = field(default_factory=threading.Event)
    _threads: list[threading.Thread] = field(default_factory=list)

    @property
    def is_ending(self) -> bool:
        """Whether the threads were asked to end."""
        return self._end.is_set()

    def start(self) -> None:
        """Start the threads."""
        for loop in self.loops:
            thread = threading.Thread(target=self._repeat, args=(loop,), daemon=True)
            self._threads.append(thread)
            thread.start()

    def pause(self, seconds: float) -> None:
        """Wait [s], or until the end."""
        self._end.wait(seconds)

    def end(self) -> None:
        """Ask the threads to end, and wait END_S for them."""
        self._end.set()
        until = time.monotonic() + END_S
        for thread in self._threads:
            thread.join(max(0.0, until - time.monotonic()))

    def _repeat(self, loop: Callable[[Client], Any]) -> None:
        while not self.is_ending:
            try:
                with self.connect() as client:
                    loop(client)
            except Exception as error:  # noqa: BLE001 - any failure is reported, and tried again
                if not self.is_ending:
                    self.on_trouble(str(error) or type(error).__name__)
            self.pause(RETRY_S)
