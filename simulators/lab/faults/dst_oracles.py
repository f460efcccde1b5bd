"""Oracles of the fault campaign: what must hold in every run.

Invariants:
    An oracle reads and reports; it changes nothing.
    Setpoints are judged by the emulator's own judge.
    Transitions are judged by invariants written here, not by the daemon's table.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

import numpy as np

from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.cycle.states import Link, Machine, Signals, State
from linemate.daemon.cycle.step_log import LogEntry
from linemate.simulators.devices.limit_judge import LimitJudge

MOST_EVIDENCE = 5
QUIET = frozenset({State.INIT, State.IDLE, State.ARMED, State.FAULT})
RUNNING = frozenset({State.TRACK, State.CONTACT})
JERKING_S = 0.4
"""What a stop may take beyond speed over deceleration, for its jerk is limited [s]."""
STILL = 1e-9
SAME = 1e-6
"""A telegram's digits: a command that near to where the robot holds asks nothing of it [rad, m]."""
NOTABLE_A_SECOND = 40
"""Changes of state and of class in any second: each is a line in the log at most."""
MOST_BYTES = 2_000_000
"""What a daemon may remember from step to step."""
SIZED_EVERY_S = 2.0
"""How often that is looked at [s]; it costs as much as a cycle, and is done at a run's end too."""
MOST_AHEAD = 30
"""Steps beyond the cycles that the time has. Flipped counters and held-up telegrams make up to 6 in
1100 runs, and 17 in those that once failed; a clock that raced made 60 in one cycle."""


