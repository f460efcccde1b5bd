"""Detection benchmark: a classifier with conveyor and sensors only, for hours.

Kinds: ``free`` (distance sensor), ``contact`` (and force), ``restart`` (a start before the stop
has ended), ``jerk`` and ``push`` (an impulse on the body; the conveyor does not stop).

Invariants:
    Plant's conveyor, sensors and body on one side, the daemon's classifier on the other.
    No robot and no wire: an hour takes half a minute.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import count, pairwise
from typing import Any, Literal

from linemate.daemon.core.tracking.conveyor import Classifier, PositionMeasurement, Source
from linemate.daemon.core.tracking.estimation.estimate import FIRST_READINGS, FIRST_SPREAD
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.simulators.harness.setup import Setup
from linemate.simulators.judge.judge import attribute
from linemate.simulators.judge.rows import DaemonEvent
from linemate.simulators.plants.body import BodyPlant
from linemate.simulators.plants.conveyor_plan import AppliedEvent, ConveyorEvent, applied_events
from linemate.simulators.plants.conveyor_plant import ConveyorPlant
from linemate.simulators.plants.scenario import Body, Jerk, Scenario
from linemate.simulators.plants.scenario_draw import sample
from linemate.simulators.plants.sensors import DistanceSensorPlant, ForceTorquePlant
from linemate.simulators.plants.streams import stream

Kind = Literal["free", "contact", "restart", "jerk", "push"]
KINDS: tuple[Kind, ...] = ("free", "contact", "restart", "jerk", "push")
TOUCHED: tuple[Kind, ...] = ("contact", "jerk", "push")
"""Kinds in which the tool is on the hub, so that the force-torque sensor takes part."""

LEAD_IN_S = 4.0
"""Nothing counts before: a classifier that has just begun settles."""

RUNNING_S = (15.0, 45.0)
STANDING_S = (8.0, 25.0)
BRAKING_S = (0.20, 0.90)
"""Spans that the onsets of a run are drawn from; restarts come this long after a stop's onset."""

PUSHED_S = (10.0, 14.0)
PUSH_M = (0.5e-3, 3.0e-3)
PUSH_S = (1.5, 4.0)
JERK_HZ = (1.2, 1.8)
JERK_DAMPING = (0.10, 0.20)
TAKEN_S = 4.0
"""A stop confirmed this soon after a push began counts as the push's."""

_TINY = 1e-9
_ORIGIN = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class DetectionRun:
    """One stretch of virtual time.

    Attributes:
        setup: truth and settings; its robot and camera stay at home.
        duration_s: of the stretch, lead-in excluded [s].
    """

    kind: Kind
    setup: Setup
    seed: int
    duration_s: float


@dataclass(slots=True)
class Tally:
    """What came of one run, or of many.

    Attributes:
        perceived, confirmed: latencies [s] by "stop" and "start"; infinity where missed.
        seconds: watched, by what the conveyor was last ordered: "running" or "standing" [s].
        false: alarms by (kind, what): stops while running, starts while standing.
        corrections: what a false alarm or a missed event made necessary later.
        pushed: pushes that were made, suspected and taken for a stop.
    """

    perceived: dict[str, list[float]] = field(default_factory=lambda: {"stop": [], "start": []})
    confirmed: dict[str, list[float]] = field(default_factory=lambda: {"stop": [], "start": []})
    seconds: dict[str, float] = field(default_factory=lambda: {"running": 0.0, "standing": 0.0})
    false: Counter[tuple[str, str]] = field(default_factory=Counter)
    corrections: int = 0
    pushed: Counter[str] = field(default_factory=Counter)

    def add(self, other: "Tally") -> None:
        """Add another run of the same kind."""
        for kind in self.perceived:
            self.perceived[kind] += other.perceived[kind]
            self.confirmed[kind] += other.confirmed[kind]
        for state, watched_s in other.seconds.items():
            self.seconds[state] += watched_s
        self.false.update(other.false)
        self.corrections += other.corrections
        self.pushed.update(other.pushed)


