"""Sway of the body from seen stops: true within its deviation, bounded, or refused."""

from dataclasses import replace

import pytest
from swaying_body import RAMPS, Body, recorded, viewed
from traces import CAMERA

from linemate.daemon.identification import sway
from linemate.daemon.identification.hand_eye import identify_camera
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal
from linemate.daemon.identification.sway import SwayResult, findings, identify_sway
from linemate.daemon.identification.swing import find_swings
from linemate.daemon.identification.trace import Images, Trace


def identified(*traces: Trace) -> SwayResult:
    seen, bodies = viewed(traces)
    return identify_sway(find_swings(seen, CAMERA), seen, bodies, traces, CAMERA, 0.0)


def within(outcome: Outcome, true: float, times: float = 4.0) -> bool:
    assert isinstance(outcome, Estimate), outcome
    assert outcome.deviation > 0.0
    return abs(outcome.value - true) <= times * outcome.deviation


@pytest.mark.parametrize(
    "body",
    [
        Body(),
        Body(frequency_hz=0.8, gain=0.6, damping=0.01, seed=1),
        Body(frequency_hz=1.7, gain=1.0, damping=0.03, seed=2),
    ],
)
def test_a_planted_sway_is_found_within_its_deviations(body: Body) -> None:
    result = identified(recorded(body))
    assert within(result.frequency_hz, body.frequency_hz)
    assert within(result.gain, body.gain)
    assert within(result.damping, body.damping)
    assert isinstance(result.frequency_hz, Estimate)
    assert isinstance(result.gain, Estimate)
    assert result.frequency_hz.deviation < 0.02 * body.frequency_hz
    assert result.gain.deviation < 0.15
    assert result.settings["frequency_hz"] == result.frequency_hz.value
    assert result.settings["gain_deviation"] >= result.gain.deviation


def test_another_sway_than_the_planted_one_is_noticed() -> None:
    result = identified(recorded(Body()))
    assert not within(result.frequency_hz, 1.3)
    assert not within(result.gain, 0.4)


def test_a_chain_that_drives_the_body_before_the_stop_hardly_changes_the_frequency() -> None:
    body = Body(lateral=1e-3, chain=0.2e-3, damping=0.01, ramps=((8.0, -0.104),))
    result = identified(recorded(body))
    assert isinstance(result.frequency_hz, Estimate)
    assert result.frequency_hz.value == pytest.approx(body.frequency_hz, rel=0.007)
    assert result.frequency_hz.deviation < 0.0067


@pytest.mark.parametrize("late", [0.0, 0.02])
def test_a_late_distance_sensor_is_no_error_of_the_cameras_stamps(late: float) -> None:
    body = Body(late=late, arm=0.1)
    trace = recorded(body)
    seen, _ = viewed([trace])
    stamp = identify_camera(find_swings(seen, CAMERA), seen, [trace.images]).stamp_error
    assert isinstance(stamp, Estimate)
    assert stamp.value == pytest.approx(body.stamp_error, abs=0.001)


def test_a_stop_that_shows_no_sway_bounds_its_gain() -> None:
    result = identified(recorded(Body(gain=0.0)))
    assert isinstance(result.frequency_hz, Refusal)
    assert "none from" in result.frequency_hz.reason
    assert isinstance(result.gain, Estimate)
    assert result.gain.value == 0.0
    assert 0.0 < result.gain.deviation <= sway.GAIN_DEVIATION
    deviation = result.gain.deviation
    assert result.settings == {"frequency_hz": 0.0, "gain": 0.0, "gain_deviation": deviation}
    assert [line.name for line in findings(result)] == ["sway frequency", "sway gain"]
    assert [line.in_overlay for line in findings(result)] == [False, True]


@pytest.mark.parametrize("frequency_hz", [0.4, 0.7, 1.5, 3.0])
def test_a_sway_too_small_to_be_found_moves_the_body_within_what_is_bounded(
    frequency_hz: float,
) -> None:
    small = 0.005 * (frequency_hz / 0.4) ** 2
    result = identified(recorded(Body(frequency_hz=frequency_hz, gain=small, lateral=2e-3)))
    assert result.settings["frequency_hz"] == 0.0
    displacement = small / frequency_hz**2
    assert displacement < 3.0 * result.settings["gain_deviation"] / sway.LOWEST_HZ**2


def test_a_conveyor_that_never_stops_tells_of_no_sway() -> None:
    result = identified(recorded(Body(ramps=())))
    assert not result.settings
    assert isinstance(result.gain, Refusal)
    assert "no stop and no start" in result.gain.reason


def test_a_stop_that_the_camera_does_not_see_is_refused() -> None:
    whole = recorded(Body(ramps=RAMPS[:1]))
    late = whole.images.exposures > 16.0
    images = Images(*(getattr(whole.images, name)[late] for name in Images.__slots__))
    result = identified(replace(whole, images=images))
    assert isinstance(result.gain, Refusal)
    assert "while the camera sees" in result.gain.reason


def test_a_camera_too_noisy_for_the_sway_bounds_it_widely() -> None:
    good, noisy = (
        identified(recorded(Body(gain=0.0, lateral=lateral))).settings["gain_deviation"]
        for lateral in (0.5e-3, 3e-3)
    )
    assert noisy > 2.5 * good
