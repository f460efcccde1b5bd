"""Laws of the sensors: spread, resolution, outliers, delay and order, blindness, streams apart."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from linemate.simulators.plants import rotation
from linemate.simulators.plants.rotation import Pose
from linemate.simulators.plants.scenario import Camera, DistanceSensor, Effector, ForceTorque
from linemate.simulators.plants.sensors import (
    CameraEmission,
    CameraPlant,
    DistanceEmission,
    DistanceSensorPlant,
    ForceTorquePlant,
    WrenchEmission,
)

TOOL: Pose = ((1.0, 2.0, 0.5), rotation.exp((0.1, 0.7, -0.2)))


def distances(sensor: DistanceSensor, count: int = 20000, seed: int = 0) -> list[DistanceEmission]:
    plant = DistanceSensorPlant(sensor, seed, 0.0, 0.012)
    for _ in range(count):
        plant.measure(0.5)
    return list(plant.due)


def images(camera: Camera, distance: float = 0.3, count: int = 4000, seed: int = 0,
           turn: rotation.Vec = (0.1, 0.2, 0.3)) -> list[CameraEmission]:  # fmt: skip
    plant = CameraPlant(camera, seed, 0.0)
    hub = rotation.multiply(TOOL, ((0.0, 0.0, distance), rotation.exp(turn)))
    for _ in range(count):
        plant.measure(TOOL, hub)
    return list(plant.due)


def wrenches(sensor: ForceTorque, count: int = 4000, seed: int = 0) -> list[WrenchEmission]:
    plant = ForceTorquePlant(sensor, Effector(), seed, 0.0)
    for _ in range(count):
        plant.measure((0.001, 0.0, 0.0, 0.0, 0.002, 0.0))
    return list(plant.due)


CLEAR = Camera(outlier_rate=0.0, dropout_rate=0.0)


def test_distance_has_its_resolution_spread_and_outliers() -> None:
    seen = distances(DistanceSensor())
    values = np.array([e.position for e in seen])
    assert np.abs(values / 1e-3 - np.round(values / 1e-3)).max() < 1e-6
    far = np.array([e.outlier for e in seen])
    assert far.mean() == pytest.approx(0.003, abs=0.0015)
    assert np.abs(values[far] - 0.5).max() > 0.05
    assert np.abs(values - 0.5).max() < 0.102
    fine = distances(DistanceSensor(quantisation=0.0, outlier_rate=0.0))
    assert np.std([e.position for e in fine]) == pytest.approx(0.25e-3, rel=0.03)
    assert np.mean([e.position for e in fine]) == pytest.approx(0.5, abs=1e-5)


def test_distance_comes_once_a_cycle_after_its_delay() -> None:
    seen = distances(DistanceSensor(phase=0.25), 100)
    assert [e.exposure_s for e in seen] == pytest.approx(0.003 + 0.012 * np.arange(100))
    assert [e.time_s - e.exposure_s for e in seen] == pytest.approx([0.001] * 100)


def test_an_offset_of_the_distance_sensor_is_seen() -> None:
    seen = distances(DistanceSensor(offset=0.02, outlier_rate=0.0), 500)
    assert np.mean([e.position for e in seen]) == pytest.approx(0.52, abs=1e-4)


@pytest.mark.parametrize("distance", [0.05, 0.3, 0.8])
def test_the_camera_has_its_spread_at_each_distance(distance: float) -> None:
    seen = images(CLEAR, distance)
    spread = np.std([e.position for e in seen], axis=0)
    sigma = 0.25e-3 + 1.2e-3 * distance
    assert spread == pytest.approx(np.array([sigma, sigma, 2 * sigma]), rel=0.05)
    errors = _turns(seen, (0.1, 0.2, 0.3))
    assert errors.std(axis=0) == pytest.approx([0.6e-3 + 4e-3 * distance] * 3, rel=0.05)


def _turns(seen: list[CameraEmission], turn: rotation.Vec) -> np.ndarray:
    """Errors of orientation as rotation vectors in the camera's frame."""
    quaternions = np.array([e.quaternion for e in seen])
    assert np.linalg.norm(quaternions, axis=1) == pytest.approx(1.0)
    measured = Rotation.from_quat(quaternions[:, [1, 2, 3, 0]])
    return np.asarray((measured * Rotation.from_rotvec(turn).inv()).as_rotvec())


def test_the_camera_sees_the_hub_from_where_it_sits() -> None:
    exact = Camera(sigma=0, sigma_per_metre=0, sigma_rotation=0, sigma_rotation_per_metre=0,
                   outlier_rate=0, dropout_rate=0, rotation_in_tcp=(0.0, 0.3, 0.0))  # fmt: skip
    (seen,) = images(exact, count=1)
    mount = np.eye(4)
    mount[:3, :3] = Rotation.from_rotvec((0, 0.3, 0)).as_matrix()
    mount[:3, 3] = (-0.10, 0.0, -0.15)
    hub = np.eye(4)
    hub[:3, :3] = Rotation.from_rotvec((0.1, 0.2, 0.3)).as_matrix()
    hub[:3, 3] = (0, 0, 0.3)
    expected = np.linalg.inv(mount) @ hub
    assert seen.position == pytest.approx(expected[:3, 3], abs=1e-12)
    w, x, y, z = seen.quaternion
    assert Rotation.from_quat((x, y, z, w)).as_matrix() == pytest.approx(
        expected[:3, :3], abs=1e-12
    )


