"""The distance sensor's link: a real python-can bus, with and without a descriptor."""

import asyncio
from collections.abc import Callable
from pathlib import Path

import can
from loops import run, until

from linemate.drivers.backoff import Backoff
from linemate.drivers.can_bus import CanLink
from linemate.protocol.sensors.distance import DistanceDecoder, DistanceEncoder
from linemate.protocol.sensors.slcan import CanFrame
from linemate.protocol.stamped_samples import DistanceSample
from linemate.simulators.devices.links.slcan_pty import SlcanPty
from linemate.simulators.devices.sensing.can_sensor import CanSensor

QUICK = (0.02, 0.1)


def _adapter(link: Path) -> SlcanPty:
    adapter = SlcanPty(CanSensor(DistanceEncoder()), link)
    adapter.open()
    return adapter


def _link(path: Path, on_sample: Callable[[DistanceSample], None]) -> CanLink:
    config = {"interface": "slcan", "channel": str(path), "bitrate": 500_000}
    return CanLink(config, DistanceDecoder(), on_sample, backoff=Backoff(*QUICK))


def test_frames_of_an_slcan_adapter_become_stamped_samples(tmp_path: Path) -> None:
    async def main() -> None:
        adapter = _adapter(tmp_path / "can")
        samples: list[DistanceSample] = []
        link = _link(tmp_path / "can", samples.append)
        link.open()
        await until(lambda: adapter.adapter.is_open)
        assert adapter.adapter.bitrate_code == 6
        for number in range(10):
            adapter.emit(0.1 * number)
        await until(lambda: len(samples) == 10)
        assert [round(s.position, 4) for s in samples] == [round(0.1 * n, 4) for n in range(10)]
        assert samples[0].stamp_ns <= samples[-1].stamp_ns
        link.close()
        await link.wait_closed()
        assert not link.status.up
        await until(lambda: not adapter.adapter.is_open)
        adapter.close()

    run(main())


def test_an_adapter_behind_a_tcp_port_gives_the_same_samples_and_is_opened_again() -> None:
    async def main() -> None:
        adapter = SlcanPty(CanSensor(DistanceEncoder()), bind=("127.0.0.1", 0))
        adapter.open()
        samples: list[DistanceSample] = []
        link = _link(Path(), samples.append)
        link._config["channel"] = adapter.port.path
        link.open()
        await until(lambda: adapter.adapter.is_open)
        await until(lambda: bool(samples) or bool(adapter.emit(0.0)))
        del samples[:]
        for number in range(1, 100):
            adapter.emit(0.01 * number)
        await until(lambda: bool(samples) and round(samples[-1].position, 4) == 0.99)
        places = [round(s.position, 4) for s in samples if s.position > 0.005]
        assert places == [round(0.01 * n, 4) for n in range(1, 100)]
        adapter.close()
        await until(lambda: not link.status.up)
        assert "Could not read" in link.status.reason
        adapter.open()
        await until(lambda: adapter.adapter.is_open)
        await until(lambda: samples[-1].position < 0.6 or bool(adapter.emit(0.5)))
        link.close()
        await link.wait_closed()
        adapter.close()

    run(main())


def test_frames_of_others_and_bad_ones_are_counted_apart(tmp_path: Path) -> None:
    async def main() -> None:
        adapter = _adapter(tmp_path / "can")
        samples: list[DistanceSample] = []
        link = _link(tmp_path / "can", samples.append)
        link.open()
        await until(lambda: adapter.adapter.is_open)
        adapter.send_frame(CanFrame(0x123, b"\x01"))
        adapter.send_frame(CanFrame(0x183, b"\x01\x02"))
        adapter.port.write(b"tXYZ4zz\r")
        adapter.port.write(b"r1234\r")
        adapter.emit(0.5)
        await until(lambda: len(samples) == 1)
        link.close()
        await link.wait_closed()
        adapter.close()
        assert link.counters["other"] == 1
        assert link.counters["refused"] == 1
        assert link.counters["garbage"] == 1
        assert link.counters["remote_frames"] == 1

    run(main())


