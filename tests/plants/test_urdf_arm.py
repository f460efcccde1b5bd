"""The plant's arm by a URDF against the daemon's own kinematics of the same text."""

import math
from pathlib import Path

import numpy as np
import pytest

from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.core.control import kinematics
from linemate.simulators import harness
from linemate.simulators.plants import rotation, urdf_arm
from linemate.simulators.plants.arm import ArmPlant
from linemate.simulators.plants.scenario import Robot
from linemate.simulators.plants.urdf_arm import UNLIMITED, UrdfArmError

SIX_AXES = Path(harness.__path__[0]) / "data" / "tasks" / "dst_six_axes.urdf"
RAIL = (DAEMON_DATA / "arm.urdf").read_text()
FIXED = SIX_AXES.read_text()
SKEW = """<robot name="skew"><link name="root"/><link name="base"/><link name="l1"/>
  <link name="l2"/><link name="l3"/><link name="l4"/><link name="l5"/><link name="l6"/>
  <link name="flange"/>
  <joint name="mount" type="fixed"><parent link="root"/><child link="base"/>
    <origin xyz="0.3 -0.2 0.5" rpy="0.3 -0.2 0.7"/></joint>
  <joint name="A1" type="revolute"><parent link="base"/><child link="l1"/>
    <origin xyz="0.1 0.2 0.3"/><axis xyz="0 1 1"/>
    <limit lower="-3" upper="3" effort="0" velocity="2"/></joint>
  <joint name="A2" type="revolute"><parent link="l1"/><child link="l2"/>
    <origin xyz="0.2 0.1 0" rpy="0.1 0 0"/><axis xyz="0 2 0"/>
    <limit lower="-3" upper="3" effort="0" velocity="2"/></joint>
  <joint name="A3" type="revolute"><parent link="l2"/><child link="l3"/>
    <origin xyz="0.5 0.05 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="0" velocity="2"/></joint>
  <joint name="A4" type="revolute"><parent link="l3"/><child link="l4"/>
    <origin xyz="0.4 0 0.1"/><axis xyz="1 0 0"/>
    <limit lower="-3" upper="3" effort="0" velocity="2"/></joint>
  <joint name="A5" type="revolute"><parent link="l4"/><child link="l5"/>
    <origin xyz="0.1 0 0"/><axis xyz="0 1 0.2"/>
    <limit lower="-3" upper="3" effort="0" velocity="2"/></joint>
  <joint name="A6" type="revolute"><parent link="l5"/><child link="l6"/>
    <origin xyz="0 0 0"/><axis xyz="-1 0 0"/>
    <limit lower="-3" upper="3" effort="0" velocity="2"/></joint>
  <joint name="end" type="fixed"><parent link="l6"/><child link="flange"/>
    <origin xyz="0.08 0.01 0" rpy="0 1.57 0"/></joint>
</robot>"""
TCP = ((-0.35, 0.1, 0.20), rotation.exp((0.2, -1.5, 0.4)))


@pytest.mark.parametrize(
    ("urdf", "rail"), [(RAIL, True), (FIXED, False), (SKEW, False)], ids=["rail", "fixed", "skew"]
)
def test_both_readers_put_the_tcp_at_the_same_place(urdf: str, rail: bool) -> None:
    arm = urdf_arm.read(urdf, "flange")
    position, turned = urdf_arm.tool(arm, TCP)
    root = arm.root[0], rotation.log(arm.root[1])
    plant = ArmPlant(
        Robot(
            root_position=root[0],
            root_rotation=root[1],
            links=arm.links,
            tcp_position=position,
            tcp_rotation=turned,
        )
    )
    matrix = np.array(TCP[1]).reshape(3, 3)
    daemon = kinematics.load(urdf, "flange", np.array(TCP[0]), matrix, linear_axis=rail)
    draws = np.random.default_rng(1)
    for _ in range(20):
        joints = draws.uniform(-2.5, 2.5, 7) * (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, rail)
        there, frame = daemon.tcp_in_base(joints[: daemon.axes])
        plant_there, plant_frame = plant.tcp(tuple(joints.tolist()))
        assert there == pytest.approx(plant_there, abs=1e-12)
        assert frame.ravel() == pytest.approx(plant_frame, abs=1e-12)


def test_a_table_is_that_of_the_shipped_data_sheet() -> None:
    links = urdf_arm.read(RAIL, "flange").links
    assert [link.a for link in links] == [0.0, 0.350, 1.150, -0.041, 0.0, 0.0]
    assert [link.d for link in links] == [-0.675, 0.0, 0.0, -1.2, 0.0, -0.215]


def test_limits_come_from_the_urdf_and_a_missing_one_is_wide() -> None:
    limit = '<limit lower="-3" upper="3" effort="0" velocity="2"/>'
    text = SKEW.replace(limit, '<limit lower="-1" upper="2"/>', 1)
    limits = urdf_arm.read(text, "flange").limits
    assert (limits[0].low, limits[0].high, limits[0].speed) == (-1.0, 2.0, UNLIMITED)
    assert (limits[5].speed, limits[5].jerk) == (2.0, UNLIMITED)
    rail = urdf_arm.read(RAIL, "flange").limits
    assert len(rail) == 7
    assert (rail[6].low, rail[6].high) == (-1.5, 6.0)


def test_a_tool_turned_by_half_a_turn_has_a_rotation_vector() -> None:
    arm = urdf_arm.read(RAIL, "flange")
    inverse = rotation.transpose(arm.flange[1])
    half = rotation.compose(inverse, (1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0))
    _, turned = urdf_arm.tool(arm, ((0.0, 0.0, 0.0), half))
    assert math.hypot(*turned) == pytest.approx(math.pi)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("<robot", "not a URDF"),
        (RAIL.replace('<axis xyz="0 1 0"/>', '<axis xyz="1 0 0"/>', 1), "along y"),
        (FIXED.replace('"A6" type="revolute"', '"A6" type="fixed"'), "5 revolute joints"),
        (FIXED.replace('"A6" type="revolute"', '"A6" type="prismatic"'), "prismatic is no axis"),
        (FIXED.replace('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 0"/>'), "no direction"),
        (FIXED.replace('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 x"/>'), "three numbers"),
        (FIXED.replace('jerk="15000"', 'jerk="fast"'), "is no number"),
    ],
)  # fmt: skip
def test_a_urdf_that_is_no_emulated_arm_is_refused_with_the_reason(text: str, what: str) -> None:
    with pytest.raises(UrdfArmError, match=what):
        urdf_arm.read(text, "flange")


def test_a_flange_that_no_joint_leads_to_is_named() -> None:
    with pytest.raises(UrdfArmError, match="'tool0'"):
        urdf_arm.read(FIXED, "tool0")
