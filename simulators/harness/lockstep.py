"""Run of plant, emulated devices and daemon cycle in virtual time.

Invariants:
    No socket and no clock, but a stopwatch if computing times are requested.
    Every datum passes as bytes through an encoder and a decoder, with its own stamp.
    One seed gives one run, to the byte.
    Cycle k begins at -lead_in + k T0; its reply takes no time.
"""

import math
import time
from collections import deque
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from linemate.daemon.core.control.settings import ControlSettings
from linemate.daemon.core.parameters import Parameters, build, with_foresight
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.daemon.core.tracking.task import TaskFile
from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.cycle.states import State
from linemate.daemon.cycle.step_log import LogEntry
from linemate.simulators.devices.emulated_world import EmulatedWorld
from linemate.simulators.devices.faults import KINDS, Faults
from linemate.simulators.devices.faulty_link import FaultyLink
from linemate.simulators.devices.robot_plant import RobotPlant
from linemate.simulators.devices.truth import TruthLog
from linemate.simulators.devices.worlds import build_world
from linemate.simulators.harness import cell_links
from linemate.simulators.harness.cell.plugins import PluginError
from linemate.simulators.harness.cell.variants import ORACLE, SetupError, change_of
from linemate.simulators.harness.sensor_links import SensorLinks
from linemate.simulators.harness.setup import Setup
from linemate.simulators.judge import rows as columns
from linemate.simulators.judge.judge import RunEvidence, StateChange, Telegrams
from linemate.simulators.judge.oracle import Oracle
from linemate.simulators.judge.rows import DaemonEvent, Rows
from linemate.simulators.plants.scenario_draw import sample
from linemate.simulators.plants.world import World

TIMELESS: dict[str, tuple[str, ...]] = {
    **{link: KINDS[link] for link in ("distance", "camera", "force_torque")},
    "robot": ("silence", "deafness", "garbage", "loss", "flip", "truncate", "ipoc_flip"),
    "reply": ("silence", "loss", "truncate"),
}
"""Faults for which an exchange that takes no time is enough; ``dst_run`` has the others."""
AFTER_COLLISION_S = 0.2

CHANGES = 1000
"""Changes of the operating state that are kept, the newest."""

OnStep = Callable[[LogEntry], None]
Change = Callable[[Parameters], Parameters]


@lru_cache(maxsize=8)
def parameters(
    task: TaskFile, urdf: str, tracking: TrackingSettings, control: ControlSettings, cycle_s: float
) -> Parameters:
    """The daemon's parameters, compiled once for all the seeds of a process.

    Raises:
        SetupError: settings, task and arm do not fit together.
    """
    try:
        return build(task, urdf, tracking, control, cycle_s)
    except ValueError as error:
        raise SetupError(str(error)) from error


def parameters_of(setup: Setup, cycle_s: float) -> Parameters:
    """The daemon's parameters of a setup, with the classifier of its variant.

    Raises:
        SetupError: settings, task and arm do not fit together, or the classifier cannot be used.
    """
    compiled = parameters(setup.task, setup.urdf, setup.tracking, setup.control, cycle_s)
    return _changed(compiled, change_of(setup.variant))


def run(
    setup: Setup, seed: int, *, timing: bool = False, on_step: OnStep | None = None
) -> RunEvidence:
    """Run one seed to its end.

    Args:
        seed: of the plant's draws.
        timing: measure computing times with the host's clock.
        on_step: given every step that the daemon made, after its reply.

    Returns:
        What the judge wants to know.

    Raises:
        SetupError: settings, task and arm do not fit together.
    """
    lockstep = Lockstep(setup, seed, timing=timing, on_step=on_step)
    while lockstep.turn():
        pass
    return lockstep.evidence()


