"""One plan, lived through in virtual time: daemon, network, controller, robot and operator.

Law of this file: no socket and no clock; everything happens in the order of its time, and what
happens at one time in the order in which it was ordered. The daemon is its cycle, its schedule
and its codecs, bytes in and bytes out; who judges it is ``dst_oracles``.
"""

import heapq
import struct
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from hashlib import blake2b
from pathlib import Path

from linemate.daemon.control.settings import AxisLimits, ControlSettings
from linemate.daemon.parameters import Parameters
from linemate.daemon.service import schedule as scheduling
from linemate.daemon.service import task_file
from linemate.daemon.service.cycle import Cycle
from linemate.daemon.service.schedule import Due, Schedule
from linemate.daemon.service.states import State
from linemate.daemon.service.watch import WatchSettings
from linemate.daemon.tracking.settings import MergeSettings, TrackingSettings
from linemate.protocol.rsi import RsiCodec, RsiConfig, parse_config
from linemate.simulators.devices.controller import ControllerConfig, RobotReading, RsiController
from linemate.simulators.devices.faults import KINDS, Faults
from linemate.simulators.devices.faulty_link import FaultyLink
from linemate.simulators.devices.limits import AxisLimit
from linemate.simulators.devices.robot_plant import RobotPlant, seven
from linemate.simulators.harness.dst_oracles import Oracle
from linemate.simulators.harness.dst_plan import Plan
from linemate.simulators.harness.lockstep import RSI_CONFIG, parameters
from linemate.simulators.harness.wires import EPOCH_NS, Wires
from linemate.simulators.plants.scenario import (
    Body,
    Contact,
    Conveyor,
    Fault,
    Robot,
    Scenario,
    Swing,
    Vector7,
)
from linemate.simulators.plants.world import World

TASK = Path(__file__).parent / "data" / "tasks" / "dst.yaml"
CYCLE_S = 0.012
LEAD_IN_S = 0.6

TRANSIT_NS = 60_000
"""One way on the wire."""
THINKING_NS = 400_000
"""From a telegram to its reply."""
LOOK_BACK = 4
"""Telegrams of a sender that are looked at after a stall, as the driver does."""

PATIENCE_S = 5.0
"""After the last fault the operator must be able to track again within this time [s]."""
HOMING_S = 0.5
HOMING_SPEED = 0.8
"""How the programme drives the robot to its rest pose, without RSI: for so long at least [s], an
axis at so much in the mean at most [rad/s, m/s]; it is not charged to the daemon's time."""
DITHERING_S = 0.2
"""How long the operator waits for what is held to go on before beginning anew [s]."""

SETTINGS = WatchSettings(healthy_cycles=20)
TRACKING = replace(TrackingSettings(), merge=MergeSettings(blend=0.5))
CONTROL = ControlSettings()

_SECOND = "another controller"
_FIRST = "the controller"
_SECOND_IPOC = 77_000
_SEVEN = struct.Struct("<7d")


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a plan.

    Attributes:
        plan: as it was.
        violations: what the oracles found, the first ones.
        digest: of every byte that crossed the robot's wire and of all that was applied.
        cycles: of the controller.
        states: the operating states that were seen.
    """

    plan: Plan
    violations: tuple[str, ...]
    digest: str
    cycles: int
    states: frozenset[str]


@cache
def task() -> task_file.Task:
    """The short task."""
    return task_file.load(TASK)


@cache
def rsi() -> RsiConfig:
    """The robot's wire."""
    from linemate.daemon.service.files import PROTOCOL_DATA

    return parse_config((PROTOCOL_DATA / RSI_CONFIG).read_bytes())


def compiled() -> Parameters:
    """The daemon's parameters, once a process."""
    return parameters(task().file, task().urdf, TRACKING, CONTROL, CYCLE_S)


def rest_pose() -> Vector7:
    """Where the task begins, A1..A6 [rad], E1 [m]."""
    return seven((*task().file.arm.rest_joints, 0.0))


