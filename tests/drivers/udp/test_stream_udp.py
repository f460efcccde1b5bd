"""A link that asks for its telegrams: handshake, answers, end of the stream."""

import asyncio
import socket
from collections.abc import Iterator
from contextlib import closing

import pytest

from linemate.drivers.udp.stream_udp import StreamLink
from linemate.protocol.fanuc import packets
from linemate.protocol.fanuc.handshake import FanucHandshake
from linemate.protocol.fanuc.packets import (
    CapabilityPacket,
    CommandPacket,
    PacketKind,
    StatusPacket,
)
from tests.loops import run, until

JOINTS = (0.0,) * 9


@pytest.fixture
def controller() -> Iterator[socket.socket]:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as endpoint:
        endpoint.bind(("127.0.0.1", 0))
        endpoint.setblocking(False)
        yield endpoint


async def receive(controller: socket.socket) -> tuple[bytes, tuple[str, int]]:
    loop = asyncio.get_running_loop()
    return await asyncio.wait_for(loop.sock_recvfrom(controller, 2048), 5.0)


def hold(data: bytes, _stamp_ns: int, _source: object, *, is_answered: bool) -> bytes:
    del is_answered
    status = packets.read_status(data)
    return packets.write_command(CommandPacket(3, status.sequence, status.joints))


def status(sequence: int) -> bytes:
    return packets.write_status(StatusPacket(3, sequence, 1, 0, JOINTS))


def test_it_asks_starts_answers_and_ends(controller: socket.socket) -> None:
    async def main() -> None:
        begun: list[int] = []
        target = controller.getsockname()
        link = StreamLink(
            hold, "127.0.0.1", 0, target, FanucHandshake(3, 8.0), on_start=lambda: begun.append(1)
        )
        link.open()
        asked = [await receive(controller) for _ in range(2)]
        assert [packets.kind_of(data) for data, _ in asked] == [
            PacketKind.STOP,
            PacketKind.CAPABILITY,
        ]
        daemon = asked[0][1]
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as stranger:
            stranger.sendto(packets.write_capability(CapabilityPacket(3, 8, 1, 3)), daemon)
            await until(lambda: link.counters["foreign"] == 1)
        assert begun == []
        controller.sendto(packets.write_capability(CapabilityPacket(3, 8, 1, 3)), daemon)
        assert packets.kind_of((await receive(controller))[0]) == PacketKind.START
        assert begun == [1]
        controller.sendto(status(1), daemon)
        command = packets.read_command((await receive(controller))[0])
        assert (command.sequence, command.is_last) == (1, False)
        ending = asyncio.create_task(link.end_stream())
        await asyncio.sleep(0)
        controller.sendto(status(2), daemon)
        command = packets.read_command((await receive(controller))[0])
        assert (command.sequence, command.is_last) == (2, True)
        assert packets.kind_of((await receive(controller))[0]) == PacketKind.STOP
        await ending
        link.close()

    run(main())


def test_a_controller_that_does_not_fit_is_named_in_the_status(controller: socket.socket) -> None:
    async def main() -> None:
        link = StreamLink(hold, "127.0.0.1", 0, controller.getsockname(), FanucHandshake(3, 8.0))
        link.open()
        _, daemon = await receive(controller)
        await until(lambda: "CAPABILITY sent, no answer." in link.status.reason)
        controller.sendto(packets.write_capability(CapabilityPacket(4, 8, 1, 4)), daemon)
        await until(lambda: "version" in link.status.reason)
        assert "version 4 of Stream Motion, configured 3" in link.status.reason
        await link.end_stream()  # nothing to wait for
        link.close()

    run(main())
