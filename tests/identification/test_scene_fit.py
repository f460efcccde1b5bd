"""Swing, hand-eye pose, stamps and offset from images: true within the deviation, or refused."""

from dataclasses import replace

import numpy as np
import pytest
from traces import CAMERA, Sight, seen, trace

from linemate.daemon.core.tracking.settings import CameraNoise
from linemate.daemon.identification import scene_fit
from linemate.daemon.identification.hand_eye import CameraResult, identify_camera
from linemate.daemon.identification.offset import identify_offset
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal
from linemate.daemon.identification.scene_fit import SHARED, SceneFit, Views
from linemate.daemon.identification.swing import SwingResult, find_swings, identify_swings
from linemate.daemon.identification.trace import Trace

Found = tuple[SceneFit | None, list[Views]]


def looked(*traces: Trace) -> Found:
    views = [view for one in traces for view in scene_fit.views(one, CAMERA, CameraNoise())]
    return find_swings(views, CAMERA), views


def swings(*traces: Trace) -> tuple[SwingResult, ...]:
    return identify_swings(*looked(*traces))


def within(outcome: Outcome, true: float, times: float = 4.0) -> bool:
    assert isinstance(outcome, Estimate), outcome
    assert outcome.deviation > 0.0
    return abs(outcome.value - true) <= times * outcome.deviation


def test_the_default_swing_is_reported_within_its_deviation() -> None:
    (result,) = swings(seen(Sight()))
    assert result.mode is not None
    assert result.mode.axis == 1
    assert within(result.frequency_hz, 0.62)
    assert within(result.damping, 0.002)
    for lever, true in zip(result.levers, (-0.3, 0.0, -0.9), strict=True):
        assert within(lever, true)
    assert isinstance(result.frequency_hz, Estimate)
    assert result.frequency_hz.deviation < 0.002


def test_deviations_are_honest_over_many_recordings() -> None:
    offs = []
    for seed in range(5):
        result = swings(seen(Sight(seconds=10.0, seed=seed)))[0]
        assert isinstance(result.frequency_hz, Estimate)
        offs.append((result.frequency_hz.value - 0.62) / result.frequency_hz.deviation)
    assert max(map(abs, offs)) < 4.0
    assert 0.3 < float(np.sqrt(np.mean(np.square(offs)))) < 2.0


def test_two_swings_about_two_axes_are_separated() -> None:
    both = (
        (0.62, 0.002, (0.0, 0.006, 0.0), (0.9, 0.0, -0.3)),
        (1.1, 0.01, (0.005, 0.0, 0.0), (0.9, 0.0, -0.3)),
    )
    results = swings(seen(Sight(seconds=18.0, swings=both)))
    modes = sorted((r.mode for r in results if r.mode), key=lambda mode: mode.frequency_hz)
    assert [mode.axis for mode in modes] == [1, 0]
    assert [mode.frequency_hz for mode in modes] == pytest.approx([0.62, 1.1], rel=0.01)
    assert modes[1].levers == pytest.approx((0.0, 0.3, 0.0), abs=0.06)


def test_an_object_at_rest_does_not_swing() -> None:
    (result,) = swings(seen(Sight(swings=())))
    assert isinstance(result.frequency_hz, Refusal)
    assert "nothing swings" in result.frequency_hz.reason


def test_an_oblique_swing_is_refused_but_its_frequency_is_reported() -> None:
    oblique = ((0.62, 0.002, (0.0, 0.005, 0.004), (0.9, 0.0, -0.3)),)
    result = swings(seen(Sight(swings=oblique)))[0]
    assert result.mode is None
    assert within(result.frequency_hz, 0.62)
    assert isinstance(result.levers[0], Refusal)
    assert "off the nearest" in result.levers[0].reason


def test_too_short_a_recording_is_refused() -> None:
    result = swings(seen(Sight(seconds=4.0)))[0]
    assert result.mode is None


def test_no_images_tell_nothing() -> None:
    found, views = looked(trace())
    assert found is None
    assert isinstance(identify_swings(found, views)[0].frequency_hz, Refusal)
    result = identify_camera(found, views, [trace().images])
    assert isinstance(result.stamp_error, Refusal)
    assert isinstance(result.latency, Refusal)
    assert isinstance(identify_offset(found, views, [], 0.0, 0.0).sensor, Refusal)


def camera(*traces: Trace) -> CameraResult:
    return identify_camera(*looked(*traces), [one.images for one in traces])


