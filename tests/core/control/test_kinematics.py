"""Kinematics: forwards and backwards are inverse, and what cannot be says why."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from linemate.daemon.config import task_file
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.core import rotations
from linemate.daemon.core.control import kinematics
from linemate.daemon.core.control.kinematics import Arm, KinematicsError, UnreachableError
from linemate.daemon.core.control.settings import AxisGeometry
from linemate.daemon.core.horizon import Array

TASK = task_file.load(DAEMON_DATA / "wheel.yaml")
URDF = TASK.urdf
TOOL = (np.array((-0.35, 0.0, 0.20)), rotations.exp(np.array((0.0, -np.pi / 2, 0.0))))


def load(
    urdf: str = URDF,
    flange: str = "flange",
    *,
    linear_axis: bool = True,
    geometry: Sequence[AxisGeometry] = (),
) -> Arm:
    return kinematics.load(urdf, flange, *TOOL, linear_axis=linear_axis, geometry=geometry)


def fixed(urdf: str) -> str:
    """The same arm without its linear axis."""
    return re.sub(r'(<joint name="[^"]*" type=")prismatic(")', r"\1fixed\2", urdf)


NOMINAL = rotations.exp(np.array((0.1, 1.5, -0.2)))


def tiled(position: Array | tuple[float, ...], rotation: Array) -> Array:
    return np.tile(np.concatenate((position, rotations.log(rotation))), (3, 1))


ARM = load()
FIXED_ARM = load(fixed(URDF), linear_axis=False)

# Away from the wrist's and the elbow's singularities, within the limits.
poses = st.tuples(
    st.floats(-1.0, 1.0),
    st.floats(-2.0, -0.6),
    st.floats(0.5, 2.2),
    st.floats(-1.5, 1.5),
    st.floats(0.4, 1.6),
    st.floats(-1.5, 1.5),
    st.floats(0.0, 4.0),
).map(np.array)


@settings(max_examples=60, deadline=None)
@given(poses, st.lists(st.floats(-0.08, 0.08), min_size=6, max_size=6))
def test_backwards_undoes_forwards_from_a_guess_nearby(joints: Array, off: list[float]) -> None:
    guess = joints + np.array((*off, 0.0))
    assert np.allclose(ARM.solve(guess, *ARM.tcp_in_base(joints)), joints, atol=1e-7)


@settings(max_examples=60, deadline=None)
@given(poses)
def test_the_pose_in_another_frame_is_the_pose_in_base_turned(joints: Array) -> None:
    position, rotation = ARM.tcp_in_base(joints)
    pose = ARM.tcp_in(NOMINAL, joints)
    assert np.allclose(NOMINAL @ pose[:3], position, atol=1e-12)
    assert np.allclose(NOMINAL @ rotations.exp(pose[3:]), rotation, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(poses)
def test_forwards_undoes_backwards_from_rest(joints: Array) -> None:
    position, rotation = ARM.tcp_in_base(joints)
    rest = np.array((*TASK.file.arm.rest_joints, joints[6]))
    try:
        found = ARM.solve(rest, position, rotation)
    except UnreachableError:
        # Newton from far away may end in a singularity; it must say so, never lie.
        return
    back = ARM.tcp_in_base(found)
    assert np.allclose(back[0], position, atol=1e-8)
    assert np.allclose(back[1], rotation, atol=1e-8)
    assert found[6] == joints[6]


def test_the_geometry_is_that_of_the_station() -> None:
    """Facts of the cell, written down by hand: flange and axes at zero and at home."""
    bare = kinematics.load(URDF, "flange", np.zeros(3), np.eye(3), linear_axis=True)
    position, rotation = bare.tcp_in_base(np.zeros(7))
    assert np.allclose(position, (2.915, 0.0, 0.634), atol=1e-12)
    assert np.allclose(rotation.T, ((0, 0, -1), (0, 1, 0), (1, 0, 0)), atol=1e-12)
    home = np.array((0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0, 1.5))
    position, rotation = bare.tcp_in_base(home)
    # The upper arm stands up, the forearm points along X: 1.15 m up, its 1.2 m ahead.
    assert np.allclose(position, (0.35 + 1.2 + 0.215, 1.5, 0.675 + 1.15 - 0.041), atol=1e-12)
    assert np.allclose(rotation[:, 2], (1, 0, 0), atol=1e-12)


@pytest.mark.parametrize(
    ("axis", "direction"),
    [
        (0, (0, 0, -1)),
        (1, (0, 1, 0)),
        (2, (0, 1, 0)),
        (3, (-1, 0, 0)),
        (4, (0, 1, 0)),
        (5, (-1, 0, 0)),
    ],
)
def test_each_axis_turns_the_way_of_the_makers_arm(
    axis: int, direction: tuple[float, float, float]
) -> None:
    joints = np.zeros(7)
    _, before = ARM.tcp_in_base(joints)
    joints[axis] = 0.3
    _, after = ARM.tcp_in_base(joints)
    assert np.allclose(rotations.log(after @ before.T), 0.3 * np.array(direction), atol=1e-12)


def test_the_shipped_rest_is_the_tasks_first_pose() -> None:
    point = TASK.file.waypoints[0].pose
    position, rotation = ARM.tcp_in_base(np.array((*TASK.file.arm.rest_joints, 0.0)))
    assert np.allclose(position, point.position, atol=1e-6)
    assert np.allclose(rotation, rotations.matrix(point.quaternion), atol=1e-6)


@settings(max_examples=30, deadline=None)
@given(poses, st.floats(-1.0, 1.0))
def test_the_linear_axis_carries_the_arm_along_y(joints: Array, way: float) -> None:
    before = ARM.tcp_in_base(joints)
    after = ARM.tcp_in_base(joints + way * np.eye(7)[6])
    assert np.allclose(after[0] - before[0], (0.0, way, 0.0), atol=1e-12)
    assert np.allclose(after[1], before[1], atol=1e-12)
    still = FIXED_ARM.tcp_in_base(joints[:6])
    assert np.allclose(still[0] + (0.0, joints[6], 0.0), before[0], atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(poses, st.integers(0, 6))
def test_the_jacobian_behind_the_solver_is_the_derivative_of_the_pose(
    joints: Array, axis: int
) -> None:
    h = 1e-6
    step = h * np.eye(7)[axis]
    (p1, R1), (p0, R0) = ARM.tcp_in_base(joints + step), ARM.tcp_in_base(joints - step)
    q = np.concatenate((joints[6:], joints[:6]))
    pin.computeJointJacobians(ARM.model, ARM.data, q)
    pin.updateFramePlacement(ARM.model, ARM.data, ARM.flange)
    world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    J = pin.getFrameJacobian(ARM.model, ARM.data, ARM.flange, world)[:, (axis + 1) % 7]
    flange = ARM.data.oMf[ARM.flange].translation
    arm = ARM.tcp_in_base(joints)[0] - flange
    turning = rotations.log(R1 @ R0.T) / (2 * h)
    assert np.allclose(turning, J[3:], atol=1e-7)
    assert np.allclose((p1 - p0) / (2 * h), J[:3] + np.cross(J[3:], arm), atol=1e-7)


def twists(arm: Arm, joints: Array, poses: Array) -> Array:
    """Return the twists (m, 6) [m, rad] in the tcp's axes from joints (m, axes) to poses (m, 6)."""
    rows = []
    for row, pose in zip(joints, poses, strict=True):
        position, rotation = arm.tcp_in_base(row)
        target = pin.SE3(NOMINAL @ rotations.exp(pose[3:]), NOMINAL @ pose[:3])
        rows.append(pin.log6(pin.SE3(rotation, position).actInv(target)).vector)
    return np.array(rows)


