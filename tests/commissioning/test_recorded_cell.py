"""Cell of a recording: the arm as it was measured, or the reason why there is none."""

import numpy as np
import pytest
from cell import TASK

from linemate.daemon.commissioning.recorded_cell import CellError, read_cell
from linemate.daemon.config.task_file import geometry_text
from linemate.daemon.core.control.settings import AxisGeometry

TEXTS = {"task": TASK.text, "urdf": TASK.urdf}
JOINTS = np.array((*TASK.file.arm.rest_joints, 0.0))


def test_the_arm_is_the_one_that_was_measured() -> None:
    plain = read_cell(TEXTS, "a.mcap").arm
    turned = JOINTS.copy()
    turned[1] += 1e-3
    geometry = [AxisGeometry(), AxisGeometry(turn=(0.0, 1e-3, 0.0))]
    measured = read_cell({**TEXTS, **geometry_text(geometry)}, "a.mcap").arm
    assert np.allclose(measured.tcp_in_base(JOINTS)[0], plain.tcp_in_base(turned)[0], atol=1e-12)


@pytest.mark.parametrize(
    ("geometry", "says"),
    [
        ("[1]", "a.mcap: geometry"),
        ("{", "a.mcap: geometry"),
        ('{"geometry": [{"turn": [1, 0, 0]}]}', "less than or equal to 0.005"),
    ],
)
def test_a_geometry_that_is_wrong_is_a_reason(geometry: str, says: str) -> None:
    with pytest.raises(CellError, match=says):
        read_cell({**TEXTS, "geometry": geometry}, "a.mcap")


def test_a_missing_text_is_named() -> None:
    with pytest.raises(CellError, match=r"a\.mcap: the recording holds no urdf"):
        read_cell({"task": TASK.text}, "a.mcap")
