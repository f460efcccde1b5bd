"""The judge's algebra of poses, against scipy's rotations."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from linemate.simulators.judge import poses


def random_poses(seed: int, n: int = 20) -> np.ndarray:
    rng = np.random.default_rng(seed)
    q = rng.standard_normal((n, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    q *= np.where(q[:, :1] < 0.0, -1.0, 1.0)
    return np.concatenate((rng.uniform(-3, 3, (n, 3)), q), axis=1)


def matrices(p: np.ndarray) -> np.ndarray:
    m = np.tile(np.eye(4), (len(p), 1, 1))
    m[:, :3, :3] = Rotation.from_quat(p[:, 3:], scalar_first=True).as_matrix()
    m[:, :3, 3] = p[:, :3]
    return m


seeds = st.integers(0, 2**32 - 1)


@given(seeds)
def test_composing_is_the_product_of_matrices(seed: int) -> None:
    a, b = random_poses(seed), random_poses(seed + 1)
    assert np.allclose(matrices(poses.compose(a, b)), matrices(a) @ matrices(b))


@given(seeds)
def test_a_relative_pose_leads_back(seed: int) -> None:
    a, b = random_poses(seed), random_poses(seed + 1)
    shift, turn = poses.distance(poses.compose(a, poses.relative(a, b)), b)
    assert max(shift.max(), turn.max()) < 1e-12


@given(seeds, st.floats(1e-7, 3.1))
def test_the_distance_of_poses_is_their_shift_and_their_turn(seed: int, angle: float) -> None:
    a = random_poses(seed)
    step = np.tile([3.0, 4.0, 0.0, np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0], (len(a), 1))
    shift, turn = poses.distance(a, poses.compose(a, step))
    assert np.allclose(shift, 5.0)
    assert np.allclose(turn, angle, rtol=1e-6)
