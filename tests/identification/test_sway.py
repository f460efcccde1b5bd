"""Sway of the body from seen stops: true within its deviation, bounded, or refused."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from traces import CAMERA, CYCLE_S, trace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.settings import CameraNoise, SwingMode
from linemate.daemon.identification import scene_fit, sway
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal
from linemate.daemon.identification.scene_fit import Views
from linemate.daemon.identification.sway import (
    SwayResult,
    across_findings,
    findings,
    identify_across,
    identify_sway,
)
from linemate.daemon.identification.swing import find_swings
from linemate.daemon.identification.trace import Images, Trace

SPEED = 0.106
RAMPS = ((6.0, -0.104), (14.0, 0.104), (22.0, -0.104))
SECONDS = 30.0
PITCH = 0.1  # of the conveyor's chain [m]


@dataclass(frozen=True)
class Body:
    """A body on a conveyor that stops and starts, as it really is."""

    frequency_hz: float = 1.2
    gain: float = 1.0
    damping: float = 0.02
    lateral: float = 0.4e-3
    stamp_error: float = 0.004
    ramps: tuple[tuple[float, float], ...] = RAMPS
    chain: float = 0.0  # amplitude of the error of the conveyor's chain [m]
    axis: int = 1  # of c, along which the body sways
    seed: int = 0


def acceleration(body: Body, t: float) -> float:
    return sum(a for begin, a in body.ramps if begin <= t < begin + SPEED / abs(a))


def moved(body: Body, times: Array) -> tuple[Array, Array]:
    """Position of the unit and sway of the body (n,) at times, integrated step by step."""
    w = 2.0 * math.pi * body.frequency_hz
    per_metre = 2.0 * math.pi / PITCH

    def rates(t: float, y: Array) -> list[float]:
        a = acceleration(body, t)
        a -= body.chain * (per_metre * y[1]) ** 2 * math.sin(per_metre * y[0])
        force = -body.gain * a - 2.0 * body.damping * w * y[3] - w * w * y[2]
        return [y[1], acceleration(body, t), y[3], force]

    found = solve_ivp(rates, (0.0, SECONDS + 1.0), (0.0, SPEED, 0.0, 0.0),
                      max_step=0.02, dense_output=True).sol(times)  # fmt: skip
    return found[0] + body.chain * np.sin(per_metre * found[0]), found[2]


def recorded(body: Body) -> Trace:
    """A camera that stands before the conveyor's path, and a distance sensor."""
    rng = np.random.default_rng(body.seed)
    exposures = np.arange(0.2, SECONDS, 0.025)
    unit, swayed = moved(body, exposures + body.stamp_error)
    place = np.column_stack((0.0 * unit, unit, 0.5 + 0.0 * unit))
    place[:, body.axis] += swayed
    deviations = np.tile((body.lateral, body.lateral, 2.0 * body.lateral, 1e-3, 1e-3, 1e-3),
                         (len(unit), 1))  # fmt: skip
    tcp = np.zeros((round((SECONDS + 1.0) / CYCLE_S), 6))
    images = Images(
        exposures,
        exposures + 0.1,
        place - CAMERA[0] + deviations[:, :3] * rng.normal(size=(len(unit), 3)),
        np.tile(np.eye(3), (len(unit), 1, 1)),
        deviations,
    )
    stamps = np.arange(0.0, SECONDS + 1.0, CYCLE_S)
    readings = np.round(moved(body, stamps)[0] + 0.3e-3 * rng.normal(size=len(stamps)), 3)
    return trace(tcp=tcp, images=images, distances=np.column_stack((stamps, readings)))


def identified(*traces: Trace) -> SwayResult:
    seen, bodies = viewed(traces)
    return identify_sway(find_swings(seen, CAMERA), seen, bodies, traces, CAMERA, 0.0)


def viewed(traces: Sequence[Trace]) -> tuple[list[Views], list[int]]:
    per_trace = [scene_fit.views(each, CAMERA, CameraNoise()) for each in traces]
    seen = [view for views in per_trace for view in views]
    return seen, [i for i, views in enumerate(per_trace) for _ in views]


def across(trace: Trace) -> list[SwingMode]:
    seen, bodies = viewed([trace])
    return identify_across(find_swings(seen, CAMERA), seen, bodies, [trace], CAMERA, 0.0)


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


@pytest.mark.row
@pytest.mark.parametrize(("axis", "gain"), [(2, 0.3), (2, -0.3), (0, 0.3)])
def test_a_sway_across_the_line_is_found_as_a_swing_without_a_turn(axis: int, gain: float) -> None:
    body = Body(frequency_hz=0.9, gain=gain, axis=axis, seed=3)
    (mode,) = across(recorded(body))
    assert mode.frequency_hz == pytest.approx(0.9, abs=4.0 * mode.spread * 0.9)
    assert mode.gain == pytest.approx(abs(gain), abs=4.0 * mode.gain_deviation)
    assert mode.gain_deviation < 0.1
    assert mode.damping == pytest.approx(body.damping, abs=0.01)
    levers = [0.0, 0.0, 0.0]
    levers[axis] = math.copysign(sway.LONGEST_LEVER, gain)
    assert list(mode.levers) == levers
    names = [line.name for line in across_findings([mode])]
    assert names == [f"sway across, {'xyz'[axis]}: {what}" for what in ("frequency", "gain")]


def test_a_sway_along_the_line_is_none_across_it() -> None:
    assert across(recorded(Body())) == []
    assert across(recorded(Body(ramps=()))) == []
