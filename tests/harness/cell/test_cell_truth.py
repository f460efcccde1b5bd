"""What a scenario takes from the task of its cell."""

import math
from dataclasses import replace

import pytest

from linemate.daemon.config import task_file
from linemate.daemon.config.task_file import Task
from linemate.daemon.core.tracking.task import PoseFile
from linemate.simulators.devices.limit_judge import LIMITS
from linemate.simulators.harness.cell import cell_truth
from linemate.simulators.harness.cell.cell_truth import shipped_task
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.lab.faults.dst_cells import TASKS
from linemate.simulators.plants.arm import ArmPlant
from linemate.simulators.plants.scenario import Robot, Scenario

SIX_AXES = task_file.load(TASKS / "dst_six_axes_task.yaml")


def with_object(task: Task, position: tuple[float, float, float]) -> Task:
    """Return the task with its object somewhere else."""
    nominal = replace(task.file.object.nominal, position=position)
    return replace(task, file=replace(task.file, object=replace(task.file.object, nominal=nominal)))


def test_the_shipped_cell_begins_at_rest_and_keeps_its_numbers() -> None:
    truth = cell_truth.placed(Scenario(), {}, shipped_task())
    rest = (*shipped_task().file.arm.rest_joints, 0.0)
    assert truth == replace(Scenario(), robot=replace(Robot(), start=rest))


def test_an_arm_of_another_urdf_stands_at_its_rest_pose() -> None:
    robot = cell_truth.placed(Scenario(), {}, SIX_AXES).robot
    there, _ = ArmPlant(robot).tcp(robot.start)
    assert there == pytest.approx(SIX_AXES.file.waypoints[0].pose.position, abs=1e-9)
    assert robot.start == (*SIX_AXES.file.arm.rest_joints, 0.0)


def test_a_linear_axis_begins_where_the_tool_is_at_the_first_waypoint() -> None:
    file = shipped_task().file
    first = file.waypoints[0]
    pose = replace(first.pose, position=(1.80, 0.25, 1.10))
    file = replace(file, waypoints=(replace(first, pose=pose), *file.waypoints[1:]))
    robot = cell_truth.placed(Scenario(), {}, replace(shipped_task(), file=file)).robot
    assert robot.start[6] == pytest.approx(0.25)


def test_a_file_that_gives_a_value_keeps_it() -> None:
    task = with_object(SIX_AXES, (2.0, 0.1, 1.0))
    silent = cell_truth.placed(Scenario(), {}, task)
    assert silent.body.nominal == (2.0, 0.1, 1.0)
    given = {"body": {"nominal": [0, 0, 0]}, "robot": {"start": [0] * 7}}
    spoken = cell_truth.placed(Scenario(), given, task)
    assert spoken.body.nominal == Scenario().body.nominal
    assert spoken.robot.start == Scenario().robot.start


def test_speed_and_camera_are_those_of_the_task() -> None:
    file = SIX_AXES.file
    mount = PoseFile((0.05, 0.0, -0.1), (0.9659258262890683, 0.0, 0.25881904510252074, 0.0))
    arm, conveyor = replace(file.arm, camera_in_tcp=mount), file.conveyor
    conveyor = replace(conveyor, nominal_speed=0.04)
    task = replace(SIX_AXES, file=replace(file, arm=arm, conveyor=conveyor))
    truth = cell_truth.placed(Scenario(), {}, task)
    assert truth.conveyor.nominal_speed == 0.04
    assert truth.camera.position_in_tcp == (0.05, 0.0, -0.1)
    assert truth.camera.rotation_in_tcp == pytest.approx((0.0, 0.5235987755982988, 0.0))


def test_a_camera_may_be_turned_by_half_a_turn() -> None:
    file = SIX_AXES.file
    arm = replace(file.arm, camera_in_tcp=PoseFile((0.05, 0.0, -0.1), (0.0, 0.0, 0.0, 1.0)))
    truth = cell_truth.placed(Scenario(), {}, replace(SIX_AXES, file=replace(file, arm=arm)))
    assert truth.camera.rotation_in_tcp == pytest.approx((0.0, 0.0, math.pi))


def test_an_object_with_other_axes_is_refused() -> None:
    nominal = replace(SIX_AXES.file.object.nominal, quaternion=(1.0, 0.0, 0.0, 0.0))
    file = replace(SIX_AXES.file, object=replace(SIX_AXES.file.object, nominal=nominal))
    with pytest.raises(SetupError, match=r"object\.nominal\.quaternion"):
        cell_truth.placed(Scenario(), {}, replace(SIX_AXES, file=file))


def test_limits_are_those_of_the_arm_with_an_axis_that_rests() -> None:
    slow = SIX_AXES.urdf.replace('velocity="1.8325957145940461"', 'velocity="1.0"')
    limits = cell_truth.axis_limits(slow, SIX_AXES.file)
    assert limits[0].speed == 1.0
    assert limits[6] == LIMITS[6]
    assert cell_truth.axis_limits(shipped_task().urdf, shipped_task().file) is LIMITS


def test_a_urdf_that_is_no_arm_of_the_cell_names_the_file() -> None:
    broken = SIX_AXES.urdf.replace('"A6" type="revolute"', '"A6" type="fixed"')
    with pytest.raises(SetupError, match=r"dst_six_axes\.urdf: 5 revolute joints"):
        cell_truth.axis_limits(broken, SIX_AXES.file)


def test_a_sensor_mounted_otherwise_is_refused() -> None:
    arm = replace(SIX_AXES.file.arm, sensor_sign=-1)
    with pytest.raises(SetupError, match="sensor_sign"):
        cell_truth.placed(Scenario(), {}, replace(SIX_AXES, file=replace(SIX_AXES.file, arm=arm)))
