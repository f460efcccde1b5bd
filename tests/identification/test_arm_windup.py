"""Windup of the axes from images: found where it is, and nowhere else."""

import math
from functools import cache

import numpy as np
import pytest
from traces import CAMERA, Sight, seen, trace, without

from linemate.daemon.core import rotations
from linemate.daemon.core.control.settings import AxisWindup
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.settings import CameraNoise
from linemate.daemon.identification.arm_windup import ArmWindup, bent_trace, identify_arm_windup
from linemate.daemon.identification.outcome import Estimate, Refusal
from linemate.daemon.identification.scene_fit import Views, views
from linemate.daemon.identification.swing import find_swings
from linemate.daemon.identification.trace import Trace

LEVER = 2.0  # of the first three axes [m]
TRAVEL = 3e-3
DEPTHS = (0.6e-3, 0.4e-3, 0.0)
NOMINAL = np.eye(3)


def kinematics(joints: Array) -> tuple[Array, Array]:
    """Three axes move the tcp, three turn it."""
    return LEVER * joints[:3], rotations.exp(joints[3:6])


def led(links: Array, depth: float) -> Array:
    """Motor positions (m,) that bring a link along a path."""
    motor, w, rows = float(links[0]), 0.0, []
    for link in links.tolist():
        goal = motor
        for _ in range(60):
            way = goal - motor
            end = math.copysign(1.0, way)
            turned = end + (w - end) * math.exp(-abs(way) / TRAVEL) if way else w
            goal = link + depth * turned
        motor, w = goal, turned
        rows.append(motor)
    return np.array(rows)


@cache
def recording(depths: tuple[float, ...] = DEPTHS, slow: float = 0.0, seed: int = 0) -> Trace:
    """What is recorded with an arm whose first axes wind up."""
    true = seen(Sight(moving=0.08, range_swing=0.08, slow=slow, seed=seed))
    links = np.column_stack((true.tcp[:, :3] / LEVER, true.tcp[:, 3:]))
    motors = links.copy()
    for axis, depth in enumerate(depths):
        motors[:, axis] = led(links[:, axis], depth)
    reported = np.column_stack((LEVER * motors[:, :3], motors[:, 3:]))
    return without(true, tcp=reported, motors=motors)


def look(each: Trace) -> list[Views]:
    return views(each, CAMERA, CameraNoise())


@cache
def found(depths: tuple[float, ...] = DEPTHS) -> ArmWindup:
    return identify_arm_windup([recording(depths)], look, CAMERA, kinematics, NOMINAL)


@pytest.mark.row
def test_the_depth_of_each_axis_is_found_within_its_deviation() -> None:
    for outcome, true in zip(found().depths, (*DEPTHS, 0.0, 0.0, 0.0), strict=True):
        assert isinstance(outcome, Estimate)
        assert abs(outcome.value - true) < 4.0 * outcome.deviation + 0.02e-3


def test_only_axes_that_wind_up_get_settings() -> None:
    axes = found().axes
    assert [each.depth > 0.0 for each in axes] == [True, True, False, False, False, False]
    assert 1.5e-3 <= axes[0].travel <= 5e-3


@pytest.mark.row
def test_an_arm_without_windup_gets_none() -> None:
    assert found((0.0, 0.0, 0.0)).axes == ()


@pytest.mark.row
def test_correlated_errors_of_the_camera_are_in_the_deviations() -> None:
    slow = recording((0.0, 0.0, 0.0), slow=1.0, seed=1)
    result = identify_arm_windup([slow], look, CAMERA, kinematics, NOMINAL)
    known = [each for each in result.depths if isinstance(each, Estimate)]
    assert result.axes == ()
    assert max(abs(each.value) / each.deviation for each in known[:3]) < 3.0


@pytest.mark.row
def test_windup_makes_false_swings_until_it_is_known() -> None:
    bent = bent_trace(recording(), found().axes, kinematics, NOMINAL)
    chi2 = []
    for each in (recording(), bent):
        scene = find_swings(look(each), CAMERA)
        assert scene is not None
        chi2.append(scene.chi2 + 0.5 * (len(scene.modes) - 1))
    assert chi2[1] < 1.15 < chi2[0]


def test_too_few_images_are_refused() -> None:
    blind = trace(tcp=np.zeros((200, 6)))
    result = identify_arm_windup([blind], look, CAMERA, kinematics, NOMINAL)
    assert result.axes == ()
    assert all(isinstance(outcome, Refusal) for outcome in result.depths)


@pytest.mark.parametrize("travel", [1e-3, 10e-3])
def test_a_bent_trace_lies_where_the_links_are(travel: float) -> None:
    straight = recording((0.0, 0.0, 0.0))
    bent = bent_trace(straight, (AxisWindup(0.5e-3, travel),), kinematics, NOMINAL)
    off = (straight.tcp - bent.tcp)[-500:, 0]
    assert 0.7e-3 < np.abs(off).max() / (0.5 * LEVER) < 1.001e-3
    assert np.abs(straight.tcp[:, 1:] - bent.tcp[:, 1:]).max() < 1e-9