class Lockstep:
    """One run, a telegram at a time.

    Attributes:
        controller: the pure emulated controller.
        links: sensor links to the daemon, in virtual time.
        truth: the plant's truth, a row a telegram.
    """

    def __init__(
        self,
        setup: Setup,
        seed: int,
        *,
        timing: bool = False,
        on_step: OnStep | None = None,
        change: Change | None = None,
    ) -> None:
        """Set everything up at the beginning of the lead-in.

        Args:
            change: of the compiled parameters, after that of the setup's variant.
        """
        scenario = sample(seed, setup.scenario)
        self._setup, self._scenario = setup, scenario
        self.world: EmulatedWorld = build_world(setup.world, scenario, setup.mujoco)
        self._plant = RobotPlant(self.world)
        compiled = parameters_of(setup, scenario.cycle_s)
        if setup.variant == ORACLE:
            if not isinstance(self.world, World):
                raise SetupError("the variant oracle needs a world whose future is known")
            oracle = Oracle(self.world, compiled.tracker.reference.nominal, scenario.cycle_s)
            compiled = with_foresight(compiled, oracle)
        compiled = _changed(compiled, change)
        links = cell_links.of(setup.station)
        self.controller, link = cell_links.pair(setup, self._plant, compiled)
        self.cycle = Cycle(compiled, link, links.watch, wrench_expected=links.device is not None)
        self.cycle.listen(0)
        self._faults = Faults(scenario.faults, TIMELESS)
        self._ways = tuple(
            FaultyLink(name, self._faults, scenario.seed) for name in ("robot", "reply")
        )
        mount = setup.task.conveyor.start_position
        self.links = SensorLinks(self.world, self.cycle, self._faults, mount, links)
        self._operator = _Operator(self.cycle)
        n = _count(scenario.lead_in_s + scenario.duration_s, scenario.cycle_s)
        self.truth = TruthLog(n)
        self._daemon = _DaemonLog(n)
        self._left = n
        self._timing, self._on_step = timing, on_step
        self._changes: deque[StateChange] = deque(maxlen=CHANGES)

    def turn(self) -> bool:
        """Exchange one telegram.

        Returns:
            Whether the run goes on.
        """
        self.links.carry()
        self._operator.give_order()
        data = self.controller.telegram()
        self.truth.begin(self.world, self._plant.axes)
        t = self.world.time_s
        if data is not None:
            self._exchange(data, t)
        applied = self.controller.end_of_cycle()
        self.truth.end(applied)
        self._log(t)
        self._plant.apply(applied)
        self._left -= 1
        return self._left > 0 and data is not None and not self._is_over()

    def evidence(self) -> RunEvidence:
        """What the judge wants to know of the run so far."""
        counts, collision = self.controller.counts, self.world.collision
        return RunEvidence(
            rows=_joined(self.truth, self._daemon),
            scenario=self._scenario.name,
            seed=self._scenario.seed,
            cycle_s=self._scenario.cycle_s,
            events=self._scenario.events,
            telegrams=Telegrams(
                counts.sent, counts.answered, counts.late, counts.lost, counts.refused
            ),
            limits=self.controller.config.limits,
            collision=None if collision is None else collision.reason,
            broken=self.controller.broken,
            variant=self._setup.variant,
            tolerated=self.controller.config.total_tolerated,
            changes=tuple(self._changes),
            refusal=self._operator.refusal,
            waiting=self._daemon.waiting,
        )

    def _exchange(self, data: bytes, t: float) -> None:
        """Bring a telegram to the daemon and its reply back, unless a fault is in the way."""
        stamp_ns = self.links.stamp(t)
        there, back = self._ways
        arrived = there.carry(data, t)
        if not arrived:
            self.cycle.on_missing(stamp_ns)
            return
        begun = time.perf_counter_ns() if self._timing else 0
        reply = self.cycle.on_telegram(arrived[0][1], stamp_ns)
        if self._timing:
            self._daemon.step_us = (time.perf_counter_ns() - begun) * 1e-3
        if reply is None:
            self.cycle.on_missing(stamp_ns)
        elif reply and self._faults.in_force("robot", "deafness", t) is None:
            for _, piece in back.carry(reply, t):
                self.controller.on_reply(piece, stamp_ns)

    def _log(self, t: float) -> None:
        for entry in self.cycle.take_log():
            self._daemon.note(t, entry)
            if self._on_step is not None:
                self._on_step(entry)
        for change in self.cycle.take_changes():
            change_entry = StateChange(change.before.value, change.after.value, change.cause)
            self._changes.append(change_entry)
        self._daemon.end_row()

    def _is_over(self) -> bool:
        collision = self.world.collision
        return collision is not None and self.world.time_s > collision.time_s + AFTER_COLLISION_S


