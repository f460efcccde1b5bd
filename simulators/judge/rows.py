"""Rows of a run: one a telegram, truth next to the daemon's columns.

Invariants:
    Preallocated arrays; nothing is computed except poses as seven numbers.
    Row i belongs to telegram i, sent at scenario time ``t[i]``.
    An unanswered telegram has NaN in the daemon's columns.
    Poses are (n, 7): position [m], quaternion w x y z.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Monotonic stamp of the begin of a run [ns]; its value has no meaning.
EPOCH_NS = 1_000_000_000_000

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

AXES = 7
"""A1..A6 [rad] and E1 [m]."""

FREE, CLAMPED, RELEASED = 0, 1, 2
"""Codes of the column ``contact``."""

PHASES = ("", "wait", "approach", "contact", "screws", "retreat", "done")
"""Codes of the column ``phase``."""

CLASSES = ("", "running", "stopping", "standing", "starting")
"""Codes of the column ``scenario``."""

STATES = (
    "", "init", "idle", "armed", "track", "contact", "retreat", "hold", "fault", "home",
    "follow",
)  # fmt: skip
"""Codes of the column ``state``."""


@dataclass(frozen=True, slots=True)
class DaemonEvent:
    """A class change that the daemon reported: ("stop", "tentative"), ("start", "confirmed")."""

    t: float
    kind: str
    what: str


@dataclass(frozen=True, slots=True)
class Rows:
    """One run, row by row (n telegrams).

    Attributes:
        t: scenario time of each telegram [s], (n,).
        tcp: true, elastic tcp in base, (n, 7).
        tcp_rigid: where the robot holds the tool: bent by its weight alone, in base, (n, 7).
        hub: true hub in base, (n, 7).
        contact: FREE, CLAMPED or RELEASED, (n,).
        digital_in: the tool's signals to the daemon (bit 0 fixed, bit 1 released), (n,).
        unit_position: of the conveyor unit [m], (n,).
        unit_speed: of the conveyor unit [m/s], (n,).
        setpoints: applied by the controller from this telegram on, (n, 7).
        joints: measured axes, (n, 7).
        force: on the elastic mount, tcp axes [N], (n, 3).
        relative: elastic tcp off where it would hang by its weight, rigid tcp axes [m], (n, 3).
        sway: of the hub by the carrier's modes, in the conveyor frame [m, rad], (n, 6).
        energy: work of the robot on the car in contact, relative to the conveyor [J], (n,).
        answered: the telegram got its reply in time, (n,).
        command: the daemon's own setpoints, (n, 7).
        target: x_t(k, 0), the committed x_c(k), in base, (n, 7).
        sensed: x_f(k, 0) in base, (n, 7).
        part: estimated hub in base, (n, 7).
        phase: index into PHASES, (n,).
        scenario: index into CLASSES, (n,).
        tentative: the class is not confirmed, (n,).
        state: index into STATES, (n,).
        contact_seen: the daemon assumes contact, (n,).
        task_time: the task's clock [s], NaN before it starts, (n,).
        speed: estimated speed of the conveyor [m/s], (n,).
        step_us: computing time of the reply [us], NaN where not measured, (n,).
        events: changes of class, in order of time.
    """

    t: Floats
    tcp: Floats
    tcp_rigid: Floats
    hub: Floats
    contact: Ints
    digital_in: Ints
    unit_position: Floats
    unit_speed: Floats
    setpoints: Floats
    joints: Floats
    force: Floats
    relative: Floats
    sway: Floats
    energy: Floats
    answered: Bools
    command: Floats
    target: Floats
    sensed: Floats
    part: Floats
    phase: Ints
    scenario: Ints
    tentative: Bools
    state: Ints
    contact_seen: Bools
    task_time: Floats
    speed: Floats
    step_us: Floats
    events: tuple[DaemonEvent, ...] = ()

    def __len__(self) -> int:
        return len(self.t)

    def judged_tcp(self) -> Floats:
        """The tcp that errors are judged by, (n, 7).

        In free space the elastic tcp; while clamped the rigid one, whose difference to the hub
        is the deflection, that is the contact force.
        """
        clamped = (self.contact == CLAMPED)[:, np.newaxis]
        return np.where(clamped, self.tcp_rigid, self.tcp)

    def cut(self, n: int) -> "Rows":
        """The first n rows, with all events."""
        columns = {f.name: getattr(self, f.name)[:n] for f in fields(self) if f.name != "events"}
        return replace(self, **columns)


TRUTH = (
    "t", "tcp", "tcp_rigid", "hub", "contact", "digital_in", "unit_position", "unit_speed",
    "setpoints", "joints", "force", "relative", "sway", "energy", "answered",
)  # fmt: skip
"""Columns that the emulator fills (``devices.truth``); the others are the daemon's word."""

_SHAPES: dict[str, tuple[int, ...]] = {
    "tcp": (7,), "tcp_rigid": (7,), "hub": (7,), "target": (7,), "sensed": (7,), "part": (7,),
    "setpoints": (AXES,), "joints": (AXES,), "command": (AXES,), "force": (3,),
    "relative": (3,), "sway": (6,),
}  # fmt: skip
_INTS = {"contact", "digital_in", "phase", "scenario", "state"}
_BOOLS = {"answered", "tentative", "contact_seen"}


def empty(n: int) -> Rows:
    """Rows to be filled: floats NaN, integers 0, flags False."""
    columns: dict[str, Any] = {}
    for field in fields(Rows):
        shape = (n, *_SHAPES.get(field.name, ()))
        if field.name in _INTS:
            columns[field.name] = np.zeros(shape, np.int64)
        elif field.name in _BOOLS:
            columns[field.name] = np.zeros(shape, np.bool_)
        elif field.name != "events":
            columns[field.name] = np.full(shape, np.nan)
    return Rows(**columns)
