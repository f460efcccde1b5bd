"""The laws of protocol/units."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linemate.protocol.units import (
    DEG,
    MM,
    abc_to_rotation,
    from_deg,
    from_mm,
    pose_to_xyzabc,
    rotation_to_abc,
    to_deg,
    to_mm,
    xyzabc_to_pose,
)

ANGLE = st.floats(-math.pi, math.pi)
LENGTH_MM = st.floats(-1e5, 1e5)


def product(a, b):
    return tuple(
        tuple(sum(a[i][k] * b[k][j] for k in range(3)) for j in range(3)) for i in range(3)
    )


def flat(rotation):
    return [value for row in rotation for value in row]


def about_z(angle):
    c, s = math.cos(angle), math.sin(angle)
    return ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))


def about_y(angle):
    c, s = math.cos(angle), math.sin(angle)
    return ((c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c))


def about_x(angle):
    c, s = math.cos(angle), math.sin(angle)
    return ((1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c))


def test_a_metre_is_a_thousand_millimetres_and_a_turn_is_two_pi():
    assert from_mm(1000.0) == 1.0
    assert to_mm(1.0) == 1000.0
    assert from_deg(360.0) == pytest.approx(2 * math.pi)
    assert to_deg(math.pi) == pytest.approx(180.0)
    assert 1.0 * MM == 0.001
    assert math.pi == 180.0 * DEG


@given(ANGLE, ANGLE, ANGLE)
def test_abc_turns_about_z_then_the_new_y_then_the_new_x(a, b, c):
    expected = product(product(about_z(a), about_y(b)), about_x(c))
    assert flat(abc_to_rotation(a, b, c)) == pytest.approx(flat(expected), abs=1e-12)


@given(ANGLE, ANGLE, ANGLE)
def test_the_angles_of_a_rotation_give_that_rotation_back(a, b, c):
    rotation = abc_to_rotation(a, b, c)
    again = abc_to_rotation(*rotation_to_abc(rotation))
    assert flat(again) == pytest.approx(flat(rotation), abs=1e-8)


@given(ANGLE, st.floats(-1.5, 1.5), ANGLE)
def test_angles_away_from_the_pole_come_back_as_they_were(a, b, c):
    again = rotation_to_abc(abc_to_rotation(a, b, c))
    assert math.cos(again[0] - a) == pytest.approx(1.0)
    assert again[1] == pytest.approx(b, abs=1e-9)
    assert math.cos(again[2] - c) == pytest.approx(1.0)


@pytest.mark.parametrize("b", [math.pi / 2, -math.pi / 2])
def test_at_the_pole_c_is_zero_and_the_rotation_still_comes_back(b):
    rotation = abc_to_rotation(0.7, b, -0.4)
    angles = rotation_to_abc(rotation)
    assert angles[2] == 0.0
    assert flat(abc_to_rotation(*angles)) == pytest.approx(flat(rotation), abs=1e-9)


@given(LENGTH_MM, LENGTH_MM, LENGTH_MM, ANGLE, st.floats(-1.5, 1.5), ANGLE)
def test_a_pose_and_kukas_six_numbers_undo_each_other(x, y, z, a, b, c):
    numbers = (x, y, z, a / DEG, b / DEG, c / DEG)
    position, rotation = xyzabc_to_pose(*numbers)
    assert position == pytest.approx((x * MM, y * MM, z * MM))
    again = xyzabc_to_pose(*pose_to_xyzabc(position, rotation))
    assert again[0] == pytest.approx(position)
    assert flat(again[1]) == pytest.approx(flat(rotation), abs=1e-8)
