"""Clock that goes from event to event, and what a loop can watch.

Invariants:
    Events of one instant run in the order in which they were scheduled.
"""

import heapq
import math
from collections.abc import Callable
from typing import Protocol

from linemate.drivers.datagrams import Address

EPOCH_NS = 10**17  # the monotonic instant at which virtual time begins: later than any host's own
WALL_NS = 1_700_000_000 * 10**9  # the wall clock's at that instant
FIRST_DESCRIPTOR = 900  # no real file of a process of ours has it, and select can be given it


class DeadlockError(RuntimeError):
    """All tasks wait and no event is to come."""


class DatagramReceiver(Protocol):
    """Socket that a datagram can reach."""

    def deliver(self, data: bytes, source: Address) -> None:
        """Queue a datagram."""


class FrameReceiver(Protocol):
    """Bus that a frame can reach."""

    def deliver(self, can_id: int, data: bytes, *, extended: bool) -> None:
        """Queue a frame."""


class ByteReceiver(Protocol):
    """Line that bytes can reach."""

    def deliver(self, data: bytes) -> None:
        """Queue bytes."""


class Port:
    """Something that a loop can watch.

    Attributes:
        world: whose time it lives in.
    """

    def __init__(self, world: "VirtualTime") -> None:
        self.world = world
        self._descriptor = world.register(self)

    def fileno(self) -> int:
        """Its descriptor."""
        return self._descriptor

    @property
    def is_ready(self) -> bool:
        """Reading would give something."""
        raise NotImplementedError

    def forget(self) -> None:
        """It is no longer there."""
        self.world.ports.pop(self._descriptor, None)
        self.emptied()

    def filled(self) -> None:
        """Reading gives something from now on."""
        self.world.filled.add(self._descriptor)

    def emptied(self) -> None:
        """Reading gives nothing any more."""
        self.world.filled.discard(self._descriptor)


class VirtualTime:
    """A clock and what is to happen.

    Attributes:
        now_ns: monotonic, of the world outside of the daemon's machine [ns].
        host_ns: monotonic, of the daemon's machine: it stands while the machine is paused [ns].
        wall_step_ns: how far the wall clock has been stepped [ns].
        stalled_until_ns: the process gets no processor before [ns].
        ports: what can be watched, by descriptor.
        filled: descriptors of the ports of which reading gives something.
        devices: what is behind a bus and a line, by name.
    """

    def __init__(self, begin_ns: int = EPOCH_NS) -> None:
        """Begin at a monotonic instant [ns]."""
        self.now_ns = begin_ns
        self._behind_ns = 0  # what the pauses of the machine came to
        self._paused: tuple[int, int] | None = None  # begin and end of a pause [ns]
        self._rate = 0.0  # share by which the machine's clock is fast
        self._rated_ns = self._shown_ns = begin_ns  # since when, and what it showed then [ns]
        self.wall_step_ns = 0
        self.stalled_until_ns = 0
        self.filled: set[int] = set()
        self.ports: dict[int, Port] = {}
        self.sockets: dict[int, DatagramReceiver] = {}
        self.buses: list[FrameReceiver] = []
        self.lines: list[ByteReceiver] = []
        self.unplugged: set[str] = set()
        self.on_datagram: Callable[[bytes, Address, Address], None] = lambda _d, _s, _t: None
        self.on_line: Callable[[bytes | None], None] = lambda _data: None
        self._queue: list[tuple[int, int, Callable[[], None]]] = []
        self._ordered = 0
        self._descriptors = FIRST_DESCRIPTOR

    @property
    def host_ns(self) -> int:
        """The monotonic clock of the daemon's machine [ns]."""
        if self._paused is not None:
            begin_ns, end_ns = self._paused
            if self.now_ns < end_ns:
                return self._shown(begin_ns - self._behind_ns)
            self._behind_ns += end_ns - begin_ns
            self._paused = None
        return self._shown(self.now_ns - self._behind_ns)

    def _shown(self, running_ns: int) -> int:
        """Return what the machine's clock shows after it ran until then [ns]."""
        passed_ns = running_ns - self._rated_ns
        return self._shown_ns + passed_ns + round(passed_ns * self._rate)

    def set_rate(self, rate: float) -> None:
        """Let the machine's clock be fast by a share from now on, slow if it is negative."""
        shown_ns = self.host_ns
        running_ns = self.now_ns if self._paused is None else self._paused[0]
        self._rated_ns, self._shown_ns = running_ns - self._behind_ns, shown_ns
        self._rate = rate

    @property
    def wall_ns(self) -> int:
        """The wall clock of the daemon's machine [ns]."""
        return self.host_ns - EPOCH_NS + WALL_NS + self.wall_step_ns

    def pause(self, duration_ns: int) -> None:
        """Let the daemon's machine stand, its clocks and all its processes.

        Args:
            duration_ns: how long [ns]; a pause within a pause is part of it.
        """
        _ = self.host_ns  # a pause that is over is booked first
        begin_ns, end_ns = self._paused or (self.now_ns, self.now_ns)
        end_ns = max(end_ns, self.now_ns + duration_ns)
        self._paused = begin_ns, end_ns
        self.stalled_until_ns = max(self.stalled_until_ns, end_ns)

    def world_ns(self, host_ns: int) -> int:
        """When the machine's clock will show a time, unless it is paused before [ns]."""
        shown_ns = self.host_ns
        from_ns = self.now_ns if self._paused is None else self._paused[1]
        ahead_ns = host_ns - shown_ns
        if not self._rate:
            return from_ns + ahead_ns
        return from_ns + math.ceil(ahead_ns / (1.0 + self._rate)) + 1

    def register(self, port: Port) -> int:
        """Give a port a descriptor, the lowest that is free, as the kernel does."""
        descriptor = FIRST_DESCRIPTOR
        while descriptor in self.ports:
            descriptor += 1
        self.ports[descriptor] = port
        return descriptor

    def at(self, at_ns: int, action: Callable[[], None]) -> None:
        """Let something happen at an instant, now if it is past [ns]."""
        self._ordered += 1
        heapq.heappush(self._queue, (max(at_ns, self.now_ns), self._ordered, action))

    @property
    def next_ns(self) -> int | None:
        """When something happens next [ns]."""
        return self._queue[0][0] if self._queue else None

    def happen(self) -> None:
        """Go on to what happens next and let it."""
        at_ns, _, action = heapq.heappop(self._queue)
        self.now_ns = max(self.now_ns, at_ns)
        action()

    def pass_until(self, end_ns: int) -> None:
        """Let everything happen that is due until an instant [ns]."""
        while self._queue and self._queue[0][0] <= end_ns:
            self.happen()
        self.now_ns = max(self.now_ns, end_ns)
