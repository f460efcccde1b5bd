"""Ground truth of a run: one row a telegram.

Invariants:
    Preallocated and bounded.
    Plant and controller only, nothing from the daemon.
    Row i: state at the instant of telegram i, and what the controller applied from then on.
    Poses are position [m] and unit quaternion w x y z, in base.
"""

import json
import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from linemate.simulators.devices.emulated_world import EmulatedWorld
from linemate.simulators.devices.rsi_controller import Applied

CONTACT_CODES = {"free": 0, "clamped": 1, "released": 2}

Column = NDArray[Any]
Floats = NDArray[np.float64]
Seven = tuple[float, float, float, float, float, float, float]

_STATE = {
    "t": slice(0, 1),
    "place": slice(1, 4),
    "turn": slice(4, 13),
    "deflection": slice(13, 19),
    "hub_place": slice(19, 22),
    "hub_turn": slice(22, 31),
    "joints": slice(31, 38),
    "contact": slice(38, 39),
    "digital_in": slice(39, 40),
    "collision": slice(40, 41),
    "sway": slice(41, 47),
    "energy": slice(47, 48),
    "sag": slice(48, 54),
}
"""What is put down when a telegram goes out: the rigid tcp, the hub, and the rest."""
_REPLY = {
    "cycle": slice(0, 1),
    "setpoints": slice(1, 8),
    "digital_out": slice(8, 9),
    "answered": slice(9, 10),
    "clamped": slice(10, 11),
    "turnaround_us": slice(11, 12),
}
"""Columns that are known once the reply is judged."""
_INTEGERS = ("cycle", "contact", "digital_in", "digital_out")
_FLAGS = ("answered", "clamped", "collision")


class TruthLog:
    """Rows in the making.

    A row is begun with the world as it is when a telegram goes out, and ended when the
    reply is judged. Columns next to the poses:

    ``t`` scenario time [s]; ``cycle``, ``ipoc`` of the telegram; ``contact`` one of
    ``CONTACT_CODES``; ``digital_in``, ``digital_out`` the tool's signals; ``unit_position`` [m],
    ``unit_speed`` [m/s] of the conveyor; ``setpoints`` applied from this telegram on and
    ``joints`` measured, A1..A6 [rad], E1 [m]; ``deflection`` of the mount [m, rad]; ``relative``,
    its translation without the sag under the weight [m], and ``force`` of contact on it [N], tool
    axes; ``turnaround_us``, NaN without a good reply; ``answered``, ``clamped`` by a correction
    limit, ``collision`` so far; ``sway`` of the hub by the carrier [m, rad], in the conveyor
    frame; ``energy`` that the robot has put into the car in contact [J].

    Attributes:
        dropped: rows beyond the allocated ones.
    """

    def __init__(self, rows: int) -> None:
        """Allocate the rows.

        Args:
            rows: how many rows at most.
        """
        self._states = np.full((rows, _width(_STATE)), np.nan)
        self._replies = np.full((rows, _width(_REPLY)), np.nan)
        self._ipocs = np.zeros(rows, np.int64)  # too long for a float
        # This long row is packed: numpy takes twice as long to put a tuple into one of its own.
        self._put_state = struct.Struct(f"{_width(_STATE)}d").pack_into
        self._world: EmulatedWorld | None = None
        self._rows = rows
        self._count = 0
        self._begun = False
        self.dropped = 0

    def __len__(self) -> int:
        return self._count

    def begin(self, world: EmulatedWorld, axes: Seven) -> None:
        """Note the world at the instant of a telegram.

        Args:
            axes: what the telegram says was measured, A1..A6 [rad], E1 [m].
        """
        self._begun = self._count < self._rows
        if not self._begun:
            self.dropped += 1
            return
        self._world = world
        place, turn = world.rigid()
        hub_place, hub_turn = world.hub()
        self._put_state(
            self._states[self._count],
            0,
            world.time_s,
            *place,
            *turn,
            *world.deflection(),
            *hub_place,
            *hub_turn,
            *axes,
            CONTACT_CODES[world.contact],
            world.digital_in(),
            world.collision is not None,
            *world.sway(),
            world.energy(),
            *world.sag(),
        )

    def end(self, applied: Applied, turnaround_ns: int | None = None) -> None:
        """Note what became of the telegram.

        Args:
            applied: what the controller applied from that telegram on.
            turnaround_ns: how long its good reply took [ns], None without one.
        """
        if not self._begun:
            return
        self._begun = False
        answered = applied.answered
        took_us = turnaround_ns / 1e3 if turnaround_ns is not None and answered else math.nan
        self._replies[self._count] = (
            applied.cycle,
            *applied.setpoints,
            applied.digital_out,
            answered,
            applied.clamped,
            took_us,
        )
        self._ipocs[self._count] = applied.ipoc
        self._count += 1

    def columns(self) -> dict[str, Column]:
        """The complete rows, by column."""
        columns: dict[str, Column] = {"ipoc": self._ipocs[: self._count]}
        for parts, rows in ((_STATE, self._states), (_REPLY, self._replies)):
            for name, part in parts.items():
                values = rows[: self._count, part].copy()
                columns[name] = values[:, 0] if values.shape[1] == 1 else values
        columns.update({name: columns[name].astype(np.int64) for name in _INTEGERS})
        columns.update({name: columns[name].astype(np.bool_) for name in _FLAGS})
        place, deflection = columns.pop("place"), columns["deflection"]
        turn, hub_turn = (columns.pop(name).reshape(-1, 3, 3) for name in ("turn", "hub_turn"))
        bent = place + np.einsum("nij,nj->ni", turn, deflection[:, :3])
        columns["tcp"] = pose_rows(bent, turn @ _turns(deflection[:, 3:]))
        sag = columns.pop("sag")
        hung = place + np.einsum("nij,nj->ni", turn, sag[:, :3])
        columns["tcp_rigid"] = pose_rows(hung, turn @ _turns(sag[:, 3:]))
        columns["hub"] = pose_rows(columns.pop("hub_place"), hub_turn)
        columns["unit_position"], columns["unit_speed"] = self._unit(columns["t"])
        columns["relative"] = deflection[:, :3] - sag[:, :3]
        columns["force"] = columns["relative"] * self._stiffness()
        return columns

    def _unit(self, times: Column) -> tuple[Column, Column]:
        if self._world is None or not len(times):
            return np.zeros(0), np.zeros(0)
        return self._world.unit_motion(times)

    def _stiffness(self) -> Column:
        world = self._world
        return np.zeros(3) if world is None else np.array(world.mount_stiffness[:3])

    def save(self, path: Path, facts: Mapping[str, Any]) -> None:
        """Write the rows as a numpy archive, with facts as JSON in ``facts``.

        Args:
            path: the file, made or overwritten in one go.
            facts: what JSON can say of the run as a whole.
        """
        fresh = path.with_name(f".{path.name}.part")
        with fresh.open("wb") as file:
            self.write(file, facts)
        fresh.replace(path)

    def write(self, stream: BinaryIO, facts: Mapping[str, Any]) -> None:
        """Write the archive of ``save`` to a binary stream."""
        np.savez_compressed(
            stream, allow_pickle=False, facts=np.array(json.dumps(facts)), **self.columns()
        )


