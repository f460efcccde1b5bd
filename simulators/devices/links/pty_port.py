"""Serial port on a pty that a client can open, close and lose.

Invariants:
    Nothing is written while no client has the port open.
    It never blocks; bytes that do not fit are dropped and counted.
    Unplugging closes the master; the client reads an error.
"""

import asyncio
import os
import select
import tty
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

LOOK_S = 0.02
READ_BYTES = 4096

OnData = Callable[[bytes], None]
OnOpened = Callable[[], None]


@dataclass(slots=True)
class PtyPort:
    """The device's end of a pty.

    Attributes:
        on_data: gets what the other end wrote.
        on_opened: called when somebody opens the port.
        link: a symbolic link that shall point at the port, or None.
        path: what to open, empty while unplugged.
        attended: somebody has the port open.
        dropped_bytes: bytes that did not fit or had no reader.
    """

    on_data: OnData
    on_opened: OnOpened | None = None
    link: Path | None = None
    path: str = ""
    attended: bool = False
    dropped_bytes: int = 0
    _master: int = -1
    _look: asyncio.TimerHandle | None = None
    _poll: "select.poll" = field(default_factory=select.poll)

    def plug(self) -> None:
        """Make the port appear.

        Raises:
            OSError: if no pty can be had.
        """
        if self._master >= 0:
            return
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(slave)
        os.close(slave)  # from here on the master sees a hang-up until somebody opens it
        self._poll.register(self._master, select.POLLIN)
        self._point_link()
        self._await_opening()

    def unplug(self) -> None:
        """Make the port disappear for the client that has it open."""
        if self._master < 0:
            return
        if self._look is not None:
            self._look.cancel()
            self._look = None
        asyncio.get_running_loop().remove_reader(self._master)
        self._poll.unregister(self._master)
        os.close(self._master)
        self._master = -1
        self.path = ""
        self.attended = False
        if self.link is not None:
            self.link.unlink(missing_ok=True)

    def write(self, data: bytes) -> bool:
        """Send bytes, all or some of them; the rest is lost.

        Returns:
            Whether all of it was written.
        """
        if not self.attended or not data:
            self.dropped_bytes += len(data)
            return not data
        try:
            written = os.write(self._master, data)
        except OSError:
            written = 0
        self.dropped_bytes += len(data) - written
        return written == len(data)

    def _point_link(self) -> None:
        if self.link is None:
            return
        fresh = self.link.with_name(f"{self.link.name}.{os.getpid()}")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(self.path)
        fresh.replace(self.link)

    def _hung_up(self) -> bool:
        return any(event & select.POLLHUP for _, event in self._poll.poll(0))

    def _await_opening(self) -> None:
        """Look now and then: a hung-up descriptor would wake the loop without end."""
        self._look = None
        loop = asyncio.get_running_loop()
        if self._hung_up():
            self._look = loop.call_later(LOOK_S, self._await_opening)
            return
        self.attended = True
        loop.add_reader(self._master, self._readable)
        if self.on_opened is not None:
            self.on_opened()

    def _readable(self) -> None:
        try:
            data = os.read(self._master, READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self.on_data(data)
            return
        self.attended = False
        asyncio.get_running_loop().remove_reader(self._master)
        self._await_opening()
