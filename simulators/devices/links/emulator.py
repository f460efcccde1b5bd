"""All devices of a station and the plant behind them, in real time, in one process.

Invariants:
    Cycle k begins at scenario time -lead_in + k T0.
    Sensors emit at their own instants between cycles.
    The log has the plant's and the controller's side only.
"""

import asyncio
import gc
import json
import os
import random
import signal
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from queue import SimpleQueue
from threading import Thread
from typing import Any, TextIO, cast

from linemate.protocol.sensors.distance import DistanceEncoder
from linemate.simulators.devices.emulated_world import CollisionRecord, ImpactRecord
from linemate.simulators.devices.faults import GARBAGE_BYTES, REAL, Faults
from linemate.simulators.devices.line.car_feeder import CarFeeder
from linemate.simulators.devices.links.camera_sender_udp import CameraUdp
from linemate.simulators.devices.links.controller_udp import ControllerUdp
from linemate.simulators.devices.links.controllers import build_controller
from linemate.simulators.devices.links.emulator_config import SHIPPED_RSI, EmulatorConfig
from linemate.simulators.devices.links.pty_port import PtyPort
from linemate.simulators.devices.links.serial_pty import SerialPty
from linemate.simulators.devices.links.slcan_pty import SlcanPty
from linemate.simulators.devices.links.tcp_port import TcpPort
from linemate.simulators.devices.robot_plant import RobotPlant
from linemate.simulators.devices.rsi_controller import Applied
from linemate.simulators.devices.schedule import DeviceSchedule
from linemate.simulators.devices.sensing.camera_sender import CameraSender
from linemate.simulators.devices.sensing.can_sensor import CanSensor
from linemate.simulators.devices.sensing.force_torque import ForceTorqueSensor
from linemate.simulators.devices.truth import TruthLog
from linemate.simulators.devices.worlds import build_world
from linemate.simulators.plants.scenario import Scenario

NEWEST = 500
SPARE_ROWS = 100
MAX_ROWS = 200_000
_BEFORE_S = 1e-6
_QUIET = 0.6
"""Time before the next telegram at which the state is reported [cycles]."""

SWITCH_S = 0.0005
"""So long may the thread that writes states keep the loop from the interpreter [s]."""

__all__ = ["SHIPPED_RSI", "Emulator", "EmulatorConfig", "EmulatorResult", "OnState", "serve"]

OnState = Callable[[dict[str, Any]], None]


@dataclass(frozen=True, slots=True)
class EmulatorResult:
    """What a run leaves behind.

    Attributes:
        facts: of the run as a whole: counters, limits, collision, why it ended.
        truth: a row a telegram.
    """

    facts: dict[str, Any]
    truth: TruthLog


