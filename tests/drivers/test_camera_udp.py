"""The camera's link on real sockets."""

import socket
from contextlib import closing

from loops import run, until

from linemate.drivers.camera_udp import BUDGET, CameraLink
from linemate.protocol.camera import CameraDecoder
from linemate.protocol.samples import CameraSample
from linemate.simulators.devices.camera_sender import CameraSender

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