def load(path: Path | BinaryIO) -> tuple[dict[str, Column], dict[str, Any]]:
    """Read what ``TruthLog.save`` wrote.

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


def pose_rows(places: Floats, turns: Floats) -> Floats:
    """Poses as seven numbers.

    Args:
        places: positions, (n, 3) [m].
        turns: rotations, (n, 3, 3).

    Returns:
        Position [m] and unit quaternion w x y z, w not negative, (n, 7).
    """
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = turns.reshape(-1, 9).T
    x, y, z, a, b, c = r21 - r12, r02 - r20, r10 - r01, r10 + r01, r02 + r20, r21 + r12
    squares = (1.0 + r00 + r11 + r22, 1.0 + r00 - r11 - r22, 1.0 - r00 + r11 - r22)
    w2, x2, y2, z2 = *squares, 1.0 - r00 - r11 + r22
    # The greatest of the four squares is divided by, which never loses digits.
    candidates = np.array(((w2, x, y, z), (x, x2, a, b), (y, a, y2, c), (z, b, c, z2)))
    greatest = np.argmax((w2, x2, y2, z2), axis=0)
    every = np.arange(len(greatest))
    quaternions = candidates[greatest, :, every]
    quaternions *= 0.5 / np.sqrt(candidates[greatest, greatest, every])[:, np.newaxis]
    quaternions[quaternions[:, 0] < 0.0] *= -1.0
    return np.concatenate((places, quaternions), axis=1)


def _turns(vectors: Floats) -> Floats:
    """Rotation matrices of rotation vectors (n, 3) [rad]."""
    angles = np.linalg.norm(vectors, axis=1)[:, np.newaxis, np.newaxis]
    zero = np.zeros(len(vectors))
    x, y, z = vectors.T
    cross = np.array(((zero, -z, y), (z, zero, -x), (-y, x, zero))).transpose(2, 0, 1)
    # sin(t)/t and (1 - cos(t))/t^2, which numpy's sinc has without a hole at zero.
    sine, versine = np.sinc(angles / np.pi), 0.5 * np.sinc(0.5 * angles / np.pi) ** 2
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))


def _width(parts: Mapping[str, slice]) -> int:
    return max(int(part.stop) for part in parts.values())