def test_the_covariance_is_the_true_one_times_honesty() -> None:
    seen = images(replace(CLEAR, covariance_honesty=0.5), 0.3, count=1)[0]
    assert seen.covariance is not None
    full = np.zeros((6, 6))
    full[np.triu_indices(6)] = seen.covariance
    assert full == pytest.approx(np.diag(np.diag(full)))
    sigma, twist = 0.25e-3 + 1.2e-3 * 0.3, 0.6e-3 + 4e-3 * 0.3
    expected = 0.5 * np.array([sigma, sigma, 2 * sigma, twist, twist, twist])
    assert np.sqrt(np.diag(full)) == pytest.approx(expected)
    assert images(replace(CLEAR, covariance=False), 0.3, count=1)[0].covariance is None


@pytest.mark.parametrize(("distance", "sees"), [(0.029, 0), (0.031, 50), (1.19, 50), (1.21, 0)])
def test_the_camera_is_blind_too_near_and_too_far(distance: float, sees: int) -> None:
    assert len(images(CLEAR, distance, count=50)) == sees


def test_images_are_late_by_their_delay_and_keep_their_order() -> None:
    seen = images(CLEAR)
    delays = np.array([e.time_s - e.exposure_s for e in seen])
    assert delays.min() >= 0.085 - 1e-12
    assert delays.max() <= 0.115 + 1e-12
    assert delays.mean() == pytest.approx(0.100, abs=0.001)
    assert delays.std() > 0.007
    assert (np.diff([e.time_s for e in seen]) >= 0).all()


def test_images_drop_out_and_lie_as_often_as_set() -> None:
    seen = images(Camera(), count=10000)
    assert 1 - len(seen) / 10000 == pytest.approx(0.03, abs=0.006)
    assert np.mean([e.outlier for e in seen]) == pytest.approx(0.02, abs=0.005)
    wild = np.array([e.position for e in seen if e.outlier])
    tame = np.array([e.position for e in seen if not e.outlier])
    assert np.abs(wild - tame.mean(axis=0)).max() > 0.02
    assert np.abs(tame - tame.mean(axis=0)).max() < 0.008


def test_dropouts_shift_no_other_image() -> None:
    few, many = images(Camera(dropout_rate=0.0)), images(Camera(dropout_rate=0.4))
    whole = {e.exposure_s: e for e in few}
    assert len(many) < 0.7 * len(few)
    assert all(whole[e.exposure_s] == e for e in many)


def test_outliers_shift_no_other_reading() -> None:
    none, some = distances(DistanceSensor(outlier_rate=0)), distances(DistanceSensor())
    assert all(a.position == b.position for a, b in zip(none, some, strict=True) if not b.outlier)


def test_the_wrench_is_stiffness_times_deflection_with_its_noise() -> None:
    seen = wrenches(ForceTorque())
    forces, torques = np.array([e.force for e in seen]), np.array([e.torque for e in seen])
    assert forces.mean(axis=0) == pytest.approx([50.0, 0.0, 0.0], abs=0.2)
    assert torques.mean(axis=0) == pytest.approx([0.0, 4.0, 0.0], abs=0.05)
    assert forces.std(axis=0) == pytest.approx([50e3 * 0.05e-3] * 3, rel=0.05)
    assert torques.std(axis=0) == pytest.approx([2000 * 0.2e-3] * 3, rel=0.05)


def test_bias_and_dropouts_of_the_wrench() -> None:
    silent = ForceTorque(sigma_translation=0, sigma_rotation=0, bias=(1e-3, 0, 0, 0, 0, 1e-3))
    assert wrenches(silent, 1)[0].force == pytest.approx((100.0, 0.0, 0.0))
    assert wrenches(silent, 1)[0].torque == pytest.approx((0.0, 4.0, 2.0))
    assert len(wrenches(ForceTorque(dropout_rate=0.5), 2000)) == pytest.approx(1000, abs=100)


def test_a_force_sensor_elsewhere_in_the_tool_states_the_same_wrench_in_its_own_frame() -> None:
    place, turn = (0.1, -0.2, 0.3), (0.3, -1.2, 0.5)
    quiet = ForceTorque(sigma_translation=0.0, sigma_rotation=0.0)
    deflection = (0.001, -0.002, 0.0005, 0.002, 0.001, -0.003)

    def felt(sensor: ForceTorque) -> WrenchEmission:
        plant = ForceTorquePlant(sensor, Effector(), 0, 0.0)
        plant.measure(deflection)
        return plant.due[0]

    plain = felt(quiet)
    moved = felt(replace(quiet, position_in_tcp=place, rotation_in_tcp=turn, sign=-1))
    R = Rotation.from_rotvec(turn)
    force = -R.apply(moved.force)
    assert force == pytest.approx(plain.force)
    torque = -R.apply(moved.torque) + np.cross(place, force)
    assert torque == pytest.approx(plain.torque)
