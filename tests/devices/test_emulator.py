"""The whole station over real sockets and ptys, against the daemon's own drivers."""

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loops import run, until

from linemate.drivers.can_bus import CanLink
from linemate.drivers.serial_port import SerialLink
from linemate.drivers.udp.camera_udp import CameraLink
from linemate.drivers.udp.robot_udp import RobotLink
from linemate.protocol.rsi.codec import RsiCodec, RsiError, SensorTelegram, parse_config
from linemate.protocol.sensors.camera_codec import CameraDecoder
from linemate.protocol.sensors.distance import DistanceDecoder
from linemate.protocol.sensors.wrench import make_decoder, make_host
from linemate.protocol.stamped_samples import CameraSample, DistanceSample, WrenchSample
from linemate.simulators.devices.links.emulator import SHIPPED_RSI, Emulator, EmulatorConfig
from linemate.simulators.devices.truth import load
from linemate.simulators.plants.scenario import Camera, DistanceSensor, Fault, Scenario

CODEC = RsiCodec(parse_config(SHIPPED_RSI.read_bytes()))


def _hold(data: bytes, stamp_ns: int, address: tuple[str, int], **_: object) -> bytes | None:
    try:
        telegram = CODEC.parse_robot(data)
    except RsiError:
        return None
    return CODEC.format_sensor(
        SensorTelegram(telegram.ipoc, telegram.ipoc_text, joints=(0.0,) * 6, external=(0.0,))
    )


def _scenario(lead_in_s: float = 0.4, duration_s: float = 0.5, cycle_s: float = 0.012) -> Scenario:
    camera = Camera(dropout_rate=0.0, blind_beyond=10.0)
    return Scenario(lead_in_s=lead_in_s, duration_s=duration_s, cycle_s=cycle_s, camera=camera)


