"""Past predictions against images: what each kind of error shows."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.estimation import prediction_error
from linemate.daemon.core.tracking.estimation.prediction_error import (
    LARGEST_GAP_NS,
    LONGEST_LEAD_S,
    NO_PREDICTIONS,
    SHORT_LEAD_S,
    SPACING_S,
    WINDOW_S,
    PredictionMonitor,
)
from linemate.daemon.core.tracking.observation import PoseMeasurement

LEADS_S = prediction_error.lead_times(LONGEST_LEAD_S)
T0, FRAME, SPEED, DELAY = 0.012, 0.024, 0.1, 0.1
Motion = Callable[[float], tuple[float, float, float, float]]


def still(_: float) -> tuple[float, float, float, float]:
    return 0.0, 0.0, 0.0, 0.0


def run(
    seconds: float,
    predicted: Motion = still,
    seen: Motion = still,
    conveyor: Callable[[float], float] = lambda t: SPEED * t,
    noise: float = 0.0,
    outliers: float = 0.0,
) -> PredictionMonitor:
    """Predictions and images of an object on a conveyor, each off by x, y, z and an angle."""
    chance = np.random.default_rng(7)
    monitor, tilt = NO_PREDICTIONS, np.array((0.0, 0.3, 0.2))

    def pose(off: tuple[float, float, float, float], t: float) -> Array:
        turned = rotations.log(rotations.exp(tilt) @ rotations.exp(np.array((off[3], 0.0, 0.0))))
        place = np.array((0.1, conveyor(t), 0.5)) + rotations.exp(tilt) @ np.array(off[:3])
        return np.concatenate((place, turned))

    for k in range(round(seconds / T0)):
        now = k * T0
        now_ns = round(now * 1e9)
        if prediction_error.is_due(monitor, now_ns):
            times = [now + lead for lead in LEADS_S]
            poses = np.array([pose(predicted(t), t) for t in times])
            # A prediction takes the conveyor to go on as it does now.
            along = np.array([conveyor(now) + SPEED * lead for lead in LEADS_S])
            poses[:, 1] += along - np.array([conveyor(t) for t in times])
            monitor = prediction_error.record(monitor, now_ns, LEADS_S, poses, along)
        if k % 2 == 0:
            t = now - DELAY
            at = pose(seen(t), t)
            place = at[:3] + noise * chance.standard_normal(3)
            if chance.random() < outliers:
                place = place + 0.03
            variance = np.full(6, noise**2)
            measured = PoseMeasurement(place, rotations.exp(at[3:]), DELAY, variance)
            monitor = prediction_error.compare_poses(monitor, now_ns, [measured])
    return monitor


def test_a_right_prediction_has_no_error() -> None:
    for lead in run(4.0).leads:
        assert max(lead.lateral, lead.depth, lead.angle) < 1e-9
        assert lead.checked_s == pytest.approx(WINDOW_S, abs=2 * FRAME)


@pytest.mark.parametrize("hz", [0.5, 1.2, 2.0])
def test_a_swing_that_is_not_predicted_shows_with_its_amplitude(hz: float) -> None:
    def swinging(t: float) -> tuple[float, float, float, float]:
        return 0.0, 0.004 * math.sin(2 * math.pi * hz * t), 0.0, 0.0

    monitor = run(5.0, seen=swinging)
    for lead in monitor.leads:
        assert 0.0034 < lead.lateral < 0.0041


@pytest.mark.parametrize(
    ("off", "field", "size"),
    [
        ((0.003, 0.004, 0.0, 0.0), "lateral", 0.005),
        ((0.0, 0.0, 0.006, 0.0), "depth", 0.006),
        ((0.0, 0.0, 0.0, 0.02), "angle", 0.02),
    ],
)
def test_each_error_shows_in_its_own_figure(
    off: tuple[float, float, float, float], field: str, size: float
) -> None:
    lead = run(4.0, seen=lambda _: off).leads[1]
    assert getattr(lead, field) == pytest.approx(size, rel=0.02)
    for other in {"lateral", "depth", "angle"} - {field}:
        assert getattr(lead, other) < 1e-4


def test_a_drift_across_shows_as_far_as_it_goes_in_the_longer_lead() -> None:
    def askew(t: float) -> tuple[float, float, float, float]:
        return 0.001 * t, 0.0, 0.0, 0.0

    short, long = run(5.0, predicted=lambda t: askew(t - 1.5), seen=askew).leads
    assert short.lateral == pytest.approx(0.0015, rel=0.1)
    assert long.lateral == pytest.approx(0.0015, rel=0.1)


def test_single_outliers_and_noise_do_not_count() -> None:
    monitor = run(4.0, noise=0.0003, outliers=0.02)
    for lead in monitor.leads:
        assert lead.lateral < 0.0009


@pytest.mark.parametrize("noise", [0.0005, 0.0015])
def test_noise_of_the_images_is_no_error_of_the_prediction(noise: float) -> None:
    for lead in run(4.0, noise=noise).leads:
        assert lead.lateral < noise * 1.2


@pytest.mark.parametrize("off", [0.002, 0.003, 0.004])
def test_a_deviation_is_not_taken_for_noise_of_the_images(off: float) -> None:
    for lead in run(4.0, seen=lambda _: (off, 0.0, 0.0, 0.0), noise=0.0013).leads:
        assert lead.lateral > off


def test_a_stop_of_the_conveyor_is_no_error_of_the_body() -> None:
    def stopping(t: float) -> float:
        return SPEED * min(t, 2.5)

    short, long = run(3.6, conveyor=stopping).leads
    assert short.lateral > 0.005  # 0.25 s at 0.1 m/s, at most
    assert long.lateral == pytest.approx(short.lateral, abs=1e-9)


def test_predictions_of_another_class_are_forgotten_and_their_errors_kept() -> None:
    monitor = run(4.0, seen=lambda _: (0.004, 0.0, 0.0, 0.0))
    after = prediction_error.forget(monitor)
    assert all(not lead.stamps_ns for lead in after.leads)
    assert after.leads[0].lateral == monitor.leads[0].lateral


def test_memory_is_bounded() -> None:
    monitor = run(12.0)
    for lead, ahead in zip(monitor.leads, LEADS_S, strict=True):
        assert len(lead.stamps_ns) <= (ahead + WINDOW_S) / SPACING_S + 1
        assert len(lead.errors) <= WINDOW_S / FRAME + 2


def test_the_distance_sensor_is_compared_with_the_shortest_prediction() -> None:
    monitor = run(4.0)
    now_ns = round(3.9e9)
    for k in range(100):
        stamp_ns = now_ns + k * 1_000_000
        position = SPEED * stamp_ns * 1e-9 + 0.004
        monitor = prediction_error.compare_distance(monitor, stamp_ns, position, T0)
    assert monitor.distance == pytest.approx(0.004, rel=0.01)
    same = prediction_error.compare_distance(monitor, now_ns, 5.0, T0)
    assert same.distance == monitor.distance


def test_an_error_of_the_distance_from_before_a_gap_is_no_evidence() -> None:
    monitor, late_ns = replace(run(4.0), distance=0.004), round(20e9)
    assert prediction_error.compare_distance(monitor, late_ns, 2.0, T0).distance == 0.0


@pytest.mark.parametrize(
    ("blind_s", "long_s"),
    [(0.4, 0.4), (1.81, LONGEST_LEAD_S), (0.1, SHORT_LEAD_S), (math.inf, LONGEST_LEAD_S)],
)
def test_the_long_lead_is_the_time_from_the_last_waypoint_to_the_contact(
    blind_s: float, long_s: float
) -> None:
    assert prediction_error.lead_times(blind_s) == (SHORT_LEAD_S, long_s)


def test_an_image_in_a_gap_between_predictions_is_not_compared() -> None:
    pose, along = np.zeros((2, 6)), np.zeros(2)
    image = PoseMeasurement(np.array((0.1, 0.0, 0.0)), np.eye(3), 0.0, np.ones(6))
    for gap_ns, count in ((LARGEST_GAP_NS, 1), (LARGEST_GAP_NS + 1_000_000, 0)):
        monitor = prediction_error.record(NO_PREDICTIONS, 0, (0.25, 0.25), pose, along)
        monitor = prediction_error.record(monitor, gap_ns, (0.25, 0.25), pose, along)
        now_ns = 250_000_000 + gap_ns // 2
        after = prediction_error.compare_poses(monitor, now_ns, [image])
        assert [len(lead.errors) for lead in after.leads] == [count, count]


def test_a_time_without_images_leaves_what_was_checked_before_for_a_while() -> None:
    monitor = run(4.0, seen=lambda _: (0.004, 0.0, 0.0, 0.0))
    seen_ns = monitor.leads[0].seen_ns
    pose, along = np.zeros((2, 6)), np.zeros(2)
    image = PoseMeasurement(np.zeros(3), np.eye(3), 0.0, np.ones(6))
    for gap_ns, kept in ((2_900_000_000, True), (3_100_000_000, False)):
        now_ns = seen_ns + gap_ns
        later = prediction_error.record(monitor, now_ns - 10, (0.0, 0.0), pose, along)
        later = prediction_error.record(later, now_ns + 10, (0.0, 0.0), pose, along)
        lead = prediction_error.compare_poses(later, now_ns, [image]).leads[0]
        assert (lead.checked_s > 0.8) is kept
        assert (lead.lateral > 0.003) is kept


def test_images_whose_stamps_stand_still_fill_no_memory() -> None:
    monitor, now_ns = run(4.0), round(4e9)
    image = PoseMeasurement(np.zeros(3), np.eye(3), 0.1, np.ones(6))
    for _ in range(2 * prediction_error.MOST_ERRORS):
        monitor = prediction_error.compare_poses(monitor, now_ns, [image])
    assert len(monitor.leads[0].errors) <= prediction_error.MOST_ERRORS + 1


def test_the_error_of_a_window_is_the_quantile_of_its_medians_computed_at_once() -> None:
    """Each image adds one median; numpy takes those of the whole window."""
    noisy = run(4.0, seen=lambda t: (0.001 * math.sin(9.0 * t), 0.002, 0.001, 0.01), noise=0.002)
    for lead in noisy.leads:
        errors = np.array([error for _, error in lead.errors])
        medians = np.median((errors[:-2], errors[1:-1], errors[2:]), axis=0)
        squared = np.square(medians[:, :2]).sum(axis=1)
        of_noise = prediction_error.NOISE_SHARE * 2.0 * 0.002**2
        across = np.sqrt(np.maximum(squared - of_noise, prediction_error.LEAST_SHARE * squared))
        sizes = np.sort(across), np.sort(np.abs(medians.T[2]))
        place = round(prediction_error.QUANTILE * len(medians))
        assert len(errors) > 20
        assert (lead.lateral, lead.depth) == pytest.approx([size[place] for size in sizes])


def test_a_state_without_medians_gives_the_same_errors_after_its_next_image() -> None:
    before = run(4.0, noise=0.002)
    older = [replace(lead, medians=()) for lead in before.leads]
    variance = np.full(6, 0.002**2)
    image = PoseMeasurement(np.array((0.1, 0.39, 0.5)), np.eye(3), DELAY, variance)
    now, bare = (
        prediction_error.compare_poses(each, 4_000_000_000, [image]).leads
        for each in (before, replace(before, leads=tuple(older)))
    )
    assert len(now[0].errors) > 20
    for lead, again in zip(now, bare, strict=True):
        assert again.medians == lead.medians[-len(again.medians) :]
        assert (again.lateral, again.depth) == (lead.lateral, lead.depth)
