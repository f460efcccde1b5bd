"""Start and stop of Stream Motion: who asks what, and who is refused."""

import pytest

from linemate.protocol.fanuc import packets
from linemate.protocol.fanuc.handshake import FanucHandshake, StreamState
from linemate.protocol.fanuc.packets import CapabilityPacket, CommandPacket, PacketKind
from linemate.protocol.fanuc.packets import StatusPacket as Status

STATUS = packets.write_status(Status(3, 1, 1, 0, (0.0,) * 9))
MS = 1_000_000


def kinds(datagrams: list[bytes]) -> list[int | None]:
    return [packets.kind_of(data) for data in datagrams]


def answer(version: int = 3, rate_ms: int = 8) -> bytes:
    return packets.write_capability(CapabilityPacket(version, rate_ms, 1, version))


def streaming() -> FanucHandshake:
    handshake = FanucHandshake(3, 8.0)
    assert kinds(handshake.due(0)) == [PacketKind.STOP, PacketKind.CAPABILITY]
    assert handshake.on_datagram(answer(), MS)
    assert kinds(handshake.due(MS)) == [PacketKind.START]
    assert not handshake.on_datagram(STATUS, 2 * MS)
    return handshake


def test_it_asks_again_until_the_controller_answers() -> None:
    handshake = FanucHandshake(3, 8.0)
    asked = [ms for ms in range(0, 1500, 50) if handshake.due(ms * MS)]
    assert asked == [0, 500, 1000]


def test_a_stream_starts_once() -> None:
    handshake = streaming()
    assert (handshake.state, handshake.starts) == (StreamState.STREAMING, 1)
    assert handshake.due(3 * MS) == []
    assert handshake.on_datagram(answer(), 4 * MS)  # a second answer begins nothing
    assert (handshake.due(5 * MS), handshake.starts) == ([], 1)


@pytest.mark.parametrize("data", [answer()[:12], answer(4), answer(3, 16)])
def test_an_answer_that_was_not_asked_for_refuses_nothing(data: bytes) -> None:
    handshake = streaming()
    assert handshake.on_datagram(data, 4 * MS)
    assert handshake.refusal is None
    assert not handshake.on_datagram(STATUS, 5 * MS)


def test_what_does_not_come_is_named_until_it_comes() -> None:
    handshake = FanucHandshake(3, 8.0)
    assert handshake.waits_for == ""
    handshake.due(0)
    assert "CAPABILITY sent, no answer. Check fanuc.peer" in handshake.waits_for
    handshake.on_datagram(answer(), MS)
    assert "START sent, no status packet." in handshake.waits_for
    handshake.on_datagram(STATUS, 2 * MS)
    assert handshake.waits_for == ""


def test_a_stream_that_falls_silent_is_asked_for_again() -> None:
    handshake = streaming()
    assert handshake.due(501 * MS) == []
    assert kinds(handshake.due(503 * MS)) == [PacketKind.STOP, PacketKind.CAPABILITY]
    assert handshake.on_datagram(STATUS, 504 * MS)  # of the old stream: it is being stopped
    assert handshake.on_datagram(answer(), 505 * MS)
    assert handshake.starts == 2


@pytest.mark.parametrize(
    ("version", "rate_ms", "says"),
    [
        (4, 8, "version 4 of Stream Motion, configured 3. Set fanuc.version: 4."),
        (3, 4, "period is 4 ms, configured 8 ms. Set fanuc.cycle_ms: 4."),
    ],
)
def test_a_controller_that_does_not_fit_gets_no_start(
    version: int, rate_ms: int, says: str
) -> None:
    handshake = FanucHandshake(3, 8.0)
    handshake.due(0)
    assert handshake.on_datagram(answer(version, rate_ms), MS)
    assert handshake.refusal is not None
    assert says in handshake.refusal
    assert handshake.due(2 * MS) == []
    # It may be set up in the meantime.
    assert kinds(handshake.due(2600 * MS)) == [PacketKind.STOP, PacketKind.CAPABILITY]
    handshake.on_datagram(answer(), 2601 * MS)
    assert handshake.refusal is None
    assert kinds(handshake.due(2602 * MS)) == [PacketKind.START]


def test_the_last_command_is_marked_and_nothing_follows() -> None:
    handshake = streaming()
    command = packets.write_command(CommandPacket(3, 5, (1.0,) * 9))
    assert handshake.outgoing(command) == command
    handshake.end()
    assert not handshake.is_ended
    assert not handshake.on_datagram(STATUS, 10 * MS)
    last = packets.read_command(handshake.outgoing(command))
    assert (last.is_last, last.joints, last.sequence) == (True, (1.0,) * 9, 5)
    assert handshake.is_ended
    assert kinds(handshake.farewell()) == [PacketKind.STOP]
    assert handshake.due(10_000 * MS) == []


def test_the_end_without_a_stream_is_immediate() -> None:
    handshake = FanucHandshake(3, 8.0)
    handshake.end()
    assert handshake.is_ended


def test_bytes_that_are_no_packet_go_to_the_codec() -> None:
    assert not streaming().on_datagram(b"<Rob Type='KUKA'/>", MS)


def test_an_answer_that_cannot_be_read_is_named() -> None:
    handshake = FanucHandshake(3, 8.0)
    handshake.due(0)
    assert handshake.on_datagram(answer()[:12], MS)
    assert handshake.refusal == "CAPABILITY packet: 12 bytes, not 28"
    assert handshake.starts == 0
