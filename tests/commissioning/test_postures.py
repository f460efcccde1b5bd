"""Postures of a robot that moves and stands."""

import numpy as np
import pytest

from linemate.daemon.commissioning.postures import distinct, find_postures
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.inputs import Inputs
from linemate.protocol.stamped_samples import CameraSample, RobotSample, WrenchSample

DELAY_NS = 100_000_000


def kinematics(joints: Array) -> tuple[Array, Array]:
    return np.array((joints[0], 0.0, 0.0)), np.eye(3)


def inputs(places: tuple[float, ...], rest_s: float = 2.0) -> list[Inputs]:
    """A first joint that goes from place to place in 1 s and rests at each; noisy encoders."""
    rng = np.random.default_rng(4)
    made, before, q = [], 0.0, []
    for place in places:
        q += np.linspace(before, place, 83).tolist() + [place] * round(rest_s / 0.012)
        before = place
    for k, first in enumerate(q):
        stamp = 12_000_000 * k
        robot = RobotSample(stamp, k, (first + rng.normal(0, 2e-5), *(0.0,) * 5), (0.0,))
        seen = q[max(0, k - round(DELAY_NS / 12e6))]  # the image is of an earlier place
        image = CameraSample(
            stamp, stamp - DELAY_NS, "c", "camera", "hub", k, (seen, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0)
        )
        wrench = WrenchSample(stamp, (first, 0.0, 0.0), (0.0, 0.0, 0.0))
        made.append(Inputs(k, stamp, robot, (), (image,), (wrench,)))
    return made


def test_each_rest_is_a_posture_with_what_was_seen_and_felt_in_it() -> None:
    found = find_postures(inputs((0.1, 0.4, 0.2)), kinematics, 7)
    assert [p.position[0] for p in found] == pytest.approx([0.1, 0.4, 0.2], abs=1e-4)
    for posture, place in zip(found, (0.1, 0.4, 0.2), strict=True):
        assert posture.seen is not None
        assert posture.wrench is not None
        assert posture.seen.position[0] == pytest.approx(place, abs=1e-9)
        assert posture.wrench[0] == pytest.approx(place, abs=1e-9)


def test_a_place_that_is_visited_twice_counts_once() -> None:
    found = find_postures(inputs((0.1, 0.4, 0.1)), kinematics, 7)
    assert len(found) == 3
    assert len(distinct(found)) == 2


def test_a_short_stop_is_no_posture() -> None:
    assert find_postures(inputs((0.1, 0.4), rest_s=0.5), kinematics, 7) == []
    assert find_postures([], kinematics, 7) == []
