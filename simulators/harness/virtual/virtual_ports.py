"""UDP socket, timer, CAN bus and serial line in memory, on virtual time."""

import asyncio
import socket
import struct
from collections import deque
from functools import partial

import can

from linemate.drivers.datagrams import SO_TIMESTAMPNS, Address
from linemate.simulators.harness.virtual.virtual_time import Port, VirtualTime

RECEIVE_QUEUE = 256  # datagrams that wait in a socket before the kernel drops new ones

_TIMESPEC = struct.Struct("@ll")


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

    def deliver(self, data: bytes, source: Address) -> None:
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

    def deliver(self, can_id: int, data: bytes, *, extended: bool) -> None:
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

    def deliver(self, data: bytes) -> None:
        """Bytes arrive; the kernel's buffer is as long as a tty's."""
        self._waiting += data[: max(0, 4096 - len(self._waiting))]
        self.filled()

    def write(self, data: bytes) -> None:
        """As a transport's own: the device receives it."""
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
