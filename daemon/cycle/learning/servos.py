"""Learning of the servo models from each motion; a change is made while the robot stands.

Invariants:
- In motion, two tuples a cycle are kept and nothing is computed.
- A window has neighbouring cycles of one motion. Where cycles are missing, another one begins.
- A motion is evaluated in a thread once the robot stands: it takes milliseconds.
- A change goes through the parameter service like an operator's, so it is recorded and logged.
- ``AdaptationSettings`` bounds it around the models that the configuration names.
- Models that were taken back are learned as at first.
"""

import math
from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from linemate.daemon.core.control import adaptation
from linemate.daemon.core.control.adaptation import AdaptationSettings, ServoEstimates
from linemate.daemon.core.control.settings import ServoModel
from linemate.daemon.core.horizon import Array
from linemate.daemon.cycle.states import MOVING
from linemate.daemon.cycle.step_log import LogEntry

WHO = "learning"
"""Operator that the log names for a learned change."""

LONGEST_S = 60.0  # of a longer motion the end is evaluated [s]
# A frequency that would change by a smaller share stays: each change is compiled and recorded.
WORTH = 0.002

Row = tuple[int, tuple[float, ...], tuple[float, ...] | None]
"""Number of a step, the setpoint in force before it, and the position that it had."""


class Learner:
    """Keeps the motion and the servo models learned from it.

    Args:
        identified: the models that the configuration names, one an axis.

    Attributes:
        ripe: a motion is over and not evaluated yet.
    """

    def __init__(
        self, settings: AdaptationSettings, identified: Sequence[ServoModel], cycle_s: float
    ) -> None:
        self.learned: ServoEstimates = adaptation.initial(identified)
        self.ripe = False
        self._settings = settings
        self._identified = tuple(identified)
        self._cycle_s = cycle_s
        self._kept: list[float] | None = None  # frequencies in force after the last change [Hz]
        self._before: LogEntry | None = None
        self._held: tuple[float, ...] | None = None
        self._motion: deque[Row] = deque(maxlen=math.ceil(LONGEST_S / cycle_s))

    def record_motion(self, entries: Sequence[LogEntry]) -> None:
        """Keep each setpoint of a motion with the position that the next step had."""
        for entry in entries:
            if entry.state not in MOVING:
                self._before = self._held = None
                self.ripe = self.ripe or bool(self._motion)
                continue
            before, self._before, inputs = self._before, entry, entry.inputs
            if before is None or inputs.k != before.inputs.k + 1:
                self._held = None
                continue
            # Without a command a robot holds. Where it goes on by itself instead is not learned.
            held = before.outputs.command if inputs.sent else inputs.applied or self._held
            self._held = held if inputs.pace is None else None
            if self._held is not None:
                robot = inputs.robot
                answer = None if robot is None else robot.joints + robot.external[:1]
                self._motion.append((inputs.k, self._held, answer))

    def motion(self) -> list[Row]:
        """Return the motion that is over, and begin the next one."""
        self.ripe = False
        kept = list(self._motion)
        self._motion.clear()
        return kept

    def estimate_servos(self, motion: Sequence[Row]) -> ServoEstimates:
        """Return the models after a motion, window by window; to be called in a thread."""
        axes, estimates = len(self._identified), self.learned
        size = max(math.ceil(self._settings.window_s / self._cycle_s), 1)
        for rows in _windows(motion, size):
            commands = np.array([command[:axes] for _, command, _ in rows])
            answers: Array = np.full((size, axes), np.nan)
            for row, (_, _, answer) in zip(answers, rows, strict=True):
                if answer is not None:
                    row[:] = answer[:axes]
            window = adaptation.ServoWindow(commands, answers)
            estimates = adaptation.update(
                self._settings,
                self._identified,
                estimates,
                window,
                self._cycle_s,
                self._settings.window_s,
            )
        return estimates

    def keep(self, estimates: ServoEstimates, present: Sequence[ServoModel]) -> dict[str, float]:
        """Keep what was learned and return the parameters that it changes, by name.

        Args:
            present: the models in force.
        """
        frequencies = [model.frequency_hz for model in present[: len(self._identified)]]
        if self._kept not in (None, frequencies):
            # The estimates go on from models that an operator has taken back.
            self.learned, self._kept = adaptation.initial(self._identified), None
            return {}
        self.learned = estimates
        learned = [float(f"{model.frequency_hz:.6g}") for model in estimates.models]
        self._kept = [
            new if abs(new / now - 1.0) > WORTH else now
            for new, now in zip(learned, frequencies, strict=True)
        ]
        return {
            f"control.servos.{axis}.frequency_hz": new
            for axis, (new, now) in enumerate(zip(self._kept, frequencies, strict=True))
            if new != now
        }


def _windows(motion: Sequence[Row], size: int) -> Iterator[Sequence[Row]]:
    """Yield windows of ``size`` neighbouring cycles, one after the other."""
    begin = 0
    for i, (k, _, _) in enumerate(motion):
        if k - motion[begin][0] != i - begin:
            begin = i
        if i - begin + 1 == size:
            yield motion[begin : i + 1]
            begin = i + 1
