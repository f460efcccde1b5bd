"""The sign of the force on a clamped tool."""

import math
from collections.abc import Callable

import pytest

from linemate.daemon.core.tracking.touch import force_sign
from linemate.daemon.core.tracking.touch.force_sign import TRUSTED, ForceSign

LEAST_N = 15.0
STIFFNESS = 50e3
DT = 0.012


def pressed(sensed: float, first_m: float, steps: int = 60) -> tuple[ForceSign, float]:
    """Return the sign and the offset of a target that follows a force that is not suspect.

    Args:
        sensed: factor of the sensor, -1 for one of the wrong sign.
        first_m: by how much the target is beyond the object, less than 0 before it.
    """
    sign, offset = TRUSTED, 0.0
    for _ in range(steps):
        force = -sensed * STIFFNESS * (first_m + offset)
        sign = force_sign.advanced(sign, force, offset, LEAST_N)
        if not sign.is_suspect:
            offset += 0.05 * (force / STIFFNESS)
    return sign, offset


def test_a_right_pull_is_followed_to_the_object() -> None:
    sign, offset = pressed(1.0, -0.002, 150)
    assert not sign.is_suspect
    assert abs(offset - 0.002) < 1e-4


def test_a_force_of_the_wrong_sign_moves_the_target_hardly() -> None:
    sign, offset = pressed(-1.0, 0.001)
    assert sign.is_suspect
    assert offset < 2.0 * force_sign.ADVANCE_M


def test_an_object_that_moves_away_faster_than_the_target_is_suspect() -> None:
    sign = force_sign.advanced(TRUSTED, 30.0, 0.0, LEAST_N)
    sign = force_sign.advanced(sign, 40.0, 0.0001, LEAST_N)
    assert not sign.is_suspect
    assert force_sign.advanced(sign, 30.0, 0.0003, LEAST_N).is_suspect
    assert not force_sign.advanced(sign, 29.0, 0.0003, LEAST_N).is_suspect


def suspected_after(force_of: Callable[[float], float], right_dt: float | None) -> float:
    """When a pull makes a sensor suspect while the target advances at 2 mm/s [s], 3 s at most."""
    sign, t = TRUSTED, 0.0
    while not sign.is_suspect and t < 3.0:
        sign = force_sign.advanced(sign, force_of(t), 0.002 * t, LEAST_N, right_dt)
        t += DT
    return t


def test_a_body_that_sways_away_makes_no_sensor_suspect_that_has_shown_the_weight() -> None:
    """Its force was not used for 0.5 s, in which a stop of the line was followed late: 234 N."""

    def sway(t: float) -> float:
        return 60.0 * math.sin(math.tau * 0.5 * t)

    assert suspected_after(sway, None) < 0.3
    assert suspected_after(sway, DT) > 2.9


def test_a_pull_that_does_not_fall_makes_suspect_what_has_shown_the_weight() -> None:
    assert 0.5 < suspected_after(lambda _: 40.0, DT) < 0.7
    assert 0.5 < suspected_after(lambda t: 40.0 + t, DT) < 0.7


def test_a_pull_that_ended_is_judged_again() -> None:
    sign = force_sign.advanced(TRUSTED, 30.0, 0.0, LEAST_N)
    sign = force_sign.advanced(sign, 0.0, 0.001, LEAST_N)
    sign = force_sign.advanced(sign, 40.0, 0.001, LEAST_N)
    assert not force_sign.advanced(sign, 40.0, 0.0011, LEAST_N).is_suspect


def test_a_contact_felt_by_a_pull_is_suspect_until_the_object_pushes() -> None:
    sign = force_sign.at_touch(60.0, LEAST_N)
    assert sign.is_suspect
    for force in (60.0, 10.0, 0.0, -14.0):
        sign = force_sign.advanced(sign, force, 0.0, LEAST_N)
        assert sign.is_suspect
    assert not force_sign.advanced(sign, -16.0, 0.0, LEAST_N).is_suspect


def test_a_contact_felt_by_a_push_is_not_suspect() -> None:
    assert force_sign.at_touch(-20.0, LEAST_N) == TRUSTED


def test_a_pull_on_a_sensor_that_has_shown_the_tools_weight_is_not_suspect() -> None:
    assert force_sign.at_touch(60.0, LEAST_N, shows_weight=True) == TRUSTED


def test_where_the_offset_of_a_contact_begins_is_no_advance_of_the_target() -> None:
    sign = force_sign.advanced(TRUSTED, 30.0, None, LEAST_N)
    sign = force_sign.advanced(sign, 35.0, 0.0014, LEAST_N)
    assert not sign.is_suspect


def test_a_pull_places_the_object_no_farther_than_the_tool() -> None:
    assert force_sign.nearer(60.0) == -60.0
    assert force_sign.nearer(-20.0) == -20.0


def probed(sensed: float, stiffness: float, drift: float = 0.0) -> tuple[ForceSign, float]:
    """Return the sign after 12 s of a suspect contact, and the largest true force [N].

    Args:
        sensed: factor of the sensor, -1 for one of the wrong sign, 0 for one that is frozen.
        stiffness: of mount and object [N/m].
        drift: of the object away from the tool [m/s].
    """
    sign, largest = force_sign.at_touch(25.0, LEAST_N), 0.0
    for step in range(1000):
        gap = sensed * 0.0005 - sign.way + drift * step * DT
        sway = 10.0 * math.sin(2.0 * math.pi * 0.75 * step * DT)
        force = stiffness * gap + sway
        sign = force_sign.tested(sign, sensed * force, DT)
        largest = max(largest, abs(force))
        if not sign.is_suspect:
            break
    return sign, largest


@pytest.mark.parametrize("stiffness", [10e3, 50e3])
@pytest.mark.parametrize("drift", [0.0, 0.0003])
def test_a_right_force_passes_its_test(stiffness: float, drift: float) -> None:
    sign, largest = probed(1.0, stiffness, drift)
    assert sign == TRUSTED
    assert largest < 110.0


@pytest.mark.parametrize("stiffness", [10e3, 50e3])
@pytest.mark.parametrize("sensed", [-1.0, 0.0])
def test_a_wrong_or_frozen_force_fails_its_test(sensed: float, stiffness: float) -> None:
    sign, _ = probed(sensed, stiffness)
    assert sign.is_suspect
    assert sign.failed > 0


def test_a_target_goes_back_where_the_force_grows() -> None:
    sign, largest = probed(-1.0, 50e3)
    assert sign.way < 0.002
    assert largest < 120.0


@pytest.mark.parametrize(
    ("sign", "mean", "ends"),
    [
        (ForceSign(is_suspect=True, failed=force_sign.TESTS), 90.0, True),
        (ForceSign(is_suspect=True, failed=force_sign.TESTS), 80.0, False),
        (ForceSign(is_suspect=True, failed=force_sign.TESTS, is_failed=True), 90.0, False),
        (ForceSign(is_suspect=True, failed=1), 90.0, False),
        (TRUSTED, 90.0, False),
    ],
)
def test_a_large_force_that_answers_no_test_ends_the_contact(
    sign: ForceSign, mean: float, *, ends: bool
) -> None:
    assert force_sign.unanswered(sign, mean, 350.0) == (mean if ends else None)


def test_the_tests_of_a_wrong_force_end() -> None:
    sign = ForceSign(is_suspect=True, failed=force_sign.TESTS)
    for _ in range(1000):
        sign = force_sign.tested(sign, 60.0, DT)
    assert sign.way == 0.0
