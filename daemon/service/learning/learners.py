"""Learning over assemblies: what each configured learner has learned becomes parameters.

Invariants:
- A value is set while the robot stands, through the parameter service, like an operator's.
- An event says why a value that was learned is not used.
- Servo models are estimated in a thread: it takes longer than a cycle.
"""

import asyncio
import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from linemate.daemon.config.config import LoadedConfig
from linemate.daemon.config.settings_tree import Settings
from linemate.daemon.core.control.adaptation import ServoEstimates
from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.cycle.learning import part_mass, position_sensors, servos
from linemate.daemon.cycle.learning.distances import DistanceLearner
from linemate.daemon.cycle.learning.part_mass import PartLearner
from linemate.daemon.cycle.learning.servos import Learner
from linemate.daemon.cycle.learning.touches import TouchLearner
from linemate.daemon.cycle.step_log import LogEntry

log = logging.getLogger(__name__)


class Learners:
    """The learners of a daemon, each None where it is not configured.

    Args:
        cycle_s: cycle of the robot's link [s].
        settings: returns the settings in force.
        set_values: sets parameters by name, in a name; its answer may be a refusal.
        add_event: takes a line for the operator.
    """

    def __init__(
        self,
        station: LoadedConfig,
        cycle: Cycle,
        cycle_s: float,
        settings: Callable[[], Settings],
        set_values: Callable[[Mapping[str, Any], str], Any],
        add_event: Callable[[str], None],
    ) -> None:
        config = station.config
        self._cycle, self._settings = cycle, settings
        self._set_values, self._add_event = set_values, add_event
        self._servos = build_servo_learner(station, cycle_s)
        self._touches = TouchLearner() if config.learn_touches else None
        self._distances = DistanceLearner() if config.learn_distance else None
        self._parts = PartLearner() if config.learn_part_mass else None

    def learn(self, entries: Sequence[LogEntry]) -> None:
        """Look at the last steps. Once the robot stands, set what a good assembly has shown."""
        if self._servos is not None:
            self._servos.record_motion(entries)
        if self._distances is not None:
            self._distances.record_motion(entries)
        if self._touches is not None:
            self._touches.record_touch(entries)
        if self._parts is not None:
            self._parts.record_weight(entries)
        if not self._cycle.stands:
            return
        if self._servos is not None and self._servos.ripe:
            self._estimate_servos(self._servos)
        tracking = self._settings().tracking
        shown = position_sensors.learned(self._distances, self._touches, tracking)
        for who, what, values in shown:
            self._keep(values, who, what)
        if self._parts is not None and self._parts.mass is not None:
            values = self._parts.keep(tracking.payload)
            self._keep(values, part_mass.WHO, "what the part weighs")

    def _estimate_servos(self, learner: Learner) -> None:
        """Estimate the servo models from a motion, in a thread."""
        work = asyncio.get_running_loop().run_in_executor(
            None, learner.estimate_servos, learner.motion()
        )

        def done(finished: asyncio.Future[ServoEstimates]) -> None:
            if finished.cancelled():
                return
            error = finished.exception()
            if error is not None:
                log.error("servo models are not estimated: %s", error)
                return
            values = learner.keep(finished.result(), self._settings().control.servos)
            self._keep(values, servos.WHO, "the estimate of the servo models")

        work.add_done_callback(done)

    def _keep(self, values: Mapping[str, Any], who: str, what: str) -> None:
        """Set values by name, in the name of ``who``; an event says why they are not used."""
        answer = self._set_values(values, who) if values else {}
        if isinstance(answer, dict) and "refused" in answer:
            self._add_event(f"{what} is not used: {answer['refused']}")


def build_servo_learner(station: LoadedConfig, cycle_s: float) -> Learner | None:
    """Return the estimator of servo models, None without one.

    Production compiles each variant at start: no servo model changes before a restart.
    """
    settings = station.config.learning
    if settings is None or station.config.production is not None:
        return None
    axes = 7 if station.task.file.arm.linear_axis else 6
    return Learner(settings, station.written.control.servos[:axes], cycle_s)
