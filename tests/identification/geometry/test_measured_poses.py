"""Tables of measured poses: units in the header, and errors with their lines."""

import numpy as np
import pytest

from linemate.daemon.core import rotations
from linemate.daemon.identification.geometry.measured_poses import (
    MeasuredPoses,
    PosesError,
    read,
    text_of,
)

HEAD = "A1_deg,A2_deg,A3_deg,A4_deg,A5_deg,A6_deg,E1_mm,x_mm,y_mm,z_mm"
ROW = "90,-90,90,0,45,0,1000,1800,300,1100"


def test_units_are_those_of_the_header() -> None:
    poses = read(f"{HEAD}\n{ROW}\n", linear_axis=True)
    assert poses.joints[0] == pytest.approx([np.pi / 2, -np.pi / 2, np.pi / 2, 0, np.pi / 4, 0, 1])
    assert poses.positions[0] == pytest.approx([1.8, 0.3, 1.1])
    assert poses.turns is None
    si = HEAD.replace("_deg", "_rad").replace("_mm", "_m")
    assert read(f"{si}\n1,2,3,4,5,6,7,8,9,10\n", linear_axis=True).joints[0].tolist() == [
        1, 2, 3, 4, 5, 6, 7,
    ]  # fmt: skip


def test_columns_come_in_any_order_and_comments_are_left_out() -> None:
    names, values = HEAD.split(",")[::-1], ROW.split(",")[::-1]
    text = f"# a tracker's table\n\n{', '.join(names)}\n{', '.join(values)}\n"
    poses = read(text, linear_axis=True)
    assert poses.lines == (4,)
    assert poses.positions[0] == pytest.approx([1.8, 0.3, 1.1])


def test_a_table_is_read_as_it_was_written() -> None:
    turns = np.array([rotations.exp(np.array((0.1, -1.2, 0.3)))] * 2)
    joints = np.array([(0.1, -1.0, 1.2, 0.3, 0.8, -0.4, 0.5)] * 2)
    poses = MeasuredPoses((2, 3), joints, np.array([(1.8, 0.3, 1.1)] * 2), turns)
    again = read(text_of(poses), linear_axis=True)
    assert again.lines == (2, 3)
    assert np.allclose(again.joints, joints, atol=1e-8)
    assert again.turns is not None
    assert np.allclose(again.turns, turns, atol=1e-8)
    positions = MeasuredPoses((2, 3), joints[:, :6], poses.positions, None)
    assert read(text_of(positions), linear_axis=False).turns is None


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no header"),
        ("\n# nothing\n", "no header"),
        (HEAD.replace("A1_deg", "A1"), "line 1: A1: its unit is missing or unknown. Write A1_deg"),
        (HEAD.replace("x_mm", "x_inch"), "line 1: x_inch: its unit .* Write x_mm or x_m"),
        (HEAD.replace("A2_deg", "A1_deg"), "A1_deg: twice"),
        (HEAD.replace(",z_mm", ""), "line 1: missing: z"),
        (HEAD + ",qw", "line 1: missing: qx, qy, qz"),
        (HEAD + ",speed", "line 1: speed: no such column"),
        (f"{HEAD}\n1,2,3", "line 2: 3 values, the header has 10 columns"),
        (f"{HEAD}\n{ROW}\n{ROW.replace('1100', 'nan')}", "line 3: z_mm: nan is out of range"),
        (f"{HEAD}\n{ROW.replace('1100', 'high')}", "line 2: z_mm: 'high' is no number"),
        (f"{HEAD}\n{ROW.replace('1100', '1e9')}", "line 2: z_mm: 1e9 is out of range"),
        (f"{HEAD},qw,qx,qy,qz\n{ROW},1,1,0,0", "line 2: the quaternion has length 1.414, not 1"),
        (f'{HEAD}\n"{ROW}', "no comma-separated values"),
        ("\x00\x01,\x02", "no such column|no comma-separated values"),
    ],
)
def test_what_cannot_be_read_is_named_with_its_line(text: str, says: str) -> None:
    with pytest.raises(PosesError, match=says):
        read(text, linear_axis=True)


def test_a_linear_axis_that_the_arm_has_not_is_refused() -> None:
    with pytest.raises(PosesError, match="E1_mm: the task's arm has no linear axis"):
        read(f"{HEAD}\n{ROW}", linear_axis=False)


def test_at_most_ten_lines_are_named() -> None:
    with pytest.raises(PosesError, match="and 5 more lines"):
        read("\n".join((HEAD, *["1,2"] * 15)), linear_axis=True)