def run(spec: DetectionRun) -> Tally:
    """Run the classifier once.

    Raises:
        SetupError: settings and task do not fit together.
    """
    from linemate.simulators.harness.lockstep import parameters_of

    setup = spec.setup
    scenario = sample(spec.seed, setup.scenario)
    pushes: list[Push] = []
    if spec.kind in {"jerk", "push"}:
        pushes = list(_pushes(spec))
        events: tuple[ConveyorEvent, ...] = ()
    else:
        events = tuple(_orders(spec, scenario))
    conveyor = replace(scenario.conveyor, events=events)
    scenario = replace(scenario, conveyor=conveyor)
    compiled = parameters_of(setup, scenario.cycle_s)
    station = _DetectionStation(scenario, setup.tracking, pushes, touched=spec.kind in TOUCHED)
    events_seen = list(_watch(compiled.tracker.classifier, station, spec.duration_s))
    return _tally(events_seen, applied_events(conveyor), pushes, spec.duration_s)


# What happens


@dataclass(frozen=True, slots=True)
class Push:
    """Somebody moves the body along the conveyor.

    Attributes:
        way: how far the body is along the conveyor [m], at a time [s].
    """

    onset_s: float
    way: Callable[[float], float]


def _orders(spec: DetectionRun, scenario: Scenario) -> Iterator[ConveyorEvent]:
    """Order stops and starts at random, at the accelerations of the scenario's own."""
    rates = {"stop": 0.104, "start": 0.013}
    rates.update({event.kind: event.acceleration for event in reversed(scenario.conveyor.events)})
    draws = stream(spec.seed, f"drill.{spec.kind}.orders")
    speed_up = scenario.conveyor.nominal_speed / rates["start"]
    t, end = 0.0, spec.duration_s
    while True:
        t += float(draws.uniform(*RUNNING_S))
        standing = float(draws.uniform(*(BRAKING_S if spec.kind == "restart" else STANDING_S)))
        # An event within the last seconds would have no time to be found.
        if t + standing + speed_up > end:
            return
        yield ConveyorEvent("stop", t, rates["stop"])
        t += standing
        yield ConveyorEvent("start", t, rates["start"])
        t += speed_up


def _pushes(spec: DetectionRun) -> Iterator[Push]:
    draws = stream(spec.seed, f"drill.{spec.kind}.pushes")
    t = 0.0
    while True:
        t += float(draws.uniform(*PUSHED_S))
        size = float(draws.uniform(*PUSH_M)) * (1.0 if draws.random() < 0.5 else -1.0)
        if t + TAKEN_S > spec.duration_s:
            return
        if spec.kind == "jerk":
            shape = float(draws.uniform(*JERK_HZ)), float(draws.uniform(*JERK_DAMPING))
            yield Push(t, _jerked(Jerk(t, (0.0, size, 0.0), *shape)))
        else:
            yield Push(t, _leaned(t, size, float(draws.uniform(*PUSH_S))))


def _jerked(jerk: Jerk) -> Callable[[float], float]:
    body = BodyPlant(Body(_ORIGIN, offset=_ORIGIN, rotation=_ORIGIN, swings=(), jerks=(jerk,)))
    return lambda t: body.hub(0.0, t)[0][1]


def _leaned(onset_s: float, size: float, length_s: float) -> Callable[[float], float]:
    """Somebody leans on the body and lets go: a raised cosine."""

    def way(t: float) -> float:
        share = min(max((t - onset_s) / length_s, 0.0), 1.0)
        return size * 0.5 * (1.0 - math.cos(math.tau * share))

    return way


# What is measured


