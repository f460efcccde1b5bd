"""Run a shift in virtual time: the whole service, one robot, car after car.

Invariants:
- No socket and no clock.
- The daemon gets telegrams, samples, and requests of the command protocol, and nothing else.
- What became of a car is judged by its world's truth; what was reported, by the record files.
"""

import asyncio
import contextlib
import json
import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from linemate.daemon.config.config import LoadedConfig
from linemate.daemon.config.settings import CommandSettings, RealtimeSettings
from linemate.daemon.config.task_file import Task
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.service.app import App
from linemate.daemon.service.host import realtime
from linemate.daemon.service.host.notify import Notifier
from linemate.drivers.datagrams import Address
from linemate.simulators.devices.faults import Faults
from linemate.simulators.devices.line.car_feeder import CarFeeder
from linemate.simulators.devices.line.cars import Car, CarFault, CarTruth, LinePlan
from linemate.simulators.devices.links import robot_program
from linemate.simulators.devices.robot_plant import RobotPlant
from linemate.simulators.harness import cell_links, host
from linemate.simulators.harness.cell import cell_truth
from linemate.simulators.harness.line.line_station import LineStation
from linemate.simulators.harness.lockstep import parameters
from linemate.simulators.harness.sensor_links import Emitters
from linemate.simulators.harness.virtual.inhabited import inhabited
from linemate.simulators.harness.virtual.virtual_loop import VirtualLoop
from linemate.simulators.harness.virtual.virtual_time import EPOCH_NS, VirtualTime
from linemate.simulators.harness.virtual.virtual_wires import (
    CAMERA_PORT,
    RSI_PORT,
    TRANSIT_NS,
    VirtualWires,
)
from linemate.simulators.lab.faults.dst_oracles import weigh
from linemate.simulators.lab.shift.line_controller import LineController

LISTENING_NS = 300_000_000  # the daemon listens so long before the robot's program starts [ns]
AHEAD_S = 1e-6
FIRST_CAR_S = 2.0  # from the beginning to the first car [s]
PAUSE_S = 0.5  # from the end of a robot program to its restart [s]
LAST_CAR_S = 45.0  # from the last car's entry to the end of the shift [s]

LOOPBACK = "127.0.0.1"
ROBOT: Address = (LOOPBACK, 50_001)


@dataclass(frozen=True, slots=True)
class ShiftOutcome:
    """What became of a shift.

    Attributes:
        cars: that entered, in their order.
        planned: number of cars of the plan.
        records: quality records in their order.
        growth: bytes that the cycle remembers after the first car and at the end.
        resident: memory of the whole process after the first car and at the end [bytes].
        files: bytes of the record files.
        requests: of the line's controller, by operation.
    """

    cars: tuple[Car, ...]
    truths: tuple[CarTruth, ...]
    records: tuple[dict[str, Any], ...]
    growth: tuple[int, int]
    resident: tuple[int, int]
    files: int
    duration_s: float
    requests: dict[str, int]
    complaints: tuple[str, ...]
    planned: int


def _virtual(station: LineStation, records: Path) -> LoadedConfig:
    """Return a daemon's configuration with links in memory, and nothing else changed."""
    files = station.files
    config = files.config
    assert config.distance is not None  # noqa: S101 - ``cell_links.of`` refuses it
    assert config.camera is not None  # noqa: S101 - ``cell_links.of`` refuses it
    wrench, (robot, robot_port) = config.force_torque, ROBOT
    linked = replace(
        config,
        rsi=replace(config.rsi, port=RSI_PORT, bind=LOOPBACK, peer=None),
        egm=replace(config.egm, port=RSI_PORT, bind=LOOPBACK, peer=None),
        fanuc=replace(config.fanuc, port=RSI_PORT, bind=LOOPBACK, peer=robot, peer_port=robot_port),
        distance=replace(config.distance, can={"interface": "virtual"}),
        camera=replace(config.camera, port=CAMERA_PORT, bind=LOOPBACK, peer=None),
        force_torque=None if wrench is None else replace(wrench, url="virtual"),
        command=CommandSettings(),
        recording=None,
        realtime=RealtimeSettings(freeze_collector=False),
        production=replace(station.production, records=str(records)),
    )
    return replace(files, config=linked, keys=(), state=None)


