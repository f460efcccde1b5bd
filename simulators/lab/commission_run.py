"""Recordings for commissioning in virtual time: a robot guided through postures, a passing object.

Invariants:
    The daemon listens and is given no order; the controller's own programme moves the robot.
    What is mounted wrongly is in the scenario alone; recordings come through the links.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from linemate.daemon.config import task_file
from linemate.daemon.config.task_file import Task
from linemate.daemon.core import rotations
from linemate.daemon.core.control import kinematics
from linemate.daemon.core.inputs import Inputs
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.step_state import Outputs
from linemate.daemon.core.tracking.task import Phase
from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.cycle.sensing.samples import SensorQueues
from linemate.daemon.cycle.sensing.sensor_health import Conditions
from linemate.daemon.cycle.states import State
from linemate.daemon.recording.step_codec import encode
from linemate.daemon.recording.step_file import StepFile
from linemate.daemon.recording.step_items import metadata_of
from linemate.protocol.controller_link import ControllerLink
from linemate.simulators.devices.faults import Faults
from linemate.simulators.devices.guided_robot import FORWARD, GuidedRobot, PostureProgramme
from linemate.simulators.devices.robot_plant import seven
from linemate.simulators.devices.rsi_controller import Seven
from linemate.simulators.devices.worlds import build_world
from linemate.simulators.harness import cell_links
from linemate.simulators.harness.cell import cell_truth
from linemate.simulators.harness.cell.cell_truth import shipped_task
from linemate.simulators.harness.lockstep import parameters
from linemate.simulators.harness.sensor_links import SensorLinks
from linemate.simulators.harness.setup import Setup
from linemate.simulators.plants.conveyor_plan import ConveyorEvent
from linemate.simulators.plants.scenario import Robot, Scenario
from linemate.simulators.plants.scenario_draw import sample

LEAD_IN_S = 1.0
TO_LIMIT = 0.05  # of a posture to the ends of the axes [rad]
STANDOFF = 0.4  # from the first pose to the object, for which the postures were chosen [m]
TILT = 0.35  # of the tool in postures before the object [rad]
SEED = 5200
LINEAR = 6  # index of the linear axis


@dataclass(frozen=True, slots=True)
class CommissioningRun:
    """One recording.

    Attributes:
        signs: of the axes as the controller counts.
        corrected: share of a correction by which each axis moves.
        starts: an operator orders home if arm asks for it, and arms and starts the daemon's task.
        cycle_ms: period of the controller [ms].
    """

    programme: PostureProgramme
    signs: Seven = FORWARD
    corrected: Seven = FORWARD
    starts: bool = False
    cycle_ms: float = 12.0


def resting_scenario(cell: Scenario | None = None) -> Scenario:
    """Return a cell with a part that stands still in front of the robot, without sway.

    Args:
        cell: truth of the cell; None: of the shipped one.
    """
    plain = cell or Scenario(robot=Robot(start=rest_of(shipped_task())))
    return replace(
        plain,
        name="postures",
        lead_in_s=LEAD_IN_S,
        duration_s=1.0,
        conveyor=replace(plain.conveyor, events=(ConveyorEvent("stop", -LEAD_IN_S + 0.01, 2.0),)),
        body=replace(plain.body, swings=(), offset=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.0)),
    )


def rest_of(task: Task) -> Seven:
    """Return the axes at the task's first pose, A1..A6 [rad], E1 [m]."""
    return seven((*task.file.arm.rest_joints, 0.0))


def looking_postures(count: int = 18, task: Task | None = None) -> list[Seven]:
    """Return postures before the object that turn the tool about all axes.

    Args:
        task: of the cell; None: the shipped one.
    """
    task = task or shipped_task()
    first, nominal = task.file.waypoints[0].pose.position, task.file.object.nominal.position
    scale = round(math.dist(first, nominal) / STANDOFF, 9)
    turns = [
        (TILT * math.cos(2.4 * i), TILT * math.sin(2.4 * i), TILT * math.sin(1.1 * i + 0.3))
        for i in range(count)
    ]
    places = [
        (0.10 * math.sin(1.7 * i), 0.12 * math.cos(1.3 * i), -0.45 - 0.15 * math.cos(0.9 * i))
        for i in range(count)
    ]
    poses = [np.array((*p, *r)) for p, r in zip(np.multiply(scale, places), turns, strict=True)]
    return _solved(poses, task)