class Emulator:
    """The devices and their world.

    Attributes:
        config: how they are set up.
        link: the controller on its socket.
        can: the distance sensor behind its adapter.
        force_torque: the sensor on its line.
    """

    def __init__(self, config: EmulatorConfig, on_state: OnState | None = None) -> None:
        """Set everything up; no port is opened yet.

        Args:
            on_state: called when it is ready, with its progress, and at its end.

        Raises:
            OSError: a file that cannot be read.
            ProtocolError: a configuration that makes no telegram or no message.
            ValueError: a scenario or controller that makes no sense.
        """
        self.config = config
        self._feeder = None if config.line is None else CarFeeder(config.scenario, config.line)
        self.world = (
            build_world(config.world, config.scenario, config.mujoco)
            if self._feeder is None
            else self._feeder.line
        )
        self.truth = TruthLog(_rows(config.scenario))
        self._plant = RobotPlant(self.world)
        controller, target = build_controller(config, self._plant)
        self._schedule = DeviceSchedule()
        self._faults = Faults(config.scenario.faults, REAL)
        self._junk = random.Random(config.scenario.seed)  # noqa: S311 - noise, not a secret
        self.link = ControllerUdp(controller, self, self._schedule, target, config.robot_bind)
        encoder = DistanceEncoder(config.dbc, config.dbc_message, config.dbc_signal)
        self.can = SlcanPty(
            CanSensor(encoder, config.distance_mount), config.can_link, config.can_bind
        )
        self.force_torque = SerialPty(
            ForceTorqueSensor(config.force_torque_device), config.serial_link, config.serial_bind
        )
        self.camera = CameraUdp(
            CameraSender(
                config.camera_source,
                config.camera_frame,
                config.camera_object,
                round(config.camera_clock_offset_s * 1e9),
            ),
            config.camera_target,
        )
        self._robot_target = target
        self._on_state = on_state
        self._waiting = config.wait_answered > 0
        self._row = 0
        self._cycle_s = config.scenario.cycle_s
        self._look_ahead_s = self.world.look_ahead_s
        self._begun_ns = 0
        self._origin_ns = 0
        self._begun_s = self.world.time_s
        self._reported_s = -1e9
        self._waits = 0
        self._silenced: Counter[str] = Counter()
        self._ended: asyncio.Future[str] | None = None

    async def run(self, stop: asyncio.Event | None = None) -> EmulatorResult:
        """Open all ports, run to the end, close all ports.

        Args:
            stop: ends the run early when set.

        Returns:
            What happened.

        Raises:
            OSError: a port that cannot be opened.
        """
        self._ended = asyncio.get_running_loop().create_future()
        self._schedule.on_error = self._failed
        reason = "cancelled"
        try:
            self._open()
            self._report(self.ready())
            reason = await self._end(self._ended, stop)
        finally:
            self._close()
            facts = self.facts(reason)
            if self.config.truth is not None and self._feeder is None:
                self.truth.save(self.config.truth, facts)
            self._report({"event": "end", **facts})
        return EmulatorResult(facts, self.truth)

    def begin_cycle(self, at_ns: int) -> None:
        """A telegram has gone out: its row begins, the sensors' near future is laid out.

        Args:
            at_ns: the instant at which the cycle began [ns].
        """
        if self._waiting:
            self._report_sometimes(self._waits * self._cycle_s)
            self._waits += 1
            return
        self._begun_ns, self._begun_s = at_ns, self.world.time_s
        if not self._origin_ns:
            lead_in_s = 0.0 if self._feeder is not None else self.config.scenario.lead_in_s
            self._origin_ns = at_ns - round(lead_in_s * 1e9)
        if self._feeder is None:
            self.truth.begin(self.world, self._plant.axes)
        # No axis moves on this cycle's setpoints before the shortest dead time has passed: the
        # world goes ahead now, so that the next telegram finds it there.
        if self._look_ahead_s >= self._cycle_s:
            self.world.advance(self.world.cycle_start(self._plant.cycle + 1))
            self._lay_out()
        elif self._look_ahead_s > _BEFORE_S:
            self.world.advance(self._begun_s + self._look_ahead_s - _BEFORE_S)
            self._lay_out()
        self._report_sometimes(self._begun_s)

    def end_cycle(self, applied: Applied, turnaround_ns: int | None) -> None:
        """Advance the world to the next cycle, after the reply is judged.

        Args:
            applied: what the controller applies during it.
            turnaround_ns: how long its good reply took [ns], None without one.
        """
        if self._waiting:
            # A miss takes back a part: a host with a hiccup a second would never have all in a row.
            taken_back = self._row - self.config.wait_answered // 8
            self._row = self._row + 1 if applied.answered else max(0, taken_back)
            if self._row >= self.config.wait_answered:
                self._waiting = False
                self._reported_s = -1e9  # the wait was reported in its own time
                self._suffer(self.world.time_s)
                self.link.begin_counting()
            return
        if self._feeder is None:
            self.truth.end(applied, turnaround_ns)
        self._plant.apply(applied)
        self._feed(applied.motion or applied.setpoints)
        self._lay_out()
        self._suffer(self.world.time_s)
        self._look_for_end()

    def _feed(self, setpoints: tuple[float, ...]) -> None:
        """Let the next car enter if it is due, and report it."""
        feeder = self._feeder
        event = None if feeder is None else feeder.next_event(setpoints, self._plant.cycle)
        if event is None:
            return
        left, entered = event.left, event.entered
        self._report(
            {
                "event": "car",
                "part": None if entered is None else entered.part,
                "variant": None if entered is None else entered.variant,
                "distance": event.reading + self.config.distance_mount,
                "left": None if left is None else {"part": left[0].part, **asdict(left[1])},
            }
        )

    def ready(self) -> dict[str, Any]:
        """Where everything is to be found."""
        return {
            "event": "ready",
            "version": 1,
            "pid": os.getpid(),
            "robot": {"source": self.link.address, "target": self._robot_target},
            "camera": {"target": self.config.camera_target},
            "can": {"interface": "slcan", "channel": _address_of(self.can.port)},
            "force_torque": {
                "url": _address_of(self.force_torque.port),
                "device": self.config.force_torque_device,
            },
        }

    def state(self) -> dict[str, Any]:
        """How it goes."""
        world = self.world
        away = world.tcp_pose()[:3, 3] - world.hub_pose()[:3, 3]
        return {
            "event": "state",
            "time_s": world.time_s,
            "waiting": self._waiting,
            "contact": world.contact,
            "unit_position": world.unit_position(),
            "unit_speed": world.unit_speed(),
            "tcp_to_hub": [float(value) for value in away],
            "digital_in": world.digital_in(),
            "telegrams": self._telegrams(),
            "tolerated": self.link.controller.config.total_tolerated,
            "delay": self.link.controller.delay,
            "broken": self.link.controller.broken,
            "turnaround_us": self.link.turnaround.summary_us(NEWEST),
            "violations": self.link.controller.judge.violations_so_far,
            "collision": None if world.collision is None else world.collision.reason,
            "slips": self.link.pace.slips,
        }

    def facts(self, reason: str) -> dict[str, Any]:
        """The run as a whole."""
        controller, world, scenario = self.link.controller, self.world, self.config.scenario
        judge = controller.judge
        return {
            "version": 1,
            "reason": reason,
            "scenario": scenario.name,
            "seed": scenario.seed,
            "cycle_s": scenario.cycle_s,
            "time_s": world.time_s,
            "telegrams": self._telegrams(),
            "refusals": dict(controller.refusals),
            "delay": controller.delay,
            "broken": controller.broken,
            "tolerated": controller.config.total_tolerated,
            "clamped": controller.clamped,
            "messages": list(controller.messages),
            "turnaround_us": self.link.turnaround.summary_us(),
            "pace": asdict(self.link.pace),
            "limits": {
                "violations": judge.violations,
                "kinds": dict(judge.counts),
                "worst": dict(judge.worst),
                "evidence": [asdict(violation) for violation in judge.evidence],
            },
            "impact": _plain(world.impact),
            "collision": _plain(world.collision),
            "screws_fixed_s": world.screws_fixed_s,
            "released_s": world.released_s,
            "contact": world.contact,
            "rows_dropped": self.truth.dropped,
            "silenced": dict(self._silenced),
            "links": {
                "can": self.can.counters(),
                "camera": self.camera.counters(),
                "force_torque": self.force_torque.counters(),
            },
        }

    def _open(self) -> None:
        self._schedule.open()
        self.can.open()
        self.force_torque.open()
        self.camera.open()
        self.link.open()
        if not self._waiting:
            self._suffer(self.world.time_s)

    def _close(self) -> None:
        self.link.close()
        self.camera.close()
        self.force_torque.close()
        self.can.close()
        self._schedule.close()

    @staticmethod
    async def _end(ended: "asyncio.Future[str]", stop: asyncio.Event | None) -> str:
        if stop is None:
            return await ended
        stopping = asyncio.create_task(stop.wait())
        stopping.add_done_callback(lambda _: None if ended.done() else ended.set_result("stopped"))
        try:
            return await ended
        finally:
            stopping.cancel()

    def _failed(self, error: Exception) -> None:
        if self._ended is not None and not self._ended.done():
            self._ended.set_exception(error)

    def _suffer(self, now_s: float) -> None:
        """Let faults take hold, let go and strike, before a telegram goes out."""
        self.link.is_mute = self._faults.in_force("robot", "silence", now_s) is not None
        self.link.loses_replies = self._faults.in_force("robot", "deafness", now_s) is not None
        for fault in self._faults.strike(now_s):
            if fault.kind == "garbage":
                for _ in range(fault.count):
                    self._send_raw(
                        fault.link, self._junk.randbytes(int(fault.value) or GARBAGE_BYTES)
                    )
            else:
                device = self.can if fault.link == "distance" else self.force_torque
                device.close()
                self._at(fault.at_s + fault.duration_s, device.open)

    def _send_raw(self, link: str, data: bytes) -> None:
        match link:
            case "robot":
                self.link.send_raw(data)
            case "camera":
                self.camera.send_raw(data)
            case "distance":
                self.can.port.write(data)
            case _:
                self.force_torque.port.write(data)

    def _lay_out(self) -> None:
        """Put what the sensors emit in this cycle on the schedule."""
        world = self.world
        for distance in world.take_distance():
            self._emit(
                "distance",
                distance.time_s,
                partial(self.can.emit, distance.position, distance.strength),
            )
        for wrench in world.take_wrench():
            # A device's clock goes on while this process and its world are stalled:
            # dates that stood with it would be early for as long as an offset is remembered.
            device_us = (self._instant(wrench.exposure_s) - self._origin_ns) // 1000
            self._emit(
                "force_torque",
                wrench.time_s,
                partial(self.force_torque.emit, wrench.force, wrench.torque, device_us),
            )
        for pose in world.take_camera():
            seen_ns = self._instant(pose.exposure_s)
            self._emit(
                "camera",
                pose.time_s,
                partial(self.camera.emit, pose.position, pose.quaternion, pose.covariance, seen_ns),
            )

    def _emit(self, link: str, time_s: float, action: Callable[[], None]) -> None:
        if self._faults.in_force(link, "silence", time_s) is not None:
            self._silenced[link] += 1
            return
        delay = self._faults.in_force(link, "delay", time_s)
        self._at(time_s if delay is None else time_s + delay.value, action)

    def _at(self, time_s: float, action: Callable[[], None]) -> None:
        self._schedule.at(self._instant(time_s), action)

    def _instant(self, time_s: float) -> int:
        """The monotonic instant of a scenario time [ns]."""
        return self._begun_ns + round((time_s - self._begun_s) * 1e9)

    def _look_for_end(self) -> None:
        now_s, config = self.world.time_s, self.config
        if self._feeder is not None:
            if self._feeder.is_over:
                self._end_with(self._feeder.complaint or "the last car has left")
            return
        hit = self.world.collision
        hit_s = None if hit is None else hit.time_s
        if now_s >= config.scenario.duration_s:
            self._end_with("duration")
        elif _passed(now_s, hit_s, config.end_after_collision_s):
            self._end_with("collision")
        elif _passed(now_s, self.world.released_s, config.end_after_release_s):
            self._end_with("released")

    def _end_with(self, reason: str) -> None:
        self.link.stop()
        if self._ended is not None and not self._ended.done():
            self._ended.set_result(reason)

    def _telegrams(self) -> dict[str, int]:
        return asdict(self.link.controller.counts)

    def _report_sometimes(self, now_s: float) -> None:
        if self._on_state is not None and now_s - self._reported_s >= self.config.state_period_s:
            self._reported_s = now_s
            # In the cycle's quiet hours: its reply is in, and most of its readings are out.
            quiet_ns = self.link.due_ns - round(_QUIET * self._cycle_s * 1e9)
            self._schedule.at(quiet_ns, lambda: self._report(self.state()))

    def _report(self, state: dict[str, Any]) -> None:
        if self._on_state is not None:
            self._on_state(state)


