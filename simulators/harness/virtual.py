"""Virtual time: an event loop whose select advances a clock, and ports in memory.

Invariants:
    Nothing sleeps, no thread starts, the host's network is not used.
    Events of one instant run in the order in which they were scheduled.
    The daemon's service runs unchanged; only clock, sockets, timer, bus and line are
        replaced.
    Nothing is replaced outside ``inhabited``.
"""

import asyncio
import contextlib
import heapq
import math
import select as select_module
import selectors
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor
from functools import cache, partial
from typing import Any, TypeVar

import can
import serialx

from linemate.daemon.cycle.clock import timer as daemon_timer
from linemate.drivers.stamps import SO_TIMESTAMPNS
from linemate.drivers.udp import sole_sender
from linemate.drivers.udp.datagrams import Address, DatagramSocket
from linemate.protocol.sensors import distance as distance_codec

T = TypeVar("T")

EPOCH_NS = 10**17
"""The monotonic instant at which virtual time begins: later than any host's own."""

WALL_NS = 1_700_000_000 * 10**9
"""The wall clock's at that instant."""

FIRST_DESCRIPTOR = 900
"""Descriptors that no real file of a process of ours has, and that select can be given."""

RECEIVE_QUEUE = 256
"""Datagrams that wait in a socket before the kernel drops new ones."""

_TIMESPEC = struct.Struct("@ll")


class DeadlockError(RuntimeError):
    """Everybody waits and nothing is to come."""


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
        self.sockets: dict[int, VirtualSocket] = {}
        self.buses: list[VirtualBus] = []
        self.lines: list[VirtualLine] = []
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


class VirtualSocket(Port):
    """A UDP socket as ``DatagramSocket`` needs it."""

    def __init__(self, world: VirtualTime, address: Address) -> None:
        super().__init__(world)
        self._address = address
        self._waiting: deque[tuple[bytes, Address, int]] = deque()
        self._sole: Address | None = None
        world.sockets[address[1]] = self

    @property
    def is_ready(self) -> bool:
        """A datagram waits."""
        return bool(self._waiting)

    def put(self, data: bytes, source: Address) -> None:
        """A datagram arrives; the kernel stamps it, or drops it."""
        if self._sole not in {None, source}:
            return
        if len(self._waiting) < RECEIVE_QUEUE:
            self._waiting.append((data, source, self.world.wall_ns))
            self.filled()

    def keep_only(self, source: Address | None) -> None:
        """As the kernel's filter: only one sender's datagrams arrive, or all."""
        self._sole = source

    def recvmsg(
        self, size: int, _ancillary_bytes: int = 0
    ) -> tuple[bytes, list[tuple[int, int, bytes]], int, Address]:
        """As a socket's own."""
        if not self._waiting:
            raise BlockingIOError
        data, source, wall_ns = self._waiting.popleft()
        if not self._waiting:
            self.emptied()
        stamp = _TIMESPEC.pack(*divmod(wall_ns, 10**9))
        ancillary = [(socket.SOL_SOCKET, SO_TIMESTAMPNS, stamp)]
        return data[:size], ancillary, socket.MSG_TRUNC if len(data) > size else 0, source

    def recvmsg_into(
        self, buffers: list[bytearray], ancillary_bytes: int = 0
    ) -> tuple[int, list[tuple[int, int, bytes]], int, Address]:
        """As a socket's own."""
        (buffer,) = buffers
        data, ancillary, flags, source = self.recvmsg(len(buffer), ancillary_bytes)
        buffer[: len(data)] = data
        return len(data), ancillary, flags, source

    def sendto(self, data: bytes, target: Address) -> int:
        """As a socket's own."""
        self.world.on_datagram(bytes(data), self._address, target)
        return len(data)

    def getsockname(self) -> Address:
        """As a socket's own."""
        return self._address

    def close(self) -> None:
        """As a socket's own."""
        self.world.sockets.pop(self._address[1], None)
        self.forget()


class VirtualTimer(Port):
    """A timer as the sampling clock needs it."""

    def __init__(self, world: VirtualTime) -> None:
        super().__init__(world)
        self._at_ns: int | None = None

    @property
    def is_ready(self) -> bool:
        """Return whether it has expired and was not read."""
        return self._at_ns is not None and self._at_ns <= self.world.host_ns

    def arm(self, at_ns: int) -> None:
        """Expire once [ns]."""
        self._at_ns = at_ns
        self.emptied()
        if self.is_ready:
            self.filled()
        # Time only stops where something happens.
        self._wait(at_ns)

    def _wait(self, at_ns: int) -> None:
        self.world.at(self.world.world_ns(at_ns), partial(self._expire, at_ns))

    def _expire(self, at_ns: int) -> None:
        if self._at_ns != at_ns:
            return
        if self.is_ready:
            self.filled()
        else:
            # The machine was paused, or its clock slowed down, after the timer was armed.
            self._wait(at_ns)

    def read(self) -> int:
        """How often it has expired since the last read."""
        if not self.is_ready:
            return 0
        self._at_ns = None
        self.emptied()
        return 1

    def close(self) -> None:
        """It is no longer there."""
        self._at_ns = None
        self.forget()


