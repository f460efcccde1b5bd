"""The sensors' noise: what was put in comes out, and what hides below a resolution is refused."""

import math

import numpy as np
import pytest
from traces import CAMERA, Array, Sight, ringing, seen, trace, without

from linemate.daemon.core.tracking.settings import CameraNoise
from linemate.daemon.identification import scene_fit
from linemate.daemon.identification.noise import (
    correlated_share,
    distance_noise,
    identify_noise,
    wrench_noise,
)
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal
from linemate.daemon.identification.swing import find_swings
from linemate.simulators.plants.scenario import Effector


def readings(speed: float, sigma: float, step: float, outliers: float = 0.0) -> Array:
    rng = np.random.default_rng(7)
    t = np.arange(0.0, 12.0, 0.012)
    x = speed * t + sigma * rng.normal(size=len(t))
    wild = rng.random(len(t)) < outliers
    x[wild] += rng.uniform(-0.1, 0.1, int(wild.sum()))
    if step:
        x = np.round(x / step) * step
    return np.column_stack((t, x))


def estimate(outcome: Outcome) -> Estimate:
    assert isinstance(outcome, Estimate), outcome
    return outcome


def test_noise_and_resolution_of_a_coarse_sensor_on_a_moving_conveyor() -> None:
    deviation, resolution, wild = distance_noise([readings(0.106, 0.25e-3, 1e-3, 0.003)])
    true = math.hypot(0.25e-3, 1e-3 / math.sqrt(12.0))
    assert estimate(deviation).value == pytest.approx(true, rel=0.08)
    assert abs(estimate(deviation).value - true) < 4.0 * estimate(deviation).deviation
    assert estimate(resolution).value == pytest.approx(1e-3, rel=1e-6)
    assert 0.0 < estimate(wild).value < 0.01


def test_a_fine_sensor_shows_its_noise_and_no_step() -> None:
    deviation, resolution, _ = distance_noise([readings(0.106, 0.3e-3, 0.0)])
    assert estimate(deviation).value == pytest.approx(0.3e-3, rel=0.08)
    assert isinstance(resolution, Refusal)


def test_a_coarse_sensor_at_rest_hides_its_noise() -> None:
    deviation, resolution, _ = distance_noise([readings(0.0, 0.6e-3, 1e-3)])
    assert isinstance(deviation, Refusal)
    assert "hardly moves" in deviation.reason
    assert estimate(resolution).value == pytest.approx(1e-3)


def test_a_coarse_sensor_that_repeats_two_values_is_no_precise_one() -> None:
    """A line at rest: taken for noise of 0.1 mm, it made the daemon see stops that were none."""
    for outcome in distance_noise([readings(0.0, 0.2e-3, 1e-3)]):
        assert isinstance(outcome, Refusal)
        assert "noise hides below the resolution. Let the conveyor move" in outcome.reason


def test_a_handful_of_readings_is_refused() -> None:
    for outcome in distance_noise([readings(0.1, 1e-4, 1e-3)[:50]]):
        assert isinstance(outcome, Refusal)


def test_the_cameras_noise_grows_with_the_distance_as_it_was_made() -> None:
    one = seen(Sight(seconds=30.0, range_swing=0.25))
    views = scene_fit.views(one, CAMERA, CameraNoise())
    found = identify_noise([one], find_swings(views, CAMERA), views, CAMERA)
    for outcome, true in (
        (found.lateral, 0.25e-3),
        (found.lateral_slope, 1.2e-3),
        (found.depth_factor, 2.0),
        (found.angle, 0.6e-3),
        (found.angle_slope, 4e-3),
        (found.honesty, 1.0),
    ):
        assert abs(estimate(outcome).value - true) < 4.0 * estimate(outcome).deviation + 1e-5
    assert estimate(found.camera_outliers).value == pytest.approx(0.02, abs=0.012)


def test_a_camera_that_states_no_covariance_is_measured_all_the_same() -> None:
    one = seen(Sight(seconds=30.0, range_swing=0.25, covariance=False))
    wrong = CameraNoise(lateral=0.001, lateral_slope=0.0, angle=0.002, angle_slope=0.0)
    views = scene_fit.views(one, CAMERA, wrong)
    found = identify_noise([one], find_swings(views, CAMERA), views, CAMERA)
    assert estimate(found.lateral_slope).value == pytest.approx(1.2e-3, rel=0.4)
    assert estimate(found.angle_slope).value == pytest.approx(4e-3, rel=0.4)


def test_images_from_one_distance_tell_no_slope() -> None:
    one = seen(Sight(seconds=8.0, range_swing=0.0, moving=0.0, turning=0.02))
    views = scene_fit.views(one, CAMERA, CameraNoise())
    found = identify_noise([one], find_swings(views, CAMERA), views, CAMERA)
    assert isinstance(found.lateral_slope, Refusal)
    assert "too close together" in found.lateral_slope.reason


def test_force_noise_is_seen_through_the_ringing() -> None:
    force, torque = wrench_noise([ringing(Effector(), seed=5, moves=3)])
    assert estimate(force).value == pytest.approx(0.05e-3 * 50e3, rel=0.05)
    assert estimate(torque).value == pytest.approx(0.2e-3 * 2000.0, rel=0.05)


def test_wrenches_in_contact_do_not_count() -> None:
    clamped = without(ringing(Effector(), seed=5, moves=2), contact=np.array([[0.0, 99.0]]))
    assert isinstance(wrench_noise([clamped])[0], Refusal)


def test_nothing_recorded_is_refused_everywhere() -> None:
    found = identify_noise([trace()], None, [], CAMERA)
    for outcome in (found.distance, found.lateral, found.force):
        assert isinstance(outcome, Refusal)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
def test_noise_that_is_correlated_from_image_to_image_is_separated(share: float) -> None:
    chance = np.random.default_rng(7)
    blocks = []
    for _ in range(4):
        times = np.arange(0.0, 30.0, 0.03)
        kept, lasting = math.exp(-0.03 / 0.5), chance.standard_normal(5)
        errors = np.empty((len(times), 5))
        for i in range(len(times)):
            lasting = kept * lasting + math.sqrt(1.0 - kept * kept) * chance.standard_normal(5)
            fresh = chance.standard_normal(5)
            errors[i] = math.sqrt(share) * lasting + math.sqrt(1.0 - share) * fresh
        blocks.append((times, errors))
    found, time_s = correlated_share(blocks)
    assert estimate(found).value == pytest.approx(share, abs=0.06)
    if share:
        assert estimate(time_s).value == pytest.approx(0.5, rel=0.25)
    else:
        assert isinstance(time_s, Refusal)