def serve(config: EmulatorConfig, out: TextIO = sys.stdout, priority: int = 0) -> EmulatorResult:
    """The body of an emulator process: a JSON line for each state; SIGTERM and SIGINT end it.

    Args:
        priority: of SCHED_FIFO, where the host grants it; 0 leaves the scheduler alone.

    Returns:
        What happened.
    """
    lines: SimpleQueue[str | None] = SimpleQueue()

    def write() -> None:
        # A disk or a reader that is slow may hold up this thread, and not the telegrams.
        with suppress(OSError, ValueError):
            while (line := lines.get()) is not None:
                print(line, file=out, flush=True)

    writer = Thread(target=write, name="states", daemon=True)

    async def body() -> EmulatorResult:
        stop = asyncio.Event()
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, stop.set)
        emulator = Emulator(config, lambda state: lines.put(json.dumps(state)))
        if priority > 0:
            with suppress(OSError):  # without the right to it, telegrams go out less evenly
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        # After that, for it inherits the priority: a thread of the ordinary class that is pushed
        # aside while it holds the interpreter would hold up the telegrams as well.
        writer.start()
        sys.setswitchinterval(SWITCH_S)
        gc.collect()
        gc.freeze()
        gc.disable()  # a collection in motion would be a late telegram
        return await emulator.run(stop)

    try:
        return asyncio.run(body())
    finally:
        lines.put(None)
        if writer.ident is not None:
            writer.join()


def _plain(event: ImpactRecord | CollisionRecord | None) -> dict[str, Any] | None:
    """Return an event of a world, a dataclass of that world's own, as plain values."""
    return None if event is None else asdict(cast("Any", event))


def _rows(scenario: Scenario) -> int:
    cycles = (scenario.lead_in_s + scenario.duration_s) / scenario.cycle_s
    return min(round(cycles) + SPARE_ROWS, MAX_ROWS)


def _address_of(port: PtyPort | TcpPort) -> str:
    return port.path if port.link is None else str(port.link)


def _passed(now_s: float, since_s: float | None, wait_s: float | None) -> bool:
    return since_s is not None and wait_s is not None and now_s >= since_s + wait_s
