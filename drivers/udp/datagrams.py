"""Non-blocking datagram socket with kernel stamps, and the link that keeps it open.

asyncio's datagram transport is not used: it allocates 256 KiB for each datagram and reads without
a limit.

Invariants:
    A read allocates at most 2 KiB.
    A longer datagram is marked as oversize by the kernel's flag.
"""

import asyncio
import select
import socket
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, field

from msgspec import Struct

from linemate.drivers.backoff import Backoff
from linemate.drivers.link import LinkStatus, describe_error
from linemate.drivers.stamps import (
    ANCILLARY_BYTES,
    ArrivalClock,
    paired_clocks,
    request_kernel_stamps,
)

TRUNCATED = int(socket.MSG_TRUNC)  # an enumeration's & takes 4 us
BUFFER_BYTES = 2048

Address = tuple[str, int]
# Bytes, control messages, flags and source, as the kernel returns them.
RawDatagram = tuple[bytes, list[tuple[int, int, bytes]], int, Address]


class Datagram(Struct, frozen=True):
    """One datagram with its monotonic arrival [ns].

    Attributes:
        oversize: the datagram was longer than 2 KiB and ``data`` is incomplete.
    """

    data: bytes
    stamp_ns: int
    source: Address
    oversize: bool


@dataclass(slots=True)
class DatagramSocket:
    """A bound, non-blocking UDP socket.

    Attributes:
        kernel_drops: datagrams that the kernel dropped because the queue was full.
    """

    endpoint: socket.socket
    clock: ArrivalClock = field(default_factory=ArrivalClock)
    kernel_drops: int = 0
    _buffer: bytearray = field(default_factory=lambda: bytearray(BUFFER_BYTES))
    _descriptors: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Keep the descriptor for ``wait``."""
        self._descriptors = (self.endpoint.fileno(),)

    @classmethod
    def bound(cls, host: str, port: int) -> "DatagramSocket":
        """Open and bind a socket; no address is shared with another process.

        Args:
            port: local port, 0 for any.

        Raises:
            OSError: the address cannot be bound.
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
        """Local address and port."""
        host, port = self.endpoint.getsockname()[:2]
        return str(host), int(port)

    def fileno(self) -> int:
        """Return the descriptor to watch."""
        return self.endpoint.fileno()

    def read(self) -> Datagram | None:
        """Return the oldest waiting datagram, None if there is none.

        Raises:
            OSError: the socket is broken.
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
        """Sleep until a datagram comes, and return it without its arrival.

        Args:
            timeout_ns: the longest time to wait [ns].

        Returns:
            The argument of ``stamped``, to be called after the reply; None after the time-out.

        Raises:
            OSError: the socket is broken.
            ValueError: the descriptor is too great for select.
        """
        # select waits in microseconds, poll in milliseconds, a socket's time-out in kernel ticks.
        if not select.select(self._descriptors, (), (), max(0, timeout_ns) * 1e-9)[0]:
            return None
        try:
            return self.endpoint.recvmsg(BUFFER_BYTES, ANCILLARY_BYTES)
        except (BlockingIOError, InterruptedError):
            return None

    def has_more(self) -> bool:
        """Return whether another datagram waits."""
        return bool(select.select(self._descriptors, (), (), 0.0)[0])

    def stamped(self, raw: RawDatagram) -> Datagram:
        """Return a datagram with its arrival; call it soon, for its age is counted from now."""
        data, ancillary, flags, source = raw
        stamp_ns, drops = self.clock.date(ancillary)
        if drops is not None:
            self.kernel_drops = drops
        return Datagram(data, stamp_ns, source, bool(flags & TRUNCATED))

    def close(self) -> None:
        """Close the socket."""
        self.endpoint.close()


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