def weighing_postures(task: Task | None = None) -> list[Seven]:
    """Return postures in which gravity comes from all sides of the tool.

    Args:
        task: of the cell; None: the shipped one.
    """
    task = task or shipped_task()
    shifts = (
        (0.0, 0.0, 0.0),
        (0.0, 0.9, 0.0),
        (0.0, -0.9, 0.0),
        (0.0, 0.0, 1.5),
        (0.0, 0.8, 1.5),
        (0.0, -0.8, -1.5),
        (0.9, -1.0, 0.0),
        (-0.9, -1.0, 0.0),
        (0.6, 0.6, -1.2),
        (-0.6, -1.4, 1.2),
    )
    limits = cell_truth.axis_limits(task.urdf, task.file)
    lowest = np.array([limit.low + TO_LIMIT for limit in limits])
    highest = np.array([limit.high - TO_LIMIT for limit in limits])
    moves = np.array([(0.0, 0.0, 0.0, *shift, 0.0) for shift in shifts])
    moved = np.clip(np.array(rest_of(task)) + moves, lowest, highest)
    moved[:, LINEAR] = rest_of(task)[LINEAR]
    return [seven(tuple(row)) for row in moved.tolist()]


def _solved(poses: Sequence[Any], task: Task) -> list[Seven]:
    """Return the joints for poses (6,) of the tcp about the nominal object."""
    file, tool = task.file, task.file.arm.tcp_in_flange
    arm = kinematics.load(
        task.urdf,
        file.arm.flange,
        np.array(tool.position),
        rotations.matrix(tool.quaternion),
        linear_axis=file.arm.linear_axis,
    )
    nominal = file.object.nominal
    turn, place = rotations.matrix(nominal.quaternion), np.array(nominal.position)
    rest = rest_of(task)
    joints, rows = np.array(rest[: len(arm.lower)]), []
    for pose in poses:
        target = turn @ rotations.exp(pose[3:])
        joints = arm.solve(joints, place + turn @ pose[:3], target, tolerance=1e-6)
        rows.append(seven((*joints.tolist(), *rest[len(joints) :])))
    return rows


def listen(setup: Setup, plan: CommissioningRun, seed: int = SEED) -> list[Inputs]:
    """Return what arrives at the daemon; it makes no steps, which saves most of the time."""
    station = _GuidedStation(setup, plan, seed)
    listener = Listener(station.link)
    station.run(listener)
    return listener.inputs


def record(setup: Setup, plan: CommissioningRun, path: Path, seed: int = SEED) -> Path:
    """Leave the recording of a daemon next to a guided robot; return where.

    Args:
        setup: settings of the daemon, and the truth.
    """
    station = _GuidedStation(setup, plan, seed)
    cycle = Cycle(_compiled(replace(setup, scenario=station.scenario)), station.link)
    cycle.listen(0)
    path.parent.mkdir(parents=True, exist_ok=True)
    file = StepFile(path.open("wb"), metadata_of(texts(setup)))
    started: list[str] = []

    def keep() -> None:
        if plan.starts:
            order = {State.IDLE: "arm", State.ARMED: "start"}.get(cycle.machine.state)
            if order is not None and not started:
                refused = cycle.order(order, "the engineer")
                if refused is not None and "Order home" in refused:
                    cycle.order("home", "the engineer")
                if order == "start" and refused is None:
                    started.append(order)
        for entry in cycle.take_log():
            step = encode(entry.counter, entry.state, entry.inputs, entry.outputs)
            file.write(entry.inputs.stamp_ns, step)

    try:
        station.run(cycle, keep)
    finally:
        file.close()
    return path


def _compiled(setup: Setup) -> Parameters:
    cycle_s = setup.scenario.cycle_s
    return parameters(setup.task, setup.urdf, setup.tracking, setup.control, cycle_s)


