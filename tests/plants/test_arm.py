"""Laws of the arm: the team's geometry, against a product of rotations written separately."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from linemate.simulators.plants import rotation
from linemate.simulators.plants.arm import ArmPlant
from linemate.simulators.plants.scenario import DenavitHartenbergLink, Robot

ARM = ArmPlant(Robot())

# Axes and points at A = 0, as the geometry names them: direction, point on the axis.
AXES = (
    ((0, 0, -1), (0.0, 0.0, 0.0)),
    ((0, 1, 0), (0.350, 0.0, 0.675)),
    ((0, 1, 0), (1.500, 0.0, 0.675)),
    ((-1, 0, 0), (2.700, 0.0, 0.634)),
    ((0, 1, 0), (2.700, 0.0, 0.634)),
    ((-1, 0, 0), (2.700, 0.0, 0.634)),
)
FLANGE = np.array([[0, 0, 1, 2.915], [0, 1, 0, 0], [-1, 0, 0, 0.634], [0, 0, 0, 1.0]])
TCP_IN_FLANGE = np.array([[0, 0, -1, -0.35], [0, 1, 0, 0], [1, 0, 0, 0.20], [0, 0, 0, 1.0]])


def by_screws(joints: tuple[float, ...]) -> np.ndarray:
    """Product of rotations about the axes at zero, then the tool."""
    total = np.eye(4)
    total[1, 3] = joints[6]
    for (direction, point), q in zip(AXES, joints, strict=False):
        turn = Rotation.from_rotvec(q * np.array(direction, dtype=float)).as_matrix()
        move = np.eye(4)
        move[:3, :3] = turn
        move[:3, 3] = np.array(point) - turn @ np.array(point)
        total = total @ move
    return np.asarray(total @ FLANGE @ TCP_IN_FLANGE)


@given(st.tuples(*[st.floats(-math.pi, math.pi)] * 6, st.floats(-2.0, 4.0)))
def test_denavit_hartenberg_is_the_product_of_rotations(joints: tuple[float, ...]) -> None:
    tcp = rotation.matrix(ARM.tcp(joints))
    assert np.abs(tcp - by_screws(joints)).max() < 1e-12


def test_the_flange_at_zero_is_where_the_geometry_says() -> None:
    assert rotation.matrix(ARM.flange((0.0,) * 7)) == pytest.approx(FLANGE, abs=1e-12)


def test_the_flange_at_home_stands_upright() -> None:
    q = math.pi / 2
    flange = rotation.matrix(ARM.flange((0.0, -q, q, 0.0, 0.0, 0.0, 0.25)))
    expected = FLANGE.copy()
    expected[:3, 3] = (0.350 + 1.200 + 0.215, 0.25, 0.675 + 1.150 - 0.041)
    assert flange == pytest.approx(expected, abs=1e-12)


def test_with_the_flange_down_the_tcp_looks_into_the_car() -> None:
    tcp = rotation.matrix(ARM.tcp(Robot().start))
    assert tcp[:3, :3] == pytest.approx(np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]), abs=1e-12)
    assert tcp[:3, 3] == pytest.approx((1.90, 0.0, 1.369), abs=1e-12)


def test_a_skew_axis_of_another_arm_is_taken_from_its_table() -> None:
    links = tuple(DenavitHartenbergLink(0.3, 0.1, 0.2, 0.1) for _ in range(6))
    arm = ArmPlant(Robot(links=links, tcp_position=(0, 0, 0), tcp_rotation=(math.pi, 0, 0)))
    q = (0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7)
    total = np.eye(4)
    total[1, 3] = q[6]
    for angle in q[:6]:
        before, after = np.eye(4), np.eye(4)
        before[:3, :3] = Rotation.from_euler("x", 0.3).as_matrix()
        before[0, 3] = 0.1
        after[:3, :3] = Rotation.from_euler("z", angle + 0.1).as_matrix()
        after[2, 3] = 0.2
        total = total @ before @ after
    assert np.abs(rotation.matrix(arm.tcp(q)) - total).max() < 1e-12
