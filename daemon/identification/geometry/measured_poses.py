"""Measured poses of the tcp, as a table of a measuring system's operator.

    A1_deg, A2_deg, ..., A6_deg, E1_mm, x_mm, y_mm, z_mm, qw, qx, qy, qz

Invariants:
- The header names the unit of each column: angles in ``deg`` or ``rad``, places in ``mm`` or ``m``.
- The four columns of the orientation may be left out, as may E1 of an arm without a linear axis.
- Every error names its line.
"""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
LINEAR_AXIS = "E1"
PLACE = ("x", "y", "z")
ORIENTATION = ("qw", "qx", "qy", "qz")
ANGLES = {"deg": math.pi / 180.0, "rad": 1.0}
LENGTHS = {"mm": 1e-3, "m": 1.0}
MOST_BYTES = 1_000_000
MOST_ERRORS = 10  # printed at once
LARGEST = 1e3  # of a value in SI units: what is larger is no place of a cell
UNIT_ERROR = 1e-3  # largest error of a quaternion's length


class PosesError(ValueError):
    """A table that cannot be read; a line of the message for each error."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPoses:
    """Poses of the undeflected tcp at rest.

    Attributes:
        lines: line of each pose in the table.
        joints: (n, axes) as the controller shows them, A1..A6 [rad], E1 [m].
        positions: (n, 3) of the tcp in base [m].
        turns: (n, 3, 3) of the tcp in base; None if only positions were measured.
    """

    lines: tuple[int, ...]
    joints: Array
    positions: Array
    turns: Array | None


def read(text: str, *, linear_axis: bool) -> MeasuredPoses:
    """Return the poses of a table.

    Args:
        text: comma-separated values with a header; lines that begin with # are comments.
        linear_axis: the arm has E1.

    Raises:
        PosesError: every line that cannot be read, at most ten.
    """
    try:
        rows = [
            (line, [cell.strip() for cell in row])
            for line, row in enumerate(csv.reader(text.splitlines(), strict=True), start=1)
            if row and not row[0].lstrip().startswith("#") and any(cell.strip() for cell in row)
        ]
    except csv.Error as error:
        raise PosesError(f"no comma-separated values: {error}") from error
    if not rows:
        raise PosesError("no header. Its columns are " + ", ".join(_columns(linear_axis)))
    scales = _scales(*rows[0], linear_axis=linear_axis)
    wrong: list[str] = []
    values: list[list[float]] = []
    for line, row in rows[1:]:
        try:
            values.append(_values(row, rows[0][1], scales))
        except ValueError as error:
            wrong.append(f"line {line}: {error}")
    if wrong:
        left = len(wrong) - MOST_ERRORS
        more = [f"and {left} more lines"] if left > 0 else []
        raise PosesError("\n".join((*wrong[:MOST_ERRORS], *more)))
    axes = len(AXES) + int(linear_axis)
    table = np.array(values).reshape(len(values), len(scales))
    order = np.array([rows[0][1].index(name) for name in _named(rows[0][1], linear_axis)])
    table = table[:, order]
    turns = None
    if table.shape[1] > axes + len(PLACE):
        turned = [rotations.matrix(tuple(row)) for row in table[:, axes + len(PLACE) :].tolist()]
        turns = np.array(turned).reshape(-1, 3, 3)
    lines = tuple(line for line, _ in rows[1:])
    return MeasuredPoses(lines, table[:, :axes], table[:, axes : axes + len(PLACE)], turns)


def text_of(poses: MeasuredPoses) -> str:
    """Return poses as a table, in degrees and millimetres."""
    linear = poses.joints.shape[1] > len(AXES)
    names = _columns(linear)[: None if poses.turns is not None else -len(ORIENTATION)]
    scales = [ANGLES["deg"]] * len(AXES) + [LENGTHS["mm"]] * (int(linear) + len(PLACE))
    rows = [",".join(names)]
    for i, (joints, position) in enumerate(zip(poses.joints, poses.positions, strict=True)):
        places = np.concatenate((joints, position)) / scales
        cells = [f"{value:.6f}" for value in places.tolist()]
        if poses.turns is not None:
            cells += [f"{value:.9f}" for value in rotations.quaternion(poses.turns[i])]
        rows.append(",".join(cells))
    return "\n".join(rows) + "\n"


def _columns(linear_axis: bool) -> list[str]:
    linear = [f"{LINEAR_AXIS}_mm"] if linear_axis else []
    places = [f"{name}_mm" for name in PLACE]
    return [*(f"{name}_deg" for name in AXES), *linear, *places, *ORIENTATION]


def _named(header: Sequence[str], linear_axis: bool) -> list[str]:
    """Return the columns of a header in the usual order."""
    by_name = {name.partition("_")[0]: name for name in header}
    usual = [name.partition("_")[0] for name in _columns(linear_axis)]
    return [by_name[name] for name in usual if name in by_name]


def _scales(line: int, header: Sequence[str], *, linear_axis: bool) -> list[float]:
    """Return the factor of each column to SI units.

    Raises:
        PosesError: a column is unknown, has no unit, or is missing.
    """
    lengths = (*PLACE, LINEAR_AXIS) if linear_axis else PLACE
    units = {**dict.fromkeys(AXES, ANGLES), **dict.fromkeys(lengths, LENGTHS)}
    scales, wrong, seen = [], [], []
    for column in header:
        name, _, unit = column.partition("_")
        if column in ORIENTATION:
            scales.append(1.0)
        elif name == LINEAR_AXIS and not linear_axis:
            wrong.append(f"{column}: the task's arm has no linear axis")
        elif name not in units:
            wrong.append(f"{column or '(empty)'}: no such column")
        elif unit not in units[name]:
            possible = " or ".join(f"{name}_{known}" for known in units[name])
            wrong.append(f"{column}: its unit is missing or unknown. Write {possible}.")
        else:
            scales.append(units[name][unit])
        if name in seen:
            wrong.append(f"{column}: twice")
        seen.append(name)
    has_orientation = any(name in seen for name in ORIENTATION)
    needed = (*units, *ORIENTATION) if has_orientation else tuple(units)
    missing = [name for name in needed if name not in seen]
    if missing:
        wrong.append(f"missing: {', '.join(missing)}")
    if wrong:
        raise PosesError("\n".join(f"line {line}: {each}" for each in wrong))
    return scales


def _values(row: Sequence[str], header: Sequence[str], scales: Sequence[float]) -> list[float]:
    """Return the values of a row in SI units, a quaternion of length 1.

    Raises:
        ValueError: it has other columns than the header, or a value that is no number.
    """
    if len(row) != len(header):
        raise ValueError(f"{len(row)} values, the header has {len(header)} columns")
    values = []
    for name, cell, scale in zip(header, row, scales, strict=True):
        try:
            value = float(cell) * scale
        except ValueError:
            raise ValueError(f"{name}: {cell!r} is no number") from None
        if not abs(value) < LARGEST:
            raise ValueError(f"{name}: {cell} is out of range")
        values.append(value)
    at = [i for i, name in enumerate(header) if name in ORIENTATION]
    if at:
        length = math.hypot(*(values[i] for i in at))
        if abs(length - 1.0) > UNIT_ERROR:
            raise ValueError(f"the quaternion has length {length:.4g}, not 1")
        for i in at:
            values[i] /= length
    return values
