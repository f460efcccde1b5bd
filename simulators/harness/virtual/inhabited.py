"""Let the daemon's service run unchanged on virtual time.

Invariants:
    The host's network is not used.
    Only clock, sockets, timer, bus and line are replaced.
    Nothing is replaced outside ``inhabited``.
"""

import asyncio
import contextlib
import math
import select as select_module
import time
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from typing import Any
from unittest import mock

import can
import serialx

from linemate.daemon.cycle.clock import timer as daemon_timer
from linemate.drivers.datagrams import DatagramSocket
from linemate.drivers.udp import sole_sender
from linemate.protocol.sensors import distance as distance_codec
from linemate.simulators.harness.virtual.virtual_ports import (
    VirtualBus,
    VirtualLine,
    VirtualSocket,
    VirtualTimer,
)
from linemate.simulators.harness.virtual.virtual_time import VirtualTime


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
        ports = [world.ports[descriptor] for descriptor in watched if descriptor in world.ports]
        if not ports:
            ready = select(watched, list(writable), list(strange), timeout)
            return ready[0], ready[1], ready[2]
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
    ]
    with contextlib.ExitStack() as stack:
        for each in replaced:
            stack.enter_context(mock.patch.object(*each))
        yield


_load_once = cache(distance_codec._load)  # noqa: SLF001 - pure, only slow