class _DetectionStation:
    """Conveyor, pushed body and the two sensors, step by step."""

    def __init__(
        self, scenario: Scenario, tracking: TrackingSettings, pushes: list[Push], *, touched: bool
    ) -> None:
        seed, begin, T0 = scenario.seed, -LEAD_IN_S, scenario.cycle_s
        self.begin_s, self.cycle_s = begin, T0
        self._tracking, self._touched = tracking, touched
        self._conveyor = ConveyorPlant(scenario.conveyor, seed, begin)
        self._distance = DistanceSensorPlant(scenario.distance, seed, begin, T0)
        # One reading a step, of the noise that the study gave a step.
        sensor = replace(scenario.force_torque, period_s=T0)
        self._force = ForceTorquePlant(sensor, scenario.effector, seed, begin)
        self._stiffness = scenario.effector.stiffness[1]
        self._pushes, self._next = pushes, 0
        self._way: Callable[[float], float] | None = None

    def rows(self, now_s: float) -> list[PositionMeasurement]:
        """Return what has arrived since the last step, as the tracker makes rows of it."""
        clock = self._distance.clock
        while clock.next_s < now_s + _TINY:
            self._distance.measure(self._conveyor.at(clock.next_s)[0])
        collected = []
        noise, due = self._tracking.distance, self._distance.due
        while due and due[0].time_s <= now_s + _TINY:
            seen = due.popleft()
            delay = now_s - seen.time_s + noise.delay
            variance = noise.deviation**2
            collected.append(
                PositionMeasurement(Source.DISTANCE, seen.position, delay, variance, noise.gate)
            )
        return collected + self._touch(now_s) if self._touched else collected

    def _touch(self, now_s: float) -> list[PositionMeasurement]:
        clock = self._force.clock
        while clock.next_s < now_s + _TINY:
            y = self._conveyor.at(clock.next_s)[0] + self._pushed(clock.next_s)
            self._force.measure((0.0, y, 0.0, 0.0, 0.0, 0.0))
        touches = []
        variance, gate = self._tracking.tactile.deflection**2, self._tracking.camera.gate
        due = self._force.due
        while due and due[0].time_s <= now_s + _TINY:
            felt = due.popleft()
            y = felt.force[1] / self._stiffness
            touches.append(
                PositionMeasurement(Source.TACTILE, y, now_s - felt.time_s, variance, gate)
            )
        return touches

    def _pushed(self, t: float) -> float:
        while self._next < len(self._pushes) and self._pushes[self._next].onset_s <= t:
            self._way = self._pushes[self._next].way
            self._next += 1
        return 0.0 if self._way is None else self._way(t)


def _watch(
    classifier: Classifier, station: _DetectionStation, duration_s: float
) -> Iterator[DaemonEvent]:
    """Step the classifier through the run and yield its events."""
    state: Any = None
    readings: list[float] = []
    for k in count(1):
        now_s = station.begin_s + k * station.cycle_s
        if now_s > duration_s:
            return
        rows = station.rows(now_s)
        if state is None:
            # As the tracker begins: some readings that agree, against an outlier first.
            heard = [row.value for row in rows if row.source is Source.DISTANCE]
            readings = [*readings, *heard][-FIRST_READINGS:]
            if len(readings) == FIRST_READINGS and max(readings) - min(readings) < FIRST_SPREAD:
                state = classifier.initial(readings[-1])
            continue
        state = classifier.advance(state, rows, station.cycle_s)
        for kind, what in classifier.estimate(state).events:
            yield DaemonEvent(now_s, kind, what)


# What came of it


def _tally(
    events_seen: list[DaemonEvent],
    events: tuple[AppliedEvent, ...],
    pushes: list[Push],
    duration_s: float,
) -> Tally:
    tally = Tally()
    events_seen = [event for event in events_seen if event.t >= 0.0]
    entries, idle = attribute(events_seen, events)
    for entry in entries:
        for name, onsets in (("perceived_s", tally.perceived), ("confirmed_s", tally.confirmed)):
            value = entry[name]
            onsets[entry["event"]].append(math.inf if value is None else value)
    edges = [0.0, *(event.onset_s for event in events), duration_s]
    for i, (begin, end) in enumerate(pairwise(edges)):
        tally.seconds["standing" if i % 2 else "running"] += end - begin
    own = {"running": "stop", "standing": "start"}
    for event in idle:
        if event.what == "cancelled":
            continue
        state = "standing" if sum(e.onset_s <= event.t for e in events) % 2 else "running"
        if own[state] == event.kind:
            tally.false[event.kind, event.what] += 1
        else:
            tally.corrections += 1
    for push in pushes:
        words = {
            event.what
            for event in events_seen
            if event.kind == "stop" and push.onset_s <= event.t < push.onset_s + TAKEN_S
        }
        tally.pushed["made"] += 1
        tally.pushed["suspected"] += bool(words & {"tentative", "confirmed"})
        tally.pushed["taken"] += "confirmed" in words
    return tally
