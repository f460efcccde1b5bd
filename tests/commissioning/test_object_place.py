"""Where objects hang, from made postures of a robot whose tcp is the origin and the camera."""

import numpy as np
import pytest

from linemate.daemon.commissioning.object_place import LEAST_OBJECTS, ObjectPlace, find_place
from linemate.daemon.commissioning.postures import SeenObject, StandingPosture
from linemate.daemon.core import rotations
from linemate.daemon.core.tracking.task import PoseFile
from linemate.daemon.identification.outcome import Refusal

NOMINAL = PoseFile((1.0, 0.2, 0.5))
CAMERA = PoseFile((0.0, 0.0, 0.1), (0.0, 1.0, 0.0, 0.0))


def hanging(shift: tuple[float, float, float], turn: tuple[float, float, float]) -> StandingPosture:
    """A robot at rest that sees an object off the nominal one."""
    camera = rotations.matrix(CAMERA.quaternion)
    place = np.array(NOMINAL.position) + shift - np.array(CAMERA.position)
    seen = SeenObject(camera.T @ place, camera.T @ rotations.exp(np.array(turn)), np.zeros(6), 90)
    return StandingPosture(0.0, 5.0, np.zeros(6), np.zeros(3), np.eye(3), seen, None, None)


def place(*objects: StandingPosture) -> ObjectPlace | Refusal:
    return find_place([[each] for each in objects], CAMERA, NOMINAL)


def test_the_mean_of_several_objects_is_the_nominal_one_but_along_the_conveyor() -> None:
    shifts = ((0.03, 0.4, -0.02), (0.05, -0.1, -0.04), (0.04, 0.2, -0.03))
    found = place(*(hanging(shift, (0.001, 0.02, -0.002)) for shift in shifts))
    assert isinstance(found, ObjectPlace)
    assert found.position == pytest.approx((1.04, 0.2, 0.47), abs=1e-9)
    assert found.spread[:2] == pytest.approx((0.01, 0.01), abs=1e-9)
    assert found.off[2:] == pytest.approx((0.001, 0.02, -0.002), abs=1e-4)
    # The conveyor's direction stays the nominal object's y axis.
    assert found.rotation[:, 1] == pytest.approx((0.0, 1.0, 0.0), abs=1e-12)
    assert rotations.log(found.rotation)[1] == pytest.approx(0.02, abs=1e-4)


def test_one_object_or_one_seen_twice_says_nothing_of_the_next() -> None:
    one = hanging((0.03, 0.0, 0.0), (0.0, 0.0, 0.0))
    found = find_place([[one, one, one], [], []], CAMERA, NOMINAL)
    assert isinstance(found, Refusal)
    assert found.reason.startswith(f"objects seen by a robot at rest: 1, at least {LEAST_OBJECTS}")


@pytest.mark.parametrize(
    ("shift", "turn"), [((0.25, 0.0, 0.25), (0.0, 0.0, 0.0)), ((0.0, 0.0, 0.0), (0.0, 0.0, 0.25))]
)
def test_objects_that_hang_elsewhere_are_refused(
    shift: tuple[float, float, float], turn: tuple[float, float, float]
) -> None:
    found = place(*3 * [hanging(shift, turn)])
    assert isinstance(found, Refusal)
    assert "Check object.nominal and arm.camera_in_tcp" in found.reason
