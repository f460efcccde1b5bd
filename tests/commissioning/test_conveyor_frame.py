"""Direction and scale of the conveyor from made images of a passing object that swings."""

import math

import numpy as np
import pytest

from linemate.daemon.commissioning.conveyor_frame import ConveyorFrame, find_frame
from linemate.daemon.commissioning.postures import StandingPosture
from linemate.daemon.core.inputs import Inputs
from linemate.daemon.core.tracking.task import PoseFile
from linemate.daemon.identification.outcome import Refusal
from linemate.protocol.stamped_samples import CameraSample, DistanceSample

AXIS = np.array((math.sin(0.01), math.cos(0.01), 0.0))
SPEED = 0.1


def passing(
    *, length_s: float = 9.0, scale: float = 1.0, sign: float = 1.0, swing: float = 0.006
) -> tuple[list[Inputs], list[StandingPosture]]:
    """An object that passes a tcp at the origin, whose camera is the tcp."""
    rng = np.random.default_rng(2)
    inputs = []
    for k in range(round(length_s / 0.012)):
        t, stamp = 0.012 * k, 12_000_000 * k
        reading = sign * SPEED * t / scale + rng.normal(0.0, 3e-4)
        images = []
        if k % 2 == 0:
            place = np.array((0.5, -0.4, 0.1)) + SPEED * t * AXIS + rng.normal(0.0, 5e-4, 3)
            place[0] += swing * math.sin(2.0 * math.pi * 0.62 * t)
            x, y, z = place.tolist()
            images.append(
                CameraSample(stamp, stamp, "c", "camera", "hub", k, (x, y, z), (1.0, 0.0, 0.0, 0.0))
            )
        inputs.append(Inputs(k, stamp, None, (DistanceSample(stamp, reading),), tuple(images)))
    rest = StandingPosture(0.0, length_s, np.zeros(7), np.zeros(3), np.eye(3), None, None, None)
    return inputs, [rest]


def frame(inputs: list[Inputs], rests: list[StandingPosture]) -> ConveyorFrame | Refusal:
    return find_frame(inputs, rests, PoseFile((0.0, 0.0, 0.0)), (0.0, 1.0, 0.0), 0.0)


def test_the_direction_is_found_next_to_a_swing() -> None:
    found = frame(*passing())
    assert isinstance(found, ConveyorFrame)
    assert float(np.linalg.norm(found.axis - AXIS)) < max(3.0 * found.deviation, 2e-4)
    assert found.deviation < 1e-3
    assert found.scale == pytest.approx(1.0, abs=2e-3)
    assert found.speed == pytest.approx(SPEED, abs=1e-3)


def test_the_scale_of_the_distance_sensor_is_found() -> None:
    found = frame(*passing(scale=1.03))
    assert isinstance(found, ConveyorFrame)
    assert found.scale == pytest.approx(1.03, abs=2e-3)


def test_a_sensor_that_counts_against_the_travel_is_refused() -> None:
    refusal = frame(*passing(sign=-1.0))
    assert isinstance(refusal, Refusal)
    assert refusal.reason.startswith("the distance falls as the object travels")


def test_a_short_way_is_refused() -> None:
    refusal = frame(*passing(length_s=3.0))
    assert isinstance(refusal, Refusal)
    assert "at least 0.4 m are needed" in refusal.reason


def test_a_direction_far_off_the_configured_one_is_refused() -> None:
    inputs, rests = passing()
    refusal = find_frame(inputs, rests, PoseFile((0.0, 0.0, 0.0)), (1.0, 0.0, 0.0), 0.0)
    assert isinstance(refusal, Refusal)
    assert "off conveyor.axis" in refusal.reason
