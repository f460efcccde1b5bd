"""Run one plan in virtual time: daemon, network, controller, robot and operator.

Invariants:
    No socket and no clock.
    Events of one instant run in the order in which they were scheduled.
    The daemon is the whole service with its drivers, on a virtual loop.
"""

import asyncio
import contextlib
import struct
import traceback
from collections import Counter
from dataclasses import dataclass
from functools import partial
from hashlib import blake2b
from pathlib import Path
from typing import Any

from linemate.daemon.cycle.states import State
from linemate.daemon.service.app import App
from linemate.daemon.service.host import realtime
from linemate.daemon.service.host.notify import Notifier
from linemate.drivers.datagrams import Address
from linemate.protocol.sensors.distance import DistanceEncoder
from linemate.simulators.devices.faults import Faults
from linemate.simulators.devices.faulty_link import FaultyLink
from linemate.simulators.devices.links import robot_program
from linemate.simulators.devices.robot_plant import RobotPlant
from linemate.simulators.devices.rsi_controller import ControllerConfig, RsiController
from linemate.simulators.harness.sensor_links import Emitters
from linemate.simulators.harness.virtual.inhabited import inhabited
from linemate.simulators.harness.virtual.virtual_loop import VirtualLoop
from linemate.simulators.harness.virtual.virtual_time import EPOCH_NS, VirtualTime
from linemate.simulators.harness.virtual.virtual_wires import RSI_PORT, TRANSIT_NS, VirtualWires
from linemate.simulators.lab.faults import dst_controllers
from linemate.simulators.lab.faults.dst_actors import Operator, Programme
from linemate.simulators.lab.faults.dst_cells import (
    CELLS,
    LEAD_IN_S,
    MOUNT_M,
    compiled,
    scenario_of,
    station,
    station_of,
)
from linemate.simulators.lab.faults.dst_controllers import StrictFamily
from linemate.simulators.lab.faults.dst_log import MOST_LINES, LogCounter
from linemate.simulators.lab.faults.dst_oracles import FaultOracle
from linemate.simulators.lab.faults.dst_plan import MOST_DRIFT, FaultPlan
from linemate.simulators.lab.faults.dst_plant_oracles import (
    RESTING_UNANSWERED_S,
    UNANSWERED_S,
    PlantOracle,
    Seen,
)
from linemate.simulators.lab.faults.dst_strangers import SECOND_IPOC, Strangers
from linemate.simulators.plants.contact_plant import FIX_SCREWS
from linemate.simulators.plants.scenario import Fault
from linemate.simulators.plants.world import World

THINKING_NS = 400_000
"""From a telegram to its reply, for a daemon whose steps take no time."""
AHEAD_S = 1e-6
"""The world advances up to so long before a cycle's end while its reply is open; no axis
moves on it before its dead time is over [s]."""

TIMEOUT_S = 5.0
"""After the last fault the operator must be able to track again within this time [s]."""
LAST_TIMEOUT_S = 12.0
DRIFTS_FROM_S = -1.2
"""Scenario time from which a cycle that drifts does [s]."""
MOST_BREAKS = 3
"""Upper bounds: time that the program drives, and restarts of the exchange."""
LONGEST_S = 60.0
"""Beyond its plan no run goes on for longer, daemon or none [s]."""
UNHEARD_S = 0.6
"""After a fault of the exchange its answers are not judged for so long [s]."""
ENDING_EVERY = 8
"""One seed in so many is ended as by SIGTERM and has to come to rest."""
ENDING_S = 5.0

_SEVEN = struct.Struct("<7d")


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """What became of a plan.

    Attributes:
        violations: what the oracles found, the first ones.
        digest: of every byte that crossed the robot's wire and of all that was applied.
        states: the operating states that were seen.
        force_n: largest force between the hub and a clamped tool [N].
    """

    plan: FaultPlan
    violations: tuple[str, ...]
    digest: str
    cycles: int
    states: frozenset[str]
    force_n: float


