"""Units of the wires, and KUKA's angles."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linemate.protocol.units import DEG, MM, Rotation, rotation_to_abc

ANGLE = st.floats(-math.pi, math.pi)


def product(a: Rotation, b: Rotation) -> Rotation:
    return tuple(  # type: ignore[return-value]
        tuple(sum(a[i][k] * b[k][j] for k in range(3)) for j in range(3)) for i in range(3)
    )


def flat(rotation: Rotation) -> list[float]:
    return [value for row in rotation for value in row]


def about_z(angle: float) -> Rotation:
    c, s = math.cos(angle), math.sin(angle)
    return ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))


def about_y(angle: float) -> Rotation:
    c, s = math.cos(angle), math.sin(angle)
    return ((c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c))


def about_x(angle: float) -> Rotation:
    c, s = math.cos(angle), math.sin(angle)
    return ((1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c))


def rotated(a: float, b: float, c: float) -> Rotation:
    """About Z, then the new Y, then the new X."""
    return product(product(about_z(a), about_y(b)), about_x(c))


def test_a_metre_is_a_thousand_millimetres_and_half_a_turn_is_pi() -> None:
    assert 1.0 * MM == 0.001
    assert math.pi == 180.0 * DEG


@given(ANGLE, ANGLE, ANGLE)
def test_the_angles_of_a_rotation_give_that_rotation_back(a: float, b: float, c: float) -> None:
    rotation = rotated(a, b, c)
    assert flat(rotated(*rotation_to_abc(rotation))) == pytest.approx(flat(rotation), abs=1e-8)


@given(ANGLE, st.floats(-1.5, 1.5), ANGLE)
def test_angles_away_from_the_pole_are_returned_unchanged(a: float, b: float, c: float) -> None:
    again = rotation_to_abc(rotated(a, b, c))
    assert math.cos(again[0] - a) == pytest.approx(1.0)
    assert again[1] == pytest.approx(b, abs=1e-9)
    assert math.cos(again[2] - c) == pytest.approx(1.0)


@pytest.mark.parametrize("b", [math.pi / 2, -math.pi / 2])
def test_at_the_pole_c_is_zero_and_the_rotation_is_the_same(b: float) -> None:
    rotation = rotated(0.7, b, -0.4)
    angles = rotation_to_abc(rotation)
    assert angles[2] == 0.0
    assert flat(rotated(*angles)) == pytest.approx(flat(rotation), abs=1e-9)
