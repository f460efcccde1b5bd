"""Rotations: the laws of the group, against scipy and against finite differences."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array

SMALL_OR_LARGE = st.one_of(
    st.floats(0.0, math.pi - 1e-3), st.floats(0.0, 1e-5), st.just(0.0), st.just(rotations.SMALL)
)


@st.composite
def vectors(draw: st.DrawFn) -> Array:
    """Rotation vectors: any axis, angles below pi, many of them near zero."""
    axis = np.array([draw(st.floats(-1.0, 1.0)) for _ in range(3)])
    norm = float(np.linalg.norm(axis))
    if norm < 1e-3:
        axis, norm = np.array((0.0, 0.0, 1.0)), 1.0
    turned: Array = axis / norm * draw(SMALL_OR_LARGE)
    return turned


quick = settings(max_examples=80, deadline=None)


@quick
@given(vectors())
def test_exp_is_scipys_rotation(r: Array) -> None:
    assert np.allclose(rotations.exp(r), Rotation.from_rotvec(r).as_matrix(), atol=1e-14)


@quick
@given(vectors())
def test_log_undoes_exp(r: Array) -> None:
    # Near pi the axis is known from the square root of what is left of the diagonal.
    assert np.allclose(rotations.log(rotations.exp(r)), r, rtol=0.0, atol=1e-12)


@quick
@given(vectors(), vectors())
def test_a_product_of_rotations_is_a_rotation_and_exp_undoes_its_log(r: Array, s: Array) -> None:
    R = rotations.exp(r) @ rotations.exp(s)
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.allclose(rotations.exp(rotations.log(R)), R, atol=1e-12)


@quick
@given(vectors())
def test_the_inverse_is_the_opposite_vector_and_the_transpose(r: Array) -> None:
    assert np.allclose(rotations.exp(-r), rotations.exp(r).T, atol=1e-15)


@pytest.mark.parametrize("angle", [math.pi, math.pi - 1e-9, math.pi - 1e-7, math.pi - 1e-4])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, -0.8, 0), (2, -1, 2)])
def test_half_a_turn_is_found_about_every_axis(axis: tuple[float, ...], angle: float) -> None:
    unit = np.array(axis) / np.linalg.norm(axis)
    R = Rotation.from_rotvec(angle * unit).as_matrix()
    found = rotations.log(R)
    assert float(np.linalg.norm(found)) == pytest.approx(angle, abs=1e-7)
    assert np.allclose(rotations.exp(found), R, atol=1e-7)


@quick
@given(vectors())
def test_a_quaternion_is_scipys_and_back(r: Array) -> None:
    R = rotations.exp(r)
    q = np.array(rotations.quaternion(R))
    known = Rotation.from_rotvec(r).as_quat(canonical=True)[[3, 0, 1, 2]]
    assert min(np.abs(q - known).max(), np.abs(q + known).max()) < 1e-8
    assert q[0] >= 0.0
    assert np.allclose(rotations.matrix((q[0], q[1], q[2], q[3])), R, atol=1e-12)


@quick
@given(vectors(), st.floats(0.01, 100.0))
def test_a_quaternion_may_have_any_length_and_either_sign(r: Array, length: float) -> None:
    w, x, y, z = rotations.quaternion(rotations.exp(r))
    scaled = (-length * w, -length * x, -length * y, -length * z)
    assert np.allclose(rotations.matrix(scaled), rotations.exp(r), atol=1e-12)
    assert np.allclose(rotations.log_quaternion((-w, -x, -y, -z)), r, atol=1e-10)


@quick
@given(vectors(), vectors())
def test_skew_is_the_cross_product(v: Array, w: Array) -> None:
    assert np.allclose(rotations.skew(v) @ w, np.cross(v, w), atol=1e-15)


@quick
@given(vectors(), st.integers(0, 2))
@example(np.zeros(3), 0)
def test_the_left_jacobian_is_the_derivative_of_exp(r: Array, axis: int) -> None:
    h = 1e-6
    e = h * np.eye(3)[axis]
    ahead = rotations.log(rotations.exp(r + e) @ rotations.exp(r).T)
    back = rotations.log(rotations.exp(r - e) @ rotations.exp(r).T)
    assert np.allclose((ahead - back) / (2 * h), rotations.left_jacobian(r)[:, axis], atol=2e-8)


@quick
@given(vectors().filter(lambda r: float(np.linalg.norm(r)) < 3.0), st.integers(0, 2))
@example(np.zeros(3), 0)
def test_the_inverse_left_jacobian_is_the_derivative_of_log(r: Array, axis: int) -> None:
    h = 1e-6
    d = h * np.eye(3)[axis]
    ahead = rotations.log(rotations.exp(d) @ rotations.exp(r))
    back = rotations.log(rotations.exp(-d) @ rotations.exp(r))
    found = rotations.left_jacobian_inverse(r)[:, axis]
    assert np.allclose((ahead - back) / (2 * h), found, atol=1e-7)


@quick
@given(vectors())
def test_the_two_jacobians_are_inverse(r: Array) -> None:
    both = rotations.left_jacobian(r) @ rotations.left_jacobian_inverse(r)
    assert np.allclose(both, np.eye(3), atol=1e-9)


@quick
@given(vectors(), st.integers(0, 2))
def test_a_small_change_is_a_twist_in_the_poses_own_axes_and_comes_back(
    r: Array, axis: int
) -> None:
    h = 1e-5
    R, turn = rotations.exp(r), h * np.eye(3)[axis]
    change = np.concatenate((h * np.eye(3)[axis], turn))
    into, back = rotations.in_own_axes_and_back(r)
    assert np.array_equal(into, rotations.in_own_axes(r))
    twist = change @ into
    assert np.allclose(twist[:3], R.T @ change[:3], atol=1e-15)
    ahead = rotations.log(R.T @ rotations.exp(r + turn))
    behind = rotations.log(R.T @ rotations.exp(r - turn))
    assert np.allclose((ahead - behind) / 2.0, twist[3:], atol=2e-8 * h)
    assert np.allclose(twist @ back, change, atol=1e-9 * h)


@quick
@given(st.lists(vectors(), min_size=1, max_size=6))
def test_many_at_once_are_what_they_are_one_by_one(rows: list[Array]) -> None:
    stacked = np.array(rows)
    singly = np.array([rotations.exp(row) for row in rows])
    assert np.allclose(rotations.exp_many(stacked), singly, atol=1e-14)
    assert np.allclose(rotations.log_many(singly), stacked, atol=1e-10)


@quick
@given(st.lists(vectors(), min_size=1, max_size=6), vectors(), vectors())
def test_many_are_turned_with_an_arm_as_one_by_one(
    rows: list[Array], turn: Array, arm: Array
) -> None:
    turns, arms = rotations.turned_many(np.array(rows), turn, arm)
    for row, turned, at in zip(rows, turns, arms, strict=True):
        R = rotations.exp(row) @ rotations.exp(turn)
        assert np.allclose(rotations.exp(turned), R, atol=1e-13)
        assert np.linalg.norm(turned) <= math.pi + 1e-9
        assert np.allclose(at, R @ arm, atol=1e-13)


@pytest.mark.parametrize("size", [1e-8, 0.999e-6, 1.001e-6, 0.9e-4, 1.1e-4])
def test_series_and_closed_forms_meet_where_one_gives_way_to_the_other(size: float) -> None:
    r = size * np.array((0.36, -0.48, 0.8))
    first = np.eye(3) + rotations.skew(r) + 0.5 * rotations.skew(r) @ rotations.skew(r)
    assert np.allclose(rotations.exp(r), first, rtol=0.0, atol=1e-12)
    half = 0.5 * rotations.skew(r)
    square = rotations.skew(r) @ rotations.skew(r)
    assert np.allclose(rotations.left_jacobian(r), np.eye(3) + half + square / 6, atol=1e-12)
    inverse = np.eye(3) - half + square / 12
    assert np.allclose(rotations.left_jacobian_inverse(r), inverse, rtol=0.0, atol=1e-12)
