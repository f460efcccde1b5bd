"""The force-torque sensor's link on real ptys and a real socket."""

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest
from loops import run, until

from linemate.drivers.backoff import Backoff
from linemate.drivers.serial_port import SerialLink
from linemate.protocol.sensors.wrench import bota_frame, make_decoder, make_host
from linemate.protocol.stamped_samples import WrenchSample
from linemate.simulators.devices.links.serial_pty import SerialPty
from linemate.simulators.devices.sensing.force_torque import ForceTorqueSensor

FORCE, TORQUE = (1.0, -2.0, 3.0), (0.1, 0.2, -0.3)


def _sensor(link: Path, device: str = "bota") -> SerialPty:
    sensor = SerialPty(ForceTorqueSensor(device), link)
    sensor.open()
    return sensor


def _link(
    path: Path, on_sample: Callable[[WrenchSample], None], device: str = "bota"
) -> SerialLink:
    return SerialLink(
        str(path),
        make_decoder(device),
        on_sample,
        host=lambda: make_host(device),
        backoff=Backoff(0.02, 0.1),
    )


@pytest.mark.parametrize("device", ["bota", "robotiq-ft300"])
def test_the_dialogue_is_run_and_frames_become_samples(tmp_path: Path, device: str) -> None:
    async def main() -> None:
        sensor = _sensor(tmp_path / "ft", device)
        samples: list[WrenchSample] = []
        link = _link(tmp_path / "ft", samples.append, device)
        link.open()
        await until(lambda: link.status.up)
        assert sensor.sensor.streaming
        for number in range(10):
            sensor.emit(FORCE, TORQUE, number)
        await until(lambda: len(samples) == 10)
        assert link._host is None, "frames still pass through the dialogue"
        assert samples[0].force == pytest.approx(FORCE)
        assert samples[0].torque == pytest.approx(TORQUE)
        link.close()
        await link.wait_closed()
        sensor.close()
        assert link.counters["garbage_bytes"] == 0

    run(main())


def test_garbage_between_frames_is_counted(tmp_path: Path) -> None:
    async def main() -> None:
        sensor = _sensor(tmp_path / "ft")
        samples: list[WrenchSample] = []
        link = _link(tmp_path / "ft", samples.append)
        link.open()
        await until(lambda: link.status.up)
        sensor.emit(FORCE, TORQUE, 1)
        sensor.port.write(b"garbage")
        sensor.emit(FORCE, TORQUE, 2)
        await until(lambda: len(samples) == 2)
        link.close()
        await link.wait_closed()
        sensor.close()
        assert link.counters["garbage_bytes"] == 7
        assert link.counters["resyncs"] == 1

    run(main())


def test_a_sensor_that_is_unplugged_is_opened_and_set_up_again(tmp_path: Path) -> None:
    async def main() -> None:
        sensor = _sensor(tmp_path / "ft")
        samples: list[WrenchSample] = []
        link = _link(tmp_path / "ft", samples.append)
        link.open()
        await until(lambda: link.status.up)
        sensor.close()
        await until(lambda: not link.status.up)
        sensor.open()
        await until(lambda: link.status.up)
        sensor.emit(FORCE, TORQUE, 1)
        await until(lambda: len(samples) == 1)
        link.close()
        await link.wait_closed()
        sensor.close()
        assert link.counters["lost"] == 1

    run(main())


def test_a_silent_sensor_is_started_again(tmp_path: Path) -> None:
    async def main() -> None:
        sensor = _sensor(tmp_path / "ft")
        link = SerialLink(
            str(tmp_path / "ft"),
            make_decoder("bota"),
            lambda sample: None,
            host=lambda: make_host("bota"),
            silence_s=0.1,
            backoff=Backoff(0.02, 0.1),
        )
        link.open()
        await until(lambda: link.counters["silences"] == 1)
        await until(lambda: link.counters["opened"] == 2)
        link.close()
        await link.wait_closed()
        sensor.close()

    run(main())


def test_a_missing_port_is_a_reason_and_not_an_exception(tmp_path: Path) -> None:
    async def main() -> None:
        link = _link(tmp_path / "none", lambda sample: None)
        link.open()
        await until(lambda: "none" in link.status.reason)
        link.close()
        await link.wait_closed()

    run(main())


def test_a_socket_is_a_line_as_well() -> None:
    async def main() -> None:
        samples: list[WrenchSample] = []

        async def stream(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writer.write(bota_frame(FORCE, TORQUE) * 3)
            await writer.drain()
            writer.close()

        server = await asyncio.start_server(stream, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        link = SerialLink(
            f"socket://127.0.0.1:{port}",
            make_decoder("bota"),
            samples.append,
            backoff=Backoff(0.02, 0.1),
        )
        link.open()
        await until(lambda: len(samples) >= 6)
        assert link.counters["lost"] >= 1
        link.close()
        await link.wait_closed()
        server.close()
        await server.wait_closed()

    run(main())
