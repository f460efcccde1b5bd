"""Limits of an arm: the URDF's, never wider, and never another robot's by default."""

import re
from dataclasses import replace

import pytest

from linemate.daemon.core.control import urdf_limits
from linemate.daemon.core.control.settings import ControlSettings
from linemate.daemon.core.control.urdf_limits import UrdfLimitsError, completed, read, wider
from linemate.simulators.devices.limit_judge import LIMITS
from linemate.simulators.harness.cell.cell_truth import shipped_task
from linemate.simulators.harness.setup import shipped_control

URDF = shipped_task().urdf


def test_the_shipped_limits_are_the_emulated_robots() -> None:
    own = shipped_control().limits
    assert len(own) == len(LIMITS) == 7
    for daemon, robot in zip(own, LIMITS, strict=True):
        assert daemon.lower == pytest.approx(robot.low, rel=1e-12)
        assert daemon.upper == pytest.approx(robot.high, rel=1e-12)
        assert daemon.speed == pytest.approx(robot.speed, rel=1e-12)
        assert daemon.acceleration == robot.acceleration
        assert daemon.jerk == robot.jerk


def test_no_arm_has_limits_that_neither_its_urdf_nor_its_site_gave() -> None:
    assert ControlSettings().limits == ()
    bare = re.sub(r' acceleration="[^"]*" jerk="[^"]*"', "", URDF)
    with pytest.raises(UrdfLimitsError, match=r"joint A1 has no acceleration\. Give control\.lim"):
        read(bare, "flange", linear_axis=True)
    own = shipped_control()
    assert completed(own, bare, "flange", linear_axis=True) is own
    assert wider(own, bare, "flange", linear_axis=True) == []


@pytest.mark.parametrize(
    ("change", "outcome"),
    [
        ({"speed": 3.1}, (3, "speed", "3.1 is wider than the URDF's for A4: 2.37365")),
        ({"upper": 6.2}, (3, "upper", "6.2 is wider than the URDF's for A4: 6.10865")),
        ({"lower": -350.0}, (3, "lower", "-350 is wider than the URDF's for A4: -6.10865")),
        ({"lower": 1.0, "upper": 0.5}, (3, "lower", "1 is not below upper: 0.5")),
    ],
)
def test_limits_beyond_the_urdfs_are_named(
    change: dict[str, float], outcome: tuple[int, str, str]
) -> None:
    rows = list(shipped_control().limits)
    rows[3] = replace(rows[3], **change)
    settings = ControlSettings(limits=tuple(rows))
    assert wider(settings, URDF, "flange", linear_axis=True) == [outcome]


def test_narrower_limits_are_good() -> None:
    rows = tuple(
        replace(row, lower=0.5 * row.lower, upper=row.upper - 0.01, speed=0.5 * row.speed)
        for row in shipped_control().limits
    )
    assert wider(ControlSettings(limits=rows), URDF, "flange", linear_axis=True) == []


@pytest.mark.parametrize(
    ("old", "new", "outcome"),
    [
        ('lower="-2.443460952792061"', 'lower="-140"', "joint A2: lower is -140, at most 12"),
        ('upper="6.0"', 'upper="6000"', "joint E1: upper is 6000, at most 30 m"),
        ('velocity="1.5"', 'velocity="1500"', "joint E1: velocity is 1500"),
        ('velocity="1.5"', 'velocity="-1.5"', "joint E1: velocity is -1.5"),
        ('lower="-1.5"', 'lower="7"', "joint E1: lower is 7, not below upper: 6"),
        ('acceleration="12"', 'acceleration="-12"', "joint E1: acceleration and jerk must be"),
        ('velocity="1.5"', 'velocity="fast"', "joint E1: velocity is 'fast', not a finite number"),
        ('velocity="1.5"', "", "the <limit> of joint E1 has no velocity"),
    ],
)
def test_a_urdf_in_other_units_is_refused_by_the_joints_name(
    old: str, new: str, outcome: str
) -> None:
    assert old in URDF
    with pytest.raises(UrdfLimitsError, match=outcome):
        read(URDF.replace(old, new), "flange", linear_axis=True)


@pytest.mark.parametrize(
    ("old", "new", "outcome"),
    [
        ('<axis xyz="-1 0 0"/>', '<axis xyz="0 0.0 -0"/>', "<axis> of joint A4 has no direction"),
        ('<axis xyz="-1 0 0"/>', "<axis/>", "the <axis> of joint A4 has no direction"),
        ("<limit ", '<mimic joint="A2"/><limit ', "joint A1 mimics another one"),
    ],
)
def test_an_axis_that_does_not_move_by_itself_is_refused(old: str, new: str, outcome: str) -> None:
    with pytest.raises(UrdfLimitsError, match=outcome):
        read(URDF.replace(old, new), "flange", linear_axis=True)


@pytest.mark.parametrize(
    ("flange", "named"),
    [("link_a5", "A6"), ("A6", "E1, A1, A2, A3, A4, A5, A6"), ("link_a1", "A2, A3, A4, A5, A6")],
)
def test_a_flange_before_the_last_axis_is_refused(flange: str, named: str) -> None:
    with pytest.raises(UrdfLimitsError, match=f"^'{flange}' is not moved by {named}\\."):
        read(URDF, flange, linear_axis=True)


def test_what_is_no_xml_and_no_limit_is_refused() -> None:
    with pytest.raises(UrdfLimitsError, match="not XML"):
        read("<robot", "flange", linear_axis=True)
    bare = re.sub(r"<limit [^>]*/>", "", URDF)
    with pytest.raises(UrdfLimitsError, match="joint A1 has no <limit>"):
        read(bare, "flange", linear_axis=True)


def test_an_arm_without_a_linear_axis_has_six() -> None:
    assert urdf_limits.read(URDF, "flange", linear_axis=False)[0].speed == 1.5
