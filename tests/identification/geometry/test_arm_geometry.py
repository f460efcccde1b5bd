"""Geometry of the arm: planted errors are found, and poses that do not give it are refused."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from cell import TASK

from linemate.daemon.core import rotations
from linemate.daemon.core.control import gravity_bend
from linemate.daemon.core.control.settings import (
    AxisGeometry,
    AxisLoad,
    ControlSettings,
    GravityBend,
)
from linemate.daemon.core.horizon import Array
from linemate.daemon.identification.geometry import arm_geometry
from linemate.daemon.identification.geometry.arm_geometry import (
    ArmGeometry,
    GeometryError,
    MeasuredArm,
    identify_geometry,
)
from linemate.daemon.identification.geometry.measured_poses import MeasuredPoses
from linemate.daemon.identification.outcome import Estimate

PLAIN = MeasuredArm(TASK.file, TASK.urdf, ControlSettings())
REST = np.array((*TASK.file.arm.rest_joints, 0.5))
SPAN = np.array((0.3, 0.2, 0.2, 0.6, 0.4, 1.0, 0.5))
NOISE_M, NOISE_RAD = 0.03e-3, 0.1e-3
ZERO = 0.5e-3
NONE = (0.0, 0.0, 0.0)
STAY = ((1, 2), (1, 5), (2, 1), (2, 2), (3, 1), (3, 4), (4, 0), (4, 3), (5, 1), (5, 4))
"""Index of axis and value that another axis explains: by the direction of the axis before."""


def planted(seed: int) -> list[AxisGeometry]:
    """Errors of the sizes of a large arm that was not calibrated."""
    rows = 0.2e-3 * np.random.default_rng(seed).standard_normal((6, 6))
    rows[[axis for axis, _ in STAY], [part for _, part in STAY]] = 0.0
    return [AxisGeometry((a, b, c), (d, e, f)) for a, b, c, d, e, f in rows.tolist()]


def poses(
    geometry: Sequence[AxisGeometry],
    count: int = 40,
    seed: int = 1,
    measured: MeasuredArm = PLAIN,
    orientation: bool = True,
) -> MeasuredPoses:
    random = np.random.default_rng(seed)
    joints = REST + SPAN * random.uniform(-1.0, 1.0, (count, 7))
    arm = measured.load(geometry)
    bent = gravity_bend.compile_bend(measured.control.bend, arm)
    links = [q if bent is None else gravity_bend.links(bent, q) for q in joints]
    placed = [arm.tcp_in_base(q) for q in links]
    positions = [place + NOISE_M * random.standard_normal(3) for place, _ in placed]
    turns = [turn @ rotations.exp(NOISE_RAD * random.standard_normal(3)) for _, turn in placed]
    lines = tuple(range(2, count + 2))
    return MeasuredPoses(
        lines, joints, np.array(positions), np.array(turns) if orientation else None
    )


@cache
def identified(seed: int) -> ArmGeometry:
    return identify_geometry(PLAIN, poses(planted(seed)))


def errors(geometry: Sequence[AxisGeometry], true: Sequence[AxisGeometry], seed: int) -> Array:
    """Errors (n,) of the tcp in poses that were not measured [m]."""
    arm, real = PLAIN.load(geometry), PLAIN.load(true)
    joints = REST + SPAN * np.random.default_rng(seed).uniform(-1.0, 1.0, (50, 7))
    off = [arm.tcp_in_base(q)[0] - real.tcp_in_base(q)[0] for q in joints]
    return np.linalg.norm(off, axis=1)


@pytest.mark.parametrize("seed", range(4))
def test_the_tcp_is_predicted_in_poses_that_were_not_measured(seed: int) -> None:
    true = planted(seed)
    assert errors((), true, 9).max() > 0.4e-3
    assert errors(identified(seed).axes, true, 9).max() < 0.1e-3


@pytest.mark.parametrize("seed", range(4))
def test_the_values_are_within_their_deviations(seed: int) -> None:
    known = [line.outcome for line in identified(seed).findings if line.in_overlay]
    rows = [(*axis.shift, *axis.turn) for axis in planted(seed)]
    true = [rows[i][j] for i in range(6) for j in range(6) if (i, j) not in STAY]
    shares = [
        (each.value - value) / each.deviation
        for each, value in zip(known, true, strict=True)
        if isinstance(each, Estimate)
    ]
    assert len(shares) == 26
    assert np.abs(shares).max() < 4.0
    assert np.sqrt(np.mean(np.square(shares))) < 1.3


@pytest.mark.parametrize("axis", range(6))
def test_a_planted_zero_is_found_within_its_deviation(axis: int) -> None:
    direction = PLAIN.load().axis_frames()[axis][2]
    x, y, z = (ZERO * direction).tolist()
    true = [AxisGeometry(NONE, (x, y, z) if i == axis else NONE) for i in range(6)]
    result = identify_geometry(PLAIN, poses(true))
    assert errors(result.axes, true, 9).max() < 0.1e-3
    lines = {line.name: line.outcome for line in result.findings}
    part = "xyz"[int(np.abs(direction).argmax())]
    found = lines[f"A{axis + 1} turn {part}"]
    assert isinstance(found, Estimate)
    assert abs(found.value - ZERO * direction.sum()) < 2.5 * found.deviation
    assert found.deviation < 0.25 * ZERO


def test_errors_that_another_axis_explains_are_predicted_as_well() -> None:
    rows = np.zeros((6, 6))
    rows[[axis for axis, _ in STAY], [part for _, part in STAY]] = 0.3e-3
    true = [AxisGeometry((a, b, c), (d, e, f)) for a, b, c, d, e, f in rows.tolist()]
    result = identify_geometry(PLAIN, poses(true))
    assert errors((), true, 9).max() > 0.4e-3
    assert errors(result.axes, true, 9).max() < 0.1e-3


def test_positions_alone_predict_positions() -> None:
    true = planted(5)
    result = identify_geometry(PLAIN, poses(true, orientation=False))
    assert errors(result.axes, true, 9).max() < 0.12e-3


def test_the_bend_under_weight_is_not_taken_for_geometry() -> None:
    loads = (AxisLoad(2, 240.0, (0.575, 0.0, 0.0)), AxisLoad(6, 115.0, (0.2, 0.0, 0.0)))
    bend = GravityBend((0.3e-6,) * 3 + (2e-6,) * 3, loads, 0.7)
    heavy = replace(PLAIN, control=ControlSettings(bend=bend))
    true = planted(6)
    measured = poses(true, measured=heavy)
    assert errors(identify_geometry(heavy, measured).axes, true, 9).max() < 0.1e-3
    assert errors(identify_geometry(PLAIN, measured).axes, true, 9).max() > 0.3e-3


def test_rows_of_one_pose_count_as_their_mean() -> None:
    true = planted(7)
    windup = np.array((0.3e-3, 0.3e-3, 0.3e-3, 0.1e-3, 0.1e-3, 0.1e-3, 0.0))
    once = poses(true)
    arm = PLAIN.load(true)
    sides = [[arm.tcp_in_base(q + side * windup) for side in (-1, 1)] for q in once.joints]
    rows = [row for pair in sides for row in pair]
    twice = MeasuredPoses(
        tuple(range(2, 82)),
        np.repeat(once.joints, 2, axis=0),
        np.array([row[0] for row in rows]),
        np.array([row[1] for row in rows]),
    )
    result = identify_geometry(PLAIN, twice)
    assert errors(result.axes, true, 9).max() < 0.05e-3
    line = result.findings[-1].outcome
    assert isinstance(line, Estimate)
    assert "80 rows of 40 poses" in {
        each.outcome.basis for each in result.findings if isinstance(each.outcome, Estimate)
    }


def test_the_report_has_the_error_of_poses_held_back() -> None:
    by_name = {line.name: line.outcome for line in identified(0).findings}
    before, after = by_name[arm_geometry.BEFORE], by_name[arm_geometry.AFTER]
    assert isinstance(before, Estimate)
    assert isinstance(after, Estimate)
    assert before.value > 0.3e-3
    assert 0.03e-3 < after.value < 0.12e-3


def test_the_overlay_has_the_frames_of_six_axes() -> None:
    rows = identified(0).overlay["control"]["geometry"]
    assert len(rows) == 6
    assert rows[0].keys() == {"shift", "turn"}
    assert rows[1]["turn"] == pytest.approx(identified(0).axes[1].turn, abs=1e-9)


def test_too_few_poses_are_refused() -> None:
    with pytest.raises(GeometryError, match="19 poses, at least 20 are needed"):
        identify_geometry(PLAIN, poses(planted(0), count=19))


def test_poses_that_do_not_turn_an_axis_are_refused() -> None:
    whole = poses(planted(0))
    joints = whole.joints.copy()
    joints[:, 3] = 0.2
    with pytest.raises(GeometryError, match="A4 turns by 0 mrad, at least 100 mrad"):
        identify_geometry(PLAIN, replace(whole, joints=joints))


@pytest.mark.parametrize("off", [0.6e-3, 5e-3, 1.0])
def test_a_row_that_does_not_fit_is_named_by_its_line(off: float) -> None:
    whole = poses(planted(0))
    positions = whole.positions.copy()
    positions[17, 1] += off
    with pytest.raises(GeometryError, match="line 19: ") as caught:
        identify_geometry(PLAIN, replace(whole, positions=positions))
    assert str(caught.value).splitlines()[-1] == "Measure these poses again or delete them."


@pytest.mark.parametrize("off", [0.3e-3, -5e-3])
def test_a_target_that_is_not_where_it_was_stated_is_not_taken_for_geometry(off: float) -> None:
    whole = poses(planted(0))
    assert whole.turns is not None
    moved = whole.positions + whole.turns @ np.array((0.0, 0.0, off))
    with pytest.raises(
        GeometryError, match=r"target on the tool shift z: .* mm, limit 0\."
    ) as caught:
        identify_geometry(PLAIN, replace(whole, positions=moved))
    assert str(caught.value).endswith("or tcp_in_flange, again.")


def test_a_measuring_system_that_is_turned_against_the_linear_axis_is_refused() -> None:
    whole, turn = poses(planted(0)), rotations.exp(np.array((0.3e-3, 0.0, -0.3e-3)))
    assert whole.turns is not None
    turned = replace(whole, positions=whole.positions @ turn.T, turns=turn @ whole.turns)
    with pytest.raises(GeometryError, match=r"measuring system turn .* mrad, limit 0\.") as caught:
        identify_geometry(PLAIN, turned)
    assert str(caught.value).endswith("or tcp_in_flange, again.")


def test_poses_of_another_tool_are_refused_with_the_residual() -> None:
    whole = poses(planted(0))
    assert whole.turns is not None
    off = whole.positions + whole.turns @ np.array((0.02, -0.01, 0.005))
    with pytest.raises(GeometryError, match="limit"):
        identify_geometry(PLAIN, replace(whole, positions=off))


def test_an_axis_that_is_not_mastered_is_refused_with_its_value() -> None:
    true = [AxisGeometry(NONE, (0.0, 8e-3, 0.0) if i == 1 else NONE) for i in range(6)]
    with pytest.raises(GeometryError, match=r"A2 turn y: .* mrad, limit 5"):
        identify_geometry(PLAIN, poses(true))


def test_noise_alone_gives_no_geometry() -> None:
    none = poses(())
    random = np.random.default_rng(3)
    noisy = none.positions + 0.25e-3 * random.standard_normal(none.positions.shape)
    with pytest.raises(GeometryError, match="no geometry is nearer to the poses than the URDF's"):
        identify_geometry(PLAIN, replace(none, positions=noisy, turns=None))