class FaultOracle:
    """Sees everything the daemon does in one run.

    Attributes:
        violations: what was found, at most ``MOST_EVIDENCE``.
        story: changes of the operating state, in order.
        now_s: scenario time of the cycle that is judged [s].
        holds: returns where the robot was sent last; a daemon that learns how much of what it sent
            was thrown away begins again from there.
        is_driven: returns whether the controller takes no commands and moves the robot by itself,
            while its packets go on. The command follows the robot then, and is not sent.
    """

    def __init__(self, cycle_s: float, braking: tuple[float, ...]) -> None:
        """Begin before the first cycle.

        Args:
            braking: what each axis stops with [rad/s^2, m/s^2].
        """
        self.violations: list[str] = []
        self.states: set[str] = set()
        self.story: list[str] = []
        self.holds: Callable[[], tuple[float, ...]] = tuple
        self.is_driven: Callable[[], bool] = bool
        self._cycle_s = cycle_s
        self._braking = braking
        self._speeds = (0.0,) * len(braking)
        self.now_s = 0.0
        self._open_orders: set[str] = set()
        self._notable: Counter[int] = Counter()
        self._command: tuple[float, ...] = ()
        self._held: tuple[float, ...] = ()
        self._session = 0
        self._resting = 0
        self._sized_s = 0.0
        self._ahead: float | None = None

    def blame(self, what: str) -> None:
        """Note a violation."""
        if len(self.violations) < MOST_EVIDENCE:
            self.violations.append(f"{what} (at {self.now_s:.3f} s)")

    def attend(self, cycle: Cycle) -> None:
        """Look at a daemon's transitions and steps from now on."""
        take_log = cycle.take_log

        def overheard() -> list[LogEntry]:
            entries = take_log()
            for entry in entries:
                self._judge_step(entry, cycle.openings)
            return entries

        cycle.operating.on_transition = self._transition
        cycle.take_log = overheard  # type: ignore[method-assign]
        self._open_orders.clear()
        self._command = ()
        self._ahead = None

    def ordered(self, op: str, cycle: Cycle, reason: str | None) -> None:
        """An operator gave an order; taken or refused with a reason."""
        if reason is None:
            self._open_orders.add(op)
        elif not reason:
            self.blame(f"order: {op} was refused without a reason")
        elif op == "stop" or (op == "retreat" and cycle.machine.state in RUNNING):
            self.blame(f"order: {op} was refused: {reason}")

    def reply(self, data: bytes) -> None:
        """A reply left the daemon: no exponent, no NaN, no Inf, one of its own size."""
        body = data.lower()
        if b"nan" in body or b"inf" in body.replace(b"info", b"") or len(data) > 2048:
            self.blame(f"reply: {data[:200]!r}")

    def judge_cycle(self, cycle: Cycle, now_s: float) -> None:
        """Judge what a daemon did in one cycle of the controller."""
        self.now_s = now_s
        self.states.add(str(cycle.machine.state))
        if cycle.log_dropped:
            self.blame("queue: steps were dropped from the log")
        if cycle.steps:
            ahead = cycle.steps - now_s / self._cycle_s
            self._ahead = ahead if self._ahead is None else self._ahead
            if ahead - self._ahead > MOST_AHEAD:
                self.blame(f"clock: {ahead - self._ahead:.0f} steps more than cycles have passed")
        if now_s - self._sized_s > SIZED_EVERY_S:
            self._sized_s = now_s
            self.size(cycle)

    def size(self, cycle: Cycle) -> None:
        """Look at how much a daemon remembers."""
        size = weigh(cycle)
        if size > MOST_BYTES:
            self.blame(f"growth: the daemon remembers {size} bytes")

    def judge(self, judge: LimitJudge) -> None:
        """Look at what was applied, when the run is over."""
        for violation in judge.evidence[:2]:
            self.blame(
                f"limits: {violation.kind} of axis {violation.axis} is {violation.value:.6g}, limit"
                f" {violation.limit:.6g}, in cycle {violation.cycle}; {judge.violations} in all"
            )
        worst = max(self._notable.values(), default=0)
        if worst > NOTABLE_A_SECOND:
            self.blame(f"log: {worst} notable events in a second")

    def _judge_step(self, entry: LogEntry, session: int) -> None:
        outputs = entry.outputs
        for name in ("command", "target", "sensed", "part"):
            values = getattr(outputs, name)
            if values is not None and not all(map(math.isfinite, values)):
                self.blame(f"finite: {name} is {values}")
        if outputs.speed is not None and not math.isfinite(outputs.speed):
            self.blame(f"finite: speed is {outputs.speed}")
        self._notable[int(self.now_s)] += len(outputs.events)
        state = State(entry.state)
        if session != self._session or len(self._command) != len(outputs.command):
            self._session, self._command, self._held = session, outputs.command, ()
        moves = [
            (new - old) / self._cycle_s
            for old, new in zip(self._command, outputs.command, strict=True)
        ]
        self._command = outputs.command
        if state not in QUIET or self.is_driven():
            self._resting, self._speeds, self._held = 0, tuple(moves), self.holds()
            return
        if not self._resting:
            self._speeds = self._braked_from()
        self._resting += 1
        needed = (abs(v) / a for v, a in zip(self._speeds, self._braking, strict=True))
        moved = max(map(abs, moves)) > STILL and not self._is_held(outputs.command)
        if moved and self._resting * self._cycle_s > JERKING_S + max(needed):
            self.blame(f"I1: motion in {state.upper()}")

    def _braked_from(self) -> tuple[float, ...]:
        """What a stop begins with: each axis as quick as its command was or as it went itself.

        A robot that stood although it was sent on, for no reply reached it, has all of the way
        before it in the cycle in which it gets replies again.
        """
        joints = zip(self._held, self.holds(), strict=False)
        applied = [abs(new - old) / self._cycle_s for old, new in joints]
        applied += [0.0] * (len(self._speeds) - len(applied))
        return tuple(max(abs(v), w) for v, w in zip(self._speeds, applied, strict=False))

    def _is_held(self, command: tuple[float, ...]) -> bool:
        held = self.holds()
        return len(held) >= len(command) and all(
            abs(a - b) < SAME for a, b in zip(command, held, strict=False)
        )

    def _transition(self, before: Machine, signals: Signals, after: Machine) -> None:
        self._take_orders(signals)
        self._persisting(signals, after)
        for name, holds in invariants(before, signals, after):
            if not holds:
                self.blame(f"{name}: {before} -> {after} on {signals}")
        if before.state is not after.state:
            self._notable[int(self.now_s)] += 1
            self.story.append(f"{self.now_s:.3f} {after.state} {after.because}")

    def _take_orders(self, signals: Signals) -> None:
        """Every accepted order is in the very next decision."""
        for op in self._open_orders:
            # A way home that has become impossible since is refused by the answer to its order.
            if not getattr(signals, op) and op != "home":
                self.blame(f"order: {op} was accepted and lost")
        self._open_orders.clear()

    def _persisting(self, signals: Signals, after: Machine) -> None:
        """I8: trouble ends tracking at once."""
        trouble = signals.overload or not (signals.position_fresh and signals.wrench_fresh)
        if trouble and after.state in RUNNING:
            self.blame(f"I8: {after.state.upper()} goes on with {signals}")