def body_jacobian(arm: Arm, joints: Array) -> Array:
    """Return the Jacobian (6, 6) of the tcp by A1..A6, in the tcp's axes."""
    q = np.roll(joints, 1) if arm.linear_axis else joints
    J: Array = pin.computeFrameJacobian(arm.model, arm.data, q, arm.tcp, pin.ReferenceFrame.LOCAL)
    return J[:, -6:]


@settings(max_examples=25, deadline=None)
@given(poses, st.integers(0, 1000))
@example(np.array((0.0, -2.0, 0.5, 0.0, 0.5, 0.0, 0.0)), 148)
@pytest.mark.parametrize("arm", [ARM, FIXED_ARM], ids=["with E1", "without"])
def test_one_newton_step_leaves_what_the_change_of_the_jacobian_explains(
    arm: Arm, joints: Array, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    count = 9
    # Ten millimetres along a list, the guesses off by what one step changes.
    wanted = joints[: arm.axes] + np.outer(np.linspace(0, 1, count), rng.normal(0, 0.005, arm.axes))
    guesses = wanted + rng.normal(0, 5e-5, wanted.shape)
    if arm.linear_axis:
        guesses[:, 6] = wanted[:, 6]
    poses = np.array([arm.tcp_in(NOMINAL, row) for row in wanted])
    found = arm.follow(guesses, poses, NOMINAL)
    if arm.linear_axis:
        assert np.array_equal(found[:, 6], guesses[:, 6])
    # One Jacobian J serves the list: of an error e, (1 - J_i / J) e is left, and a second order.
    errors = twists(arm, guesses, poses)
    J = body_jacobian(arm, guesses[count // 2])
    changes = np.array([np.eye(6) - body_jacobian(arm, row) @ np.linalg.inv(J) for row in guesses])
    steps = np.linalg.solve(J, errors.T).T
    second_order = 10.0 * float((steps * steps).sum(axis=1).max())
    left = twists(arm, found, poses)
    expected = (changes @ errors[:, :, None])[:, :, 0]
    assert np.abs(left - expected).max() < second_order
    share = float(np.abs(changes).sum(axis=2).max())
    if share > 0.5:
        return  # next to a singularity, as in the explicit example: no contraction
    # The answers are the next step's guesses: errors die out from step to step.
    later = twists(arm, arm.follow(found, poses, NOMINAL), poses)
    assert np.abs(later).max() <= 1.2 * share * np.abs(left).max() + second_order
    # Where the guesses' own poses are known, only the ends are solved for exactly. In between the
    # change is taken in the axes of the first pose: its share is the angle from that one.
    before = np.array([arm.tcp_in(NOMINAL, row) for row in guesses])
    again = arm.follow(guesses, poses, NOMINAL, before)
    assert np.abs(again[[0, -1]] - found[[0, -1]]).max() < 1e-12
    beyond = twists(arm, again, poses) - left
    angle = float(np.linalg.norm(poses[:, 3:] - poses[0, 3:], axis=1).max())
    assert np.abs(beyond).max() < 2.0 * angle * float(np.linalg.norm(errors, axis=1).max())


def test_a_list_that_starts_far_off_is_solved_one_by_one() -> None:
    rest = np.array((*TASK.file.arm.rest_joints, 0.0))
    wanted = rest + np.outer(np.linspace(0.1, 0.15, 5), np.array((1, 1, -1, 1, 1, 1, 0)))
    targets = [ARM.tcp_in_base(row) for row in wanted]
    poses = np.array([ARM.tcp_in(NOMINAL, row) for row in wanted])
    found = ARM.follow(np.tile(rest, (5, 1)), poses, NOMINAL)
    for row, (position, rotation) in zip(found, targets, strict=True):
        p, R = ARM.tcp_in_base(row)
        assert np.allclose(p, position, atol=3e-5)
        assert np.allclose(R, rotation, atol=3e-5)


@pytest.mark.parametrize("position", [(9.0, 0.0, 1.0), (0.0, 0.0, 5.0), (2.0, 4.0, 1.0)])
def test_a_pose_out_of_reach_is_an_error_that_holds_what_was_left(
    position: tuple[float, float, float],
) -> None:
    rest = np.array((*TASK.file.arm.rest_joints, 0.0))
    rotation = ARM.tcp_in_base(rest)[1]
    with pytest.raises(UnreachableError) as caught:
        ARM.solve(rest, np.array(position), rotation)
    assert caught.value.residual > 1e-3
    assert "does not reach" in str(caught.value)
    with pytest.raises(UnreachableError):
        ARM.follow(np.tile(rest, (3, 1)), tiled(position, rotation), np.eye(3))


@pytest.mark.parametrize("count", [5, 30])
def test_a_list_far_off_takes_little_more_than_an_iteration_a_pose(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = 0
    jacobian = pin.computeFrameJacobian

    def counted(*outcome: Any) -> Array:
        nonlocal made
        made += 1
        found: Array = jacobian(*outcome)
        return found

    rest = np.array((*TASK.file.arm.rest_joints, 0.0))
    way = np.outer(np.linspace(0.1, 0.1 + 0.01 * count, count), np.array((1, 1, -1, 1, 1, 1, 0)))
    poses = np.array([ARM.tcp_in(NOMINAL, row) for row in rest + way])
    monkeypatch.setattr(pin, "computeFrameJacobian", counted)
    ARM.follow(rest + way - way[0], poses, NOMINAL)
    assert made <= kinematics.MOST_IN_CYCLE + 2 * count
    # What is out of reach at its far end costs nothing but that end.
    made, beyond = 0, poses.copy()
    beyond[-1, :3] += 9.0
    with pytest.raises(UnreachableError):
        ARM.follow(rest + way - way[0], beyond, NOMINAL)
    assert made <= kinematics.MOST_IN_CYCLE


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_pose_that_is_no_number_is_unreachable(bad: float) -> None:
    rest = np.array((*TASK.file.arm.rest_joints, 0.0))
    position, rotation = ARM.tcp_in_base(rest)
    position[1] = bad
    with pytest.raises(UnreachableError):
        ARM.follow(np.tile(rest, (3, 1)), tiled(position, rotation), np.eye(3))


def test_a_singular_arm_stops_and_does_not_crash() -> None:
    home = np.array((0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0, 0.0))
    position, rotation = ARM.tcp_in_base(home)
    with pytest.raises(UnreachableError):
        ARM.follow(np.tile(home, (3, 1)), tiled(position, rotation), np.eye(3))


def test_limits_come_in_the_controllers_order() -> None:
    assert len(ARM.lower) == len(ARM.upper) == ARM.axes == 7
    assert (ARM.lower < ARM.upper).all()
    assert np.array_equal(ARM.lower[:6], FIXED_ARM.lower)
    assert FIXED_ARM.axes == 6
    # E1 is metres of travel along the line, last and not first.
    e1 = re.search(r'type="prismatic".*?lower="([-\d.]+)"\s+upper="([-\d.]+)"', URDF, re.DOTALL)
    assert e1 is not None
    assert (ARM.lower[6], ARM.upper[6]) == (float(e1[1]), float(e1[2]))


def typed(name: str, kind: str) -> str:
    """Return the shipped URDF with another type of a joint."""
    return re.sub(f'(name="{name}" type=)"[a-z]+"', f'\\1"{kind}"', URDF)


@pytest.mark.parametrize(
    ("urdf", "flange", "linear_axis", "says"),
    [
        ("", "flange", True, "not a URDF"),
        ("<robot/>", "flange", True, "not a URDF"),
        ("no xml at all", "flange", True, "not a URDF"),
        (URDF[: len(URDF) // 2], "flange", True, "not a URDF"),
        (URDF, "flansch", True, "no frame 'flansch'"),
        (URDF, "flange", False, "7 joints, the task's arm has 6"),
        (fixed(URDF), "flange", True, "6 joints, the task's arm has 7"),
        (typed("A3", "prismatic"), "flange", True, "joint A3 of the URDF should be revolute"),
        (typed("A6", "continuous"), "flange", True, "joint A6 of the URDF should be revolute"),
        (typed("E1", "revolute"), "flange", True, "joint E1 of the URDF should be prismatic"),
    ],
)
def test_a_urdf_that_cannot_be_says_what_is_wrong(
    urdf: str, flange: str, linear_axis: bool, says: str
) -> None:
    with pytest.raises(KinematicsError, match=re.escape(says)):
        load(urdf, flange, linear_axis=linear_axis)


def test_a_missing_flange_is_answered_with_the_frames_there_are() -> None:
    with pytest.raises(KinematicsError, match=r"it has .*flange"):
        load(flange="tool0")


@pytest.mark.parametrize("short", [0.01, -0.003])
def test_the_arm_makes_up_for_a_linear_axis_that_is_behind(short: float) -> None:
    joints = np.array((0.1, -1.4, 1.5, 0.2, 1.2, -0.1, 0.5))
    position, rotation = ARM.tcp_in_base(joints)
    behind = joints.copy()
    behind[6] -= short
    behind[:6] += ARM.stand_in(joints, short)
    place, turned = ARM.tcp_in_base(behind)
    assert np.abs(place - position).max() < 0.02 * abs(short)
    assert np.abs(turned - rotation).max() < 0.02 * abs(short)


MIDDLE = np.array((0.3, -1.2, 1.4, 0.5, 1.1, -0.4, 0.7))


def of_axis(axis: int, **frame: tuple[float, float, float]) -> list[AxisGeometry]:
    return [AxisGeometry(**frame) if i == axis else AxisGeometry() for i in range(6)]


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("linear_axis", [True, False])
def test_a_turn_about_an_axis_is_an_error_of_its_zero(axis: int, linear_axis: bool) -> None:
    urdf, joints = (URDF, MIDDLE) if linear_axis else (fixed(URDF), MIDDLE[:6])
    arm = load(urdf, linear_axis=linear_axis)
    x, y, z = (1e-3 * arm.axis_frames()[axis][2]).tolist()
    measured = load(urdf, linear_axis=linear_axis, geometry=of_axis(axis, turn=(x, y, z)))
    turned = joints.copy()
    turned[axis] += 1e-3
    for part, expected in zip(measured.tcp_in_base(joints), arm.tcp_in_base(turned), strict=True):
        assert np.allclose(part, expected, atol=1e-12)


def test_a_shift_is_another_length_in_the_frame_of_the_axis() -> None:
    text = 'xyz="1.150 0 0"'
    assert URDF.count(text) == 1
    longer = load(URDF.replace(text, 'xyz="1.151 0 0.0005"'))
    measured = load(geometry=of_axis(2, shift=(1e-3, 0.0, 0.5e-3)))
    assert np.allclose(measured.tcp_in_base(MIDDLE)[0], longer.tcp_in_base(MIDDLE)[0], atol=1e-12)


def test_the_solver_brings_the_measured_tcp_to_a_pose() -> None:
    measured = load(geometry=[AxisGeometry((1e-3, -1e-3, 0.5e-3), (1e-3, 2e-3, -1e-3))] * 6)
    pose = ARM.tcp_in_base(MIDDLE)
    joints = measured.solve(MIDDLE, *pose)
    assert np.abs(joints - MIDDLE).max() > 1e-3
    assert np.allclose(measured.tcp_in_base(joints)[0], pose[0], atol=1e-8)


def test_an_arm_that_was_not_measured_is_that_of_the_urdf_bit_for_bit() -> None:
    for part, same in zip(
        load(geometry=()).tcp_in_base(MIDDLE), ARM.tcp_in_base(MIDDLE), strict=True
    ):
        assert np.array_equal(part, same)
