"""One moment as the page draws it: from telemetry, or from a recorded step.

Law of this file: pure; plain values in, plain values out, rounded to what an eye can see. What was
measured an instant before is compared with what was desired *then*, never with what is desired now:
at the conveyor's pace a cycle is a millimetre.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from linemate.daemon.view.cell import Scene
from linemate.daemon.view.chain import Vector

Frame = dict[str, Any]

REMEMBERED: Final = 16  # moments, to find the one before
LONGEST_GAP_NS: Final = 200_000_000
"""Between two moments, beyond which nothing is said of what lay between them [ns]."""

KEPT: Final = ("k", "state", "phase", "task_time", "scenario", "speed", "contact", "held",
               "overload", "ages_ms", "foreseen_ms", "cycle_ms", "samples")  # fmt: skip
AXES: Final = 7


@dataclass(frozen=True, slots=True)
class _Moment:
    stamp_ns: int
    target: Vector | None
    part: Vector | None


@dataclass(slots=True)
class Framer:
    """Makes frames, and remembers the last moments.

    Attributes:
        unfit: telemetry that no frame could be made of.
    """

    scene: Scene
    unfit: int = 0
    _moments: deque[_Moment] = field(default_factory=lambda: deque(maxlen=REMEMBERED))

    def note(self, told: Mapping[str, Any]) -> None:
        """Remember a moment that is not drawn.

        Raises:
            TypeError, ValueError: it is none.
        """
        stamp_ns = told.get("stamp_ns")
        if isinstance(stamp_ns, int):
            moment = _Moment(stamp_ns, _place(told.get("target")), _place(told.get("part")))
            last_ns = self._moments[-1].stamp_ns if self._moments else stamp_ns - 1
            if stamp_ns == last_ns:
                return  # told twice between two steps
            if stamp_ns < last_ns:
                self._moments.clear()  # another daemon, or another boot
            self._moments.append(moment)

    def frame(self, told: Mapping[str, Any]) -> Frame | None:
        """Return the frame of a moment, None (counted) if it cannot be one.

        Args:
            told: a daemon's telemetry, or the same made of a recorded step.
        """
        try:
            return self._frame(told)
        except (TypeError, ValueError, KeyError, IndexError, OverflowError):
            self.unfit += 1
            return None

    def _frame(self, told: Mapping[str, Any]) -> Frame:
        self.note(told)
        frame: Frame = {name: told[name] for name in KEPT if told.get(name) is not None}
        if told.get("stamp_ns") is not None:
            frame["t"] = round(told["stamp_ns"] * 1e-9, 4)
        frame["tentative"] = told.get("scenario_state") == "tentative"
        confidence = told.get("confidence")
        if confidence is not None:
            frame["confidence"] = round(float(confidence), 3)
        for name in ("target", "sensed", "part"):
            if told.get(name) is not None:
                frame[name] = [round(float(part), 5) for part in told[name]]
        if told.get("foreseen"):
            frame["foreseen"] = [[round(float(x), 5) for x in point] for point in told["foreseen"]]
        if told.get("turnaround_us") is not None and told.get("cycle_ms"):
            frame["slack_ms"] = round(told["cycle_ms"] - told["turnaround_us"] / 1e3, 3)
        frame["errors"] = self._errors(told, self._place(told, frame))
        return frame

    def _place(self, told: Mapping[str, Any], frame: Frame) -> Vector | None:
        """Put the arm into the frame; its tcp, None if that is not known."""
        axes = told.get("measured")
        if axes is None:
            axes = told.get("command")
        if axes is None or self.scene.chain is None:
            return None
        frame["guessed"] = told.get("measured") is None
        values = [float(axis) for axis in axes]
        if not all(math.isfinite(value) for value in values):
            raise ValueError("axes that are no numbers")
        points, tcp = self.scene.chain.place(values)
        frame["arm"] = [[round(x, 4) for x in point] for point in points]
        frame["tcp"] = [round(x, 5) for x in tcp]
        frame["axes"] = [round(value, 5) for value in values[:AXES]]
        return tcp[:3]

    def _errors(self, told: Mapping[str, Any], tcp: Vector | None) -> dict[str, float]:
        errors = {}
        target, sensed = told.get("target"), told.get("sensed")
        if target is not None and sensed is not None:
            errors["plan_mm"] = _apart_mm(target, sensed)
        measured_ns = told.get("measured_ns")
        if tcp is not None and measured_ns is not None:
            then = self._then(measured_ns)
            if then.target is not None:
                errors["control_mm"] = _apart_mm(tcp, then.target)
            if then.part is not None:
                errors["gap_mm"] = _apart_mm(tcp, then.part)
        return errors

    def _then(self, stamp_ns: int) -> _Moment:
        """What was desired and where the object was at a time among the last moments."""
        nothing = _Moment(stamp_ns, None, None)
        for before, after in zip(
            reversed([*self._moments][:-1]), reversed([*self._moments][1:]), strict=True
        ):
            if before.stamp_ns <= stamp_ns <= after.stamp_ns:
                span_ns = after.stamp_ns - before.stamp_ns
                if span_ns > LONGEST_GAP_NS:
                    return nothing
                share = (stamp_ns - before.stamp_ns) / span_ns
                return _Moment(
                    stamp_ns,
                    _between(before.target, after.target, share),
                    _between(before.part, after.part, share),
                )
        return nothing


def _place(pose: Sequence[float] | None) -> Vector | None:
    if pose is None:
        return None
    x, y, z = (float(part) for part in pose[:3])
    return x, y, z


def _between(a: Vector | None, b: Vector | None, share: float) -> Vector | None:
    if a is None or b is None:
        return None
    x, y, z = (p + share * (q - p) for p, q in zip(a, b, strict=True))
    return x, y, z


def _apart_mm(a: Sequence[float], b: Sequence[float]) -> float:
    return round(1e3 * math.dist(a[:3], b[:3]), 4)
