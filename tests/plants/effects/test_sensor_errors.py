"""Each effect of the sensors alone against its closed form; without effects no number is drawn."""

import math
from dataclasses import replace

import numpy as np
import pytest

from linemate.simulators.plants import rotation
from linemate.simulators.plants.effects.sensor_errors import (
    CameraEffects,
    DistanceEffects,
    Interval,
    view_angle,
)
from linemate.simulators.plants.rotation import Pose
from linemate.simulators.plants.scenario import Camera, DistanceSensor
from linemate.simulators.plants.sensors import CameraEmission, CameraPlant, DistanceSensorPlant

CLEAN = Camera(
    dropout_rate=0.0, outlier_rate=0.0, jitter_s=0.0, sigma=0.0, sigma_per_metre=0.0,
    sigma_rotation=0.0, sigma_rotation_per_metre=0.0, position_in_tcp=(0.0, 0.0, 0.0),
)  # fmt: skip
RIGID: Pose = ((0.0, 0.0, 0.0), rotation.IDENTITY)


def ahead(distance: float, aside: float = 0.0) -> Pose:
    return (aside, 0.0, distance), rotation.IDENTITY


def images(
    count: int, distance: float = 0.5, seed: int = 1, **effects: object
) -> list[CameraEmission]:
    camera = replace(CLEAN, effects=CameraEffects(**effects))  # type: ignore[arg-type]
    plant = CameraPlant(camera, seed, 0.0)
    for _ in range(count):
        plant.measure(RIGID, ahead(distance))
    return list(plant.due)


def test_the_bias_of_depth_and_side_grows_with_the_distance() -> None:
    for distance in (0.1, 1.0):
        (seen,) = images(1, distance, depth_bias=4e-3, lateral_bias=(1e-3, -2e-3))
        expected = (1e-3 * distance, -2e-3 * distance, 1.004 * distance)
        assert seen.position == pytest.approx(expected)


def test_correlated_noise_has_its_size_and_its_correlation_time() -> None:
    runs = [
        [e.position for e in images(400, seed=seed, correlated_sigma=1e-3, correlation_s=0.5)]
        for seed in range(60)
    ]
    error = np.array(runs) - (0.0, 0.0, 0.5)
    assert error.std(axis=(0, 1)) == pytest.approx([1e-3, 1e-3, 2e-3], rel=0.1)
    lag = round(0.5 / CLEAN.period_s)
    for axis in range(3):
        e = error[:, :, axis]
        assert (e[:, lag:] * e[:, :-lag]).mean() / (e**2).mean() == pytest.approx(
            math.exp(-1.0), abs=0.08
        )


def test_correlated_noise_grows_with_the_distance_and_turns_the_pose() -> None:
    near, far = (
        np.array([e.position[0] for e in images(4000, d, correlated_sigma_per_metre=1e-3)]).std()
        for d in (0.2, 1.0)
    )
    assert far / near == pytest.approx(5.0)
    turned = images(4000, correlated_rotation=1e-3)
    angles = np.array([2.0 * np.array(e.quaternion[1:]) for e in turned])
    assert angles.std(axis=0) == pytest.approx([1e-3] * 3, rel=0.3)


def test_an_occlusion_hides_the_hub_for_its_time() -> None:
    seen = images(80, occlusions=(Interval(0.5, 1.0),))
    missing = 80 - len(seen)
    assert missing == 20
    assert not any(0.5 <= e.exposure_s < 1.0 for e in seen)


def test_the_wheel_hides_the_hub_for_its_time_before_contact() -> None:
    camera = replace(CLEAN, blind_below=0.0, effects=CameraEffects(blind_before_contact_s=0.5))
    plant = CameraPlant(camera, 0, 0.0)
    distances = [0.2 - 0.1 * 0.025 * n for n in range(80)]  # 0.1 m/s: contact after 2 s
    for distance in distances:
        plant.measure(RIGID, ahead(distance))
    last = max(e.exposure_s for e in plant.due)
    assert last == pytest.approx(1.5, abs=0.03)
    # A tool that waits sees the hub again after that time, and a new approach hides it again.
    for _ in range(10):
        plant.measure(RIGID, ahead(0.001))
    assert len(plant.due) > len([e for e in plant.due if e.exposure_s <= last])
    plant.due.clear()
    for distance in (0.3, *distances):
        plant.measure(RIGID, ahead(distance))
    assert 55 < len(plant.due) < 65


