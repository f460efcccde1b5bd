"""Feed the hub from a daemon by two threads: its telemetry as it comes, its status once a second.

Invariants:
    * It subscribes and asks at its own rate, and orders nothing.
    * The daemon never waits for it: a subscription that is not renewed ends within seconds.
    * A daemon that does not answer is asked again later.
"""

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from linemate.daemon.transport.client import Client, RefusedError
from linemate.daemon.view.broadcast_hub import BroadcastHub
from linemate.daemon.view.cell import Cell, read_cell
from linemate.daemon.view.frames import Framer
from linemate.protocol.command.frame_codec import CommandError

RATE_HZ: Final = 25.0
STATUS_S: Final = 1.0
RETRY_S: Final = 0.5
TIMEOUT_S: Final = 1.0
END_S: Final = 0.5  # the threads end with the process: waiting for them is a courtesy

Call = Callable[..., Any]  # call(function, *arguments): call it soon in the event loop


@dataclass(slots=True)
class LiveFeed:
    """Feeds a hub from one daemon.

    Attributes:
        connect: Makes a client of the daemon, for each attempt.
        hub: The hub that is fed.
        call: The event loop's ``call_soon_threadsafe``.
        rate_hz: Rate of the telemetry.
    """

    connect: Callable[[], Client]
    hub: BroadcastHub
    call: Call
    rate_hz: float = RATE_HZ
    _framer: Framer = field(default_factory=lambda: Framer(Cell()))
    _end: threading.Event = field(default_factory=threading.Event)
    _threads: list[threading.Thread] = field(default_factory=list)

    def start(self) -> None:
        """Start the threads."""
        for loop in (self._subscribe, self._ask_status):
            thread = threading.Thread(target=self._repeat, args=(loop,), daemon=True)
            self._threads.append(thread)
            thread.start()

    def end(self) -> None:
        """Ask the threads to end, and wait END_S for them."""
        self._end.set()
        until = time.monotonic() + END_S
        for thread in self._threads:
            thread.join(max(0.0, until - time.monotonic()))

    def _repeat(self, loop: Callable[[Client], None]) -> None:
        while not self._end.is_set():
            try:
                with self.connect() as client:
                    loop(client)
            except Exception as error:  # noqa: BLE001 - any failure is shown, and tried again
                if self._end.is_set():
                    return  # the event loop may be closed
                link = {"up": False, "reason": str(error) or type(error).__name__}
                self.call(self.hub.publish, "link", link)
            self._end.wait(RETRY_S)

    def _subscribe(self, client: Client) -> None:
        cell = _ask_cell(client)
        self.call(self._begin, cell)
        for telemetry in client.telemetry(self.rate_hz):
            self.call(self._show, telemetry)
            if self._end.is_set():
                return

    def _ask_status(self, client: Client) -> None:
        while not self._end.is_set():
            self.call(self.hub.publish, "status", client.call("status", timeout_s=TIMEOUT_S))
            self._end.wait(STATUS_S)

    def _begin(self, cell: Cell) -> None:
        self._framer = Framer(cell)
        self.hub.restart()
        self.hub.publish("scene", cell.as_page())
        self.hub.publish("link", {"up": True, "reason": ""})

    def _show(self, telemetry: Mapping[str, Any]) -> None:
        frame = self._framer.frame(telemetry)
        if frame is not None:
            self.hub.push_frame(frame)
        self.hub.push_events(telemetry.get("happened"))


def _ask_cell(client: Client) -> Cell:
    try:
        return read_cell(client.call("scene", timeout_s=TIMEOUT_S))
    except (RefusedError, CommandError) as error:  # a daemon older than this view
        return Cell(trouble=f"the daemon does not describe its cell: {error}")