def _changed(compiled: Parameters, change: Change | None) -> Parameters:
    """Return changed parameters.

    Raises:
        SetupError: a classifier or predictor of another package cannot be used.
    """
    if change is None:
        return compiled
    try:
        return change(compiled)
    except PluginError as error:
        raise SetupError(str(error)) from error


class _Operator:
    """Arms and starts the task as soon as the daemon lets it, once."""

    def __init__(self, cycle: Cycle) -> None:
        self._cycle = cycle
        self._started = False
        self.refusal: str | None = None

    def give_order(self) -> None:
        """Give the next order if it is due."""
        if self._started:
            return
        state = self._cycle.machine.state
        op = {State.IDLE: "arm", State.ARMED: "start"}.get(state)
        if op is None:
            return
        reason = self._cycle.order(op, "the run")
        self.refusal = None if reason is None else f"{op} refused: {reason}"
        self._started = op == "start" and reason is None


class _DaemonLog:
    """The daemon's word, a row a telegram; columns are made of it at the end."""

    def __init__(self, n: int) -> None:
        self.events: list[DaemonEvent] = []
        self.waiting: str | None = None
        self.step_us = math.nan
        self._values = np.full((n, _WIDTH), np.nan)
        self._codes = np.zeros((n, len(_CODES)), np.int64)
        self._row = 0

    def note(self, t: float, entry: LogEntry) -> None:
        """Take a step; only one that answered a telegram fills a row."""
        outputs = entry.outputs
        if outputs.waiting is not None:
            self.waiting = outputs.waiting
        if outputs.events:
            self.events += [DaemonEvent(t, kind, what) for kind, what in outputs.events]
        if entry.counter is None:
            return
        sensed, part = outputs.sensed, outputs.part
        self._values[self._row] = (
            *outputs.command,
            *_NO_RAIL[len(outputs.command) :],
            *outputs.target,
            *(_UNKNOWN if sensed is None else sensed),
            *(_UNKNOWN if part is None else part),
            math.nan if outputs.task_time is None else outputs.task_time,
            math.nan if outputs.speed is None else outputs.speed,
            self.step_us,
        )
        self._codes[self._row] = (
            _PHASES[outputs.phase.value],
            _CLASSES[outputs.scenario],
            outputs.scenario_state == "tentative",
            _STATES[entry.state],
            outputs.contact,
        )

    def end_row(self) -> None:
        """The telegram's row is complete."""
        self._row += 1

    def columns(self, n: int) -> dict[str, Any]:
        """The first n rows, by column."""
        values, codes = self._values[:n], self._codes[:n]
        daemon_columns: dict[str, Any] = {
            name: values[:, columns.AXES * i : columns.AXES * (i + 1)]
            for i, name in enumerate(_POSES)
        }
        daemon_columns |= dict(zip(_NUMBERS, values[:, -len(_NUMBERS) :].T, strict=True))
        for name, code in zip(_CODES, codes.T, strict=True):
            daemon_columns[name] = code.astype(np.bool_) if name in _FLAGS else code
        return daemon_columns


_POSES = ("command", "target", "sensed", "part")
_NUMBERS = ("task_time", "speed", "step_us")
_CODES = ("phase", "scenario", "tentative", "state", "contact_seen")
_FLAGS = ("tentative", "contact_seen")
_WIDTH = columns.AXES * len(_POSES) + len(_NUMBERS)
_UNKNOWN = (math.nan,) * columns.AXES
_NO_RAIL = (0.0,) * columns.AXES
"""Command of an axis that the arm does not have: E1 stays where it is."""
_PHASES = {name: i for i, name in enumerate(columns.PHASES)}
_CLASSES = {name: i for i, name in enumerate(columns.CLASSES)}
_STATES = {name: i for i, name in enumerate(columns.STATES)}


def _joined(truth: TruthLog, daemon: _DaemonLog) -> Rows:
    """Truth and the daemon's word side by side."""
    true_columns = truth.columns()
    shared: dict[str, Any] = {name: true_columns[name] for name in columns.TRUTH}
    daemon_columns = daemon.columns(len(truth))
    return Rows(events=tuple(daemon.events), **shared, **daemon_columns)


def _count(length_s: float, cycle_s: float) -> int:
    """Telegrams of a run; both ends may be a rounding error away from a whole number."""
    return max(1, round(length_s / cycle_s - 1e-6))
