"""Kernel filter that lets one sender's datagrams through to a port.

The filter saves work and decides nothing: a kernel that refuses it is no error. Unlike a
connected socket it lets another sender come without a new socket.

Invariants:
    The filter is set for a sender of good datagrams, and removed when that sender is silent.
    The kernel counts what it drops, without sender or content.

Reference: Linux, include/uapi/linux/filter.h (classic BPF). A datagram is loaded from its UDP
header on; the IP header is reached by ``NETWORK``.
"""

import asyncio
import contextlib
import ctypes
import ipaddress
import socket
import struct
import time
from collections.abc import Callable, Sequence
from typing import Final

from linemate.drivers.datagrams import Address, DatagramSocket

SO_ATTACH_FILTER: Final = 26
SO_DETACH_FILTER: Final = 27

Instruction = tuple[int, int, int, int]  # code, jump if true, jump if false, constant

LOAD_WORD, LOAD_HALF, JUMP_EQUAL, RETURN = 0x20, 0x28, 0x15, 0x06
NETWORK = 0xFFF00000  # SKF_NET_OFF
SOURCE_4, SOURCE_6 = 12, 8  # offset of the source address in an IPv4 and IPv6 header [bytes]
SHORTEST_DELAY_S = 2e-3  # the loop's clock is coarser than the kernel's

WHOLE, NOTHING = 0xFFFFFFFF, 0


def only_from(source: Address) -> list[Instruction]:
    """Return the program that keeps one sender's datagrams.

    Args:
        source: numeric address and port, as a socket returns them.

    Raises:
        ValueError: the address is not numeric.
    """
    address = ipaddress.ip_address(source[0].partition("%")[0])
    at = NETWORK + (SOURCE_6 if address.version == 6 else SOURCE_4)
    words = struct.unpack(f"!{len(address.packed) // 4}I", address.packed)
    wanted = [(LOAD_WORD, at + 4 * i, word) for i, word in enumerate(words)]
    wanted.append((LOAD_HALF, 0, source[1]))
    program: list[Instruction] = []
    for load, offset, value in wanted:
        to_refusal = 2 * len(wanted) - len(program) - 1  # instructions from the jump
        program += [(load, 0, 0, offset), (JUMP_EQUAL, 0, to_refusal, value)]
    return [*program, (RETURN, 0, 0, WHOLE), (RETURN, 0, 0, NOTHING)]


def attach(endpoint: socket.socket, program: Sequence[Instruction]) -> None:
    """Filter what comes from now on; datagrams that wait already stay.

    Raises:
        OSError: the kernel refuses.
    """
    code = b"".join(struct.pack("HBBI", *instruction) for instruction in program)
    buffer = ctypes.create_string_buffer(code, len(code))
    header = struct.pack("HL", len(program), ctypes.addressof(buffer))
    endpoint.setsockopt(socket.SOL_SOCKET, SO_ATTACH_FILTER, header)


def keep_only(endpoint: socket.socket, source: Address | None) -> None:
    """Narrow a socket to one sender, or widen it to all.

    Raises:
        OSError, ValueError: the kernel refuses, or the address is not numeric.
    """
    if source is None:
        endpoint.setsockopt(socket.SOL_SOCKET, SO_DETACH_FILTER, 0)
    else:
        attach(endpoint, only_from(source))


class SoleSender:
    """Sets the filter for a sender of good datagrams, and removes it after silence.

    Args:
        silence_s: time without a good datagram after which all senders come through [s].
        needed: good datagrams in a row from one sender before the filter is set.
        last_ns: returns the arrival of the last good datagram [ns].

    Attributes:
        kept: the only sender that comes through, None while all do.
    """

    def __init__(self, silence_s: float, needed: int, last_ns: Callable[[], int | None]) -> None:
        self._silence_s = silence_s
        self._needed = needed
        self._last_ns = last_ns
        self.kept: Address | None = None
        self._source: Address | None = None
        self._row = 0
        self._endpoint: socket.socket | None = None
        self._timer: asyncio.TimerHandle | None = None

    def note_good(self, transport: DatagramSocket, source: Address) -> None:
        """Note a good datagram; set the filter if there were enough in a row."""
        if source == self.kept:
            return
        if source == self._source:
            self._row += 1
        else:
            self._widen()
            self._source, self._row = source, 1
        if self._row >= self._needed:
            self._narrow(transport.endpoint, source)

    def forget(self) -> None:
        """Note that the socket is closed."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._endpoint = self._source = self.kept = None
        self._row = 0

    def _narrow(self, endpoint: socket.socket, source: Address) -> None:
        self._row = 0  # after a refusal, try again later and not at each datagram
        with contextlib.suppress(OSError, ValueError):
            keep_only(endpoint, source)
            self._endpoint, self.kept = endpoint, source
            self._check_in(self._silence_s)

    def _widen(self) -> None:
        endpoint = self._endpoint
        self.forget()
        if endpoint is not None:
            with contextlib.suppress(OSError):
                keep_only(endpoint, None)

    def _check_in(self, delay_s: float) -> None:
        self._timer = asyncio.get_running_loop().call_later(delay_s, self._check)

    def _check(self) -> None:
        last_ns = self._last_ns()
        silent_s = 0.0 if last_ns is None else (time.monotonic_ns() - last_ns) * 1e-9
        if silent_s >= self._silence_s:
            self._widen()
        else:
            self._check_in(max(self._silence_s - silent_s, SHORTEST_DELAY_S))
