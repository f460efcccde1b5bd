"""A daemon, asked by two threads: one takes the telemetry as it comes, one asks for the status.

Law of this file: it subscribes and asks, at a rate of its own choosing, and orders nothing. Nothing
waits for it: the daemon drops a subscriber who does not read, and a subscription that is not
renewed ends by itself within seconds. Whoever does not answer is asked again later.
"""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from linemate.daemon.transport.client import Client, RefusedError
from linemate.daemon.view.broadcast_hub import Board
from linemate.daemon.view.cell import Scene, of
from linemate.daemon.view.frames import Framer
from linemate.protocol.command.frame_codec import CommandError

RATE_HZ: Final = 25.0
STATUS_S: Final = 1.0
AGAIN_S: Final = 0.5
PATIENCE_S: Final = 1.0

Call = Callable[..., Any]
"""``call(function, *arguments)``: lets the event loop call it soon; from any thread."""


@dataclass(slots=True)
class Live:
    """Shows a daemon on a board.

    Attributes:
        make: a client that has not been used.
        board: where it is shown.
    """

    make: Callable[[], Client]
    board: Board
    call: Call
    rate_hz: float = RATE_HZ
    _framer: Framer = field(default_factory=lambda: Framer(Scene()))
    _ended: threading.Event = field(default_factory=threading.Event)
    _threads: list[threading.Thread] = field(default_factory=list)

    def start(self) -> None:
        """Begin to ask."""
        for ask in (self._subscribe, self._ask_status):
            thread = threading.Thread(target=self._go_on, args=(ask,), daemon=True)
            self._threads.append(thread)
            thread.start()

    def end(self) -> None:
        """Ask no more; returns when the threads have ended, or nearly."""
        self._ended.set()
        for thread in self._threads:
            thread.join(2.0 * PATIENCE_S)

    def _go_on(self, ask: Callable[[Client], None]) -> None:
        while not self._ended.is_set():
            try:
                with self.make() as client:
                    ask(client)
            except Exception as error:  # noqa: BLE001 - whatever it is: it is said, and tried again
                if self._ended.is_set():
                    return  # the loop may be gone
                told = {"up": False, "reason": str(error) or type(error).__name__}
                self.call(self.board.tell, "link", told)
            self._ended.wait(AGAIN_S)

    def _subscribe(self, client: Client) -> None:
        scene = _scene(client)
        self.call(self._begin, scene)
        for told in client.telemetry(self.rate_hz):
            self.call(self._show, told)
            if self._ended.is_set():
                return

    def _ask_status(self, client: Client) -> None:
        while not self._ended.is_set():
            self.call(self.board.tell, "status", client.call("status", timeout_s=PATIENCE_S))
            self._ended.wait(STATUS_S)

    def _begin(self, scene: Scene) -> None:
        self._framer = Framer(scene)
        self.board.anew()
        self.board.tell("scene", scene.told())
        self.board.tell("link", {"up": True, "reason": ""})

    def _show(self, told: Mapping[str, Any]) -> None:
        frame = self._framer.frame(told)
        if frame is not None:
            self.board.frame(frame)
        self.board.happened(told.get("happened"))


def _scene(client: Client) -> Scene:
    try:
        return of(client.call("scene", timeout_s=PATIENCE_S))
    except (RefusedError, CommandError) as error:  # a daemon older than this view
        return Scene(trouble=f"the daemon does not tell its cell: {error}")
