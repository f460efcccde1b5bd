"""The camera's link on real sockets."""

import asyncio
import socket
import time
from contextlib import ExitStack, closing
from functools import partial

import pytest
from loops import run, until

from linemate.drivers.udp import camera_udp
from linemate.drivers.udp.camera_peer import CameraPeer
from linemate.drivers.udp.camera_udp import BUDGET, IN_A_ROW, SILENCE_S, CameraLink
from linemate.protocol.sensors.camera_codec import CameraDecoder
from linemate.protocol.stamped_samples import CameraSample
from linemate.simulators.devices.sensing.camera_sender import CameraSender

POSE = ((0.1, 0.2, 0.3), (1.0, 0.0, 0.0, 0.0))


def _datagram(sender: CameraSender, number: int) -> bytes:
    at_ns = number * 25_000_000
    return sender.datagram(*POSE, None, exposure_ns=at_ns - 100_000_000, sent_ns=at_ns)


def test_poses_become_stamped_samples() -> None:
    async def main() -> None:
        samples: list[CameraSample] = []
        link = CameraLink(CameraDecoder(), samples.append)
        link.open()
        assert link.address is not None
        sender = CameraSender()
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as camera:
            camera.sendto(_datagram(sender, 1), link.address)
            await until(lambda: len(samples) == 1)
        link.close()
        assert samples[0].position == POSE[0]
        assert samples[0].object_id == "hub"
        assert link.status.last_sample_stamp_ns == samples[0].stamp_ns
        assert 99_000_000 < samples[0].stamp_ns - samples[0].exposure_ns < 101_000_000

    run(main())


def test_garbage_is_counted_and_good_poses_go_on() -> None:
    async def main() -> None:
        samples: list[CameraSample] = []
        link = CameraLink(CameraDecoder(), samples.append)
        link.open()
        assert link.address is not None
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as camera:
            camera.sendto(b"", link.address)
            camera.sendto(b"\xc1garbage", link.address)
            camera.sendto(b"z" * 5000, link.address)
            camera.sendto(_datagram(CameraSender(), 1), link.address)
            await until(lambda: len(samples) == 1)
        link.close()
        assert link.counters["refused"] == 2
        assert link.counters["oversize"] == 1

    run(main())


def test_a_flood_is_read_within_the_budget_of_a_wake() -> None:
    async def main() -> None:
        link = CameraLink(CameraDecoder(), lambda sample: None)
        link.open()
        assert link.address is not None
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as camera:
            for _ in range(3 * BUDGET):
                camera.sendto(b"junk", link.address)
        link.poll()
        assert link.counters["received"] == BUDGET
        link.poll()
        assert link.counters["received"] == 2 * BUDGET
        link.close()

    run(main())


def test_a_receiver_that_fails_does_not_reach_the_loop() -> None:
    def fail(sample: CameraSample) -> None:
        raise ZeroDivisionError

    async def main() -> None:
        link = CameraLink(CameraDecoder(), fail)
        link.open()
        assert link.address is not None
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as camera:
            camera.sendto(_datagram(CameraSender(), 1), link.address)
            await until(lambda: link.counters["callback_errors"] == 1)
        link.close()

    run(main())


class Camera:
    """Something that sends poses, from a port of its own."""

    def __init__(self, stack: ExitStack, link: CameraLink, x: float) -> None:
        self._socket = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        self._socket.bind(("127.0.0.1", 0))
        self._sender = CameraSender()
        self._link = link
        self._x = x

    @property
    def address(self) -> tuple[str, int]:
        host, port = self._socket.getsockname()
        return str(host), int(port)

    def send(self) -> None:
        now_ns = time.monotonic_ns()
        pose = (self._x, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
        data = self._sender.datagram(*pose, None, exposure_ns=now_ns, sent_ns=now_ns)
        assert self._link.address is not None
        self._socket.sendto(data, self._link.address)


def test_a_stranger_takes_no_port_from_a_camera_that_pauses() -> None:
    async def main() -> None:
        samples: list[CameraSample] = []
        link = CameraLink(CameraDecoder(), samples.append)
        link.open()
        with ExitStack() as stack:
            camera, stranger = Camera(stack, link, 1.0), Camera(stack, link, 2.0)
            for k in range(IN_A_ROW):
                camera.send()
                await until(lambda k=k: len(samples) == k + 1)
            await asyncio.sleep(2 * SILENCE_S)
            for k in range(3 * IN_A_ROW):
                stranger.send()
                await until(lambda k=k: link.counters["foreign"] == k + 1)
            camera.send()
            await until(lambda: len(samples) == IN_A_ROW + 1)
        link.close()
        assert {sample.position[0] for sample in samples} == {1.0}

    run(main())


def test_a_camera_that_starts_again_on_another_port_is_heard_after_the_silence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(camera_udp, "CameraPeer", partial(CameraPeer, takeover_s=0.6))

    async def main() -> None:
        samples: list[CameraSample] = []
        link = CameraLink(CameraDecoder(), samples.append)
        link.open()
        with ExitStack() as stack:
            first, again = Camera(stack, link, 1.0), Camera(stack, link, 2.0)
            for k in range(2 * IN_A_ROW):
                first.send()
                await until(lambda k=k: len(samples) == k + 1)
            began = time.monotonic()
            while samples[-1].position[0] != 2.0:
                again.send()
                await asyncio.sleep(0.02)
                assert time.monotonic() - began < 10.0
            assert time.monotonic() - began >= 0.6
            assert link.counters["takeovers"] == 1
            before = len(samples)
            again.send()
            await until(lambda: len(samples) == before + 1)
            # The one that was the camera has its right still.
            first.send()
            await until(lambda: samples[-1].position[0] == 1.0)
            foreign = link.counters["foreign"]
            again.send()
            await until(lambda: link.counters["foreign"] == foreign + 1)
        link.close()

    run(main())


def test_with_a_peer_set_others_are_refused_from_the_first_pose_on() -> None:
    async def main() -> None:
        samples: list[CameraSample] = []
        with ExitStack() as stack:
            reserved = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            reserved.bind(("127.0.0.1", 0))
            link = CameraLink(CameraDecoder(), samples.append, peer=reserved.getsockname())
            link.open()
            stranger = Camera(stack, link, 2.0)
            for k in range(2 * IN_A_ROW):
                stranger.send()
                await until(lambda k=k: link.counters["foreign"] == k + 1)
            camera = Camera(stack, link, 1.0)
            camera._socket = reserved
            camera.send()
            await until(lambda: len(samples) == 1)
            link.close()
        assert samples[0].position[0] == 1.0

    run(main())


def test_the_numbers_of_a_stranger_do_not_make_the_cameras_old() -> None:
    async def main() -> None:
        samples: list[CameraSample] = []
        link = CameraLink(CameraDecoder(), samples.append)
        link.open()
        with ExitStack() as stack:
            camera, stranger = Camera(stack, link, 1.0), Camera(stack, link, 2.0)
            for _ in range(500):
                stranger._sender.datagram(*POSE, None, exposure_ns=0, sent_ns=0)
            for k in range(IN_A_ROW):
                camera.send()
                await until(lambda k=k: len(samples) == k + 1)
            link._peer._last_ns -= 10**10
            await asyncio.sleep(2 * SILENCE_S)
            for _ in range(IN_A_ROW):
                stranger.send()
            await until(lambda: link.counters["takeovers"] == 1)
            assert samples[-1].position[0] == 2.0
            camera.send()
            await until(lambda: samples[-1].position[0] == 1.0)
        link.close()

    run(main())
