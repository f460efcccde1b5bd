"""From samples to sightings: the robot's pose at a moment, and consistent transforms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.observation import (
    MOST_DISTANCES,
    History,
    Wrench,
    date_error,
    mean_distances,
    mean_wrench,
    measure_camera,
    measure_touch,
    pose_at,
    rate_now,
    remember,
)
from linemate.daemon.core.tracking.settings import CameraNoise, TactileNoise
from linemate.protocol.stamped_samples import CameraSample, DistanceSample, WrenchSample

EPOCH = 5_000_000_000_000
CAMERA = (np.array((-0.10, 0.02, -0.15)), rotations.exp(np.array((0.02, -0.3, 0.1))))


def homogeneous(position: Array, rotation: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, position
    return T


def poses(limit: float = 1.0) -> st.SearchStrategy[Array]:
    place = st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3)
    turn = st.lists(st.floats(-limit, limit), min_size=3, max_size=3)
    return st.tuples(place, turn).map(lambda both: np.array((*both[0], *both[1])))


def camera_sample(
    pose: Array, exposure_ns: int, covariance: tuple[float, ...] | None = None
) -> CameraSample:
    x, y, z = pose[:3].tolist()
    return CameraSample(
        stamp_ns=exposure_ns + 100_000_000,
        exposure_ns=exposure_ns,
        source="cam",
        frame="camera",
        object_id="hub",
        sequence=1,
        position=(x, y, z),
        quaternion=rotations.quaternion(rotations.exp(pose[3:])),
        covariance=covariance,
    )


def moving(count: int, period_ns: int, speed: Array, length: int = 40) -> History:
    history = None
    for k in range(count):
        history = remember(history, EPOCH + k * period_ns, k * period_ns * 1e-9 * speed, length)
    assert history is not None
    return history


STILL = np.zeros(6)
SPEED = np.array((0.01, 0.106, -0.05, 0.02, -0.01, 0.03))


@settings(max_examples=60, deadline=None)
@given(st.floats(0.0, 0.25), st.sampled_from((4_000_000, 12_000_000)))
def test_a_steady_motion_is_known_at_any_instant_to_the_nanosecond(t: float, period: int) -> None:
    history = moving(round(0.26e9 / period) + 1, period, SPEED, length=80)
    stamp_ns = EPOCH + round(t * 1e9)
    found = pose_at(history, stamp_ns, 0.0)
    assert found is not None
    assert np.allclose(found, (stamp_ns - EPOCH) * 1e-9 * SPEED, atol=1e-12)


def test_the_newest_motion_is_carried_on_but_not_far() -> None:
    history = moving(20, 12_000_000, SPEED)
    last = EPOCH + 19 * 12_000_000
    found = pose_at(history, last + 10_000_000, 0.012)
    assert found is not None
    assert np.allclose(found, (19 * 0.012 + 0.010) * SPEED, atol=1e-12)
    assert pose_at(history, last + 13_000_000, 0.012) is None


@pytest.mark.parametrize("late_ms", [11.945, 11.0, 9.5, 0.0])
@pytest.mark.parametrize("together", [2, 3])
def test_late_telegrams_that_come_together_give_no_high_speed(
    late_ms: float, together: int
) -> None:
    """0.055 ms apart they gave 23 m/s: a clamped tool measured its object 0.2 m away."""
    history = moving(20, 12_000_000, SPEED)
    for k in range(20, 20 + together):
        late_ns = round(1e6 * late_ms) * (19 + together - k)
        history = remember(history, EPOCH + k * 12_000_000 + late_ns, k * 0.012 * SPEED, 40)
    assert np.all(np.abs(rate_now(history)) <= 4.001 * np.abs(SPEED))
    found = pose_at(history, history.stamps_ns[-1] + 10_000_000, 0.03)
    assert found is not None
    assert np.allclose(found, history.poses[-1] + 0.010 * rate_now(history), atol=1e-12)


def test_what_was_before_the_history_is_not_known() -> None:
    history = moving(60, 12_000_000, SPEED, length=40)
    assert len(history.stamps_ns) == len(history.poses) == 40
    oldest = EPOCH + 20 * 12_000_000
    assert pose_at(history, oldest - 1_000_000, 0.012) is None
    assert pose_at(history, oldest + 1_000_000, 0.012) is not None


def test_one_pose_alone_tells_of_no_other_instant() -> None:
    assert pose_at(remember(None, EPOCH, SPEED, 40), EPOCH, 1.0) is None


def test_a_telegram_that_is_not_newer_changes_nothing() -> None:
    history = moving(5, 12_000_000, SPEED)
    assert remember(history, EPOCH + 4 * 12_000_000, SPEED, 40) is history
    assert remember(history, EPOCH + 12_000_000, SPEED, 40) is history


def test_a_history_keeps_no_reference_to_a_pose_that_its_caller_may_change() -> None:
    pose = SPEED.copy()
    history = remember(remember(None, EPOCH, pose, 5), EPOCH + 1_000_000, pose, 5)
    pose[:] = 0.0
    assert np.array_equal(history.poses, np.tile(SPEED, (2, 1)))


@settings(max_examples=30, deadline=None)
@given(st.floats(0.0, 1.0), poses(0.4))
def test_between_two_telegrams_the_orientation_is_all_but_the_great_circles(
    share: float, start: Array
) -> None:
    end = start + 0.012 * SPEED
    history = remember(remember(None, EPOCH, start, 5), EPOCH + 12_000_000, end, 5)
    found = pose_at(history, EPOCH + round(share * 12e6), 0.0)
    assert found is not None
    ends = Rotation.from_rotvec(np.array((start[3:], end[3:])))
    known = Slerp([0.0, 1.0], ends)(share).as_matrix()
    assert np.abs(rotations.log(rotations.exp(found[3:]) @ known.T)).max() < 1e-6


@settings(max_examples=60, deadline=None)
@given(poses(), poses())
def test_a_sighting_is_the_product_of_the_transforms(tcp: Array, seen: Array) -> None:
    sighting = measure_camera(
        camera_sample(seen, EPOCH), tcp, CAMERA, CameraNoise(), EPOCH + 105_000_000, STILL
    )
    known = (
        homogeneous(tcp[:3], rotations.exp(tcp[3:]))
        @ homogeneous(*CAMERA)
        @ homogeneous(seen[:3], rotations.exp(seen[3:]))
    )
    assert np.allclose(homogeneous(sighting.position, sighting.rotation), known, atol=1e-12)
    assert sighting.delay == pytest.approx(0.105)


@settings(max_examples=60, deadline=None)
@given(poses(), st.lists(st.floats(-0.3, 0.3), min_size=2, max_size=2))
def test_a_stationary_object_is_seen_at_one_place_from_wherever(
    tcp: Array, view: list[float]
) -> None:
    """Whatever the pose of the robot, the sighting is where the object is."""
    part = homogeneous(np.array((-1.1, 0.4, 2.2)), rotations.exp(np.array((0.1, *view))))
    camera = homogeneous(tcp[:3], rotations.exp(tcp[3:])) @ homogeneous(*CAMERA)
    seen = np.linalg.inv(camera) @ part
    in_camera = np.concatenate((seen[:3, 3], rotations.log(seen[:3, :3])))
    sighting = measure_camera(
        camera_sample(in_camera, EPOCH), tcp, CAMERA, CameraNoise(), EPOCH, STILL
    )
    assert np.allclose(homogeneous(sighting.position, sighting.rotation), part, atol=1e-10)


@settings(max_examples=40, deadline=None)
@given(poses(), st.integers(0, 1000))
def test_variances_are_turned_with_the_line_of_sight(tcp: Array, seed: int) -> None:
    diagonal = np.random.default_rng(seed).uniform(0.1, 2.0, 6) * 1e-6
    covariance = [0.0] * 21
    for index, value in zip((0, 6, 11, 15, 18, 20), diagonal, strict=True):
        covariance[index] = float(value)
    sample = camera_sample(np.array((0, 0, 0.3, 0, 0, 0.0)), EPOCH, tuple(covariance))
    sighting = measure_camera(sample, tcp, CAMERA, CameraNoise(), EPOCH, STILL)
    R = rotations.exp(tcp[3:]) @ CAMERA[1]
    assert np.allclose(sighting.variance[:3], np.diag(R @ np.diag(diagonal[:3]) @ R.T))
    assert np.allclose(sighting.variance[3:], np.diag(R @ np.diag(diagonal[3:]) @ R.T))
    assert sighting.variance[:3].sum() == pytest.approx(diagonal[:3].sum())


def test_without_a_covariance_noise_grows_with_distance_and_most_along_the_line_of_sight() -> None:
    straight = (np.zeros(3), np.eye(3))

    def deviation(distance: float) -> Array:
        sample = camera_sample(np.array((0.0, 0.0, distance, 0.0, 0.0, 0.0)), EPOCH)
        return np.sqrt(
            measure_camera(sample, np.zeros(6), straight, CameraNoise(), EPOCH, STILL).variance
        )

    # 0.25 + 0.0012 d mm across, twice that along, 0.6 + 0.004 d mrad: the study's camera, d in mm.
    for distance in (0.0, 0.25, 1.0):
        lateral = 0.00025 + 0.0012 * distance
        angle = 0.0006 + 0.004 * distance
        known = (lateral, lateral, 2 * lateral, angle, angle, angle)
        assert np.allclose(deviation(distance), known)


@settings(max_examples=60, deadline=None)
@given(poses(), poses())
def test_touch_is_the_deflected_tool(tcp: Array, load: Array) -> None:
    """p = p_rigid + R C_t F, R = R_rigid Exp(C_r M): the sign that the station agreed upon."""
    force, torque = 40.0 * load[:3], 5.0 * load[3:]
    sample = WrenchSample(EPOCH, tuple(force), tuple(torque))
    wrench = mean_wrench((sample,))
    assert wrench is not None
    noise = TactileNoise(stiffness=(50e3, 40e3, 30e3), rotational_stiffness=(2e3, 1e3, 3e3))
    sighting = measure_touch(wrench, tcp, noise, EPOCH + 3_000_000, STILL)
    R = rotations.exp(tcp[3:])
    shift, turn = force / (50e3, 40e3, 30e3), torque / (2e3, 1e3, 3e3)
    known = homogeneous(tcp[:3], R) @ homogeneous(shift, rotations.exp(turn))
    assert np.allclose(homogeneous(sighting.position, sighting.rotation), known, atol=1e-12)
    assert sighting.delay == pytest.approx(0.003)


def test_the_mean_of_three_wrenches_is_dated_to_their_middle_and_a_third_as_uncertain() -> None:
    samples = tuple(
        WrenchSample(EPOCH + i * 4_000_000, (float(i), 2.0, 3.0), (0.1 * i, 0.0, 1.0))
        for i in range(3)
    )
    wrench = mean_wrench(samples)
    assert wrench is not None
    assert wrench.stamp_ns == EPOCH + 4_000_000
    assert np.allclose(wrench.force, (1.0, 2.0, 3.0))
    assert np.allclose(wrench.torque, (0.1, 0.0, 1.0))
    one, three = (
        measure_touch(found, np.zeros(6), TactileNoise(), EPOCH, STILL).variance
        for found in (mean_wrench(samples[:1]), wrench)
        if found is not None
    )
    assert np.allclose(3.0 * three, one)
    assert mean_wrench(()) is None


@pytest.mark.parametrize(
    ("spaces_ms", "error_ms"),
    [
        ([12.0] * 7, 0.0),
        ([12.36] * 7, 0.0),
        ([12.0, 36.0, 12.0, 60.0, 12.0, 12.0, 12.0], 0.0),
        ([12.1, 11.9] * 3, 0.0),
        ([12.0, 12.0, 2.0, 22.0, 12.0, 12.0, 12.0], 11.0),
        ([12.0, 12.0, 12.0, 12.0, 12.0, 54.0, 12.0], 5.0),
    ],
)
def test_dates_of_a_robot_that_are_uneven_make_a_touch_as_uncertain_as_it_moves(
    spaces_ms: list[float], error_ms: float
) -> None:
    history = None
    for stamp in np.cumsum([0.0, *spaces_ms]):
        history = remember(history, EPOCH + round(1e6 * float(stamp)), np.zeros(6), 20)
    assert history is not None
    off_s = date_error(history, 0.012)
    assert off_s == pytest.approx(1e-3 * error_ms, abs=1e-5)
    wrench = mean_wrench((WrenchSample(EPOCH, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),))
    assert wrench is not None
    rate, noise = np.array((0.0, 0.106, 0.0, 0.0, 0.0, 0.0)), TactileNoise()
    variance = measure_touch(wrench, np.zeros(6), noise, EPOCH, rate, off_s).variance
    assert variance[0] == noise.deflection**2
    least = noise.deflection**2 + (0.106 * (noise.stamp + off_s)) ** 2
    assert variance[1] == pytest.approx(least)


def test_the_middle_of_many_stamps_loses_no_nanoseconds() -> None:
    late = 2**62
    wrench = mean_wrench(tuple(WrenchSample(late + i, (0, 0, 0), (0, 0, 0)) for i in (0, 2, 4)))
    assert wrench is not None
    assert wrench.stamp_ns == late + 2


def test_what_moves_is_less_well_known_by_as_much_as_it_moves_in_the_dates_deviation() -> None:
    wrench = Wrench(np.zeros(3), np.zeros(3), EPOCH, 1)
    noise = TactileNoise(stamp=0.001)
    still = measure_touch(wrench, np.zeros(6), noise, EPOCH, STILL).variance
    moving_too = measure_touch(wrench, np.zeros(6), noise, EPOCH, SPEED).variance
    assert np.allclose(moving_too - still, (0.001 * SPEED) ** 2)
    assert np.allclose(rate_now(moving(3, 12_000_000, SPEED)), SPEED, atol=1e-9)
    assert not rate_now(moving(1, 12_000_000, SPEED)).any()


def readings(count: int) -> list[DistanceSample]:
    return [DistanceSample(EPOCH + 1_000_000 * i, 0.1 + 1e-4 * i, 300.0) for i in range(count)]


def test_a_few_readings_of_the_distance_sensor_stay_as_they_are() -> None:
    few = readings(MOST_DISTANCES)
    assert mean_distances(few) == [(sample, 1) for sample in few]
    assert mean_distances([]) == []


@pytest.mark.parametrize("count", [5, 12, 13, 128])
def test_many_readings_become_a_few_means_with_their_own_stamps(count: int) -> None:
    many = readings(count)
    blocks = mean_distances(many)
    assert len(blocks) <= MOST_DISTANCES
    assert sum(each for _, each in blocks) == count
    for mean, _ in blocks:
        assert mean.position == pytest.approx(0.1 + 1e-4 * (mean.stamp_ns - EPOCH) * 1e-6, abs=1e-9)


def test_an_outlier_among_many_readings_is_left_out_of_its_mean() -> None:
    many = readings(12)
    many[4] = DistanceSample(many[4].stamp_ns, 0.2, 30.0)
    blocks = mean_distances(many)
    assert max(mean.position for mean, _ in blocks) < 0.102
    assert [each for _, each in blocks] == [3, 1, 3, 3]
