"""One sender at a time, on real sockets: who is dropped by the kernel, and for how long."""

import asyncio
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing

import pytest
from loops import run, until

from linemate.drivers.datagrams import DatagramSocket
from linemate.drivers.udp import camera_udp, robot_udp, sole_sender
from linemate.drivers.udp.camera_udp import CameraLink
from linemate.drivers.udp.robot_udp import RobotLink
from linemate.drivers.udp.sole_sender import SoleSender, keep_only, only_from
from linemate.protocol.sensors.camera_codec import CameraDecoder
from linemate.protocol.stamped_samples import CameraSample
from linemate.simulators.devices.sensing.camera_sender import CameraSender

Sender = socket.socket


@pytest.fixture
def two() -> Iterator[tuple[Sender, Sender]]:
    with ExitStack() as stack:
        senders = [stack.enter_context(socket.socket(type=socket.SOCK_DGRAM)) for _ in range(2)]
        for sender in senders:
            sender.bind(("127.0.0.1", 0))
        yield senders[0], senders[1]


def _drained(transport: DatagramSocket) -> list[bytes]:
    taken = []
    while (datagram := transport.read()) is not None:
        taken.append(datagram.data)
    return taken


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_only_one_address_and_port_come_through_a_narrow_socket(host: str) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with ExitStack() as stack:
        try:
            good, stranger = (
                stack.enter_context(socket.socket(family, socket.SOCK_DGRAM)) for _ in range(2)
            )
            good.bind((host, 0))
            transport = DatagramSocket.bound(host, 0)
        except OSError:
            pytest.skip(f"no {host} here")
        stack.callback(transport.close)
        keep_only(transport.endpoint, good.getsockname()[:2])
        for sender, data in ((stranger, b"a"), (good, b"b"), (stranger, b"c"), (good, b"")):
            sender.sendto(data, transport.address)
        assert _drained(transport) == [b"b", b""]
        keep_only(transport.endpoint, None)
        stranger.sendto(b"d", transport.address)
        assert _drained(transport) == [b"d"]


def test_the_same_port_at_another_address_is_another_sender() -> None:
    with ExitStack() as stack:
        good, stranger = (
            stack.enter_context(socket.socket(type=socket.SOCK_DGRAM)) for _ in range(2)
        )
        good.bind(("127.0.0.1", 0))
        stranger.bind(("127.0.0.2", good.getsockname()[1]))
        transport = DatagramSocket.bound("127.0.0.1", 0)
        stack.callback(transport.close)
        keep_only(transport.endpoint, good.getsockname())
        stranger.sendto(b"a", transport.address)
        good.sendto(b"b", transport.address)
        assert _drained(transport) == [b"b"]


def test_what_is_kept_out_is_among_the_kernels_drops(two: tuple[Sender, Sender]) -> None:
    good, stranger = two
    with closing(DatagramSocket.bound("127.0.0.1", 0)) as transport:
        keep_only(transport.endpoint, good.getsockname())
        for _ in range(7):
            stranger.sendto(b"junk", transport.address)
        good.sendto(b"good", transport.address)
        assert _drained(transport) == [b"good"]
        assert transport.kernel_drops == 7


def test_a_name_is_no_address() -> None:
    with pytest.raises(ValueError, match="somewhere"):
        only_from(("somewhere", 1))


def test_a_controller_that_is_answered_has_the_port_for_itself(two: tuple[Sender, Sender]) -> None:
    async def main() -> None:
        link = RobotLink(lambda data, *_, **__: data, port=0)
        link.open()
        assert link.address is not None
        assert link._sole_sender.kept is None
        first, second = two
        first.sendto(b"1", link.address)
        await until(lambda: link.counters["answered"] == 1)
        assert link._sole_sender.kept == first.getsockname()
        second.sendto(b"2", link.address)
        first.sendto(b"3", link.address)
        await until(lambda: link.counters["answered"] == 2)
        assert link.counters["received"] == 2
        assert link.counters["kernel_drops"] == 1
        link.close()
        assert link._sole_sender.kept is None

    run(main())


def test_another_controller_may_come_after_the_first_ones_silence(
    two: tuple[Sender, Sender],
) -> None:
    async def main() -> None:
        link = RobotLink(lambda data, *_, **__: data, port=0)
        link.open()
        assert link.address is not None
        first, second = two
        first.sendto(b"1", link.address)
        await until(lambda: link._sole_sender.kept is not None)
        begun = time.monotonic()
        while link.counters["answered"] == 1:
            second.sendto(b"2", link.address)
            await asyncio.sleep(0.005)
            assert time.monotonic() - begun < 5.0
        assert time.monotonic() - begun >= 0.8 * robot_udp.SILENCE_S
        assert link._sole_sender.kept == second.getsockname()
        link.close()

    run(main())


def test_telegrams_without_an_answer_keep_no_sender_out(two: tuple[Sender, Sender]) -> None:
    async def main() -> None:
        link = RobotLink(lambda data, *_, **__: data if data == b"robot" else None, port=0)
        link.open()
        assert link.address is not None
        first, second = two
        for _ in range(20):
            first.sendto(b"junk", link.address)
        second.sendto(b"robot", link.address)
        await until(lambda: link.counters["answered"] == 1)
        assert link._sole_sender.kept == second.getsockname()
        link.close()

    run(main())


def test_a_camera_has_the_port_for_itself_after_five_poses_in_a_row(
    two: tuple[Sender, Sender],
) -> None:
    async def main() -> None:
        samples: list[CameraSample] = []
        link = CameraLink(CameraDecoder(), samples.append)
        link.open()
        assert link.address is not None
        camera, stranger = two
        pose = CameraSender()

        def send(sender: Sender) -> None:
            now_ns = time.monotonic_ns()
            data = pose.datagram(
                (0.1, 0.2, 0.3), (1.0, 0.0, 0.0, 0.0), None, exposure_ns=now_ns, sent_ns=now_ns
            )
            sender.sendto(data, link.address or ("", 0))

        for k in range(camera_udp.IN_A_ROW):
            send(stranger)
            send(camera)
            await until(lambda k=k: len(samples) == 2 * k + 2)
        for k in range(camera_udp.IN_A_ROW - 1):
            send(camera)
            await until(lambda k=k: len(samples) == 2 * camera_udp.IN_A_ROW + k + 1)
        before = len(samples)
        stranger.sendto(b"junk", link.address)
        send(camera)
        await until(lambda: len(samples) == before + 1)
        assert link.counters["kernel_drops"] == 1
        assert link.counters["refused"] == 0
        link.close()

    run(main())


def test_a_kernel_that_refuses_is_no_error_and_is_asked_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[object] = []

    def refuse(_endpoint: object, source: object) -> None:
        asked.append(source)
        raise OSError(1, "not permitted")

    monkeypatch.setattr(sole_sender, "keep_only", refuse)

    async def main() -> None:
        sole = SoleSender(0.1, 3, lambda: None)
        with closing(DatagramSocket.bound("127.0.0.1", 0)) as transport:
            for _ in range(7):
                sole.note_good(transport, ("127.0.0.1", 5))
        assert sole.kept is None
        assert asked == [("127.0.0.1", 5)] * 2

    run(main())
