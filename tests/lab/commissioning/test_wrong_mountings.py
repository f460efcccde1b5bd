"""The measure of wrong mountings: each planted error comes out as large as it is."""

import numpy as np
import pytest

from linemate.daemon.core import rotations
from linemate.simulators.harness.cell import cell_files
from linemate.simulators.lab.commission_cell import EmulatedCell
from linemate.simulators.lab.commissioning import wrong_mountings as wrong
from linemate.simulators.lab.commissioning.wrong_mountings import MOUNTINGS

SMALL = 2e-3  # rotation about y [rad]
KR10 = EmulatedCell(cell_files.DATA / "kr10")


def turned(vector: tuple[float, float, float]) -> list[float]:
    """A pose's quaternion that is off a rotation vector by SMALL."""
    matrix = rotations.exp(np.array(vector)) @ rotations.exp(np.array((0.0, SMALL, 0.0)))
    return list(rotations.quaternion(matrix))


def test_an_error_of_the_camera_is_in_mm_and_mrad() -> None:
    place = np.add(wrong.CAMERA_PLACE, (0.0, 3e-3, 4e-3)).tolist()
    mount = {"position": place, "quaternion": turned(wrong.CAMERA_TURN)}
    found = wrong._camera({"task": {"arm": {"camera_in_tcp": mount}}}, KR10)
    assert found == pytest.approx({"mm": 5.0, "mrad": 2.0})


def test_an_error_of_the_sensor_is_in_mrad_and_kg() -> None:
    arm = {"sensor_in_tcp": {"quaternion": turned(wrong.SENSOR_TURN)}}
    overlay = {"task": {"arm": arm}, "tracking": {"payload": {"mass": 5.9}}}
    assert wrong._sensor(overlay, KR10) == pytest.approx({"mrad": 2.0, "kg": 0.1})


def test_an_error_of_the_line_is_in_mrad() -> None:
    cell = EmulatedCell(KR10.site, overrides=("scenario.conveyor.effects.askew=[0.01, 0.0]",))
    found = wrong._line({"task": {"conveyor": {"axis": [0.0, 1.0, 0.0]}}}, cell)
    assert found == pytest.approx({"mrad": 10.0}, abs=1e-3)


def test_an_object_that_is_not_found_is_off_by_what_was_planted() -> None:
    nominal = KR10.setup().task.object.nominal
    place = {"position": list(nominal.position), "quaternion": list(nominal.quaternion)}
    found = wrong._object({"task": {"object": {"nominal": place}}}, KR10)
    assert found == pytest.approx({"mm": float(np.hypot(50.0, 40.0)), "mrad": 30.0})


def test_a_mounting_without_a_measure_is_one_that_has_to_be_refused() -> None:
    assert [m.what for m in MOUNTINGS if m.errors is None] == [
        "axis A5 counts the other way",
        "correction of A3 moves it the other way",
    ]
