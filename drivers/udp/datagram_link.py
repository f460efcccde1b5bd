"""A bound datagram socket that the loop watches, and that is bound again when it breaks."""

import asyncio
import time
from abc import ABC, abstractmethod

from linemate.drivers.backoff import Backoff
from linemate.drivers.datagrams import Address, DatagramSocket
from linemate.drivers.link import LinkStatus, describe_error


class DatagramLink(ABC):
    """A bound socket that the loop watches, and that is bound again when it breaks.

    Attributes:
        refusal: error of the last try to bind, None if it succeeded.
        opened_ns: time of opening [ns], 0 before.
    """

    def __init__(self, name: str, host: str, port: int, backoff: Backoff | None = None) -> None:
        self.status = LinkStatus(name)
        self.counters = self.status.counters
        self.refusal: OSError | OverflowError | None = None
        self.opened_ns = 0
        self._bind = (host, port)
        self._backoff = backoff or Backoff()
        self._socket: DatagramSocket | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._retry: asyncio.TimerHandle | None = None

    @property
    def address(self) -> Address | None:
        """Local address and port, None while the link is down."""
        return self._socket.address if self._socket is not None else None

    def open(self) -> None:
        """Bind and listen on the running loop; if that fails, try again with back-off."""
        self._loop = asyncio.get_running_loop()
        self._forget_retry()
        if self._socket is not None:
            return
        try:
            self._socket = DatagramSocket.bound(*self._bind)
        except (OSError, OverflowError) as error:
            self.refusal = error
            self._down(describe_error(error))
            return
        self.refusal = None
        self.opened_ns = time.monotonic_ns()
        self._loop.add_reader(self._socket.fileno(), self.poll)
        self._backoff.reset()
        self.status.mark_up()

    def close(self) -> None:
        """Stop listening and do not open again."""
        self._forget_retry()
        self._release()
        self.status.mark_closed()

    async def wait_closed(self) -> None:
        """Let the loop run once; ``close`` has released everything."""
        await asyncio.sleep(0)

    def poll(self) -> None:
        """Read what waits, within the budget; the rest waits for the next wake."""
        transport = self._socket
        if transport is None:
            return
        try:
            self._read(transport)
        except OSError as error:
            self._down(describe_error(error))
            return
        self.counters["kernel_drops"] = transport.kernel_drops
        self.counters["stamps_refused"] = transport.clock.refused

    @abstractmethod
    def _read(self, transport: DatagramSocket) -> None:
        """Read and deliver datagrams; an OSError means that the socket is broken."""

    def _forget_retry(self) -> None:
        if self._retry is not None:
            self._retry.cancel()
            self._retry = None

    def _release(self) -> None:
        if self._socket is None or self._loop is None:
            return
        self._loop.remove_reader(self._socket.fileno())
        self._socket.close()
        self._socket = None

    def _down(self, reason: str) -> None:
        self._release()
        self.status.mark_down(reason)
        if self._loop is not None:
            self._retry = self._loop.call_later(self._backoff.next_delay(), self.open)