class Station:
    """The daemon's four links, keeping what they bring."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.distances: list[DistanceSample] = []
        self.poses: list[CameraSample] = []
        self.wrenches: list[WrenchSample] = []
        self.robot = RobotLink(_hold, port=0)
        self.camera = CameraLink(CameraDecoder(), self.poses.append)
        self.can = CanLink(
            {"interface": "slcan", "channel": str(folder / "can")},
            DistanceDecoder(),
            self.distances.append,
        )
        self.force_torque = SerialLink(
            str(folder / "ft"),
            make_decoder("bota"),
            self.wrenches.append,
            host=lambda: make_host("bota"),
        )

    @property
    def links(self) -> tuple[RobotLink, CameraLink, CanLink, SerialLink]:
        return self.robot, self.camera, self.can, self.force_torque

    def open(self) -> None:
        for link in self.links:
            link.open()

    async def close(self) -> None:
        for link in self.links:
            link.close()
            await link.wait_closed()

    def config(self, **changes: Any) -> EmulatorConfig:
        assert self.robot.address is not None
        assert self.camera.address is not None
        return EmulatorConfig(
            scenario=changes.pop("scenario", _scenario()),
            robot_target=self.robot.address,
            camera_target=self.camera.address,
            can_link=self.folder / "can",
            serial_link=self.folder / "ft",
            distance_mount=1.0,
            **changes,
        )


def test_all_four_links_live_and_the_truth_is_kept(tmp_path: Path) -> None:
    async def main() -> None:
        station = Station(tmp_path)
        station.open()
        states: list[dict[str, Any]] = []
        config = station.config(wait_answered=3, truth=tmp_path / "truth.npz")
        emulator = Emulator(config, states.append)
        running = asyncio.create_task(emulator.run())
        result = await running
        await station.close()

        assert [state["event"] for state in states[:1] + states[-1:]] == ["ready", "end"]
        assert any(state["event"] == "state" for state in states)
        facts = result.facts
        assert facts["reason"] == "duration"
        assert facts["telegrams"]["sent"] == 75
        assert facts["telegrams"]["refused"] == 0
        assert facts["telegrams"]["answered"] >= 60
        assert facts["turnaround_us"]["p50"] > 0
        assert facts["limits"]["violations"] == 0
        assert facts["contact"] == "free"
        assert station.distances
        assert station.poses
        assert station.wrenches
        assert station.can.counters["refused"] == 0
        assert station.force_torque.counters["bad_crc"] == 0
        assert station.camera.counters["refused"] == 0

        columns, saved = load(tmp_path / "truth.npz")
        assert saved == facts
        assert len(columns["t"]) == 75
        np.testing.assert_allclose(columns["t"], -0.4 + 0.012 * np.arange(75), atol=1e-9)
        np.testing.assert_array_equal(np.diff(columns["ipoc"]), 12)
        assert columns["answered"].sum() == facts["telegrams"]["answered"]
        np.testing.assert_allclose(columns["setpoints"], columns["setpoints"][:1].repeat(75, 0))

    run(main(), 60.0)


def test_readings_arrive_when_the_world_says(tmp_path: Path) -> None:
    """A reading put on the unit's true path at its stamp is as old as the sensor's delay."""

    async def main() -> None:
        station = Station(tmp_path)
        station.open()
        exact = DistanceSensor(sigma=0.0, quantisation=0.0, outlier_rate=0.0, delay_s=0.002)
        scenario = replace(_scenario(), distance=exact)
        emulator = Emulator(station.config(scenario=scenario, wait_answered=3))
        cycles: list[tuple[int, float]] = []
        begin = emulator.begin_cycle

        def note(at_ns: int) -> None:
            if not emulator._waiting:
                cycles.append((at_ns, emulator.world.time_s))
            begin(at_ns)

        emulator.begin_cycle = note  # type: ignore[method-assign]
        await emulator.run()
        await station.close()
        ages = []
        for sample in station.distances:
            at_ns, at_s = max(pair for pair in cycles if pair[0] <= sample.stamp_ns)
            arrived_s = at_s + (sample.stamp_ns - at_ns) * 1e-9
            seen = emulator.world.unit_position(arrived_s) - (sample.position - 1.0)
            ages.append(seen / emulator.world.unit_speed(arrived_s))
        assert len(ages) > 20
        # Never early but for the frame's 0.1 mm; a busy host makes some late, but not all.
        assert 0.001 < min(ages) < 0.005

    run(main(), 60.0)


def test_the_world_stands_still_until_somebody_answers(tmp_path: Path) -> None:
    async def main() -> None:
        station = Station(tmp_path)
        station.open()
        config = station.config(wait_answered=3)
        silent = replace(config, robot_target=("127.0.0.1", 9))
        stop = asyncio.Event()
        states: list[dict[str, Any]] = []
        emulator = Emulator(silent, states.append)
        running = asyncio.create_task(emulator.run(stop))
        await until(lambda: sum(state["event"] == "state" for state in states) >= 2)
        stop.set()
        result = await running
        await station.close()
        assert result.facts["reason"] == "stopped"
        assert result.facts["time_s"] == -0.4
        assert result.facts["delay"] == 0
        assert len(result.truth) == 0

    run(main(), 60.0)


def test_without_answers_the_controller_breaks_off_and_sends_no_more(tmp_path: Path) -> None:
    async def main() -> None:
        station = Station(tmp_path)
        station.open()
        config = station.config()
        config = replace(
            config, robot_target=("127.0.0.1", 9), controller=replace(config.controller, timeout=5)
        )
        result = await Emulator(config).run()
        await station.close()
        assert "KSS29002" in result.facts["broken"]
        assert result.facts["telegrams"]["sent"] == 6
        assert len(result.truth) == 75
        assert not result.truth.columns()["answered"].any()

    run(main(), 60.0)


def test_a_lost_run_still_closes_every_port(tmp_path: Path) -> None:
    async def main() -> None:
        station = Station(tmp_path)
        station.open()
        emulator = Emulator(station.config())
        running = asyncio.create_task(emulator.run())
        await until(lambda: len(emulator.truth) > 3)
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
        await station.close()
        assert emulator.link.address is None
        assert not (tmp_path / "can").is_symlink()
        assert not (tmp_path / "ft").is_symlink()

    run(main(), 60.0)


def test_faults_of_a_scenario_hit_their_link_and_leave_the_others_alone(tmp_path: Path) -> None:
    faults = (
        Fault(0.2, "camera", "garbage", count=5),
        Fault(0.2, "robot", "garbage", count=2),
        Fault(0.3, "distance", "unplug", duration_s=0.2),
        Fault(0.3, "force_torque", "unplug", duration_s=0.2),
        Fault(0.4, "camera", "silence", duration_s=0.3),
        Fault(0.4, "robot", "deafness", duration_s=0.048),
    )

    async def main() -> None:
        station = Station(tmp_path)
        station.open()
        scenario = replace(_scenario(0.3, 2.0), faults=faults)
        lived: dict[str, tuple[int, int]] = {}

        def note(state: dict[str, Any]) -> None:
            if state["event"] == "end":  # before the emulator's own end unplugs both again
                for link in (station.can, station.force_torque):
                    counters = link.counters
                    lived[link.status.name] = (counters["opened"], counters["lost"])

        emulator = Emulator(station.config(scenario=scenario, wait_answered=3), note)
        result = await emulator.run()
        await station.close()
        facts = result.facts
        assert facts["broken"] is None
        assert station.camera.counters["refused"] == 5
        robot = station.robot.counters
        assert robot["unanswered"] + robot["stale"] >= 2
        assert result.facts["telegrams"]["refused"] == 0
        assert lived == {"distance": (2, 1), "force_torque": (2, 1)}
        assert facts["silenced"] == {"camera": 12}
        held = result.truth.columns()
        deaf = (held["t"] >= 0.4) & (held["t"] < 0.4 + 0.047)
        assert not held["answered"][deaf].any()

    run(main(), 60.0)