def write(setup: Setup, inputs: Sequence[Inputs], path: Path) -> Path:
    """Write what arrived as a daemon in IDLE records it: it holds and decides nothing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    file = StepFile(path.open("wb"), metadata_of(texts(setup)))
    for each in inputs:
        robot = each.robot
        joints = () if robot is None else (*robot.joints, *robot.external[:1])
        step = encode(each.k, State.IDLE.value, each, _holding(each, joints))
        file.write(each.stamp_ns, step)
    file.close()
    return path


def _holding(inputs: Inputs, joints: tuple[float, ...]) -> Outputs:
    return Outputs(
        k=inputs.k,
        stamp_ns=inputs.stamp_ns,
        command=joints,
        digital_out=0,
        phase=Phase.WAIT,
        task_time=None,
        scenario="running",
        scenario_state="confirmed",
        confidence=1.0,
        events=(),
        target=(0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0),
        sensed=None,
        part=None,
        speed=None,
        horizon=None,
        contact=False,
        clamped=False,
        overdue=False,
        overload=False,
        finished=False,
        held="hold",
        ready=None,
        refused=0,
    )


class Listener:
    """Decoders and sample queues of the daemon, and replies without a setpoint.

    Attributes:
        inputs: of all telegrams so far.
    """

    def __init__(self, link: ControllerLink) -> None:
        self.samples = SensorQueues()
        self.inputs: list[Inputs] = []
        self._link = link

    def on_telegram(self, data: bytes, stamp_ns: int) -> bytes | None:
        """Keep a telegram and everything that came before it; return the reply."""
        telegram = self._link.read(data, stamp_ns)
        drained = self.samples.drain(Conditions(moving=True, deviation=1e-3), 1e6)
        self.inputs.append(
            Inputs(
                len(self.inputs),
                stamp_ns,
                telegram.robot,
                drained.distance,
                drained.camera,
                drained.wrench,
            )
        )
        reply = self._link.without_setpoint(0)
        return None if reply is None else reply.with_counter(telegram.echo)


class _GuidedStation:
    """World, guided robot and both ends of the exchange."""

    def __init__(self, setup: Setup, plan: CommissioningRun, seed: int) -> None:
        duration_s = max(plan.programme.end_s, setup.scenario.duration_s)
        cycle_s = round(plan.cycle_ms * 1e-3, 9)
        truth = replace(setup.scenario, cycle_s=cycle_s, duration_s=duration_s)
        self.scenario = sample(seed, truth)
        self._world = build_world(setup.world, self.scenario, setup.mujoco)
        self._robot = GuidedRobot(self._world, plan.programme, plan.signs, plan.corrected)
        setup = replace(setup, scenario=self.scenario)
        self._controller, self.link = cell_links.pair(setup, self._robot, _compiled(setup))
        self._ends = cell_links.of(setup.station)
        self._mount = setup.task.conveyor.start_position

    def run(self, receiver: Cycle | Listener, after: Callable[[], None] = lambda: None) -> None:
        """Exchange telegrams to the end, with a call after each."""
        world, controller = self._world, self._controller
        links = SensorLinks(
            world, receiver, Faults(self.scenario.faults, {}), self._mount, self._ends
        )
        while world.time_s < self.scenario.duration_s:
            links.carry()
            data = controller.telegram()
            if data is None:
                return
            stamp_ns = links.stamp(world.time_s)
            reply = receiver.on_telegram(data, stamp_ns)
            if reply:
                controller.on_reply(reply, stamp_ns)
            after()
            self._robot.apply(controller.end_of_cycle())


def texts(setup: Setup) -> dict[str, str]:
    """Return the texts of a recording of the cell that the daemon is set up for."""
    from pydantic import TypeAdapter

    def plain(value: Any) -> Any:
        return TypeAdapter(type(value)).dump_python(value, mode="json")

    config = {"tracking": plain(setup.tracking), "control": plain(setup.control)}
    return {
        "config": yaml.safe_dump(config),
        "task": yaml.safe_dump(plain(setup.task)),
        "urdf": setup.urdf,
        **task_file.geometry_text(setup.control.geometry),
    }


def line_direction(setup: Setup) -> Any:
    """Return the true direction of travel in base, unit vector (3,)."""
    aside, upwards = setup.scenario.conveyor.effects.askew
    return np.array((
        math.sin(aside) * math.cos(upwards),
        math.cos(aside) * math.cos(upwards),
        math.sin(upwards),
    ))  # fmt: skip
