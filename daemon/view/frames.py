"""Frames for the page, from telemetry or from recorded steps.

Invariants:
    * Pure: plain values in, plain values out, rounded to what a screen shows.
    * A measured pose is compared with what was desired at its own time: a cycle is 1 mm of travel.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final, NamedTuple

from linemate.daemon.view.cell import Cell
from linemate.daemon.view.chain import Vector

Frame = dict[str, Any]
Moment = Mapping[str, Any]  # a daemon's telemetry, or the same of a recorded step

MAX_MOMENTS: Final = 16  # to find the one at which a pose was measured
MAX_GAP_NS: Final = 200_000_000  # between two moments that are interpolated
COPIED: Final = ("k", "state", "phase", "task_time", "scenario", "speed", "contact", "held",
                 "overload", "ages_ms", "foreseen_ms", "cycle_ms", "samples")  # fmt: skip


class _Positions(NamedTuple):
    stamp_ns: int
    target: Vector | None
    part: Vector | None


@dataclass(slots=True)
class Framer:
    """Makes frames, with the last moments for comparison.

    Attributes:
        cell: The cell whose arm is drawn.
        unfit: Moments that no frame could be made of.
    """

    cell: Cell
    unfit: int = 0
    _moments: deque[_Positions] = field(default_factory=lambda: deque(maxlen=MAX_MOMENTS))

    def remember(self, moment: Moment) -> None:
        """Keep the positions of a moment.

        Raises:
            TypeError, ValueError: Its positions are not vectors.
        """
        stamp_ns = moment.get("stamp_ns")
        if not isinstance(stamp_ns, int):
            return
        positions = _Positions(
            stamp_ns, _position(moment.get("target")), _position(moment.get("part"))
        )
        last_ns = self._moments[-1].stamp_ns if self._moments else stamp_ns - 1
        if stamp_ns == last_ns:
            return  # the same step was sent twice
        if stamp_ns < last_ns:
            self._moments.clear()  # another daemon, or the host was restarted
        self._moments.append(positions)

    def frame(self, moment: Moment) -> Frame | None:
        """Return the frame of a moment; None, which is counted, if it is unfit."""
        try:
            return self._frame(moment)
        except (TypeError, ValueError, KeyError, IndexError, OverflowError):
            self.unfit += 1
            return None

    def _frame(self, moment: Moment) -> Frame:
        self.remember(moment)
        frame: Frame = {name: moment[name] for name in COPIED if moment.get(name) is not None}
        if moment.get("stamp_ns") is not None:
            frame["t"] = round(moment["stamp_ns"] * 1e-9, 4)
        frame["tentative"] = moment.get("scenario_state") == "tentative"
        confidence = moment.get("confidence")
        if confidence is not None:
            frame["confidence"] = round(float(confidence), 3)
        for name in ("target", "sensed", "part"):
            if moment.get(name) is not None:
                frame[name] = [round(float(part), 5) for part in moment[name]]
        if moment.get("foreseen"):
            frame["foreseen"] = [[round(float(x), 5) for x in p] for p in moment["foreseen"]]
        if moment.get("turnaround_us") is not None and moment.get("cycle_ms"):
            frame["margin_ms"] = round(moment["cycle_ms"] - moment["turnaround_us"] / 1e3, 3)
        frame["errors"] = self._errors(moment, self._add_arm(moment, frame))
        return frame

    def _add_arm(self, moment: Moment, frame: Frame) -> Vector | None:
        """Add the arm to the frame and return its tcp, None if it is not known."""
        axes = moment.get("measured")
        if axes is None:
            axes = moment.get("command")
        if axes is None or self.cell.chain is None:
            return None
        frame["guessed"] = moment.get("measured") is None
        values = [float(axis) for axis in axes]
        if not all(math.isfinite(value) for value in values):
            raise ValueError("axes that are not finite")
        points, tcp = self.cell.chain.place(values)
        frame["arm"] = [[round(x, 4) for x in point] for point in points]
        frame["tcp"] = [round(x, 5) for x in tcp]
        return tcp[:3]

    def _errors(self, moment: Moment, tcp: Vector | None) -> dict[str, float]:
        errors = {}
        target, sensed = moment.get("target"), moment.get("sensed")
        if target is not None and sensed is not None:
            errors["plan_mm"] = _distance_mm(target, sensed)
        measured_ns = moment.get("measured_ns")
        if tcp is not None and measured_ns is not None:
            desired = self._positions_at(measured_ns)
            if desired.target is not None:
                errors["control_mm"] = _distance_mm(tcp, desired.target)
            if desired.part is not None:
                errors["gap_mm"] = _distance_mm(tcp, desired.part)
        return errors

    def _positions_at(self, stamp_ns: int) -> _Positions:
        """Interpolate the positions of the last moments."""
        newest_first = [*self._moments][::-1]
        for after, before in pairwise(newest_first):
            if before.stamp_ns <= stamp_ns <= after.stamp_ns:
                span_ns = after.stamp_ns - before.stamp_ns
                if span_ns > MAX_GAP_NS:
                    break
                share = (stamp_ns - before.stamp_ns) / span_ns
                return _Positions(
                    stamp_ns,
                    _between(before.target, after.target, share),
                    _between(before.part, after.part, share),
                )
        return _Positions(stamp_ns, None, None)


def _position(pose: Sequence[float] | None) -> Vector | None:
    if pose is None:
        return None
    x, y, z = (float(part) for part in pose[:3])
    return x, y, z


def _between(a: Vector | None, b: Vector | None, share: float) -> Vector | None:
    if a is None or b is None:
        return None
    x, y, z = (p + share * (q - p) for p, q in zip(a, b, strict=True))
    return x, y, z


def _distance_mm(a: Sequence[float], b: Sequence[float]) -> float:
    return round(1e3 * math.dist(a[:3], b[:3]), 4)
