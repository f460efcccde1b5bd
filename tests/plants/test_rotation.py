"""Laws of the plain-float rotations: the group, against scipy."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from linemate.simulators.plants import rotation

small = st.floats(-1.8, 1.8)
vectors = st.tuples(small, small, small)


def as_array(r: rotation.Rot) -> np.ndarray:
    return np.array(r).reshape(3, 3)


@given(vectors)
def test_exp_is_scipys(v: rotation.Vec) -> None:
    assert as_array(rotation.exp(v)) == pytest.approx(
        Rotation.from_rotvec(v).as_matrix(), abs=1e-12
    )


@given(vectors)
def test_log_undoes_exp(v: rotation.Vec) -> None:
    if rotation.norm(v) < math.pi - 1e-3:
        assert rotation.log(rotation.exp(v)) == pytest.approx(v, abs=1e-9)
        assert rotation.angle(rotation.exp(v)) == pytest.approx(rotation.norm(v), abs=1e-9)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-9, 1e-7, 1e-6, 2e-6, 1e-4])
def test_small_rotations_lose_nothing(size: float) -> None:
    v = (size, -2 * size, 0.5 * size)
    assert rotation.log(rotation.exp(v)) == pytest.approx(v, rel=1e-6, abs=1e-20)


def test_a_half_turn_has_no_unique_vector() -> None:
    with pytest.raises(ValueError, match="half a turn"):
        rotation.log((1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0))


@given(vectors)
def test_any_rotation_has_a_vector(v: rotation.Vec) -> None:
    turned = rotation.exp(v)
    assert rotation.exp(rotation.vector(turned)) == pytest.approx(turned, abs=1e-7)
    for half in ((1.0, 0.0, 0.0), (0.6, 0.0, 0.8), (0.0, 1.0, 0.0)):
        x, y, z = (math.pi * part for part in half)
        turned = rotation.exp((x, y, z))
        assert rotation.exp(rotation.vector(turned)) == pytest.approx(turned, abs=1e-12)


@given(vectors)
def test_the_quaternion_is_scipys_with_w_not_negative(v: rotation.Vec) -> None:
    w, x, y, z = rotation.quaternion(rotation.exp(v))
    assert w >= 0.0
    expected = Rotation.from_rotvec(v)
    assert (Rotation.from_quat((x, y, z, w)).inv() * expected).magnitude() < 1e-7


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1)])
def test_the_quaternion_of_a_half_turn_is_its_axis(axis: tuple[float, float, float]) -> None:
    turned = rotation.exp((math.pi * axis[0], math.pi * axis[1], math.pi * axis[2]))
    quaternion = rotation.quaternion(turned)
    assert np.abs(quaternion) == pytest.approx((0.0, *axis), abs=1e-12)


@given(vectors, vectors, vectors, vectors)
def test_relative_undoes_multiply(
    a: rotation.Vec, b: rotation.Vec, p: rotation.Vec, q: rotation.Vec
) -> None:
    first, second = (p, rotation.exp(a)), (q, rotation.exp(b))
    back = rotation.relative(first, rotation.multiply(first, second))
    assert back[0] == pytest.approx(second[0], abs=1e-12)
    assert back[1] == pytest.approx(second[1], abs=1e-12)
    product = rotation.matrix(first) @ rotation.matrix(second)
    assert rotation.matrix(rotation.multiply(first, second)) == pytest.approx(product, abs=1e-12)