def scenario_of(plan: Plan) -> Scenario:
    """The plant's truth: a body nearly where it should be and a tool that is quick."""
    return Scenario(
        name="dst",
        seed=plan.seed,
        cycle_s=CYCLE_S,
        lead_in_s=LEAD_IN_S,
        duration_s=plan.duration_s + 1.0,
        conveyor=Conveyor(events=plan.events),
        body=Body(offset_range=(0.01, 0.01, 0.01), tilt=0.05, swings=(Swing(amplitude_max=3e-3),)),
        robot=Robot(start=rest_pose()),
        contact=Contact(nutrunner_s=0.2, release_s=0.1),
        faults=plan.faults,
    )


def run(plan: Plan) -> Outcome:
    """Live a plan through.

    Returns:
        What became of it; whatever goes wrong in the daemon is a violation.
    """
    simulation = Simulation(plan)
    try:
        while simulation.turn():
            pass
    except Exception as error:  # noqa: BLE001 - an exception is the finding
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}:{place.lineno}"
        simulation.oracle.blame(f"exception: {type(error).__name__} in {where}: {error}")
    return simulation.outcome()


def _same(limit: AxisLimits) -> AxisLimit:
    """The daemon's own limits, for the judge: what is configured must hold exactly."""
    return AxisLimit(limit.lower, limit.upper, limit.speed, limit.acceleration, limit.jerk)


