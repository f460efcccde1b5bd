"""Actors of a plan: the controller's program and the operator.

Invariants:
    Each acts once a cycle and knows only the daemon's answers.
"""

import math
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from msgspec.structs import replace

from linemate.daemon.cycle.states import State
from linemate.daemon.service.app import App
from linemate.simulators.devices.links import robot_program
from linemate.simulators.devices.links.robot_program import Controller
from linemate.simulators.devices.robot_plant import RobotPlant
from linemate.simulators.lab.faults.dst_controllers import StrictFamily
from linemate.simulators.lab.faults.dst_oracles import FaultOracle
from linemate.simulators.lab.faults.dst_orders import NAMES, CommandWire
from linemate.simulators.lab.faults.dst_plan import FaultPlan
from linemate.simulators.plants import rotation
from linemate.simulators.plants.arm import ArmPlant
from linemate.simulators.plants.contact_plant import RELEASE_WHEEL
from linemate.simulators.plants.rotation import Pose
from linemate.simulators.plants.scenario import Axis, Robot, Vector7
from linemate.simulators.plants.world import World

HOMING_S = 0.5
HOMING_SPEED = 0.8
"""How the programme drives the robot to its rest pose, without RSI: for so long at least [s], an
axis at so much in the mean at most [rad/s, m/s]; it is not charged to the daemon's time."""
HOMING_SHARE = 0.7
"""Of what its servo can accelerate, at most: a rail that was asked for more rang for 2 s."""
OPENING_S = 0.5
"""For which it stands before that while its clamp opens [s]; the clamp needs 0.3 s."""
OUT_M, OUT_S = 0.08, 0.5
"""A tool nearer to the hub's plane is drawn straight out of the hub first, so far in this time."""
HOME_EVERY = 3
"""In one seed of so many the daemon brings the robot home by corrections."""
HARMLESS: tuple[dict[str, Any], ...] = (
    {"tracking.camera.gate": 5.5},
    {"control.damping": True},
    {"control.feed_forward": True},
    {"tracking.mixture": False},
)
"""Parameters that may be set in motion."""
HELD = "control is held"
"""How a refusal begins whose reason is another operator."""
SHORTEST_PAUSE_S = 0.12
"""Between two programs: RSI_OFF, the interpreter, RSI_ON [s]. None is known to be quicker."""
DITHERING_S = 0.2
"""Time that the operator waits in a hold before starting again [s]."""


class SimulatedRun(Protocol):
    """A run as its actors see it."""

    plan: FaultPlan
    world: World
    plant: RobotPlant
    controller: Controller
    strict: StrictFamily
    oracle: FaultOracle
    app: App | None
    robot: "Programme"
    tracked_s: float

    @property
    def is_stalled(self) -> bool:
        """Whether the host of the daemon is stopped."""

    @property
    def host_ns(self) -> int:
        """Time of the daemon's host [ns]."""


def homing_time(ways: Sequence[float], axes: Sequence[Axis]) -> float:
    """Return how long a programme takes for some ways [rad, m] of its axes [s]."""
    steepest = 10.0 / math.sqrt(3.0)  # acceleration of a quintic over a way of 1 in a time of 1
    least_s = [
        math.sqrt(steepest * way / (HOMING_SHARE * axis.acceleration_limit))
        for way, axis in zip(ways, axes, strict=True)
    ]
    return max(HOMING_S, max(ways) / HOMING_SPEED, *least_s)


def smooth(share: float) -> float:
    """Return a quintic from 0 to 1 over a share of a time, 0 before and 1 after it."""
    s = min(max(share, 0.0), 1.0)
    return s**3 * (10.0 + s * (6.0 * s - 15.0))


def drawn_out(robot: Robot, joints: Vector7, way: float) -> Vector7:
    """Return the axes with the tool drawn back along its own axis by a way [m]; E1 stands."""
    tcp, axes = ArmPlant(robot).tcp, np.array(joints)
    place, turn = tcp(joints)
    back = rotation.apply(turn, (0.0, 0.0, -way))
    goal = (place[0] + back[0], place[1] + back[1], place[2] + back[2]), turn
    for _ in range(6):
        off = _off(tcp(tuple(axes.tolist())), goal)
        columns = []
        for n in range(6):
            moved = axes.copy()
            moved[n] += 1e-6
            columns.append((off - _off(tcp(tuple(moved.tolist())), goal)) / 1e-6)
        axes[:6] += np.linalg.lstsq(np.array(columns).T, off, rcond=1e-4)[0]
    a1, a2, a3, a4, a5, a6, e1 = axes.tolist()
    return a1, a2, a3, a4, a5, a6, e1