def run(plan: FaultPlan) -> RunOutcome:
    """Live a plan through.

    Returns:
        What became of it; whatever goes wrong in the daemon is a violation.
    """
    simulation = Simulation(plan)
    simulation.live()
    return simulation.outcome()


class Simulation:
    """One plan that runs.

    Attributes:
        app: the daemon, None while there is none.
        tracked_s: when the daemon tracked last [s].
    """

    def __init__(self, plan: FaultPlan) -> None:
        """Begin at the lead-in, daemon and controller just started."""
        self.plan = plan
        scenario, files = scenario_of(plan), station(plan.cell)
        cell = CELLS[plan.cell]
        self.world = World(scenario)
        self.plant = RobotPlant(self.world)
        self.controller = dst_controllers.build(plan, self.plant.read, self.plant.start)
        self._is_rsi = isinstance(self.controller, RsiController)
        brake = files.config.control.brake
        braking = (*(brake.acceleration,) * 6, brake.axis_acceleration)
        axes = 7 if files.task.file.arm.linear_axis else 6
        self.oracle = FaultOracle(plan.real_cycle_s, braking[:axes])
        self.oracle.holds = lambda: self.controller.setpoints
        self.strict = StrictFamily(self.controller, plan, self.oracle.blame)
        self.app: App | None = None
        self.robot = Programme(self)
        self.oracle.is_driven = lambda: not self.robot.leads and self.robot.is_sent
        self.operator = Operator(self)
        self.tracked_s = float("-inf")
        self._faults = Faults(scenario.faults)
        self._emitters = Emitters(
            self.world,
            Faults(scenario.faults),
            MOUNT_M,
            _ns,
            DistanceEncoder(message=cell.message, signal=cell.signal),
            cell.force_torque,
        )
        self._there = FaultyLink("robot", self._faults, plan.seed)
        self._back = FaultyLink("reply", self._faults, plan.seed)
        self.plant_oracle = PlantOracle(
            self.world,
            self._emitters,
            plan.real_cycle_s,
            self.oracle.blame,
            plan.cycle_off,
            has_rail=files.task.file.arm.linear_axis,
            unanswered_s=UNANSWERED_S if self._is_rsi else RESTING_UNANSWERED_S,
        )
        self._ready_s = float("-inf")
        self._strangers = Strangers(
            partial(dst_controllers.second, plan, SECOND_IPOC),
            plan.cycle_s,
            ControllerConfig(plan.cycle_s).ipoc_step,
        )
        self._telegram = b""
        self._is_readable = True
        self._cycle = 0
        self._cycle_ns = round(plan.real_cycle_s * 1e9)
        self._is_over = False
        self._hash = blake2b(digest_size=16)
        self._time = VirtualTime(EPOCH_NS - LISTENING_NS)
        self._time.on_datagram = self._replied
        self._wires = VirtualWires(self._time, self._emitters)
        self._loop: VirtualLoop | None = None
        self._process: asyncio.Task[None] | None = None
        self._log = LogCounter(self._time)

    # The life of a run.

    def live(self) -> None:
        """Run the plan to its end."""
        with inhabited(self._time), self._log.listening():
            self._loop = loop = VirtualLoop(self._time)
            loop.set_exception_handler(self._unhandled)
            try:
                self._time.at(EPOCH_NS, self._begin_cycle)
                loop.run_until_complete(self._main())
            except Exception as error:  # noqa: BLE001 - an exception is the finding
                self._blame(error)
            finally:
                loop.close()
        if self._log.worst > MOST_LINES:
            self.oracle.blame(f"log: {self._log.worst} lines in a second: {self._log.example}")

    async def _main(self) -> None:
        self._over = asyncio.Event()
        self._boot()
        await self._over.wait()
        if self.app is not None and self._process is not None:
            if self.plan.seed % ENDING_EVERY == 0 and not self.oracle.violations:
                await self._end_gently(self.app, self._process)
            await self._kill()

    async def _end_gently(self, app: App, process: "asyncio.Task[None]") -> None:
        """End it as by SIGTERM: it has to come to rest first."""
        moved = app.cycle.machine.state in {State.TRACK, State.CONTACT, State.RETREAT}
        app.end()
        await asyncio.wait([process], timeout=ENDING_S)
        if not process.done():
            self.oracle.blame("end: the daemon is still there after SIGTERM")
        elif moved and app.cycle.machine.state in {State.TRACK, State.CONTACT}:
            self.oracle.blame(f"end: it ended in {app.cycle.machine.state.upper()}")

    def _boot(self) -> None:
        """Start the daemon's process."""
        assert self._loop is not None  # noqa: S101 - a run has started
        plan = self.plan
        app = App(
            station_of(plan.lead_ms, plan.cycle_ms, plan.cell),
            compiled(plan.cycle_s, plan.cell),
            realtime.RealtimeHost(),
            Notifier(),
        )
        self.app = app
        self._log.note_start()
        self.oracle.attend(app.cycle)
        self._process = self._loop.create_task(app.run())
        self._process.add_done_callback(self._ended)

    def _ended(self, process: "asyncio.Task[None]") -> None:
        if process is self._process and not process.cancelled():
            error = process.exception()
            if error is not None:
                self._blame(error)

    async def _kill(self) -> None:
        """The process is gone at once."""
        process, self._process = self._process, None
        app, self.app = self.app, None
        if process is None or app is None:
            return
        self._look_at(app)
        process.cancel()
        with contextlib.suppress(asyncio.CancelledError, Exception):
            await process

    def _crash(self, duration_s: float) -> None:
        assert self._loop is not None  # noqa: S101 - a run has started
        if self.app is None:
            return
        self._dying = self._loop.create_task(self._kill())
        self._time.at(self._time.now_ns + round(duration_s * 1e9), self._revive)

    def _revive(self) -> None:
        if not self._dying.done():
            # It was stalled when it was ended, and ends as soon as it gets the processor.
            self._dying.add_done_callback(lambda _: self._revive())
        elif self.app is None and not self._is_over:
            self._boot()

    def _blame(self, error: BaseException) -> None:
        frames = traceback.extract_tb(error.__traceback__)
        where = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "nowhere"
        self.oracle.blame(f"exception: {type(error).__name__} in {where}: {error}")

    def _unhandled(self, _loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        if error is not None:
            self._blame(error)
        else:
            self.oracle.blame(f"exception: {context.get('message')}")

    def _look_at(self, app: App) -> None:
        """Counters of the service that must stay zero."""
        counters: Counter[str] = Counter(app.counters)
        for link in app._links:  # noqa: SLF001 - what an operator sees through status
            for name in ("callback_errors", "hasty"):
                counters[name] += link.counters[name]
        for name in ("faults", "callback_errors", "hasty"):
            if counters[name]:
                self.oracle.blame(f"exception: {counters[name]} {name}: {self._log.example}")

    def outcome(self) -> RunOutcome:
        """What has become of the plan."""
        self.oracle.judge(self.controller.judge)
        self._hash.update(repr(self.oracle.story).encode())
        return RunOutcome(
            self.plan,
            tuple(self.oracle.violations),
            self._hash.hexdigest(),
            self._cycle,
            frozenset(self.oracle.states),
            self.plant_oracle.largest_n,
        )

    # The controller's cycle.

    @property
    def now_s(self) -> float:
        """Scenario time at which the open cycle began [s]."""
        return self.world.cycle_start(self._cycle)

    def _begin_cycle(self) -> None:
        """Close a cycle of the controller and open the next one."""
        if self._cycle or self.robot.is_open:
            self._hash.update(_SEVEN.pack(*self.robot.close()))
            self._cycle += 1
            self._judge_cycle()
        if self._is_over:
            self._time.at(EPOCH_NS + (self._cycle + 1) * self._cycle_ns, self._begin_cycle)
            self._exchange()
            return
        self._drift()
        for fault in self._faults.strike(self.now_s):
            self._strike(fault)
        self._stall()
        self.operator.give_order(self.now_s)
        self._exchange()
        self._time.at(EPOCH_NS + (self._cycle + 1) * self._cycle_ns, self._begin_cycle)

    def _exchange(self) -> None:
        """Send the telegram, and let the sensors see the cycle."""
        now_s = self.now_s
        data = self.robot.telegram(now_s)
        if data is not None:
            self._hash.update(data)
            self._telegram = data
            self._strangers.passed(data)
            spoilt = self._there.suffered["unreadable"]
            pieces = self._there.carry(data, now_s)
            self._is_readable = self._there.suffered["unreadable"] == spoilt
            for at_s, piece in pieces:
                self._wires.send(_ns(at_s) + TRANSIT_NS, piece, self._strangers.source, RSI_PORT)
        is_there = self._faults.in_force("robot", "second", now_s) is not None
        self._strangers.second(now_s, is_there=is_there, send=self._send_to_robot_port)
        self.world.advance(self.world.cycle_start(self._cycle + 1) - AHEAD_S)
        self._plug(now_s)
        for at_s, link, piece in self._emitters.collect():
            if link == "robot":
                self._wires.send(_ns(at_s), piece, self._strangers.source, RSI_PORT)
            else:
                self._wires.send_sensor(_ns(at_s), link, piece)

    def _judge_cycle(self) -> None:
        app, now_s = self.app, self.now_s
        machine = None if app is None else app.cycle.machine
        if app is None or self.is_stalled:
            self._ready_s = now_s
        self.oracle.now_s = now_s
        self.plant_oracle.judge_cycle(
            Seen(
                now_s=now_s,
                state=None if machine is None else machine.state,
                because="" if machine is None else machine.because,
                answered=self.robot.is_answered,
                programme=not self.robot.is_paused and self.robot.stands is None,
                busy_s=self._ready_s,
                sent=self.controller.setpoints,
                stands=self.robot.stands,
                screws=bool(self.robot.orders & FIX_SCREWS),
                is_heard=self._is_heard(now_s),
                readable=self._is_readable,
            )
        )
        if app is not None:
            self.oracle.judge_cycle(app.cycle, now_s)
            if app.cycle.machine.state in {State.TRACK, State.CONTACT}:
                self.tracked_s = self.now_s
        if not self._is_over and not self._goes_on(app):
            if app is not None:
                self.oracle.size(app.cycle)
            self._is_over = True
            self._over.set()

    def _is_heard(self, now_s: float) -> bool:
        """Return whether nothing keeps telegrams and replies from arriving."""
        return self.robot.is_sent and not any(
            fault.at_s - 0.1 <= now_s <= fault.at_s + fault.duration_s + UNHEARD_S
            for link in ("robot", "reply", "daemon")
            for fault in self._faults.of(link)
            if fault.kind not in {"unreadable", "exponent"}
        )

    def _goes_on(self, app: App | None) -> bool:
        if self.oracle.violations:
            return False
        if self.now_s > self.plan.duration_s + LONGEST_S:
            self.oracle.blame("liveness: the run does not end")
            return False
        if app is None or self.now_s < self.plan.duration_s:
            return True
        quiet_s = max(self.plan.quiet_s, self.robot.quiet_s)
        if self.tracked_s >= quiet_s:
            return False
        timeout_s = min(TIMEOUT_S + self.robot.homing_s, LAST_TIMEOUT_S)
        timeout_s += self.operator.homing_s
        if self.now_s - max(quiet_s, 0.0) > timeout_s or self.robot.breaks > MOST_BREAKS:
            machine = app.cycle.machine
            self.oracle.blame(
                f"liveness: {machine.state} ({machine.because}) {TIMEOUT_S:g} s after the last"
                f" fault; {self.operator.refusal}"
            )
            return False
        return True

    def _strike(self, fault: Fault) -> None:
        match fault.link, fault.kind:
            case "robot", "restart":
                self.robot.pause(self.now_s, fault.duration_s)
            case "robot", "drives_off":
                self.robot.brake(self.now_s, fault.duration_s)
            case "daemon", "crash":
                self._crash(fault.duration_s)
            case "robot", "ipoc_jump":
                self.controller.jump(int(fault.value) or None)
            case "robot", "readdress":
                self._strangers.readdress(fault)
            case "robot", "forged":
                self._strangers.forge(fault, self._telegram, self._send_to_robot_port)
            case "daemon", "wall_step":
                self._time.wall_step_ns += round(fault.value * 1e9)
            case "daemon", "pause":
                self._time.pause(round(fault.duration_s * 1e9))
            case "operator", "set":
                self.operator.set(fault.count)
            case "operator", order:
                self.operator.order(order, is_colleague=self.plan.operators > 1)

    def _drift(self) -> None:
        """Let the controller's cycle drift: by the daemon's clock it grows longer.

        The clock that drifts is the daemon's. Sensors drift with the controller.
        """
        if self.plan.cycle_drift:
            rate = self.plan.cycle_drift * max(self.now_s - DRIFTS_FROM_S, 0.0)
            self._time.set_rate(min(max(rate, -MOST_DRIFT), MOST_DRIFT))

    def _stall(self) -> None:
        fault = self._faults.in_force("daemon", "stall", self.now_s)
        if fault is not None:
            end_ns = _ns(fault.at_s + fault.duration_s)
            self._time.stalled_until_ns = max(self._time.stalled_until_ns, end_ns)

    @property
    def host_ns(self) -> int:
        """The monotonic clock of the daemon's machine [ns]."""
        return self._time.host_ns

    @property
    def is_stalled(self) -> bool:
        """The daemon takes no orders now."""
        return self._time.now_ns < self._time.stalled_until_ns

    # The network.

    def _send_to_robot_port(self, at_s: float, data: bytes, source: Address) -> None:
        self._wires.send(_ns(at_s), data, source, RSI_PORT)

    def _replied(self, data: bytes, source: Address, target: Address) -> None:
        """The daemon has sent a datagram."""
        del source
        self._hash.update(data)
        if self._is_rsi:
            self.oracle.reply(data)
        forged = self._strangers.moved_by(data)
        if forged is not None:
            self.oracle.blame(forged)
        if target != self._strangers.source:
            return
        if self._faults.in_force("robot", "deafness", self.now_s) is None:
            sent_s = _seconds(self._time.now_ns + THINKING_NS)
            for at_s, piece in self._back.carry(data, sent_s):
                self._time.at(_ns(at_s) + TRANSIT_NS, partial(self._on_reply, piece))

    def _on_reply(self, data: bytes) -> None:
        self.controller.on_reply(data, self._time.now_ns)
        self.strict.judge_reply(_seconds(self._time.now_ns))
        for answer in robot_program.answers(self.controller):
            self._wires.send(
                self._time.now_ns + TRANSIT_NS, answer, self._strangers.source, RSI_PORT
            )

    def _plug(self, now_s: float) -> None:
        for link in ("distance", "force_torque"):
            if self._faults.in_force(link, "unplug", now_s) is None:
                self._time.unplugged.discard(link)
            else:
                self._time.unplugged.add(link)


LISTENING_NS = 300_000_000
"""The daemon listens for so long before the controller's program starts [ns]."""


def _ns(time_s: float) -> int:
    return EPOCH_NS + round((time_s + LEAD_IN_S) * 1e9)


def _seconds(stamp_ns: int) -> float:
    return (stamp_ns - EPOCH_NS) * 1e-9 - LEAD_IN_S