def _compiled(files: LoadedConfig, task: Task) -> Parameters:
    """Return the parameters of a variant's task, compiled once a process."""
    tracking, control = files.config.tracking, files.config.control
    return parameters(task.file, task.urdf, tracking, control, files.cycle_s)


class ShiftRun:
    """One shift that runs."""

    def __init__(
        self,
        station: LineStation,
        cars: Sequence[Car],
        takt_s: float,
        folder: Path,
        on_car: Callable[[Car, CarTruth], None] = lambda _car, _truth: None,
        longest_s: float = math.inf,
        plc: LineController | None = None,
    ) -> None:
        """Begin before the first cycle.

        Args:
            takt_s: from one car to the next at least [s].
            folder: for the record files.
            on_car: called with each car that has left.
            longest_s: time of the host after which no further car enters [s].
            plc: the line's controller; None: one that speaks the command protocol.
        """
        ends = cell_links.of(station.files)
        files = self._station = _virtual(station, folder)
        hubs, entry_s = station.hubs, station.entry_s
        line_plan = LinePlan(tuple(cars), hubs, takt_s, entry_s, FIRST_CAR_S, LAST_CAR_S)
        self._feeder = CarFeeder(station.scenario, line_plan)
        self.line = self._feeder.line
        self.plant = RobotPlant(self.line)
        limits = cell_truth.axis_limits(files.task.urdf, files.task.file)
        self.controller = cell_links.controller(
            files, self.plant.read, self.plant.start, files.cycle_s, limits, timeout_rule="row"
        )
        self._sent: tuple[float, ...] = self.plant.start
        mount = files.task.file.conveyor.start_position
        self._emitters = Emitters(
            self.line, Faults(()), mount, _ns, ends.encoder, ends.device, ends.sender
        )
        self.plc = LineController() if plc is None else plc
        self._planned, self._last_entry_s = len(cars), time.monotonic() + longest_s
        self._folder, self._on_car = folder, on_car
        self._truths: list[CarTruth] = []
        self._cycle = 0
        self._is_open = False
        self._paused_until_s: float | None = None
        self._has_restarted = False
        self._growth = [0, 0]
        self._resident = [0, 0]
        self._complaints: list[str] = []
        self._time = VirtualTime(EPOCH_NS - LISTENING_NS)
        self._time.on_datagram = self._replied
        self._wires = VirtualWires(self._time, self._emitters)
        self.app: App | None = None

    def run(self) -> ShiftOutcome:
        """Run it to its end."""
        with inhabited(self._time):
            loop = VirtualLoop(self._time)
            try:
                self._time.at(EPOCH_NS, self._begin_cycle)
                loop.run_until_complete(self._main())
            finally:
                loop.close()
        files = sorted(self._folder.iterdir())
        records = [
            json.loads(line)
            for path in files
            if path.suffix == ".jsonl"
            for line in path.read_text().splitlines()
        ]
        return ShiftOutcome(
            self._feeder.cars,
            tuple(self._truths),
            tuple(records),
            (self._growth[0], self._growth[1]),
            (self._resident[0], self._resident[1]),
            sum(path.stat().st_size for path in files),
            self.line.time_s,
            dict(self.plc.orders),
            tuple(self._complaints),
            self._planned,
        )

    async def _main(self) -> None:
        self._over = asyncio.Event()
        files = self._station
        variants = {name: _compiled(files, task) for name, task in files.variants.items()}
        app = App(
            files, _compiled(files, files.task), realtime.RealtimeHost(), Notifier(), variants
        )
        self.app = app
        process = asyncio.get_running_loop().create_task(app.run())
        await self._over.wait()
        if process.done():
            process.result()
        if app.counters["faults"]:
            self._complaints.append(f"{app.counters['faults']} faults in the cycle")
        process.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await process

    @property
    def now_s(self) -> float:
        """Time at which the open cycle began [s]."""
        return self.line.cycle_start(self._cycle)

    def _begin_cycle(self) -> None:
        """Close a cycle of the controller and open the next one."""
        if self._is_open:
            self._close_cycle()
        if self._over.is_set():
            return
        self._bring_cars()
        app = self.app
        if app is not None:
            self.plc.poll(app, self.now_s, self._time.host_ns)
        self._restart_robot()
        self._exchange()
        self._is_open = True
        self._time.at(_ns(self.line.cycle_start(self._cycle + 1)), self._begin_cycle)

    def _close_cycle(self) -> None:
        if self._paused_until_s is None:
            applied = self.controller.end_of_cycle()
            self.plant.apply(applied)
            self._sent = applied.motion or applied.setpoints
        else:
            self.line.command(self._sent)
            self.plant.cycle += 1
            self.line.advance(self.line.cycle_start(self.plant.cycle))
        self._cycle += 1
        self._judge()

    def _judge(self) -> None:
        """End the shift if the controller has broken the exchange off."""
        if self.controller.broken is not None and not self._complaints:
            self._complaints.append(self.controller.broken)
            self._over.set()

    def _bring_cars(self) -> None:
        """Let the next car enter once it is due and the robot stands."""
        if time.monotonic() > self._last_entry_s:
            self._feeder.close()
        event = self._feeder.next_event(self._sent, self._cycle)
        if self._feeder.complaint is not None:
            self._complaints.append(self._feeder.complaint)
        if self._feeder.is_over:
            self._over.set()
        if event is None:
            return
        if event.left is not None:
            self._end_car(*event.left)
        car = event.entered
        self._has_restarted = False
        if self.app is not None and car is not None:
            mount = self._station.task.file.conveyor.start_position
            reading = event.reading + mount
            self.plc.announce(self.app, car.part, car.variant, reading, self._time.host_ns)

    def _end_car(self, car: Car, truth: CarTruth) -> None:
        """Note what became of a car."""
        self._truths.append(truth)
        self._on_car(car, truth)
        if self.app is not None:
            size = weigh(self.app.cycle) + weigh(self.app._production)  # noqa: SLF001
            self._growth = [self._growth[0] or size, size]
            resident = host.resident_bytes()
            self._resident = [self._resident[0] or resident, resident]

    def _restart_robot(self) -> None:
        """End the robot's program and start it again where it stands, if that is the fault."""
        now_s = self.now_s
        if self._paused_until_s is not None and now_s >= self._paused_until_s:
            self._paused_until_s = None
            self.controller.restart()
        is_due = self.line.car.fault is CarFault.ROBOT_RESTARTED and self.line.is_faulty_now
        if is_due and not self._has_restarted:
            self._has_restarted = True
            self._paused_until_s = now_s + PAUSE_S

    def _exchange(self) -> None:
        """Send the telegram, and let the sensors see the cycle."""
        is_running = self._paused_until_s is None
        robot_program.show(self.controller, is_running=is_running, has_drives=True)
        if is_running:
            data = self.controller.telegram()
        else:
            data = robot_program.paused_telegram(self.controller)
        if data is not None:
            self._wires.send(_ns(self.now_s) + TRANSIT_NS, data, ROBOT, RSI_PORT)
        self.line.advance(self.line.cycle_start(self._cycle + 1) - AHEAD_S)
        for at_s, link, piece in self._emitters.collect():
            self._wires.send_sensor(_ns(at_s), link, piece)

    def _replied(self, data: bytes, _source: Address, target: Address) -> None:
        if target == ROBOT:
            at_ns = self._time.now_ns + TRANSIT_NS
            self._time.at(at_ns, partial(self._on_reply, data))

    def _on_reply(self, data: bytes) -> None:
        self.controller.on_reply(data, self._time.now_ns)
        for answer in robot_program.answers(self.controller):
            self._wires.send(self._time.now_ns + TRANSIT_NS, answer, ROBOT, RSI_PORT)


def run(
    station: LineStation,
    cars: Sequence[Car],
    takt_s: float,
    folder: Path | None = None,
    on_car: Callable[[Car, CarTruth], None] = lambda _car, _truth: None,
    longest_s: float = math.inf,
    plc: LineController | None = None,
) -> ShiftOutcome:
    """Run a shift.

    Args:
        takt_s: from one car to the next at least [s].
        folder: for the record files; None: a temporary one.
        on_car: called with each car that has left.
        longest_s: time of the host after which no further car enters [s].
        plc: the line's controller; None: one that speaks the command protocol.
    """
    if folder is not None:
        return ShiftRun(station, cars, takt_s, folder, on_car, longest_s, plc).run()
    with tempfile.TemporaryDirectory(prefix="linemate-") as name:
        return ShiftRun(station, cars, takt_s, Path(name), on_car, longest_s, plc).run()


def _ns(time_s: float) -> int:
    return EPOCH_NS + round(time_s * 1e9)
