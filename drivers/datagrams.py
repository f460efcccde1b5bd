"""Reading a datagram socket: non-blocking, stamped by the kernel, bounded; and its link.

Law of this file: a read allocates nothing that grows with what a stranger sends; a datagram
longer than the buffer is known by the kernel's flag and never handed on. asyncio's own
datagram transport is not used: it takes a 256 KiB buffer for each datagram and has no budget.
"""

import asyncio
import select
import socket
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, field

from msgspec import Struct

from linemate.drivers.backoff import Backoff
from linemate.drivers.link import LinkStatus, why
from linemate.drivers.stamps import (
    ANCILLARY_BYTES,
    ArrivalClock,
    paired_clocks,
    request_kernel_stamps,
)

BUFFER_BYTES = 2048

Address = tuple[str, int]
RawDatagram = tuple[bytes, list[tuple[int, int, bytes]], int, Address]
"""Bytes, control messages, flags and source, as the kernel hands them over."""


class Datagram(Struct, frozen=True):
    """One datagram as it came.

    Attributes:
        data: its bytes, cut at 2 KiB.
        stamp_ns: monotonic arrival [ns].
        oversize: it was longer than 2 KiB and is incomplete.
    """

    data: bytes
    stamp_ns: int
    source: Address
    oversize: bool


@dataclass(slots=True)
class DatagramSocket:
    """A bound, non-blocking UDP socket.

    Attributes:
        clock: maps the kernel's stamps.
        kernel_drops: datagrams the kernel dropped because nobody read them in time.
    """

    endpoint: socket.socket
    clock: ArrivalClock = field(default_factory=ArrivalClock)
    kernel_drops: int = 0
    _buffer: bytearray = field(default_factory=lambda: bytearray(BUFFER_BYTES))
    _alone: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Note what to wait for."""
        self._alone = (self.endpoint.fileno(),)

    @classmethod
    def bound(cls, host: str, port: int) -> "DatagramSocket":
        """Open and bind; no address is ever shared with another process.

        Args:
            port: local port, 0 for any.

        Returns:
            The open socket.

        Raises:
            OSError: if the address cannot be bound.
        """
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        endpoint = socket.socket(family, socket.SOCK_DGRAM)
        try:
            endpoint.setblocking(False)
            request_kernel_stamps(endpoint)
            endpoint.bind((host, port))
        except OSError:
            endpoint.close()
            raise
        return cls(endpoint)

    @property
    def address(self) -> Address:
        """Where the socket is bound."""
        host, port = self.endpoint.getsockname()[:2]
        return str(host), int(port)

    def fileno(self) -> int:
        """The descriptor to watch."""
        return self.endpoint.fileno()

    def read(self) -> Datagram | None:
        """Take one datagram.

        Returns:
            The oldest waiting datagram, or None if there is none.

        Raises:
            OSError: if the socket is broken.
        """
        try:
            size, ancillary, flags, source = self.endpoint.recvmsg_into(
                [self._buffer], ANCILLARY_BYTES
            )
        except (BlockingIOError, InterruptedError):
            self.clock.drained(paired_clocks()[0])
            return None
        return self.stamped((bytes(memoryview(self._buffer)[:size]), ancillary, flags, source))

    def wait(self, timeout_ns: int) -> RawDatagram | None:
        """Sleep until a datagram comes, and return it without its time.

        Args:
            timeout_ns: how long at most [ns].

        Returns:
            To be given to ``stamped`` once its reply is out; None if nothing came.

        Raises:
            OSError: the socket is broken.
            ValueError: select cannot wait for a descriptor this great.
        """
        # A socket's own time-out counts in ticks of the kernel, poll in milliseconds.
        if not select.select(self._alone, (), (), max(0, timeout_ns) * 1e-9)[0]:
            return None
        try:
            return self.endpoint.recvmsg(BUFFER_BYTES, ANCILLARY_BYTES)
        except (BlockingIOError, InterruptedError):
            return None

    def stamped(self, raw: RawDatagram) -> Datagram:
        """Return a datagram with its arrival; its age is counted from now, so call it soon."""
        data, ancillary, flags, source = raw
        stamp_ns, drops = self.clock.date(ancillary)
        if drops is not None:
            self.kernel_drops = drops
        return Datagram(data, stamp_ns, source, bool(flags & socket.MSG_TRUNC))

    def close(self) -> None:
        """Close the socket."""
        self.endpoint.close()


class DatagramLink(ABC):
    """A bound socket that is watched by the loop and bound again when it breaks.

    Attributes:
        status: the link's visible state.
        counters: the status's.
        refusal: why it could not be bound the last time that it was tried, None if it could.
        opened_ns: since when datagrams can arrive [ns], 0 before the link was open.
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
        """Where the link listens, None while it is down."""
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
            self._down(why(error))
            return
        self.refusal = None
        self.opened_ns = time.monotonic_ns()
        self._loop.add_reader(self._socket.fileno(), self.poll)
        self._backoff.reset()
        self.status.mark_up()

    def close(self) -> None:
        """Stop listening, for good."""
        self._forget_retry()
        self._release()
        self.status.mark_closed()

    async def wait_closed(self) -> None:
        """Let the loop see the closing; nothing of a datagram link outlives ``close``."""
        await asyncio.sleep(0)

    def poll(self) -> None:
        """Take what waits, within the budget; what is left waits for the next wake."""
        transport = self._socket
        if transport is None:
            return
        try:
            self._read(transport)
        except OSError as error:
            self._down(why(error))
            return
        self.counters["kernel_drops"] = transport.kernel_drops
        self.counters["stamps_refused"] = transport.clock.refused

    @abstractmethod
    def _read(self, transport: DatagramSocket) -> None:
        """Read and hand on; an OSError means that the socket is broken."""

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