def test_images_are_lost_with_the_square_of_the_view_angle() -> None:
    limit = 1.0
    camera = replace(CLEAN, effects=CameraEffects(view_limit=limit))
    for angle in (0.3, 0.6):
        plant = CameraPlant(camera, 2, 0.0)
        hub = ahead(0.5, 0.5 * math.tan(angle))
        for _ in range(4000):
            plant.measure(RIGID, hub)
        assert view_angle(hub) == pytest.approx(angle)
        assert 1.0 - len(plant.due) / 4000 == pytest.approx(angle**2, abs=0.02)
    plant = CameraPlant(camera, 2, 0.0)
    plant.measure(RIGID, ahead(0.5, 0.5 * math.tan(1.01)))
    assert not plant.due


def test_stamps_are_off_by_bias_and_jitter() -> None:
    plain = images(2000)
    seen = images(2000, stamp_bias_s=0.010, stamp_jitter_s=0.004)
    off = np.array([b.exposure_s - a.exposure_s for a, b in zip(plain, seen, strict=True)])
    assert off.min() >= 0.006
    assert off.max() <= 0.014
    assert off.mean() == pytest.approx(0.010, abs=2e-4)
    assert off.std() == pytest.approx(0.004 / math.sqrt(3.0), rel=0.05)
    assert [e.time_s for e in seen] == [e.time_s for e in plain]


def test_an_exposure_smears_along_the_motion_only() -> None:
    camera = replace(CLEAN, effects=CameraEffects(exposure_time_s=5e-3))
    plant = CameraPlant(camera, 3, 0.0)
    speed = 0.2
    for n in range(4000):
        plant.measure(RIGID, ahead(0.5, speed * CLEAN.period_s * n * 0.01 % 0.4))
    error = np.array([e.position for e in plant.due])
    assert np.ptp(error[:, 2]) == 0.0
    still = CameraPlant(camera, 3, 0.0)
    for _ in range(100):
        still.measure(RIGID, ahead(0.5))
    assert {e.position for e in still.due} == {(0.0, 0.0, 0.5)}
    moving = CameraPlant(camera, 3, 0.0)
    for n in range(4000):
        moving.measure(RIGID, ((0.01 * speed * CLEAN.period_s * n, 0.0, 0.9), rotation.IDENTITY))
    there = np.array([0.01 * speed * CLEAN.period_s * n for n in range(4000)])
    off = np.array([e.position[0] for e in moving.due]) - there
    assert off[1:].std() == pytest.approx(0.01 * speed * 5e-3 / math.sqrt(12.0), rel=0.05)


def test_the_true_mount_is_off_the_stated_one() -> None:
    (seen,) = images(1, mount_offset=(2e-3, 0.0, -1e-3), mount_rotation=(0.0, 3e-3, 0.0))
    x, _, z = seen.position
    assert x == pytest.approx(-2e-3 * math.cos(3e-3) - 0.501 * math.sin(3e-3))
    assert z == pytest.approx(0.501 * math.cos(3e-3) - 2e-3 * math.sin(3e-3))


def test_a_camera_without_effects_is_the_one_before() -> None:
    assert images(50) == images(50, correlation_s=0.5)


def distances(count: int, seed: int = 1, **effects: float) -> np.ndarray:
    sensor = DistanceSensor(
        period_s=0.001, sigma=0.0, quantisation=0.0, outlier_rate=0.0,
        effects=DistanceEffects(**effects),
    )  # fmt: skip
    plant = DistanceSensorPlant(sensor, seed, 0.0, 0.012)
    for n in range(count):
        plant.measure(0.106e-3 * n)
    return np.array([e.position for e in plant.due])


def test_a_slipping_wheel_counts_less_travel() -> None:
    assert distances(1000, slip=0.01) == pytest.approx(0.99 * 0.106e-3 * np.arange(1000))


def test_the_drift_is_a_random_walk_in_time() -> None:
    ends = np.array([
        distances(250, seed, drift=1e-3)[-1] - 0.106e-3 * 249 for seed in range(300)
    ])  # fmt: skip
    assert ends.std() == pytest.approx(0.5e-3, rel=0.12)
    assert ends.mean() == pytest.approx(0.0, abs=1e-4)


def test_effects_depend_on_the_seed_alone() -> None:
    names = {"correlated_sigma": 1e-3, "stamp_jitter_s": 0.002, "view_limit": 1.2}
    assert images(100, seed=4, **names) == images(100, seed=4, **names)
    assert images(100, seed=4, **names) != images(100, seed=5, **names)
