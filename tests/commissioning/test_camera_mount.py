"""Camera in the tcp from made postures: truth, honesty of the deviations, and refusals."""

from dataclasses import replace

import numpy as np
import pytest

from linemate.daemon.commissioning import camera_mount
from linemate.daemon.commissioning.camera_mount import CameraMount, find_mount
from linemate.daemon.commissioning.postures import SeenObject, StandingPosture
from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.identification.outcome import Refusal

X = np.array((-0.1, 0.03, -0.15, 0.2, -2.0, 1.0))
Y = np.array((2.2, 0.1, 1.1, 0.0, 1.5, 0.2))
SIGMA = (0.3e-3, 1.0e-3)
IMAGES = 50


def postures(count: int, turns: Array, seed: int = 1, noise: float = 1.0) -> list[StandingPosture]:
    """Postures with exact tcp poses and noisy mean images."""
    rng = np.random.default_rng(seed)
    made = []
    mount, there = rotations.exp(X[3:]), rotations.exp(Y[3:])
    for i in range(count):
        R = rotations.exp(np.array((0.1, 1.4, 0.2))) @ rotations.exp(turns[i])
        p = np.array((1.6, 0.0, 1.0)) + rng.uniform(-0.15, 0.15, 3)
        Z = (R @ mount).T @ there
        z = (R @ mount).T @ (Y[:3] - p - R @ X[:3])
        e = noise * rng.standard_normal(6) / np.sqrt(IMAGES)
        view = SeenObject(
            z + SIGMA[0] * e[:3], Z @ rotations.exp(SIGMA[1] * e[3:]), np.repeat(SIGMA, 3), IMAGES
        )
        made.append(StandingPosture(0.0, 1.0, np.full(7, float(i)), p, R, view, None, None))
    return made


def all_round(count: int, size: float = 0.35, seed: int = 3) -> Array:
    turns: Array = np.random.default_rng(seed).uniform(-size, size, (count, 3))
    return turns


def errors(mount: CameraMount) -> Array:
    off = rotations.log(rotations.exp(X[3:]).T @ mount.rotation)
    return np.concatenate((mount.position - X[:3], off))


def test_the_camera_is_found_without_noise() -> None:
    mount = find_mount(postures(15, all_round(15), noise=0.0))
    assert isinstance(mount, CameraMount)
    assert np.abs(errors(mount)).max() < 1e-8
    assert mount.object_position == pytest.approx(Y[:3], abs=1e-8)
    assert mount.used == mount.given == 15


def test_the_stated_deviations_are_those_of_many_tries() -> None:
    squares = []
    for seed in range(30):
        mount = find_mount(postures(18, all_round(18), seed))
        assert isinstance(mount, CameraMount)
        squares.append((errors(mount) / mount.deviations) ** 2)
    assert 0.7 < float(np.sqrt(np.mean(squares))) < 1.3


def test_a_posture_with_a_wrong_image_is_left_out() -> None:
    made = postures(18, all_round(18))
    view = made[4].seen
    assert view is not None
    wrong = SeenObject(view.position + 0.05, view.rotation, view.spread, view.images)
    made[4] = StandingPosture(
        0.0, 1.0, made[4].joints, made[4].position, made[4].rotation, wrong, None, None
    )
    mount = find_mount(made)
    assert isinstance(mount, CameraMount)
    assert mount.used < mount.given
    assert np.abs(errors(mount)).max() < 1e-3


def test_too_few_postures_are_refused_with_their_number() -> None:
    refusal = find_mount(postures(14, all_round(14)))
    assert isinstance(refusal, Refusal)
    assert refusal.reason.startswith("14 postures with images, at least 15 are needed")


def test_rotation_about_one_axis_alone_is_refused() -> None:
    turns = np.zeros((20, 3))
    turns[:, 2] = np.linspace(-0.6, 0.6, 20)
    refusal = find_mount(postures(20, turns))
    assert isinstance(refusal, Refusal)
    assert "about a second axis, at least 0.10 rad" in refusal.reason


def test_an_object_that_moves_between_postures_is_refused() -> None:
    rng = np.random.default_rng(0)
    made = [
        replace(p, position=p.position + rng.normal(0.0, 0.02, 3))
        for p in postures(18, all_round(18))
    ]  # fmt: skip
    refusal = find_mount(made)
    assert isinstance(refusal, Refusal)
    assert "contradict each other" in refusal.reason


def test_rotations_that_are_just_large_enough_are_refused_by_their_deviations(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(camera_mount, "POSITION_DEVIATION", 1e-6)
    refusal = find_mount(postures(18, all_round(18)))
    assert isinstance(refusal, Refusal)
    assert "the camera is known to +-" in refusal.reason