def test_an_adapter_that_is_unplugged_is_opened_again_when_it_returns(tmp_path: Path) -> None:
    async def main() -> None:
        adapter = _adapter(tmp_path / "can")
        samples: list[DistanceSample] = []
        link = _link(tmp_path / "can", samples.append)
        link.open()
        await until(lambda: adapter.adapter.is_open)
        # What comes while the bus is still being opened is thrown away by it.
        await until(lambda: bool(samples) or bool(adapter.emit(0.1)))
        adapter.close()
        await until(lambda: not link.status.up)
        assert link.status.reason
        adapter.open()
        await until(lambda: adapter.adapter.is_open)
        await until(lambda: samples[-1].position > 0.15 or bool(adapter.emit(0.2)))
        link.close()
        await link.wait_closed()
        adapter.close()
        assert link.counters["lost"] == 1
        assert link.counters["opened"] == 2

    run(main())


def test_bytes_that_are_no_text_cost_their_line_and_not_the_bus(tmp_path: Path) -> None:
    async def main() -> None:
        adapter = _adapter(tmp_path / "can")
        samples: list[DistanceSample] = []
        link = _link(tmp_path / "can", samples.append)
        link.open()
        await until(lambda: adapter.adapter.is_open)
        for junk in (b"\xff\xfe\r", b"t183\xff\r", b"\x80\a"):
            adapter.port.write(junk)
            adapter.emit(0.4)
        await until(lambda: len(samples) == 3)
        link.close()
        await link.wait_closed()
        adapter.close()
        assert link.counters["garbage"] == 3
        assert link.counters["lost"] == 0

    run(main())


def test_bytes_that_never_become_frames_end_the_bus(tmp_path: Path) -> None:
    async def main() -> None:
        adapter = _adapter(tmp_path / "can")
        samples: list[DistanceSample] = []
        link = _link(tmp_path / "can", samples.append)
        link.open()
        await until(lambda: adapter.adapter.is_open)
        while link.counters["opened"] < 2:
            adapter.port.write(b"x\r")
            await asyncio.sleep(0.001)
        while not samples:
            adapter.emit(0.3)
            await asyncio.sleep(0.01)
        link.close()
        await link.wait_closed()
        adapter.close()

    run(main())


def test_a_missing_adapter_is_a_reason_and_not_an_exception(tmp_path: Path) -> None:
    async def main() -> None:
        link = _link(tmp_path / "none", lambda sample: None)
        link.open()
        await until(lambda: "none" in link.status.reason)
        assert not link.status.up
        link.close()
        await link.wait_closed()

    run(main())


def test_a_configuration_python_can_refuses_is_a_reason_too() -> None:
    async def main() -> None:
        link = CanLink({"interface": "no such"}, DistanceDecoder(), lambda sample: None)
        link.open()
        await until(lambda: link.status.reason not in {"", "not opened"})
        link.close()
        await link.wait_closed()

    run(main())


def test_a_bus_without_a_descriptor_is_read_by_a_thread() -> None:
    async def main() -> None:
        samples: list[DistanceSample] = []
        config = {"interface": "virtual", "channel": "test_can_bus"}
        link = CanLink(config, DistanceDecoder(), samples.append)
        link.open()
        await until(lambda: link.status.up)
        encoder = DistanceEncoder()
        sender = await asyncio.to_thread(can.Bus, interface="virtual", channel="test_can_bus")
        try:
            for number in range(5):
                can_id, data = encoder.encode(0.1 * number)
                sender.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
            sender.send(can.Message(is_error_frame=True))
            await until(lambda: len(samples) == 5 and link.counters["error_frames"] == 1)
        finally:
            sender.shutdown()
        link.close()
        await link.wait_closed()
        assert link.counters["dropped"] == 0

    run(main())
