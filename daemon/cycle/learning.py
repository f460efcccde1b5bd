"""The servos, learned anew from each motion and taken while the robot stands.

Law of this file: in motion two tuples a cycle are kept and nothing is computed; a look costs
milliseconds of the interpreter, which a cycle does not have. Once the robot stands the motion is
looked at in a thread, and what was learned goes to the parameters' desk as an operator's change
would: recorded, replayed, logged, and undone by one ``param set``. How far and how fast is bounded
by ``AdaptationSettings``, about the models that the configuration names.
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
"""Whom the log names for a change that was learned."""

LONGEST_S = 60.0
"""The end of a motion that is longer is looked at."""

WORTH = 0.002
"""A frequency that would change by a smaller share stays: a change is compiled and recorded."""


class Learner:
    """What moved, and what is believed of the servos.

    Args:
        identified: the models that the configuration names, one an axis.
        cycle_s: T0 [s].

    Attributes:
        ripe: a motion is over and has not been looked at.
    """

    def __init__(
        self, settings: AdaptationSettings, identified: Sequence[ServoModel], cycle_s: float
    ) -> None:
        self.learned: ServoEstimates = adaptation.initial(identified)
        self.ripe = False
        self._settings = settings
        self._identified = tuple(identified)
        self._cycle_s = cycle_s
        self._command: tuple[float, ...] | None = None
        longest = math.ceil(LONGEST_S / cycle_s)
        self._motion: deque[tuple[tuple[float, ...], tuple[float, ...] | None]] = deque(
            maxlen=longest
        )

    def take(self, entries: Sequence[LogEntry]) -> None:
        """Note the steps that were made: each command with the answer that the next one saw."""
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
        """Hand over the motion that is over; the next one begins."""
        self.ripe = False
        kept = list(self._motion)
        self._motion.clear()
        return kept

    def look(
        self, motion: Sequence[tuple[tuple[float, ...], tuple[float, ...] | None]]
    ) -> ServoEstimates:
        """Return what is believed after a motion, window by window; in a thread.

        Args:
            motion: as ``motion`` handed it over.
        """
        axes, found = len(self._identified), self.learned
        size = max(math.ceil(self._settings.window_s / self._cycle_s), 1)
        for begin in range(0, len(motion) - size + 1, size):
            rows = motion[begin : begin + size]
            commands = np.array([command[:axes] for command, _ in rows])
            answers: Array = np.full((size, axes), np.nan)
            for row, (_, answer) in zip(answers, rows, strict=True):
                if answer is not None:
                    row[:] = answer[:axes]
            window = adaptation.ServoWindow(commands, answers)
            found = adaptation.update(
                self._settings,
                self._identified,
                found,
                window,
                self._cycle_s,
                self._settings.window_s,
            )
        return found

    def keep(self, found: ServoEstimates, present: Sequence[ServoModel]) -> dict[str, float]:
        """Keep what was learned and return the parameters that it changes, by name.

        Args:
            present: the models in force.
        """
        self.learned = found
        return {
            f"control.servos.{axis}.frequency_hz": float(f"{model.frequency_hz:.6g}")
            for axis, (model, now) in enumerate(zip(found.models, present, strict=False))
            if abs(model.frequency_hz / now.frequency_hz - 1.0) > WORTH
        }
