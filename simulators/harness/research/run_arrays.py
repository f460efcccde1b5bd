"""A run as arrays in SI units: the daemon's estimate, and the plant's truth next to it."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from linemate.simulators.judge.judge import compute_errors
from linemate.simulators.judge.rows import TRUTH, DaemonEvent, Floats, Rows

_PARTS = {
    3: ("x", "y", "z"),
    6: ("x", "y", "z", "rx", "ry", "rz"),
    7: ("x", "y", "z", "qw", "qx", "qy", "qz"),
}
_AXES = ("a1", "a2", "a3", "a4", "a5", "a6", "e1")
_OF_AXES = frozenset({"setpoints", "joints", "command"})


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One run, row by row; row i belongs to telegram i.

    Poses are (n, 7): position [m] and unit quaternion w x y z, in base. Axes are (n, 7): A1..A6
    [rad] and E1 [m]. What is not known is NaN.

    Attributes:
        rows: all columns, with shape and unit of each below, in ``judge.rows.Rows``.
        has_truth: the columns of the truth are known.
        result: the judge's result of the run (``docs/json.md``), None if it was not judged.
        recording: the file it was recorded to or read from, None without one.
        is_identical: of a replay: every output has the recorded bits. None for a simulation.
    """

    rows: Rows
    has_truth: bool = True
    result: Mapping[str, Any] | None = None
    recording: Path | None = None
    is_identical: bool | None = None

    @property
    def t(self) -> Floats:
        """Time of each telegram [s], (n,)."""
        return self.rows.t

    @property
    def events(self) -> tuple[DaemonEvent, ...]:
        """Changes of class that the daemon reported, in order of time."""
        return self.rows.events

    @property
    def truth(self) -> dict[str, Any]:
        """Columns of the plant's truth by name; empty if they are not known."""
        return {name: getattr(self.rows, name) for name in TRUTH} if self.has_truth else {}

    @property
    def estimate(self) -> dict[str, Any]:
        """Columns of the daemon by name."""
        known = {field.name for field in fields(self.rows)} - {*TRUTH, "events"}
        return {name: getattr(self.rows, name) for name in sorted(known)}

    def errors(self) -> dict[str, tuple[Floats, Floats]]:
        """Return the errors of each row: distance [m] and angle [rad], (n,) each.

        ``control``: tcp to the committed pose. ``plan``: the committed pose to the estimate.
        ``prediction``: the estimate to the true object. ``total``: tcp to the true object.

        Raises:
            ValueError: the truth is not known.
        """
        if not self.has_truth:
            raise ValueError(
                "the recording has no truth. Record it with linemate-sim run --record."
            )
        return compute_errors(self.rows)

    def columns(self) -> dict[str, Any]:
        """Return all columns by name, (n,) each: ``pandas.DataFrame(run.columns())``."""
        flat: dict[str, Any] = {"t": self.t}
        groups = (("truth", self.truth), ("estimate", self.estimate))
        for group, columns in groups:
            for name, values in columns.items():
                if name == "t":
                    continue
                if values.ndim == 1:
                    flat[f"{group}.{name}"] = values
                    continue
                parts = _AXES if name in _OF_AXES else _PARTS[values.shape[1]]
                for i, part in enumerate(parts):
                    flat[f"{group}.{name}.{part}"] = values[:, i]
        return flat