def _off(pose: Pose, goal: Pose) -> "np.ndarray[Any, np.dtype[np.float64]]":
    """Return way and turn (6,) from a pose to another [m, rad]."""
    turned = rotation.apply(pose[1], rotation.log(rotation.between(pose[1], goal[1])))
    return np.array((*(b - a for a, b in zip(pose[0], goal[0], strict=True)), *turned))


class Programme:
    """The controller's program: pauses, brakes, drives home, starts again.

    Attributes:
        quiet_s: when the exchange broke off last [s].
        homing_s: time that the programme drove by itself [s].
        breaks: how often the exchange broke off.
        is_answered: a reply moved the robot in the closed cycle.
        orders: the tool's signals, as ordered.
        is_sent: the open cycle has a telegram.
        leads: the program runs in the open cycle, and lets the daemon lead.
    """

    def __init__(self, simulation: SimulatedRun) -> None:
        self._simulation = simulation
        self._controller = simulation.controller
        self._plant = simulation.plant
        self._paused_until_s: float | None = None
        self._braked_until_s: float | None = None
        self._pose = self._plant.start
        self._from = self._out = self._pose
        self._took_s = 1.0
        self._is_open = False
        self.leads = self.is_sent = False
        self.quiet_s = float("-inf")
        self.homing_s = 0.0
        self.breaks = 0
        self.is_answered = False
        self.orders = 0

    def pause(self, now_s: float, duration_s: float) -> None:
        """End the program; it starts again after some time, which it needs at least."""
        duration_s = max(duration_s, SHORTEST_PAUSE_S)
        if self._paused_until_s is None:
            # Drives that are off stay where they are, whatever the controller was sent in between.
            is_braked = self._braked_until_s is not None
            where = self._pose if is_braked else robot_program.standing(self._controller)
            self._from = self._out = self._pose = where
        self._paused_until_s = max(now_s + duration_s, self._paused_until_s or now_s)

    def brake(self, now_s: float, duration_s: float) -> None:
        """Drives off: the axes stand where they were sent last, whatever comes."""
        if self._paused_until_s is None:
            self._braked_until_s = max(now_s + duration_s, self._braked_until_s or now_s)
            self._pose = robot_program.standing(self._controller)

    def home(self, now_s: float) -> None:
        """Drive to the rest pose without RSI; the program starts again there.

        A closed clamp is opened before: no programme drives off with the object. A tool at the hub
        is drawn straight out of it: a motion of the axes alone leads it sideways.
        """
        world, opening_s, out_s = self._simulation.world, 0.0, 0.0
        if world.contact == "clamped":
            world.digital_out(RELEASE_WHEEL)
            opening_s = OPENING_S
        where = robot_program.standing(self._controller)
        self._from, self._out, self._pose = where, where, self._plant.start
        hub, rigid = world.hub(), world.rigid()
        away = [a - b for a, b in zip(rigid[0], hub[0], strict=True)]
        left = OUT_M + rotation.unapply(hub[1], (away[0], away[1], away[2]))[2]
        if left > 0.0:
            self._out, out_s = drawn_out(world.scenario.robot, where, min(left, OUT_M)), OUT_S
        ways = [abs(a - b) for a, b in zip(self._out, self._pose, strict=True)]
        self._took_s = homing_time(ways, world.scenario.robot.axes)
        lasts_s = opening_s + out_s + self._took_s
        self._paused_until_s = now_s + lasts_s
        self.homing_s += lasts_s

    @property
    def is_open(self) -> bool:
        """A cycle is open."""
        return self._is_open

    @property
    def stands(self) -> Vector7 | None:
        """Where the axes are held while the drives are off, None while they are on."""
        return None if self._braked_until_s is None else self._pose

    @property
    def is_paused(self) -> bool:
        """No telegrams come."""
        return self._paused_until_s is not None

    def telegram(self, now_s: float) -> bytes | None:
        """Open a cycle."""
        self._is_open = True
        if self._braked_until_s is not None and now_s >= self._braked_until_s:
            self.pause(now_s, SHORTEST_PAUSE_S)
            self._braked_until_s = None
        if self._controller.broken is not None and self._paused_until_s is None:
            self.quiet_s = now_s
            self.breaks += 1
            self.home(now_s)
        if self._paused_until_s is not None and now_s >= self._paused_until_s:
            self._paused_until_s = None
            self._controller.restart(setpoints=self._pose)
        self.leads = self._paused_until_s is None
        robot_program.show(
            self._controller, is_running=self.leads, has_drives=self._braked_until_s is None
        )
        if self.leads:
            data = self._controller.telegram()
        else:
            data = robot_program.paused_telegram(self._controller)
        self.is_sent = data is not None
        return data

    def close(self) -> Vector7:
        """Close the cycle and move; returns where the axes are sent."""
        if not self.leads:
            self.is_answered = False
            self._stand()
            return self._pose
        applied = self._simulation.strict.end_of_cycle(self._simulation.world.time_s)
        self.is_answered, self.orders = applied.answered, applied.digital_out
        if self._braked_until_s is not None:
            applied = replace(applied, setpoints=self._pose, motion=None)
        self._plant.apply(applied)
        return applied.setpoints

    def _stand(self) -> None:
        world, plant = self._simulation.world, self._plant
        left_s = (self._paused_until_s or world.time_s) - world.time_s
        out, home = (
            smooth(1.0 - (left_s - self._took_s) / OUT_S),
            smooth(1.0 - left_s / self._took_s),
        )
        ways = zip(self._from, self._out, self._pose, strict=True)
        world.command(tuple(a + out * (b - a) + home * (c - b) for a, b, c in ways))
        plant.cycle += 1
        world.advance(world.cycle_start(plant.cycle))