class VirtualBus(Port):
    """A CAN bus as ``CanLink`` needs it; frames wait with the adapter's stamps."""

    def __init__(self, world: VirtualTime) -> None:
        if "distance" in world.unplugged:
            raise can.CanInitializationError("no such device")
        super().__init__(world)
        self._waiting: deque[can.Message] = deque(maxlen=RECEIVE_QUEUE)
        world.buses.append(self)

    @property
    def is_ready(self) -> bool:
        """A frame waits, or the bus has gone."""
        return bool(self._waiting) or "distance" in self.world.unplugged

    def put(self, can_id: int, data: bytes, *, extended: bool) -> None:
        """A frame arrives."""
        self._waiting.append(
            can.Message(
                timestamp=self.world.wall_ns * 1e-9,
                arbitration_id=can_id,
                data=data,
                is_extended_id=extended,
            )
        )
        self.filled()

    def recv(self, _timeout: float | None = None) -> can.Message | None:
        """As a bus's own."""
        if "distance" in self.world.unplugged:
            raise can.CanOperationError("the device has gone")
        if not self._waiting:
            return None
        frame = self._waiting.popleft()
        if not self._waiting:
            self.emptied()
        return frame

    def shutdown(self) -> None:
        """As a bus's own."""
        if self in self.world.buses:
            self.world.buses.remove(self)
        self.forget()


class VirtualLine(Port):
    """A serial line as ``SerialLink`` needs it."""

    def __init__(
        self, world: VirtualTime, loop: asyncio.AbstractEventLoop, protocol: asyncio.Protocol
    ) -> None:
        super().__init__(world)
        self._loop = loop
        self._protocol = protocol
        self._waiting = bytearray()
        self._open = True
        world.lines.append(self)
        loop.add_reader(self.fileno(), self._read)

    @property
    def is_ready(self) -> bool:
        """Bytes wait, or the line has gone."""
        return bool(self._waiting) or "force_torque" in self.world.unplugged

    def put(self, data: bytes) -> None:
        """Bytes arrive; the kernel's buffer is as long as a tty's."""
        self._waiting += data[: max(0, 4096 - len(self._waiting))]
        self.filled()

    def write(self, data: bytes) -> None:
        """As a transport's own: the device hears it."""
        self.world.on_line(data)

    def abort(self) -> None:
        """As a transport's own."""
        self._end(None)

    def _read(self) -> None:
        if "force_torque" in self.world.unplugged:
            self._end(OSError("the device has gone"))
            return
        data, self._waiting = bytes(self._waiting), bytearray()
        self.emptied()
        if data:
            self._protocol.data_received(data)

    def _end(self, error: Exception | None) -> None:
        if not self._open:
            return
        self._open = False
        self._loop.remove_reader(self.fileno())
        self.world.lines.remove(self)
        self.forget()
        self._loop.call_soon(self._protocol.connection_lost, error)