class Simulation:
    """One plan under way.

    Attributes:
        world: the plant.
        controller: its RSI.
        cycle: the daemon's; another one after a crash.
        oracle: the judge.
    """

    def __init__(self, plan: Plan) -> None:
        """Begin at the lead-in, daemon and controller just started."""
        self.plan = plan
        scenario = scenario_of(plan)
        self.world = World(scenario)
        self._plant = RobotPlant(self.world)
        self.controller = RsiController(
            rsi(),
            self._plant.read,
            self._plant.start,
            ControllerConfig(
                cycle_s=CYCLE_S,
                timeout_rule="row" if plan.rule == "row" else "total",
                limits=tuple(_same(limit) for limit in CONTROL.limits),
            ),
        )
        faults = Faults(scenario.faults, KINDS)
        brake = CONTROL.brake
        self.oracle = Oracle(CYCLE_S, (*(brake.acceleration,) * 6, brake.axis_acceleration))
        self.cycle = self._daemon()
        self.wires = Wires(
            self.world, self.cycle, Faults(scenario.faults), task().file.conveyor.start_position
        )
        self._faults = faults
        self._there = FaultyLink("robot", faults, plan.seed)
        self._back = FaultyLink("reply", faults, plan.seed)
        self._schedule = self._fresh_schedule(EPOCH_NS)
        self._answered_ns: int | None = None
        self._robot = _Robot(self)
        self._second: RsiController | None = None
        self._operator = _Operator(self)
        self._queue: list[_Event] = []
        self._ordered = 0
        self._cycle = -1
        self._down_ns = 0
        self._deaf_ns = 0
        self._hash = blake2b(digest_size=16)
        self.tracked_s = float("-inf")

    # Time.

    @property
    def now_s(self) -> float:
        """Scenario time of the open controller cycle [s]."""
        return self.world.time_s

    def turn(self) -> bool:
        """Live through one cycle of the controller.

        Returns:
            Whether the run goes on.
        """
        self._cycle += 1
        begins_ns = EPOCH_NS + self._cycle * _CYCLE_NS
        for fault in self._faults.strike(self.now_s):
            self._strike(fault)
        self._sense(begins_ns)
        self._operator.look(self.now_s)
        data = self._robot.telegram(self.now_s)
        if data is not None:
            self._hash.update(data)
            for at_s, piece in self._there.carry(data, self.now_s):
                self._post(_ns(at_s) + TRANSIT_NS, partial_telegram(piece, _FIRST))
        self._impostor(begins_ns)
        self._live_until(begins_ns + _CYCLE_NS)
        self._hash.update(_SEVEN.pack(*self._robot.close()))
        self.oracle.look(self.cycle, self.now_s)
        if self.cycle.machine.state in {State.TRACK, State.CONTACT}:
            self.tracked_s = self.now_s
        return self._goes_on()

    def _goes_on(self) -> bool:
        if self.oracle.violations:
            return False
        if self.now_s < self.plan.duration_s:
            return True
        quiet_s = max(self.plan.quiet_s, self._robot.quiet_s)
        if self.tracked_s >= quiet_s:
            return False
        if self.now_s - quiet_s > PATIENCE_S + self._robot.homing_s:
            machine = self.cycle.machine
            self.oracle.blame(
                f"liveness: {machine.state} ({machine.because}) {PATIENCE_S:g} s after the last"
                f" fault; {self._operator.refusal}"
            )
            return False
        return True

    def outcome(self) -> Outcome:
        """What has become of the plan."""
        self.oracle.judge(self.controller.judge)
        self._hash.update(repr(self.oracle.story).encode())
        return Outcome(
            self.plan,
            tuple(self.oracle.violations),
            self._hash.hexdigest(),
            self._cycle + 1,
            frozenset(self.oracle.states),
        )

    def _post(self, at_ns: int, event: "_Action") -> None:
        self._ordered += 1
        heapq.heappush(self._queue, (at_ns, self._ordered, event))

    def _live_until(self, end_ns: int) -> None:
        """Let everything happen that is due before a time."""
        while True:
            wake_ns = max(scheduling.wake_ns(self._schedule), self._deaf_ns)
            next_ns = self._queue[0][0] if self._queue else end_ns
            if min(wake_ns, next_ns) >= end_ns:
                return
            if wake_ns < next_ns:
                self._wake(wake_ns)
            else:
                _, _, action = heapq.heappop(self._queue)
                action(self, next_ns)

    # The network.

    def arrive(self, data: bytes, peer: str, at_ns: int) -> None:
        """A telegram comes to the daemon's port."""
        if at_ns < self._down_ns:
            return
        if at_ns < self._deaf_ns:
            self._post(self._deaf_ns, _Waiting(data, peer, at_ns))
            return
        self._answer(data, peer, at_ns, at_ns)

    def drain(self, at_ns: int, first: "_Waiting") -> None:
        """After a stall: the newest telegram that is worth an answer, of each sender."""
        waiting = [first]
        while self._queue and self._queue[0][0] == at_ns:
            if not isinstance(self._queue[0][2], _Waiting):
                break
            waiting.append(heapq.heappop(self._queue)[2])  # type: ignore[arg-type]
        for peer in dict.fromkeys(one.peer for one in waiting):
            newest = [one for one in reversed(waiting) if one.peer == peer][:LOOK_BACK]
            for one in newest:
                if self._answer(one.data, peer, one.stamp_ns, at_ns):
                    break

    def _answer(self, data: bytes, peer: str, stamp_ns: int, now_ns: int) -> bool:
        sent = self.cycle.express(data, peer)
        reply = self.cycle.on_telegram(data, stamp_ns, peer)
        if sent is not None and sent != reply:
            self.oracle.blame(f"express: {sent!r} was sent, {reply!r} was meant")
        if reply is None:
            return False
        self._answered_ns = stamp_ns
        self._schedule = scheduling.on_telegram(self._schedule, stamp_ns)
        self._hash.update(reply)
        self.oracle.reply(reply)
        if peer == _SECOND:
            return True
        sent_s = _seconds(now_ns + THINKING_NS)
        if self._faults.in_force("robot", "deafness", self.now_s) is None:
            for at_s, piece in self._back.carry(reply, sent_s):
                self._post(_ns(at_s) + TRANSIT_NS, partial_reply(piece))
        return True

    def _impostor(self, begins_ns: int) -> None:
        """Another controller that stands still and asks for answers."""
        if self._faults.in_force("robot", "second", self.now_s) is None:
            self._second = None
            return
        if self._second is None:
            pose = self._plant.start
            self._second = RsiController(
                rsi(),
                lambda: RobotReading(pose, (0.0,) * 6),
                pose,
                ControllerConfig(cycle_s=CYCLE_S, first_ipoc=_SECOND_IPOC),
            )
        data = self._second.telegram()
        self._second.end_of_cycle()
        if data is not None:
            self._post(begins_ns + _CYCLE_NS // 3, partial_telegram(data, _SECOND))

    # The daemon.

    def _daemon(self) -> Cycle:
        cycle = Cycle(compiled(), RsiCodec(rsi()), SETTINGS)
        self.oracle.attend(cycle)
        return cycle

    def _fresh_schedule(self, now_ns: int) -> Schedule:
        return scheduling.free(_CYCLE_NS, now_ns, round(self.plan.lead_ms * 1e6))

    def _sense(self, now_ns: int) -> None:
        if now_ns < self._down_ns:
            self.wires.discard()
        elif now_ns >= self._deaf_ns:
            self.wires.carry()

    def _wake(self, now_ns: int) -> None:
        self._schedule, due = scheduling.on_wake(self._schedule, now_ns)
        for one in due:
            self._on_due(one)

    def _on_due(self, due: Due) -> None:
        """As the service does it."""
        if due.kind is scheduling.Kind.PREPARE:
            self.cycle.prepare(due.stamp_ns)
            return
        lost_ns = SETTINGS.link_lost_s * 1e9
        if self._answered_ns is None or due.stamp_ns - self._answered_ns > lost_ns:
            self._schedule = scheduling.run_free(self._schedule)
        self.cycle.on_missing(due.stamp_ns)

    def _strike(self, fault: Fault) -> None:
        now_ns = EPOCH_NS + self._cycle * _CYCLE_NS
        end_ns = now_ns + round(fault.duration_s * 1e9)
        match fault.link, fault.kind:
            case "robot", "restart":
                self._robot.pause(self.now_s, fault.duration_s)
            case "robot", "drives_off":
                self._robot.brake(self.now_s, fault.duration_s)
            case "daemon", "crash":
                self._down_ns = self._deaf_ns = end_ns
                self.cycle = self._daemon()
                self.wires.connect(self.cycle)
                self._schedule = self._fresh_schedule(end_ns)
                self._answered_ns = None
            case "operator", order:
                self._operator.order(order)

    @property
    def is_stalled(self) -> bool:
        """The daemon takes no orders now."""
        return EPOCH_NS + self._cycle * _CYCLE_NS < self._deaf_ns

    def stall(self) -> None:
        """Look for a stall that begins or goes on."""
        fault = self._faults.in_force("daemon", "stall", self.now_s)
        if fault is not None:
            self._deaf_ns = max(self._deaf_ns, _ns(fault.at_s + fault.duration_s))


class _Robot:
    """The controller's programme, its operator included: pauses, brakes, homing, restarts."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._controller = simulation.controller
        self._plant = simulation._plant  # noqa: SLF001 - two halves of one thing
        self._paused_until_s: float | None = None
        self._braked_until_s: float | None = None
        self._pose = self._plant.start
        self._from = self._pose
        self._took_s = 1.0
        self._sent = False
        self.quiet_s = float("-inf")
        self.homing_s = 0.0

    def pause(self, now_s: float, duration_s: float) -> None:
        """End the programme; it begins anew after some time."""
        if self._paused_until_s is None:
            self._from = self._pose = self._controller.setpoints
        self._paused_until_s = max(now_s + duration_s, self._paused_until_s or now_s)

    def brake(self, now_s: float, duration_s: float) -> None:
        """Drives off: the axes stand where they were sent last, whatever comes."""
        if self._paused_until_s is None:
            self._braked_until_s = max(now_s + duration_s, self._braked_until_s or now_s)
            self._pose = self._controller.setpoints

    def home(self, now_s: float) -> None:
        """Drive to the rest pose without RSI; the programme begins anew there."""
        self._from, self._pose = self._controller.setpoints, self._plant.start
        way = max(abs(a - b) for a, b in zip(self._from, self._pose, strict=True))
        self._took_s = max(HOMING_S, way / HOMING_SPEED)
        self._paused_until_s = now_s + self._took_s
        self.homing_s += self._took_s

    @property
    def is_paused(self) -> bool:
        """No telegrams come."""
        return self._paused_until_s is not None

    def telegram(self, now_s: float) -> bytes | None:
        """Open a cycle."""
        if self._braked_until_s is not None and now_s >= self._braked_until_s:
            self._braked_until_s = None
            self.pause(now_s, CYCLE_S)
        if self._controller.broken is not None and self._paused_until_s is None:
            self.quiet_s = now_s
            self.home(now_s)
        if self._paused_until_s is not None and now_s >= self._paused_until_s:
            self._paused_until_s = None
            self._controller.restart(setpoints=self._pose)
        if self._paused_until_s is not None:
            self._sent = False
            return None
        data = self._controller.telegram()
        self._sent = data is not None
        return data

    def close(self) -> Vector7:
        """Close the cycle and move; returns where the axes are sent."""
        if not self._sent:
            self._stand()
            return self._pose
        applied = self._controller.end_of_cycle()
        if self._braked_until_s is not None:
            applied = replace(applied, setpoints=self._pose)
        self._plant.apply(applied)
        return applied.setpoints

    def _stand(self) -> None:
        world, plant = self._simulation.world, self._plant
        left_s = (self._paused_until_s or world.time_s) - world.time_s
        share = min(max(1.0 - left_s / self._took_s, 0.0), 1.0)
        share = share**3 * (10.0 + share * (6.0 * share - 15.0))
        moved = (a + share * (b - a) for a, b in zip(self._from, self._pose, strict=True))
        world.command(tuple(moved))
        plant.cycle += 1
        world.advance(world.cycle_start(plant.cycle))


class _Operator:
    """Arms and starts once; when the trouble is over, or at once if eager, again and again."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._started = False
        self._waited_s = 0.0
        self.refusal = ""

    def order(self, op: str) -> bool:
        """Give an order; whether it was taken."""
        simulation = self._simulation
        if simulation.is_stalled:
            return False
        reason = simulation.cycle.order(op, "operator")
        simulation.oracle.ordered(op, simulation.cycle, reason)
        if reason is not None:
            self.refusal = f"{op}: {reason}"
        return reason is None

    def look(self, now_s: float) -> None:
        """Give the next order if it is due."""
        simulation = self._simulation
        simulation.stall()
        if simulation.is_stalled or simulation._robot.is_paused:  # noqa: SLF001 - halves of one
            return
        quiet = now_s >= simulation.plan.quiet_s
        if self._started and not (quiet or simulation.plan.eager):
            return
        if quiet and simulation.tracked_s >= simulation.plan.quiet_s > float("-inf"):
            return
        self._act(now_s, simulation.cycle.machine.state)

    def _act(self, now_s: float, state: State) -> None:
        waits = state is State.HOLD or self._simulation.cycle.is_foreign
        self._waited_s = self._waited_s + CYCLE_S if waits else 0.0
        if self._simulation.cycle.is_foreign:
            if self._waited_s > DITHERING_S:
                self._simulation._robot.home(now_s)  # noqa: SLF001 - halves of one thing
            return
        match state:
            case State.IDLE:
                if not self.order("arm") and "away from the task's first pose" in self.refusal:
                    self._simulation._robot.home(now_s)  # noqa: SLF001 - halves of one thing
            case State.ARMED:
                self._started = self.order("start") or self._started
            case State.HOLD:
                if not self.order("start") and self._waited_s > DITHERING_S:
                    self.order("stop")
            case State.FAULT:
                self.order("ack")


_CYCLE_NS = round(CYCLE_S * 1e9)
_Action = Callable[[Simulation, int], None]
_Event = tuple[int, int, _Action]


@dataclass(frozen=True, slots=True)
class _Waiting:
    """A telegram in the socket of a daemon that does not read."""

    data: bytes
    peer: str
    stamp_ns: int

    def __call__(self, simulation: Simulation, at_ns: int) -> None:
        simulation.drain(at_ns, self)


def partial_telegram(data: bytes, peer: str) -> _Action:
    """A telegram on its way."""
    return lambda simulation, at_ns: simulation.arrive(data, peer, at_ns)


def partial_reply(data: bytes) -> _Action:
    """A reply on its way."""

    def arrive(simulation: Simulation, at_ns: int) -> None:
        simulation.controller.on_reply(data, at_ns)

    return arrive


def _ns(time_s: float) -> int:
    return EPOCH_NS + round((time_s + LEAD_IN_S) * 1e9)


def _seconds(stamp_ns: int) -> float:
    return (stamp_ns - EPOCH_NS) * 1e-9 - LEAD_IN_S
