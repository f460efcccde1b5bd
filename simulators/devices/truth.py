"""What really happened, a row a telegram: the ground on which a run is judged.

Law of this file: preallocated and bounded; truth of the plant and of the controller, never the
daemon's word. Row i is the state at the instant of telegram i and what the controller applied
from that instant on. Poses are position [m] and unit quaternion w x y z, in base.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linemate.simulators.devices.controller import Applied
from linemate.simulators.plants.world import World

CONTACT_CODES = {"free": 0, "clamped": 1, "released": 2}

Column = NDArray[Any]
Seven = tuple[float, float, float, float, float, float, float]

_FLOATS = {
    "t": 0,
    "tcp": 7,
    "tcp_rigid": 7,
    "hub": 7,
    "unit_position": 0,
    "unit_speed": 0,
    "setpoints": 7,
    "joints": 7,
    "deflection": 6,
    "force": 3,
    "turnaround_us": 0,
}
_INTEGERS = ("cycle", "ipoc", "contact", "digital_in", "digital_out")
_FLAGS = ("answered", "clamped", "collision")


class TruthLog:
    """Rows in the making.

    A row is begun with the world as it is when a telegram goes out, and ended when the
    telegram's fate is known. Columns, beside the poses:

    ``t`` scenario time [s]; ``cycle``, ``ipoc`` of the telegram; ``contact`` one of
    ``CONTACT_CODES``; ``digital_in``, ``digital_out`` the tool's signals; ``unit_position`` [m],
    ``unit_speed`` [m/s] of the conveyor; ``setpoints`` applied from this telegram on and
    ``joints`` measured, A1..A6 [rad], E1 [m]; ``deflection`` of the mount [m, rad] and ``force``
    on it [N], tool axes; ``turnaround_us``, NaN without a good reply; ``answered``, ``clamped``
    by a correction limit, ``collision`` so far.

    Attributes:
        dropped: rows that found no room.
    """

    def __init__(self, rows: int) -> None:
        """Make room.

        Args:
            rows: how many rows at most.
        """
        self._columns: dict[str, Column] = {
            name: np.full((rows, width) if width else rows, np.nan)
            for name, width in _FLOATS.items()
        }
        self._columns.update({name: np.zeros(rows, np.int64) for name in _INTEGERS})
        self._columns.update({name: np.zeros(rows, np.bool_) for name in _FLAGS})
        self._room = rows
        self._count = 0
        self._begun = False
        self.dropped = 0

    def __len__(self) -> int:
        """Number of complete rows."""
        return self._count

    def begin(self, world: World, axes: Seven) -> None:
        """Note the world at the instant of a telegram.

        Args:
            world: at that instant.
            axes: what the telegram says was measured, A1..A6 [rad], E1 [m].
        """
        self._begun = self._count < self._room
        if not self._begun:
            self.dropped += 1
            return
        row, columns = self._count, self._columns
        deflection = world.deflection()
        stiffness = world.scenario.effector.stiffness
        columns["t"][row] = world.time_s
        columns["tcp"][row] = pose_row(world.tcp_pose())
        columns["tcp_rigid"][row] = pose_row(world.tcp_rigid_pose())
        columns["hub"][row] = pose_row(world.hub_pose())
        columns["unit_position"][row] = world.unit_position()
        columns["unit_speed"][row] = world.unit_speed()
        columns["joints"][row] = axes
        columns["deflection"][row] = deflection
        columns["force"][row] = [k * d for k, d in zip(stiffness, deflection, strict=True)][:3]
        columns["contact"][row] = CONTACT_CODES[world.contact]
        columns["digital_in"][row] = world.digital_in()
        columns["collision"][row] = world.collision is not None

    def end(self, applied: Applied, turnaround_ns: int | None = None) -> None:
        """Note what became of the telegram.

        Args:
            applied: what the controller applied from that telegram on.
            turnaround_ns: how long its good reply took [ns], None without one.
        """
        if not self._begun:
            return
        self._begun = False
        row, columns = self._count, self._columns
        columns["cycle"][row] = applied.cycle
        columns["ipoc"][row] = applied.ipoc
        columns["setpoints"][row] = applied.setpoints
        columns["digital_out"][row] = applied.digital_out
        columns["answered"][row] = applied.answered
        columns["clamped"][row] = applied.clamped
        if turnaround_ns is not None and applied.answered:
            columns["turnaround_us"][row] = turnaround_ns / 1e3
        self._count += 1

    def columns(self) -> dict[str, Column]:
        """The complete rows, by column."""
        return {name: column[: self._count] for name, column in self._columns.items()}

    def save(self, path: Path, facts: Mapping[str, Any]) -> None:
        """Write the rows as a numpy archive, with facts as JSON in ``facts``.

        Args:
            path: the file, made or overwritten in one go.
            facts: what JSON can say of the run as a whole.
        """
        fresh = path.with_name(f".{path.name}.part")
        with fresh.open("wb") as file:
            np.savez_compressed(
                file, allow_pickle=False, facts=np.array(json.dumps(facts)), **self.columns()
            )
        fresh.replace(path)


def load(path: Path) -> tuple[dict[str, Column], dict[str, Any]]:
    """Read what ``TruthLog.save`` wrote.

    Args:
        path: the file.

    Returns:
        The columns, and the facts.

    Raises:
        OSError: if it cannot be read.
        ValueError: if it is no such archive.
    """
    with np.load(path, allow_pickle=False) as archive:
        columns = {name: archive[name] for name in archive.files}
    facts: dict[str, Any] = json.loads(str(columns.pop("facts")))
    return columns, facts


def pose_row(pose: NDArray[np.float64]) -> Seven:
    """A 4x4 pose as seven numbers.

    Args:
        pose: homogeneous matrix.

    Returns:
        Position [m] and unit quaternion w x y z, w not negative.
    """
    (r00, r01, r02, x), (r10, r11, r12, y), (r20, r21, r22, z), _ = pose.tolist()
    # The greatest of the four squares is divided by, which never loses digits.
    squares = (
        1.0 + r00 + r11 + r22,
        1.0 + r00 - r11 - r22,
        1.0 - r00 + r11 - r22,
        1.0 - r00 - r11 + r22,
    )
    greatest = max(range(4), key=squares.__getitem__)
    rows = (
        (squares[0], r21 - r12, r02 - r20, r10 - r01),
        (r21 - r12, squares[1], r10 + r01, r02 + r20),
        (r02 - r20, r10 + r01, squares[2], r21 + r12),
        (r10 - r01, r02 + r20, r21 + r12, squares[3]),
    )
    scale = 0.5 / math.sqrt(squares[greatest])
    w, i, j, k = (value * scale for value in rows[greatest])
    sign = -1.0 if w < 0.0 else 1.0
    return x, y, z, sign * w, sign * i, sign * j, sign * k
