"""One sender at a time: the kernel drops what others send to a port while that one lives.

Law of this file: a filter only ever narrows to a sender that was worth it, and widens as soon as
that one is silent; it saves work and decides nothing, so a kernel that refuses it is no error.
Unlike a connected socket it lets another sender come without a new socket. What it drops the
kernel counts among its drops, unseen: neither who it was nor what it said is known.
Classic BPF sees a datagram from its UDP header on; the IP header is reached by an offset.
Source: reference/reliability.md, 0 (finding 4); Linux, include/uapi/linux/filter.h.
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

Instruction = tuple[int, int, int, int]
"""Code, jump if true, jump if false, constant."""

LOAD_WORD, LOAD_HALF, JUMP_EQUAL, RETURN = 0x20, 0x28, 0x15, 0x06
NETWORK = 0xFFF00000  # SKF_NET_OFF
SOURCE_4, SOURCE_6 = 12, 8
"""Where an IP header has its source address [bytes]."""
SOONEST_S = 2e-3
"""A loop's clock is coarser than the kernel's: no look again sooner than that [s]."""

WHOLE, NOTHING = 0xFFFFFFFF, 0


def only_from(source: Address) -> list[Instruction]:
    """Return the programme that keeps one sender's datagrams.

    Args:
        source: numeric address and port, as a socket tells it.

    Raises:
        ValueError: the address is not numeric.
    """
    address = ipaddress.ip_address(source[0].partition("%")[0])
    at = NETWORK + (SOURCE_6 if address.version == 6 else SOURCE_4)
    words = struct.unpack(f"!{len(address.packed) // 4}I", address.packed)
    wanted = [(LOAD_WORD, at + 4 * i, word) for i, word in enumerate(words)]
    wanted.append((LOAD_HALF, 0, source[1]))
    program: list[Instruction] = []
    for load, where, what in wanted:
        left = 2 * len(wanted) - len(program) - 1  # instructions from the jump to the refusal
        program += [(load, 0, 0, where), (JUMP_EQUAL, 0, left, what)]
    return [*program, (RETURN, 0, 0, WHOLE), (RETURN, 0, 0, NOTHING)]


def attach(endpoint: socket.socket, program: Sequence[Instruction]) -> None:
    """Let the kernel judge what comes from now on; what waits already stays.

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
        OSError, ValueError: it cannot be done.
    """
    if source is None:
        endpoint.setsockopt(socket.SOL_SOCKET, SO_DETACH_FILTER, 0)
    else:
        attach(endpoint, only_from(source))


class SoleSender:
    """Keeps strangers off a socket while one sender is worth it.

    Args:
        silence_s: without a good datagram for so long, anybody may come again [s].
        needed: good datagrams in a row from one sender before strangers are kept off.
        last_ns: tells when the last good datagram came [ns].
    """

    def __init__(self, silence_s: float, needed: int, last_ns: Callable[[], int | None]) -> None:
        self._silence_s = silence_s
        self._needed = needed
        self._last_ns = last_ns
        self._source: Address | None = None
        self._row = 0
        self._endpoint: socket.socket | None = None
        self._look: asyncio.TimerHandle | None = None

    @property
    def kept(self) -> Address | None:
        """The one whose datagrams come through, None while everybody's do."""
        return self._source if self._endpoint is not None else None

    def good(self, transport: DatagramSocket, source: Address) -> None:
        """A datagram was worth it."""
        if source == self._source:
            if self._endpoint is not None:
                return
            self._row += 1
        else:
            self._widen()
            self._source, self._row = source, 1
        if self._row >= self._needed:
            self._narrow(transport.endpoint, source)

    def forget(self) -> None:
        """The socket is closed."""
        if self._look is not None:
            self._look.cancel()
            self._look = None
        self._endpoint = self._source = None
        self._row = 0

    def _narrow(self, endpoint: socket.socket, source: Address) -> None:
        self._row = 0  # a kernel that refuses is asked again, not at each datagram
        with contextlib.suppress(OSError, ValueError):
            keep_only(endpoint, source)
            self._endpoint = endpoint
            self._look_in(self._silence_s)

    def _widen(self) -> None:
        endpoint = self._endpoint
        self.forget()
        if endpoint is not None:
            with contextlib.suppress(OSError):
                keep_only(endpoint, None)

    def _look_in(self, delay_s: float) -> None:
        self._look = asyncio.get_running_loop().call_later(delay_s, self._look_again)

    def _look_again(self) -> None:
        last_ns = self._last_ns()
        silent_s = 0.0 if last_ns is None else (time.monotonic_ns() - last_ns) * 1e-9
        if silent_s >= self._silence_s:
            self._widen()
        else:
            self._look_in(max(self._silence_s - silent_s, SOONEST_S))
