"""Two generations of Stream Motion's packets behind one interface of the emulated controller."""

import math
from collections.abc import Callable
from enum import StrEnum
from typing import NamedTuple

from linemate.protocol.fanuc import classic_packets as classic
from linemate.protocol.fanuc import packets
from linemate.protocol.fanuc.classic_packets import ClassicKind, LimitKind
from linemate.protocol.fanuc.packets import (
    CapabilityPacket,
    CommandPacket,
    FanucError,
    PacketKind,
    StatusPacket,
)
from linemate.simulators.devices.limit_judge import AxisLimit

READY_SYSTEM = 0x04  # SYSRDY in the older status
FASTEST_MM_S = 2000  # greatest speed of the tcp, for the tables of limits [mm/s]


class RequestKind(StrEnum):
    """What a client asks for."""

    START = "begin the stream"
    STOP = "end the stream"
    POSITION = "say what was commanded last"
    QUESTION = "another question that is answered at once"


class ClientRequest(NamedTuple):
    """A packet of a client that is no command.

    Attributes:
        version: what START names; None where it does not matter.
        answer: bytes of the answer, if there is one.
    """

    kind: RequestKind
    version: int | None = None
    answer: bytes | None = None


class Dialect(NamedTuple):
    """Codec of one generation.

    Attributes:
        request: reads what is no command; raises FanucError at anything else.
    """

    command_kinds: frozenset[int]
    read_command: Callable[[bytes], CommandPacket]
    write_status: Callable[[StatusPacket], bytes]
    request: Callable[[bytes], ClientRequest]
    write_position: Callable[[StatusPacket], bytes]


def dialect(version: int, cycle_s: float, limits: tuple[AxisLimit, ...]) -> Dialect:
    """Return the codec of a version.

    Args:
        cycle_s: period of the controller [s].
        limits: of each axis, which the older generation answers with.
    """
    if version in classic.VERSIONS:
        return Dialect(
            frozenset({ClassicKind.COMMAND_SINGLE, ClassicKind.COMMAND_DOUBLE}),
            classic.read_command,
            _write_classic_status,
            lambda data: _classic_request(data, version, cycle_s, limits),
            classic.write_position,
        )
    return Dialect(
        frozenset({PacketKind.COMMAND}),
        packets.read_command,
        packets.write_status,
        lambda data: _request(data, version, cycle_s),
        packets.write_status,
    )


def _request(data: bytes, version: int, cycle_s: float) -> ClientRequest:
    kind = packets.kind_of(data)
    if kind == PacketKind.CAPABILITY:
        packets.read_capability(data)
        answer = CapabilityPacket(version, round(cycle_s * 1e3), 1, version)
        return ClientRequest(RequestKind.QUESTION, answer=packets.write_capability(answer))
    if kind == PacketKind.START:
        return ClientRequest(RequestKind.START, packets.read_short(data, PacketKind.START))
    packets.read_short(data, PacketKind.STOP)
    return ClientRequest(RequestKind.STOP)


def _write_classic_status(packet: StatusPacket) -> bytes:
    bits = packet.motion_bits | (0 if packet.fault_bits else READY_SYSTEM)
    return classic.write_status(
        StatusPacket(packet.version, packet.sequence, bits, 0, packet.joints, packet.pose)
    )


def _classic_request(
    data: bytes, version: int, cycle_s: float, limits: tuple[AxisLimit, ...]
) -> ClientRequest:
    if packets.kind_of(data) == ClassicKind.LIMITS:
        request = classic.read_limit_request(data)
        limit = limits[min(request.axis, len(limits)) - 1]
        scale = 1e3 if request.axis == len(limits) else math.degrees(1.0)
        value = (
            scale
            * {
                LimitKind.SPEED: limit.speed,
                LimitKind.ACCELERATION: limit.acceleration,
                LimitKind.JERK: limit.jerk,
            }[request.kind]
        )
        period_ms = round(cycle_s * 1e3)
        table = classic.write_limits(request, FASTEST_MM_S, period_ms, [value] * classic.LIMITS)
        return ClientRequest(RequestKind.QUESTION, answer=table)
    kind, _ = classic.read_short(data)
    if kind == ClassicKind.VERSION:
        answer = classic.write_short(ClassicKind.VERSION, version)
        return ClientRequest(RequestKind.QUESTION, answer=answer)
    if kind == ClassicKind.POSITION:
        return ClientRequest(RequestKind.POSITION)
    if kind == ClassicKind.START:
        # A client of this generation starts first and asks for the version then.
        return ClientRequest(RequestKind.START)
    if kind == ClassicKind.STOP:
        return ClientRequest(RequestKind.STOP)
    raise FanucError(f"packet type {kind} of {len(data)} bytes")
