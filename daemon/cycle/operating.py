"""Operating state between two steps: gathers facts and orders, and decides what may be done next.

Invariants:
- ``watch`` applies time-outs and debounce to the facts, ``states`` decides.
- An event or an order counts until the next decision, no longer.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from msgspec import Struct, structs

from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core.step_state import Outputs, Pose
from linemate.daemon.core.tracking.task import Phase
from linemate.daemon.cycle import causes, states, watch
from linemate.daemon.cycle.causes import Change, Evidence
from linemate.daemon.cycle.sensing.samples import SensorQueues
from linemate.daemon.cycle.states import Machine, Signals, State

OnTransition = Callable[[Machine, Signals, Machine], None]

SETTLED = 0.3  # a retreat is over when no axis is quicker [rad/s, m/s]; it may follow the object
BRAKING = 1.0  # least deceleration of a tool that stops [m/s^2]
LEADING_S = 0.12  # a stopping tool follows its plan for this time: commands lead, jerk is limited
STANDING = 0.01  # speed up to which an object stands [m/s]
SETTLING = "the robot has not come to rest yet since its programme began"
NEAR = frozenset({State.TRACK, State.HOLD, State.RETREAT})
"""States in which it matters what a stop would leave between tool and object."""

SEEING = frozenset({State.IDLE, State.ARMED, State.TRACK})
"""States in which a camera that contradicts the estimate counts."""

CHANGES = 64
"""Changes that wait to be read; the oldest is dropped."""

_AT_REST = frozenset({State.INIT, State.IDLE, State.HOLD, State.FAULT})


class Situation(Struct, frozen=True, eq=False):
    """The robot and the task at a decision.

    Attributes:
        last, before: outputs of the last two steps; None before there were any.
        following_error: axis beyond the tolerance, in words; None if there is none.
        settling: the robot may still move although it was not sent anywhere yet.
        sensed: poses lead the motion, and not its programme alone.
        longest_wait_s: that the task allows before contact [s].
        last_approach: the tool has left its last waypoint before contact; the camera, which soon
            sees nothing any more, is not waited for.
        closing: the tool is so near to its touch that a wait cannot prevent it any more.
        home: why the robot cannot go home from where it is, None if it can.
        declined: why telegrams get no setpoint and what to do, None if they get one.
    """

    last: Outputs | None
    before: Outputs | None
    following_error: str | None
    settling: bool
    sensed: bool
    longest_wait_s: float = math.inf
    last_approach: bool = False
    closing: bool = False
    home: str | None = "not looked at"
    declined: str | None = None


class Operating:
    """Decides what the daemon may do.

    Attributes:
        machine: where the operating state stands.
        signals: what the last decision saw.
        on_transition: called with every decision.
        has_new_session: event: the robot's program has started again.
        has_resynchronised: event: the counter or the address has changed, the program goes on.
        is_reply_lost: event: a reply has not reached the robot.
        has_failed: event: what was begun raised.
        unled_s: event: the robot had no setpoint for so long [s].
        wrong_cycle: why the controller's period cannot be followed, None if it can.
        cause: why the present state was entered.
        fault: the cause of the latched fault, None without one.
    """

    def __init__(self, settings: WatchSettings, cycle_s: float, *, wrench_expected: bool) -> None:
        """Wait for the first telegram.

        Args:
            wrench_expected: there is a force-torque sensor.
        """
        self.machine = Machine()
        self.signals = Signals()
        self.settings = settings
        self.on_transition: OnTransition | None = None
        self.has_new_session = self.has_resynchronised = False
        self.is_reply_lost = self.has_failed = False
        self.unled_s = 0.0
        self.wrong_cycle: str | None = None
        self._cycle_s = cycle_s
        self._wrench_expected = wrench_expected
        self._watch = watch.Watch()
        self.cause = self.machine.because
        self.fault: str | None = None
        self.decisions = 0
        self._orders: dict[str, str] = {}  # operators by order
        self._changes: deque[Change] = deque(maxlen=CHANGES)
        self._settled: Machine | None = None  # the last signals led nowhere from there
        self._seen: tuple[watch.Facts, SensorQueues, Situation] | None = None

    def refusal(self, op: str, situation: Situation) -> str | None:
        """Return why an operator's order is refused now, None if it is not.

        Args:
            op: arm, start, stop, retreat, ack or home.
            situation: what keeps a robot from being armed is named before what follows from it.
        """
        reason = states.refusal(self.machine, self.signals, op)
        if self._seen and reason and reason == states.unfit(self.signals):
            reason = causes.refusal(reason, self.signals, self._evidence(*self._seen, {}))
        if reason is not None and op == "arm" and situation.last is not None:
            reason = situation.last.ready or (SETTLING if situation.settling else reason)
        if reason is None and op == "home":
            reason = _home_refusal(situation)
        if reason is None and op == "follow" and situation.settling:
            reason = SETTLING
        return reason

    def order(self, op: str, situation: Situation, who: str = "") -> str | None:
        """Take an operator's order for the next decision.

        Args:
            op: arm, start, stop, retreat, ack or home.
            situation: the robot and the task.

        Returns:
            None, or why it is refused.
        """
        reason = self.refusal(op, situation)
        if reason is None:
            self._orders[op] = who
        return reason

    @property
    def rests(self) -> bool:
        """Whether nothing is about to move the robot."""
        return self.machine.state in _AT_REST and not self._orders

    def decide(
        self, stamp_ns: int, samples: SensorQueues, situation: Situation, *, telegram: bool
    ) -> None:
        """Move the operating state on what was seen up to now.

        Args:
            situation: the robot and the task.
            telegram: the step is made for one.
        """
        before = self.machine
        facts = self._facts(stamp_ns, samples, situation, telegram=telegram)
        self._seen = (facts, samples, situation)
        orders = self._orders
        self._orders = {}
        self.decisions += 1
        self.has_new_session = self.has_resynchronised = False
        self.is_reply_lost = self.has_failed = False
        self.unled_s = 0.0
        seen = self.signals
        self._watch, self.signals = watch.observe(self._watch, facts, before, self.settings)
        # Where the same signals led nowhere a cycle ago, they lead nowhere now.
        if before is not self._settled or self.signals is not seen:
            self.machine = states.transition(before, self.signals)
            self._settled = self.machine if self.machine is before else None
            if self.machine is not before:
                self._note_change(before, self._evidence(facts, samples, situation, orders))
        if self.on_transition is not None:
            self.on_transition(before, self.signals, self.machine)

    def take_changes(self) -> list[Change]:
        """Return the changes since the last call, oldest first."""
        if not self._changes:
            return []
        changes = list(self._changes)
        self._changes.clear()
        return changes

    def _note_change(self, before: Machine, evidence: Evidence) -> None:
        """Keep why the machine changed."""
        after, signals = self.machine, self.signals
        if signals.fault and not before.latched:
            self.fault = causes.fault(signals, evidence)
            evidence = structs.replace(evidence, fault=self.fault)
            before = replace(before, latched=True)
        row = states.deciding_row(before, signals)
        why = f"latched: {self.fault}"
        if row is not None:
            why = self.cause = causes.cause(row, before, signals, evidence)
        if after.latched and self.fault is None:
            self.fault = why
        elif not after.latched:
            self.fault = None
        self._changes.append(Change(evidence.facts.stamp_ns, before.state, after.state, why))

    def _evidence(
        self,
        facts: watch.Facts,
        samples: SensorQueues,
        situation: Situation,
        orders: dict[str, str],
    ) -> Evidence:
        last = situation.last
        return Evidence(
            facts,
            self._watch,
            self.settings,
            samples.facts(),
            waiting=None if last is None else last.waiting,
            unready=SETTLING if situation.settling else None if last is None else last.ready,
            following_error=situation.following_error,
            overload_n=samples.overload_n,
            swinging_n=None if last is None else last.swinging_n,
            unanswered_n=None if last is None else last.unanswered_n,
            ordered_by=orders,
            fault=self.fault,
            declined=situation.declined,
        )

    def _facts(
        self, stamp_ns: int, samples: SensorQueues, situation: Situation, *, telegram: bool
    ) -> watch.Facts:
        """Return what was seen up to now, for the watch."""
        # A link that carries telegrams but no replies is no link.
        telegram = telegram and not self.is_reply_lost
        last = situation.last
        if last is None:
            return watch.Facts(
                stamp_ns,
                telegram,
                self.unled_s,
                self.has_new_session,
                self.has_resynchronised,
                self.wrong_cycle,
                position_ns=samples.newest_ns,
                wrench_ns=samples.wrench.newest_ns,
                wrench_expected=self._wrench_expected,
                overload=samples.overloaded,
                fault=self.has_failed,
                orders=frozenset(self._orders),
            )
        before, period, state = situation.before or last, self._cycle_s, self.machine.state
        # No pose fits a motion that poses lead. An exercise, led by its program alone, goes on: it
        # is there to find out what does not fit.
        # Nor does a motion begin with it: it was started and held in the next cycle.
        contradicted = state in SEEING and samples.camera_health.contradicts and situation.sensed
        # In the last approach the camera goes blind: the distance sensor alone shows the object.
        lost = state is State.TRACK and situation.last_approach
        lost = lost and samples.distance_health.reason is not None
        has_no_end = last.swinging_n is not None or last.unanswered_n is not None
        return watch.Facts(
            stamp_ns=stamp_ns,
            telegram=telegram,
            unled_s=self.unled_s,
            new_session=self.has_new_session,
            wrong_cycle=self.wrong_cycle,
            resynchronised=self.has_resynchronised,
            position_ns=samples.newest_ns,
            slower_ns=_slower_ns(samples, last, last_approach=situation.last_approach),
            wrench_ns=samples.wrench.newest_ns,
            wrench_expected=self._wrench_expected,
            contradicted=contradicted,
            distance_lost=lost,
            gap_m=_gap(last, period, state),
            following_error=situation.following_error is not None,
            ready=last.ready is None and not situation.settling,
            object_left=last.object_left,
            contact=last.contact,
            clamped=last.clamped,
            closing=situation.closing,
            settling=situation.settling,
            outwaited=situation.longest_wait_s < (last.waited_s or 0.0),
            overdue=last.overdue,
            overload=samples.overloaded or has_no_end,
            done=last.phase is Phase.RETREAT,
            fault=self.has_failed,
            home_blocked=_home_refusal(situation) is not None,
            clear=last.finished and max_axis_speed(before, last, period) < SETTLED,
            orders=frozenset(self._orders),
        )


def _home_refusal(situation: Situation) -> str | None:
    """Return why the robot cannot go home from where it is, None if it can."""
    if situation.last is None:
        return "no step was made yet"
    return SETTLING if situation.settling else situation.home


def _slower_ns(samples: SensorQueues, last: Outputs, *, last_approach: bool) -> int | None:
    """Return the stamp of the position sensor that must not be silent for long [ns], or None."""
    if (last.task_time or 0.0) <= 0.0:
        return None
    return samples.distance.newest_ns if last_approach else samples.slower_ns


def max_axis_speed(before: Outputs, now: Outputs, period: float) -> float:
    """Return the speed of the fastest axis from one step to the next [rad/s, m/s]."""
    moved = zip(before.command, now.command, strict=True)
    return max(abs(b - a) for a, b in moved) / period


def _gap(now: Outputs, period: float, state: State) -> float | None:
    """Return what a stop leaves between tool and object [m], None while it is of no matter."""
    approaches = state is State.FAULT and abs(now.speed or 0.0) > STANDING
    return gap_after_stop(now, period) if approaches or state in NEAR else None


def gap_after_stop(now: Outputs, period: float) -> float | None:
    """Return what a stop would leave between tool and object [m], None while it is not seen.

    Along the tool's axis alone: an object that goes on sideways passes the tool in all its width.
    Commands lead the tool. So it follows its plan for a while before it slows down.

    Args:
        now: outputs of the last step.
        period: of the steps [s].
    """
    if now.part is None:
        return None
    distance = _ahead(now.target, now.part)
    if now.horizon is None:
        return distance
    depth = now.horizon.item
    n = min(max(1, round(LEADING_S / period)), len(now.horizon) - 1)
    reached = depth(n, 2)
    speed = max(0.0, (reached - depth(n - 1, 2)) / period)
    return distance - (reached - depth(0, 2)) - speed * speed / (2.0 * BRAKING)


def _ahead(tool: Pose, part: Pose) -> float:
    """Return how far ahead of a tool a part is, along the tool's own z [m]."""
    px, py, pz, w, x, y, z = tool
    ax, ay, az = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
    return (part[0] - px) * ax + (part[1] - py) * ay + (part[2] - pz) * az