def invariants(before: Machine, s: Signals, after: Machine) -> tuple[tuple[str, bool], ...]:
    """The invariants of one transition, each with whether it holds.

    Args:
        before: where the machine stood.
    """
    a, b = before.state, after.state
    fresh = s.position_fresh and s.wrench_fresh
    fit = s.link is Link.HEALTHY and fresh and s.ready
    fit = fit and not (s.contact or s.overload or s.fault)
    acknowledged = a is State.FAULT and b is State.IDLE
    entered = a is not b
    return (
        (
            "I2",
            a is not State.FAULT
            or not entered
            or (b is State.IDLE and s.ack)
            or (b is State.RETREAT and s.contact and s.link is not Link.LOST),
        ),
        (
            "I3",
            b is not State.TRACK
            or not entered
            or (a in {State.ARMED, State.HOLD} and s.start and fit),
        ),
        ("I4", a is not State.CONTACT or not entered or s.link is Link.LOST or b is State.RETREAT),
        ("I5", s.link is not Link.LOST or b in {State.INIT, State.FAULT}),
        ("I6", acknowledged or not before.latched or after.latched),
        ("I6", acknowledged or not s.fault or after.latched),
        (
            "I11",
            b is not State.CONTACT or not entered or (a is State.TRACK and s.contact and fresh),
        ),
        ("I15", b is not State.HOME or entered <= (a is State.IDLE and s.home)),
        ("I15", b is not State.HOME or (s.link is Link.HEALTHY and s.wrench_fresh)),
        ("I15", b is not State.HOME or not (s.contact or s.overload or s.fault)),
        ("I17", b is not State.FOLLOW or entered <= (a is State.IDLE and s.follow)),
        ("I17", b is not State.FOLLOW or (s.link is Link.HEALTHY and s.wrench_fresh)),
        ("I17", b is not State.FOLLOW or not (s.contact or s.overload or s.fault)),
        ("I12", b is not State.ARMED or not entered or (a is State.IDLE and s.arm and fit)),
        ("I13", not s.stop or b not in {*RUNNING, State.ARMED, State.HOME, State.FOLLOW}),
        ("I13", not s.retreat or b not in {*RUNNING, State.ARMED, State.HOLD, State.HOME}),
        ("I13", not s.retreat or b is not State.FOLLOW),
        ("I13", not (s.stop or s.retreat) or b is not State.RETREAT or not after.programmed),
    )


_BARE = (float, int, bool, type(None))
"""Types that weigh eight bytes, looked at first: nearly everything is one of these."""
_SKIPPED = frozenset({"parameters", "codec", "on_transition", "on_step"})


def weigh(value: Any, depth: int = 0) -> int:
    """Bytes of arrays and items of collections behind a value, its slots and attributes."""
    if isinstance(value, np.ndarray):
        return int(value.nbytes)
    if isinstance(value, (str, bytes)):
        return len(value)
    if depth > 6 or value is None or isinstance(value, (bool, int, float, type)):
        return 8
    if isinstance(value, dict):
        return _weigh_all(value.values(), depth) + 8 * len(value)
    if isinstance(value, (tuple, list, set, frozenset)) or hasattr(value, "maxlen"):
        return _weigh_all(value, depth) + 8
    kind: Any = type(value)
    parts = [getattr(value, name, None) for name in _slots(kind)]
    parts += [part for name, part in getattr(value, "__dict__", {}).items() if name not in _SKIPPED]
    return _weigh_all(parts, depth) + 8


@cache
def _slots(kind: type) -> tuple[str, ...]:
    return tuple(name for name in getattr(kind, "__slots__", ()) if name not in _SKIPPED)


def _weigh_all(values: Iterable[Any], depth: int) -> int:
    return sum([8 if type(value) in _BARE else weigh(value, depth + 1) for value in values])
