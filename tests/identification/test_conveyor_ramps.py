"""Ramps of the conveyor from distance readings: true within their deviations, or refused."""

import numpy as np
import pytest
from traces import trace

from linemate.daemon.identification import conveyor_ramps
from linemate.daemon.identification.conveyor_ramps import (
    FittedRamp,
    RampClass,
    find_ramps,
    findings,
    identify_ramps,
    motion,
)
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal
from linemate.daemon.identification.trace import Trace

SPEED = 0.106
STOP, START = 6.0, 14.0


def recorded(stop: float = 0.104, start: float = 0.05, smooth: float = 0.4, seed: int = 0) -> Trace:
    """What a distance sensor reads of a stop and a start with a limited jerk."""
    fine = np.arange(0.0, 22.0, 1e-3)
    a = np.where((fine >= STOP) & (fine < STOP + SPEED / stop), -stop, 0.0)
    a += np.where((fine >= START) & (fine < START + SPEED / start), start, 0.0)
    width = max(round(smooth / 1e-3), 1)
    a = np.convolve(a, np.full(width, 1.0 / width))[: len(fine)]
    speed = SPEED + np.cumsum(a) * 1e-3
    position = np.cumsum(speed) * 1e-3
    stamps = np.arange(0.0, 21.9, 0.012)
    noise = 0.25e-3 * np.random.default_rng(seed).normal(size=len(stamps))
    readings = np.round(np.interp(stamps, fine, position) + noise, 3)
    return trace(distances=np.column_stack((stamps, readings)))


def within(outcome: Outcome, true: float) -> bool:
    assert isinstance(outcome, Estimate), outcome
    assert outcome.deviation > 0.0
    return abs(outcome.value - true) <= 4.0 * outcome.deviation


def classes(*traces: Trace) -> tuple[RampClass, RampClass]:
    found = identify_ramps(traces, 0.0)
    assert [each.starts for each in found] == [False, True]
    return found[0], found[1]


@pytest.mark.parametrize("smooth", [0.1, 0.4, 0.6])
def test_acceleration_and_smooth_time_of_ramps_are_found(smooth: float) -> None:
    stop, start = classes(*(recorded(smooth=smooth, seed=seed) for seed in range(3)))
    assert within(stop.acceleration, 0.104)
    assert within(start.acceleration, 0.05)
    assert within(stop.smooth, smooth)
    assert isinstance(stop.acceleration, Estimate)
    assert stop.acceleration.deviation < 0.006
    assert isinstance(stop.smooth, Estimate)
    assert stop.smooth.deviation < 0.15


def test_a_planted_harder_stop_is_noticed() -> None:
    stop, _ = classes(recorded(stop=0.16))
    assert within(stop.acceleration, 0.16)
    assert not within(stop.acceleration, 0.104)


def test_ramps_are_found_where_they_are() -> None:
    moved = motion(recorded(), 0.0)
    assert moved is not None
    stop, start = find_ramps(moved)
    assert not stop.starts
    assert start.starts
    assert stop.begin == pytest.approx(STOP, abs=0.3)
    assert stop.end == pytest.approx(STOP + SPEED / 0.104 + 0.4, abs=0.4)
    assert start.begin == pytest.approx(START, abs=0.4)


def test_a_conveyor_that_only_runs_has_no_ramps() -> None:
    stamps = np.arange(0.0, 10.0, 0.012)
    (found,) = identify_ramps((trace(distances=np.column_stack((stamps, SPEED * stamps))),), 0.0)
    assert isinstance(found.acceleration, Refusal)
    assert [line.name for line in findings((found,))] == ["conveyor stop deceleration"]


def test_without_a_distance_sensor_there_are_no_ramps() -> None:
    (found,) = identify_ramps((trace(tcp=np.zeros((100, 6))),), 0.0)
    assert isinstance(found.acceleration, Refusal)


def test_a_ramp_within_a_ramp_has_no_readings_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [FittedRamp(False, 5.9, 8.1), FittedRamp(False, 7.7, 7.9), FittedRamp(True, 8.0, 8.01)]
    monkeypatch.setattr(conveyor_ramps, "find_ramps", lambda _: found)
    assert motion(recorded(), 0.0) is not None
    assert identify_ramps([recorded()], 0.0)
