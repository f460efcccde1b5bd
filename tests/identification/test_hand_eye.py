"""Correction of the hand-eye pose: only one that is significant, and only what it improves."""

from linemate.daemon.identification.hand_eye import corrections
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal


def found(*values: tuple[float, float]) -> list[Outcome]:
    return [Estimate(value, deviation, "") for value, deviation in values]


def test_a_camera_that_is_off_a_little_along_each_axis_is_corrected() -> None:
    assert corrections(found((1.05, 0.3), (1.15, 0.3), (-0.9, 0.3))).tolist() == [1.05, 1.15, -0.9]


def test_a_value_within_its_deviation_stays_as_configured() -> None:
    assert corrections(found((1.05, 0.3), (1.15, 0.3), (0.7, 1.2))).tolist() == [1.05, 1.15, 0.0]
    assert corrections([*found((2.0, 0.3)), Refusal("not observable")]).tolist() == [2.0, 0.0]


def test_a_pose_that_is_right_stays_as_configured() -> None:
    assert not corrections(found((0.6, 0.3), (-0.5, 0.3), (1.2, 1.2))).any()
    assert not corrections([Refusal("not observable")] * 3).any()
