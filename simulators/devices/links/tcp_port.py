"""A serial port behind a TCP server on the loopback, as a serial device server gives it.

Unlike a pty, whose bytes a kernel worker of the ordinary class hands on, a socket's bytes arrive
with the sender's own priority: a busy desktop does not delay them.

Invariants:
- One client at a time; a second one is turned away.
- Without a client nothing is written. What does not fit is dropped and counted.
- Unplugging closes the line and the port; plugging opens the same port again.
"""

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from linemate.simulators.devices.links.endpoint import Address

READ_BYTES = 4096


class TcpPort:
    """The device's end of a serial line over TCP, with the members of a ``PtyPort``.

    Attributes:
        path: what to open, empty while unplugged.
        link: None; there is nothing to link to.
        attended: somebody has the port open.
        dropped_bytes: bytes that did not fit or had no reader.
    """

    def __init__(self, on_data: Callable[[bytes], None], bind: Address) -> None:
        """Keep the address to listen on.

        Args:
            on_data: gets what the other end wrote.
            bind: address and port, 0 for any.
        """
        self.path = ""
        self.link: Path | None = None
        self.dropped_bytes = 0
        self._on_data = on_data
        self._bind = bind
        self._listener: socket.socket | None = None
        self._line: socket.socket | None = None

    @property
    def attended(self) -> bool:
        """Whether somebody has the port open."""
        return self._line is not None

    def plug(self) -> None:
        """Make the port appear.

        Raises:
            OSError: the address is taken.
        """
        if self._listener is not None:
            return
        self._listener = socket.create_server(self._bind, backlog=1)
        self._listener.setblocking(False)
        self._bind = self._listener.getsockname()[:2]
        self.path = f"socket://{self._bind[0]}:{self._bind[1]}"
        asyncio.get_running_loop().add_reader(self._listener, self._accept)

    def unplug(self) -> None:
        """Make the port disappear for the client that has it open."""
        self._hang_up()
        if self._listener is not None:
            asyncio.get_running_loop().remove_reader(self._listener)
            self._listener.close()
            self._listener = None
        self.path = ""

    def write(self, data: bytes) -> bool:
        """Send bytes, all or some of them; the rest is lost.

        Returns:
            Whether all of it was written.
        """
        if self._line is None or not data:
            self.dropped_bytes += len(data)
            return not data
        try:
            written = self._line.send(data)
        except OSError:
            written = 0
        self.dropped_bytes += len(data) - written
        return written == len(data)

    def _accept(self) -> None:
        if self._listener is None:
            return
        try:
            line, _ = self._listener.accept()
        except OSError:
            return
        if self._line is not None:
            line.close()
            return
        line.setblocking(False)
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._line = line
        asyncio.get_running_loop().add_reader(line, self._readable)

    def _readable(self) -> None:
        if self._line is None:
            return
        try:
            data = self._line.recv(READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self._on_data(data)
        else:
            self._hang_up()

    def _hang_up(self) -> None:
        line, self._line = self._line, None
        if line is not None:
            asyncio.get_running_loop().remove_reader(line)
            with suppress(OSError):
                line.close()
