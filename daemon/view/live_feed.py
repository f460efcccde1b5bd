"""Feed the hub from a daemon by two threads: its telemetry as it comes, its status once a second.

Invariants:
    * It subscribes and asks at its own rate, and orders nothing.
    * The daemon never waits for it: a subscription that is not renewed ends within seconds.
    * A daemon that does not answer is asked again later.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from linemate.daemon.transport.client import Client, RefusedError
from linemate.daemon.view.broadcast_hub import BroadcastHub
from linemate.daemon.view.cell import Cell, read_cell
from linemate.daemon.view.client_threads import ClientThreads
from linemate.daemon.view.frames import Framer
from linemate.protocol.command.frame_codec import CommandError

RATE_HZ: Final = 25.0
STATUS_S: Final = 1.0
TIMEOUT_S: Final = 1.0

Call = Callable[..., Any]  # call(function, *arguments): call it soon in the event loop


@dataclass(slots=True)
class LiveFeed:
    """Feeds a hub from one daemon.

    Attributes:
        connect: Makes a client of the daemon, for each attempt.
        call: The event loop's ``call_soon_threadsafe``.
    """

    connect: Callable[[], Client]
    hub: BroadcastHub
    call: Call
    rate_hz: float = RATE_HZ
    _framer: Framer = field(default_factory=lambda: Framer(Cell()))
    _threads: ClientThreads = field(init=False)

    def __post_init__(self) -> None:
        loops = (self._subscribe, self._ask_status)
        self._threads = ClientThreads(self.connect, loops, self._show_trouble)

    def start(self) -> None:
        """Start the threads."""
        self._threads.start()

    def end(self) -> None:
        """Ask the threads to end, and wait a moment for them."""
        self._threads.end()

    def _show_trouble(self, reason: str) -> None:
        self.call(self.hub.publish, "link", {"up": False, "reason": reason})

    def _subscribe(self, client: Client) -> None:
        cell = _ask_cell(client)
        self.call(self._begin, cell)
        for telemetry in client.telemetry(self.rate_hz):
            self.call(self._show, telemetry)
            if self._threads.is_ending:
                return

    def _ask_status(self, client: Client) -> None:
        while not self._threads.is_ending:
            self.call(self.hub.publish, "status", client.call("status", timeout_s=TIMEOUT_S))
            self._threads.pause(STATUS_S)

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
