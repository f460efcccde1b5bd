"""Object as bolts in their holes feel it."""

import math

import numpy as np
import pytest

from linemate.daemon.core import rotations
from linemate.daemon.core.tracking.settings import PayloadSettings, TactileNoise
from linemate.daemon.core.tracking.touch import held_bolts
from linemate.protocol.stamped_samples import Vector3

PAYLOAD = PayloadSettings(bolts=0.025, bolt_play=0.0005)
MOUNT = TactileNoise(stiffness=(50e3, 50e3, 50e3))
TCP = np.array((0.1, 0.2, 2.0, 0.03, 0.3, 0.2))
DISTANCE = -0.015


def place(*force: float, weight: float = 0.0, mean: Vector3 = (0.0, 0.0, 0.0)) -> np.ndarray | None:
    contact = np.array(force)
    bending = contact + np.array((weight, 0.0, 0.0))
    return held_bolts.place(contact, bending, TCP, PAYLOAD, MOUNT, DISTANCE, mean)


def in_tool(found: np.ndarray | None) -> np.ndarray:
    assert found is not None
    off: np.ndarray = rotations.exp(TCP[3:]).T @ (found - TCP[:3])
    return off


@pytest.mark.parametrize(
    ("distance", "is_in"),
    [(-0.05, False), (-0.024, False), (-0.02, True), (0.003, True), (math.inf, False)],
)
def test_bolts_are_in_their_holes_from_the_tips_entry_on_also_beyond_the_estimated_object(
    distance: float, is_in: bool
) -> None:
    assert held_bolts.is_entered(PAYLOAD, distance) is is_in


def test_bolts_whose_play_is_not_known_measure_nothing() -> None:
    assert not held_bolts.is_entered(PayloadSettings(bolts=0.025), -0.02)


def test_the_object_is_off_the_bent_tool_by_the_play_to_the_side_of_the_force() -> None:
    off = in_tool(place(40.0, 30.0, 0.0))
    assert off == pytest.approx((0.0008 + 0.0004, 0.0006 + 0.0003, -DISTANCE), abs=1e-9)


def test_a_weight_bends_the_mount_and_shows_no_side() -> None:
    off = in_tool(place(0.0, -30.0, 0.0, weight=196.0))
    assert off == pytest.approx((196.0 / 50e3, -0.0006 - 0.0005, -DISTANCE), abs=1e-9)


@pytest.mark.parametrize("force", [(8.0, 8.0, 0.0), (20.0, 0.0, -40.0), (0.0, 0.0, -60.0)])
def test_neither_noise_nor_tips_nor_a_face_show_a_place(force: tuple[float, ...]) -> None:
    assert place(*force) is None


def test_friction_of_bolts_in_their_holes_is_no_face() -> None:
    assert place(50.0, 0.0, -15.0) is not None


def test_bolts_that_lean_on_a_side_show_it_by_their_mean_force() -> None:
    off = in_tool(place(4.0, 8.0, 0.0, mean=(6.0, 0.0, 0.0)))
    assert off == pytest.approx((0.00008 + 0.0005, 0.00016, -DISTANCE), abs=1e-9)


@pytest.mark.parametrize(
    ("force", "mean"),
    [
        ((6.0, 0.0, 0.0), (4.0, 0.0, 0.0)),  # a tare is wrong by as much
        ((-3.0, 0.0, 0.0), (6.0, 0.0, 0.0)),  # they have left that side
        ((6.0, 0.0, -30.0), (6.0, 0.0, -5.0)),  # it is the face's
    ],
)
def test_a_mean_force_shows_a_side_only_while_the_bolts_press_on_it(
    force: Vector3, mean: Vector3
) -> None:
    assert place(*force, mean=mean) is None


@pytest.mark.parametrize("cycle_s", [0.004, 0.012])
def test_a_mean_force_does_not_follow_a_tool_that_rings(cycle_s: float) -> None:
    mean, largest = (0.0, 0.0, 0.0), 0.0
    for k in range(round(1.0 / cycle_s)):
        ringing = 20.0 * math.sin(2.0 * math.pi * 5.0 * k * cycle_s)
        mean = held_bolts.averaged(mean, np.array((ringing, 0.0, 0.0)), cycle_s)
        largest = max(largest, abs(mean[0]))
    assert largest < 1.9 * held_bolts.LEAST_N
    assert abs(mean[0]) < held_bolts.LEAST_N


@pytest.mark.parametrize("cycle_s", [0.004, 0.012])
def test_a_second_of_measurements_is_as_certain_at_any_cycle(cycle_s: float) -> None:
    found = place(40.0, 30.0, 0.0)
    assert found is not None
    measured = held_bolts.measured(found, TCP, 0.01, cycle_s)
    count = 1.0 / cycle_s
    assert measured.variance[0] / count == pytest.approx(0.0003**2 * 0.1, rel=1e-9)
    assert (measured.variance[2:] == held_bolts.UNKNOWN).all()


def test_bolts_that_press_along_the_line_give_the_object_a_speed() -> None:
    turned = np.array((0.0, 0.0, 0.0, 0.0, 0.0, 0.5 * math.pi))
    still, along = np.zeros(6), 40.0 * held_bolts.PUSHED_S / held_bolts.LIGHT_KG
    assert held_bolts.pushed((10.0, -40.0, 5.0), still, 1) == pytest.approx(along)
    assert held_bolts.pushed((-40.0, 0.0, 5.0), turned, 1) == pytest.approx(along)