def test_a_camera_that_hangs_crooked_and_stamps_late_is_found_out() -> None:
    crooked = (0.004, -0.003, 0.005, 0.006, -0.004, 0.008)
    result = camera(seen(Sight(hand_eye=crooked, stamp_error=0.006)))
    for outcome, true in zip((*result.position, *result.rotation), crooked, strict=True):
        assert within(outcome, true)
    assert within(result.stamp_error, 0.006)
    assert isinstance(result.stamp_error, Estimate)
    assert result.stamp_error.deviation < 0.002


@pytest.mark.row
def test_deviations_hold_for_a_camera_whose_errors_last_half_a_second() -> None:
    crooked = (0.004, -0.003, 0.005, 0.006, -0.004, 0.008)
    offs = []
    for seed in range(4):
        found, _ = looked(seen(Sight(hand_eye=crooked, slow=1.0, seed=seed)))
        assert found is not None
        deviations = np.sqrt(found.covariance.diagonal()[-7:-1])
        offs.append((found.hand_eye - np.array(crooked)) / deviations)
    assert np.abs(offs).max() < 4.0
    assert 0.3 < float(np.sqrt(np.mean(np.square(offs)))) < 2.0


def test_a_bias_of_2_mm_a_metre_moves_nothing_by_more_than_a_deviation() -> None:
    plain = seen(Sight())
    images = replace(plain.images, positions=1.002 * plain.images.positions)
    (before, _), (after, _) = looked(plain), looked(replace(plain, images=images))
    assert before is not None
    assert after is not None
    deviations = np.sqrt(after.covariance.diagonal()[-SHARED:-2])
    assert np.all(np.abs(after.hand_eye - before.hand_eye) < deviations)


def test_a_good_camera_is_left_alone_before_a_moving_object_too() -> None:
    result = camera(seen(Sight(speed=0.106)))
    for outcome in (*result.position, *result.rotation, result.stamp_error):
        assert within(outcome, 0.0)
    assert isinstance(result.latency, Estimate)
    assert result.latency.value == pytest.approx(0.1)
    assert isinstance(result.period, Estimate)
    assert result.period.value == pytest.approx(0.025)


def test_a_tool_that_does_not_turn_tells_no_place_of_the_camera() -> None:
    result = camera(seen(Sight(turning=0.0)))
    for outcome in result.position:
        assert isinstance(outcome, Refusal)
        assert "turned by only" in outcome.reason


def test_a_tool_at_rest_before_an_object_at_rest_tells_no_delay() -> None:
    result = camera(seen(Sight(turning=0.0, moving=0.0, range_swing=0.0, swings=())))
    assert isinstance(result.stamp_error, Refusal)
    assert isinstance(result.rotation[2], Refusal)


def test_a_swing_is_found_next_to_a_crooked_camera() -> None:
    crooked = (0.004, -0.003, 0.005, 0.006, -0.004, 0.008)
    result = swings(seen(Sight(hand_eye=crooked)))[0]
    assert within(result.frequency_hz, 0.62)
    assert within(result.levers[2], -0.9)


def test_the_offset_of_a_recording_is_reported_and_the_sensors_only_over_bodies() -> None:
    found, views = looked(seen(Sight(offset=0.012)))
    result = identify_offset(found, views, [0], 0.0, 0.02)
    assert within(result.recordings[0], 0.012)
    assert isinstance(result.sensor, Refusal)
    assert found is not None
    (rest,) = found.rests
    off = (-0.04, -0.03, -0.01, 0.02, 0.025, 0.035)
    bodies = tuple(replace(rest, position=rest.position + np.array((0.0, x, 0.0))) for x in off)
    many = replace(found, rests=bodies, rest_deviations=np.tile(found.rest_deviations, (6, 1)))
    shared = identify_offset(many, views * 6, list(range(6)), 0.0, 0.02).sensor
    assert within(shared, 0.012)
    same_body = identify_offset(many, views * 6, [0, 0, 0, 1, 1, 1], 0.0, 0.02).sensor
    assert isinstance(same_body, Refusal)


def test_before_and_after_a_contact_are_two_scenes() -> None:
    one = replace(seen(Sight()), contact=np.array([[8.0, 10.0]]))
    before, after = scene_fit.views(one, CAMERA, CameraNoise())
    assert before.times.max() < 7.95
    assert after.times.min() > 10.05
