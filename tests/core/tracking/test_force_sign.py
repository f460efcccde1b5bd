"""The sign of the force on a clamped tool."""

from linemate.daemon.core.tracking.touch import force_sign
from linemate.daemon.core.tracking.touch.force_sign import TRUSTED, ForceSign

LEAST_N = 15.0
STIFFNESS = 50e3


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


def test_a_pull_places_the_object_no_farther_than_the_tool() -> None:
    assert force_sign.nearer(60.0) == -60.0
    assert force_sign.nearer(-20.0) == -20.0