class _Selector(selectors.BaseSelector):
    """Waits by letting time pass."""

    def __init__(self, world: VirtualTime) -> None:
        self._world = world
        self._keys: dict[int, selectors.SelectorKey] = {}
        self.has_work: Callable[[], bool] = lambda: False

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        descriptor = fileobj if isinstance(fileobj, int) else fileobj.fileno()
        key = selectors.SelectorKey(fileobj, descriptor, events, data)
        self._keys[descriptor] = key
        return key

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        descriptor = fileobj if isinstance(fileobj, int) else fileobj.fileno()
        return self._keys.pop(descriptor)

    def modify(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        return self.register(fileobj, events, data)

    def get_map(self) -> Mapping[Any, selectors.SelectorKey]:
        return self._keys

    def get_key(self, fileobj: Any) -> selectors.SelectorKey:
        return self._keys[fileobj if isinstance(fileobj, int) else fileobj.fileno()]

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        world = self._world
        end_ns = None if timeout is None else world.now_ns + math.ceil(max(timeout, 0.0) * 1e9)
        while True:
            if world.stalled_until_ns > world.now_ns:
                world.pass_until(world.stalled_until_ns)
            if world.filled or world.unplugged:
                ready = self._ready()
                if ready:
                    return ready
            if self.has_work():
                return []
            next_ns = world.next_ns
            if next_ns is None and end_ns is None:
                raise DeadlockError("everybody waits and nothing is to come")
            if end_ns is not None and (next_ns is None or next_ns > end_ns):
                world.now_ns = max(world.now_ns, end_ns)
                return []
            world.happen()

    def _ready(self) -> list[tuple[selectors.SelectorKey, int]]:
        filled, ports = self._world.filled, self._world.ports
        if self._world.unplugged:
            filled = {descriptor for descriptor, port in ports.items() if port.is_ready}
        return [
            (key, selectors.EVENT_READ)
            for descriptor, key in self._keys.items()
            if descriptor in filled
        ]


class VirtualLoop(asyncio.SelectorEventLoop):
    """asyncio's own loop on virtual time."""

    def __init__(self, world: VirtualTime) -> None:
        selector = _Selector(world)
        super().__init__(selector)
        self.world = world
        # Seconds in a float are no finer this long after the epoch.
        self._clock_resolution = 1e-7
        selector.has_work = lambda: bool(self._ready)  # type: ignore[attr-defined]

    def time(self) -> float:
        """Monotonic [s]."""
        return self.world.host_ns * 1e-9

    def run_in_executor(  # type: ignore[override]
        self, executor: Executor | None, func: Callable[..., T], *args: Any
    ) -> "asyncio.Future[T]":
        """There are no threads here: done at once."""
        del executor
        future: asyncio.Future[T] = self.create_future()
        try:
            future.set_result(func(*args))
        except Exception as error:  # noqa: BLE001 - the waiting caller gets it
            future.set_exception(error)
        return future

    def add_signal_handler(  # type: ignore[override]
        self, sig: int, callback: Callable[..., Any], *args: Any
    ) -> None:
        """A simulated process gets no signals from the host."""

    def remove_signal_handler(self, sig: int) -> bool:
        """A simulated process gets no signals from the host."""
        del sig
        return False


@contextlib.contextmanager
def inhabited(world: VirtualTime) -> Iterator[None]:
    """Let clocks, sockets, timers, buses and lines of this process be virtual ones."""

    def bound(host: str, port: int) -> DatagramSocket:
        if port in world.sockets:
            raise OSError(98, "Address already in use")
        return DatagramSocket(VirtualSocket(world, (host, port)))  # type: ignore[arg-type]

    def wait(
        readable: Iterable[Any],
        writable: Iterable[Any],
        strange: Iterable[Any],
        timeout: Any = None,
    ) -> tuple[list[Any], list[Any], list[Any]]:
        watched = list(readable)
        ports = [world.ports[one] for one in watched if one in world.ports]
        if not ports:
            found = select(watched, list(writable), list(strange), timeout)
            return found[0], found[1], found[2]
        end_ns = world.now_ns + math.ceil(max(0.0, timeout) * 1e9)
        while not any(port.is_ready for port in ports):
            next_ns = world.next_ns
            if next_ns is None or next_ns > end_ns:
                world.now_ns = max(world.now_ns, end_ns)
                return [], [], []
            world.happen()
            if world.stalled_until_ns > world.now_ns:
                world.pass_until(world.stalled_until_ns)
        return [port.fileno() for port in ports if port.is_ready], [], []

    async def connect(
        loop: asyncio.AbstractEventLoop,
        factory: Callable[[], asyncio.Protocol],
        *_args: Any,
        **_options: Any,
    ) -> tuple[VirtualLine, asyncio.Protocol]:
        if "force_torque" in world.unplugged:
            raise OSError(2, "No such file or directory")
        protocol = factory()
        line = VirtualLine(world, loop, protocol)
        world.on_line(None)
        return line, protocol

    select = select_module.select
    replaced: list[tuple[Any, str, Any]] = [
        (time, "monotonic_ns", lambda: world.host_ns),
        (time, "time_ns", lambda: world.wall_ns),
        (DatagramSocket, "bound", bound),
        (select_module, "select", wait),
        (sole_sender, "keep_only", lambda endpoint, source: endpoint.keep_only(source)),
        (daemon_timer, "TimerFd", lambda: VirtualTimer(world)),
        (can, "Bus", lambda **_config: VirtualBus(world)),
        (serialx, "create_serial_connection", connect),
        # A DBC is parsed once a process: it takes longer than the second that is simulated.
        (distance_codec, "_load", _load_once),
        # So are the docstrings of settings.
    ]
    kept = [(owner, name, vars(owner)[name]) for owner, name, _ in replaced]
    try:
        for owner, name, virtual in replaced:
            setattr(owner, name, virtual)
        yield
    finally:
        for owner, name, real in kept:
            setattr(owner, name, real)


_load_once = cache(distance_codec._load)  # noqa: SLF001 - pure, only slow