class Operator:
    """Arms and starts once; when the trouble is over, or at once if eager, again and again.

    Attributes:
        homing_s: time that the daemon brought the robot home [s].
    """

    def __init__(self, simulation: SimulatedRun) -> None:
        self._simulation = simulation
        self._started = False
        self._waited_s = 0.0
        self._wire = CommandWire()
        self.homing_s = 0.0
        self.refusal = ""

    def order(self, op: str, *, is_colleague: bool = False) -> bool:
        """Give an order, a colleague's if asked for, and return whether it was accepted."""
        simulation = self._simulation
        app = simulation.app
        if simulation.is_stalled or app is None:
            return False
        reason = self._ask(app, op, {}, NAMES[is_colleague])
        if reason is not None and HELD in reason and not is_colleague:
            # Who holds control is asked to give the order.
            reason = self._ask(app, op, {}, NAMES[1])
        simulation.oracle.ordered(op, app.cycle, reason)
        if reason is not None:
            self.refusal = f"{op}: {reason}"
        return reason is None

    def set(self, number: int) -> None:
        """Set parameters, whatever moves."""
        simulation = self._simulation
        if simulation.app is not None and not simulation.is_stalled:
            values = {"values": HARMLESS[number % len(HARMLESS)]}
            self._ask(simulation.app, "set", values, NAMES[0])

    def _ask(self, app: App, op: str, params: dict[str, Any], name: str) -> str | None:
        """Return None if an order was taken, else why not."""
        simulation = self._simulation
        if simulation.plan.operators:
            return self._wire.order(app, name, op, params, simulation.host_ns)
        answer = app._handle(op, params, "operate", name)  # noqa: SLF001
        # What is answered later was accepted.
        return answer.get("refused") if isinstance(answer, dict) else None

    def give_order(self, now_s: float) -> None:
        """Give the next order if it is due."""
        simulation = self._simulation
        app = simulation.app
        if simulation.is_stalled or simulation.robot.is_paused or app is None:
            return
        # A robot that tracked before its controller broke the exchange off has to track again.
        quiet_s = max(simulation.plan.quiet_s, simulation.robot.quiet_s)
        quiet = now_s >= quiet_s
        if self._started and not (quiet or simulation.plan.eager):
            return
        if quiet and simulation.tracked_s >= quiet_s > float("-inf"):
            return
        self._act(now_s, app)

    def _act(self, now_s: float, app: App) -> None:
        simulation = self._simulation
        state = app.cycle.machine.state
        waits = state in {State.HOLD, State.FAULT} or app.cycle.is_unproven
        self._waited_s = self._waited_s + simulation.plan.cycle_s if waits else 0.0
        if app.cycle.is_unproven:
            if self._waited_s > DITHERING_S:
                self._drive_home(now_s)
            return
        match state:
            case State.IDLE:
                if not self.order("arm") and "away from the task's first pose" in self.refusal:
                    self._go_home(now_s)
            case State.HOME:
                self.homing_s += simulation.plan.cycle_s
            case State.ARMED:
                self._started = self.order("start") or self._started
            case State.HOLD:
                if not self.order("start") and self._waited_s > DITHERING_S:
                    self.order("stop")
            case State.FAULT:
                if self.order("ack") or "overload" not in self.refusal:
                    return
                # A robot that stands pulls at a hub that moved on: it is driven off by hand.
                if self._waited_s > DITHERING_S:
                    self._drive_home(now_s)

    def _go_home(self, now_s: float) -> None:
        """Let the daemon bring the robot home in some plans, and the programme in the others."""
        simulation = self._simulation
        if simulation.plan.seed % HOME_EVERY or not self.order("home"):
            simulation.robot.home(now_s)

    def _drive_home(self, now_s: float) -> None:
        """Drive the robot off by hand, and wait again before doing so once more."""
        self._simulation.robot.home(now_s)
        self._waited_s = 0.0
