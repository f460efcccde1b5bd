"""A scenario's truth where its file is silent: as the task describes the cell.

Invariants:
    What a scenario file gives is the truth. The rest of arm, camera, object and speed is nominal.
    The plant reads the URDF by itself; servos, noise and errors come from the scenario alone.
    The shipped arm keeps the numbers of ``plants.scenario``.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from linemate.daemon.config import task_file
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.config.task_file import Task
from linemate.daemon.core import rotations
from linemate.daemon.core.tracking.task import PoseFile, TaskFile, WaypointFrame
from linemate.simulators.devices.limit_judge import LIMITS, AxisLimit
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.plants import rotation, urdf_arm
from linemate.simulators.plants.arm import ArmPlant
from linemate.simulators.plants.body import C_IN_BASE
from linemate.simulators.plants.rotation import Pose, Rot
from linemate.simulators.plants.scenario import Robot, Scenario, Vector7
from linemate.simulators.plants.urdf_arm import UrdfArm, UrdfArmError

TASK = "wheel.yaml"
ALIGNED = 1e-6  # of the object's axes with those of the emulated conveyor [rad]
PLACE = 9  # decimals of E1 at the start [m]


@cache
def shipped_task() -> Task:
    """The task that comes with the daemon: the wheel onto the hub."""
    return task_file.load(DAEMON_DATA / TASK)


def placed(scenario: Scenario, given: Mapping[str, Any], task: Task) -> Scenario:
    """Return a scenario whose silent parts are the task's nominal cell.

    Args:
        given: plain values of the scenario file.

    Raises:
        SetupError: the emulated cell cannot be of this task.
    """
    file, shipped = task.file, shipped_task()
    robot, camera = scenario.robot, scenario.camera
    if (task.urdf, file.arm.flange) != (shipped.urdf, shipped.file.arm.flange) or (
        file.arm.tcp_in_flange != shipped.file.arm.tcp_in_flange
    ):
        robot = _of_urdf(robot, _part(given, "robot"), task)
    if "start" not in _part(given, "robot"):
        robot = replace(robot, start=_start(robot, file))
    mount = file.arm.camera_in_tcp
    if mount != shipped.file.arm.camera_in_tcp:
        values = {
            "position_in_tcp": mount.position,
            "rotation_in_tcp": rotation.vector(_pose(mount)[1]),
        }
        camera = replace(camera, **_silent(values, _part(given, "camera")))
    _refuse_other_frame(file)
    _refuse_other_sensor(file)
    body, conveyor = scenario.body, scenario.conveyor
    if "nominal" not in _part(given, "body"):
        body = replace(body, nominal=file.object.nominal.position)
    if "nominal_speed" not in _part(given, "conveyor"):
        conveyor = replace(conveyor, nominal_speed=file.conveyor.nominal_speed)
    return replace(scenario, robot=robot, camera=camera, body=body, conveyor=conveyor)


def axis_limits(urdf: str, task: TaskFile) -> tuple[AxisLimit, ...]:
    """Return the limits of the emulated axes A1..A6 and E1, by a URDF's text.

    Raises:
        SetupError: the URDF is no arm of the emulated cell.
    """
    if urdf == shipped_task().urdf:
        return LIMITS
    own = tuple(
        AxisLimit(limit.low, limit.high, limit.speed, limit.acceleration, limit.jerk)
        for limit in _arm(urdf, task).limits
    )
    return (*own, *LIMITS[len(own) :])


def _of_urdf(robot: Robot, given: Mapping[str, Any], task: Task) -> Robot:
    """Return a robot with the kinematics of the task's URDF, where its file has none."""
    arm = _arm(task.urdf, task.file)
    position, turned = urdf_arm.tool(arm, _pose(task.file.arm.tcp_in_flange))
    values = {
        "root_position": arm.root[0],
        "root_rotation": rotation.vector(arm.root[1]),
        "links": arm.links,
        "tcp_position": position,
        "tcp_rotation": turned,
    }
    if given.keys() & {"links", "root_position", "root_rotation"}:
        return robot  # a table of the scenario's own, with the flange that belongs to it
    return replace(robot, **_silent(values, given))


def _arm(urdf: str, task: TaskFile) -> UrdfArm:
    try:
        return urdf_arm.read(urdf, task.arm.flange)
    except UrdfArmError as error:
        raise SetupError(f"{task.arm.urdf}: {error}") from error


def _start(robot: Robot, task: TaskFile) -> Vector7:
    """Return the rest pose, E1 where it brings the tcp to the first waypoint."""
    joints = (*task.arm.rest_joints, 0.0)
    if not task.arm.linear_axis:
        return joints
    first = task.waypoints[0]
    there = _pose(first.pose)
    if first.frame is WaypointFrame.OBJECT:
        there = rotation.multiply(_pose(task.object.nominal), there)
    off = there[0][1] - ArmPlant(robot).tcp(joints)[0][1]
    return (*task.arm.rest_joints, round(off, PLACE) + 0.0)


def _refuse_other_frame(task: TaskFile) -> None:
    """Refuse an object whose frame the emulated conveyor cannot have.

    Raises:
        SetupError: the axes of the object lie otherwise.
    """
    nominal = _pose(task.object.nominal)[1]
    if rotation.angle(rotation.between(C_IN_BASE, nominal)) > ALIGNED:
        raise SetupError(
            f"object.nominal.quaternion is {list(task.object.nominal.quaternion)}: the emulated "
            "conveyor runs along y of base and its object's z lies along x. Give "
            "[0.7071067811865476, 0, 0.7071067811865476, 0], or turn the base."
        )


def _refuse_other_sensor(task: TaskFile) -> None:
    """Refuse a force-torque sensor that the emulated tool does not have.

    Raises:
        SetupError: it is not in the tcp, or has the other sign.
    """
    if task.arm.sensor_in_tcp != PoseFile((0.0, 0.0, 0.0)) or task.arm.sensor_sign != 1:
        raise SetupError(
            "arm.sensor_in_tcp and sensor_sign: the emulated sensor states its wrench in the tcp "
            "with sign 1. Leave both out of the task of an emulated run."
        )


def _pose(pose: PoseFile) -> Pose:
    turned: Rot = tuple(np.ravel(rotations.matrix(pose.quaternion)).tolist())  # type: ignore[assignment]
    return pose.position, turned


def _part(given: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    value = given.get(name)
    return value if isinstance(value, Mapping) else {}


def _silent(values: dict[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that a file does not give."""
    return {name: value for name, value in values.items() if name not in given}
