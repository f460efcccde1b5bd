"""Learning of the servo models from each motion; a change is made while the robot stands.

Invariants:
- In motion, two tuples a cycle are kept and nothing is computed.
- A motion is evaluated in a thread once the robot stands: it takes milliseconds.
- A change goes through the parameter service like an operator's, so it is recorded and logged.
- ``AdaptationSettings`` bounds it around the models that the configuration names.
- Models that were taken back are learned as at first.
"""

import math
from collections import deque
from collections.abc import Sequence

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
        self._command: tuple[float, ...] | None = None
        longest = math.ceil(LONGEST_S / cycle_s)
        self._motion: deque[tuple[tuple[float, ...], tuple[float, ...] | None]] = deque(
            maxlen=longest
        )

    def record_motion(self, entries: Sequence[LogEntry]) -> None:
        """Keep each command of a motion with the position that the next step had."""
        for entry in entries:
            if entry.state not in MOVING:
                self._command = None
                self.ripe = self.ripe or bool(self._motion)
                continue
            if self._command is not None:
                robot = entry.inputs.robot
                answer = None if robot is None else robot.joints + robot.external[:1]
                self._motion.append((self._command, answer))
            self._command = entry.outputs.command if entry.inputs.sent else None

    def motion(self) -> list[tuple[tuple[float, ...], tuple[float, ...] | None]]:
        """Return the motion that is over, and begin the next one."""
        self.ripe = False
        kept = list(self._motion)
        self._motion.clear()
        return kept

    def estimate_servos(
        self, motion: Sequence[tuple[tuple[float, ...], tuple[float, ...] | None]]
    ) -> ServoEstimates:
        """Return the models after a motion, window by window; to be called in a thread."""
        axes, estimates = len(self._identified), self.learned
        size = max(math.ceil(self._settings.window_s / self._cycle_s), 1)
        for begin in range(0, len(motion) - size + 1, size):
            rows = motion[begin : begin + size]
            commands = np.array([command[:axes] for command, _ in rows])
            answers: Array = np.full((size, axes), np.nan)
            for row, (_, answer) in zip(answers, rows, strict=True):
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
