"""The picture's arm against the daemon's: two kinematics, one URDF."""

import math
from itertools import combinations, pairwise

import numpy as np
import pytest
from cell import TASK
from hypothesis import given, settings
from hypothesis import strategies as st

from linemate.daemon.core import rotations
from linemate.daemon.core.control import kinematics
from linemate.daemon.core.control.settings import AxisGeometry
from linemate.daemon.view import chain

ARM = TASK.file.arm
TOOL: chain.Pose = (*ARM.tcp_in_flange.position, *ARM.tcp_in_flange.quaternion)
DRAWN = chain.read_chain(TASK.urdf, ARM.flange, TOOL, linear_axis=True)
EXACT = kinematics.load(
    TASK.urdf,
    ARM.flange,
    np.array(ARM.tcp_in_flange.position),
    rotations.matrix(ARM.tcp_in_flange.quaternion),
    linear_axis=True,
)
angles = st.floats(-3.0, 3.0)


@settings(max_examples=100, deadline=None)
@given(st.tuples(*[angles] * 6, st.floats(-1.5, 3.0)))
def test_the_tool_is_where_the_daemon_has_it(axes: tuple[float, ...]) -> None:
    points, tcp = DRAWN.place(axes)
    position, rotation = EXACT.tcp_in_base(np.array(axes))
    assert points[-1] == pytest.approx(position, abs=1e-9)
    assert np.array(chain.matrix(tcp[3:])) == pytest.approx(rotation, abs=1e-9)


def test_a_measured_arm_is_drawn_where_the_daemon_has_it() -> None:
    rows = [((1e-3 * i, -1e-3, 2e-3), (5e-4, -1e-3, 1e-3 * i)) for i in range(6)]
    drawn = chain.read_chain(TASK.urdf, ARM.flange, TOOL, linear_axis=True, geometry=rows)
    exact = kinematics.load(
        TASK.urdf,
        ARM.flange,
        np.array(ARM.tcp_in_flange.position),
        rotations.matrix(ARM.tcp_in_flange.quaternion),
        linear_axis=True,
        geometry=[AxisGeometry(*row) for row in rows],
    )
    axes = (0.3, -1.2, 1.4, 0.5, 1.1, -0.4, 0.7)
    position, _ = exact.tcp_in_base(np.array(axes))
    assert drawn.place(axes)[0][-1] == pytest.approx(position, abs=1e-9)
    assert DRAWN.place(axes)[0][-1] != pytest.approx(position, abs=1e-3)


def test_the_joints_are_where_the_arm_was_designed_to_have_them() -> None:
    points, _ = DRAWN.place((0.0,) * 6 + (1.0,))
    rounded = [tuple(round(x, 6) for x in point) for point in points]
    for joint in ((0.35, 1.0, 0.675), (1.5, 1.0, 0.675), (2.7, 1.0, 0.634), (2.915, 1.0, 0.634)):
        assert joint in rounded


def test_the_linear_axis_carries_everything_and_missing_axes_are_zero() -> None:
    here, _ = DRAWN.place((0.3,) * 6)
    there, _ = DRAWN.place((0.3,) * 6 + (0.5,))
    moved = [b[1] - a[1] for a, b in zip(here[1:], there[1:], strict=True)]
    assert moved == pytest.approx([0.5] * len(moved))


@given(st.tuples(angles, angles, angles))
def test_a_rotation_survives_its_quaternion(rpy: tuple[float, float, float]) -> None:
    turn = chain.from_rpy(*rpy)
    assert np.array(chain.matrix(chain.quaternion(turn))) == pytest.approx(np.array(turn))


def test_half_turns_survive_as_well() -> None:
    for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)):
        turn = chain.about(axis, np.pi)
        assert np.array(chain.matrix(chain.quaternion(turn))) == pytest.approx(np.array(turn))


@pytest.mark.parametrize(
    ("urdf", "why"),
    [
        ("<robot", "not a URDF"),
        ("<robot/>", "no joint that leads to 'flange'"),
        (TASK.urdf.replace('xyz="0 0 0.675"', 'xyz="0 zero 0.675"'), "not a vector"),
        (TASK.urdf.replace('xyz="0 0 0.675"', 'xyz="0 nan 0.675"'), "not a vector"),
        (TASK.urdf.replace('axis xyz="0 0 -1"', 'axis xyz="0 0 0"'), "length 0"),
        (TASK.urdf.replace('parent link="rail"', 'parent link="link_a1"'), "loop"),
    ],
)
def test_what_is_no_chain_is_refused_with_its_reason(urdf: str, why: str) -> None:
    with pytest.raises(chain.ChainError, match=why):
        chain.read_chain(urdf, "flange", TOOL, linear_axis=True)


def test_every_axis_moves_something_of_its_own() -> None:
    base = [0.1, -1.2, 1.3, 0.2, 0.9, 0.1, 0.2]
    seen = set()
    for number in range(7):
        axes = list(base)
        axes[number] += 0.1
        seen.add(tuple(round(x, 6) for x in DRAWN.place(axes)[1]))
    assert len(seen) == 7
    assert all(a != b for a, b in combinations(seen, 2))


def test_a_rail_is_drawn_for_an_arm_on_a_linear_axis_alone() -> None:
    assert DRAWN.rail() == ((0.0, -1.5, 0.0), (0.0, 6.0, 0.0))
    on_the_floor = chain.read_chain(
        TASK.urdf.replace('type="prismatic"', 'type="fixed"'), ARM.flange, TOOL, linear_axis=False
    )
    assert on_the_floor.rail() is None
    without_limits = chain.read_chain(
        TASK.urdf.replace('lower="-1.5"', ""), ARM.flange, TOOL, linear_axis=True
    )
    assert without_limits.rail() == ((0.0, -1.5, 0.0), (0.0, 1.5, 0.0))


def test_the_reach_of_an_arm_is_its_stretched_length() -> None:
    points, _ = DRAWN.place([0.0] * 7)
    lengths = [math.dist(a, b) for a, b in pairwise(points)]
    assert DRAWN.reach() == pytest.approx(sum(lengths))
    grown = chain.read_chain(
        TASK.urdf.replace("1.150", "2.150"), ARM.flange, TOOL, linear_axis=True
    )
    assert grown.reach() == pytest.approx(DRAWN.reach() + 1.0)
