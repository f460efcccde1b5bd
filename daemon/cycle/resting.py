"""Orders of operators, and the rest while a robot stands idle: replies, but no steps.

A telegram that brings nothing new gets the reply that holds the robot. Sensor health, watches and
states are judged every ``LOOK_S``. Anything else ends the rest, and the step is made.

Invariants:
- A rest begins in IDLE alone, with a proven command and a robot that stands.
- After a rest the step's state begins again, as in a new session. The robot is moved only after
  ``SETTLE_S`` of steps, because the first estimates are off by millimetres.
"""

from typing import Any

from msgspec import Struct

from linemate.daemon.core import step as stepping
from linemate.daemon.core.followed_poses import Chunk
from linemate.daemon.cycle.session import Axes, standing
from linemate.daemon.cycle.states import Link, State
from linemate.daemon.cycle.steps import Stepper
from linemate.protocol.controller_link import ControllerTelegram, PreparedReply
from linemate.protocol.exchange import TelegramDecision, TelegramKind
from linemate.protocol.stamped_samples import RobotSample

LOOK_S = 0.05  # between two looks at sensors and watches in a rest [s]
SETTLE_S = 2.0  # of steps after a rest, until its estimates are those of a daemon without one [s]
STILL = 5e-4  # an axis that has moved farther ends the rest [rad, m]

_AFTER_SETTLING = frozenset({"arm", "home", "follow"})
_MOVES = _AFTER_SETTLING | {"start"}


class Rest(Struct, frozen=True):
    """What holds the robot during a rest, and how its telegrams look.

    Attributes:
        reply: to every telegram, without its counter.
        robot: the telegram before the rest.
        axes: where it says that the axes are.
    """

    reply: PreparedReply
    command: Axes
    robot: RobotSample
    axes: Axes


class RestingStepper(Stepper):
    """Makes no steps for a robot that stands idle, between ``begin_rest`` and ``end_rest``.

    Attributes:
        rested: telegrams answered without a step.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.rested = 0
        self._rest_now: Rest | None = None
        self._owes_reply = False
        self._looked_ns = 0
        self._settled_step = 0

    @property
    def is_resting(self) -> bool:
        """Whether telegrams are answered without steps."""
        return self._rest_now is not None

    @property
    def settles_s(self) -> float:
        """Time of steps until the robot may be moved after a rest [s], 0 without one."""
        if self.is_resting:
            return SETTLE_S
        return max(0, self._settled_step - self.steps) * self.parameters.cycle_s

    def refusal(self, op: str) -> str | None:
        """Return why an operator's order is refused now, None if it is not.

        Args:
            op: arm, start, stop, retreat, ack or home.
        """
        if op in _MOVES and self.session.unproven is not None:
            return self.session.unproven
        return self.operating.refusal(op, self._situation()) or self._unsettled(op)

    def order(self, op: str, who: str = "") -> str | None:
        """Accept an operator's order for the next step; return why it is refused, or None.

        Args:
            op: arm, start, stop, retreat, ack or home.
        """
        reason = self.refusal(op)
        return self.operating.order(op, self._situation(), who) if reason is None else reason

    def hand_in(self, chunk: Chunk, who: str = "") -> str | None:
        """Accept target poses for the next step; return why they are refused, or None.

        The first chunk orders a robot that stands idle to follow.

        Args:
            chunk: monotonic time [ns], position [m] and quaternion of each pose, in base.
        """
        state, begins = self._state, self.machine.state is not State.FOLLOW
        reason = self.refusal("follow") if begins else self.session.unproven
        if reason is not None or state is None:
            return reason or "no telegram has come yet"
        if begins and (state.moving or state.tracker.contact or state.tracker.clamped):
            return "the robot still moves" if state.moving else "the tool is on the object"
        reason = self._poses.add(state, chunk, self._stamp_ns, self.parameters)
        return self.order("follow", who) if reason is None and begins else reason

    def _unsettled(self, op: str) -> str | None:
        wait_s = self.settles_s
        if op not in _AFTER_SETTLING or wait_s <= 0.0:
            return None
        return (
            f"the estimates are not settled after a rest: {wait_s:.1f} s left. "
            f"Order {op} again after that"
        )

    def begin_rest(self) -> bool:
        """Make no more steps from now on; return whether that is possible.

        To be called after the reply to a telegram.
        """
        last, robot = self.last, self._robot
        if last is None or robot is None or self._ready is not None or not self._may_rest():
            return False
        axes = self._axes(robot)
        self._rest_now = Rest(self._reply(last), last.outputs.command, robot, axes)
        self._looked_ns = robot.stamp_ns
        return True

    def end_rest(self) -> None:
        """Make steps again, with a new state where the robot holds."""
        if self._rest_now is None:
            return
        state, robot = self._opened(), self._robot or self._rest_now.robot
        self._rest_now = None
        if robot.stamp_ns > self._looked_ns:
            # Else the silence would be counted from the last look.
            self._judge(robot.stamp_ns)
        position = standing(robot, self.session.held)
        self._state = stepping.initial(self.parameters, position, state)
        self._plan = self._given = None
        self._settled_step = self.steps + round(SETTLE_S / self.parameters.cycle_s)

    def _restart(self, robot: RobotSample, held: Axes) -> None:
        self._rest_now = None
        super()._restart(robot, held)

    def _may_rest(self) -> bool:
        """Return whether nothing moves, nothing is to come, and the robot has its command."""
        state, last, session = self._state, self.last, self.session
        if state is None or last is None or self.machine.latched:
            return False
        is_idle = self.machine.state is State.IDLE and self.stands
        if not is_idle or self._settled_step > self.steps:
            return False
        tracker = state.tracker
        if tracker.started or tracker.contact or tracker.clamped or last.outputs.digital_out:
            return False
        is_proven = session.was_sent and not session.was_lost and not session.is_interrupted
        is_held = last.outputs.command == session.held and self._plan is not None
        return is_proven and is_held and self._is_quiet()

    def _is_quiet(self) -> bool:
        """Return whether the link is healthy and nothing waits for the next decision or step."""
        operating, session, following = self.operating, self.session, self.following
        return not (
            operating.has_new_session
            or operating.has_resynchronised
            or operating.is_reply_lost
            or operating.has_failed
            or operating.wrong_cycle is not None
            or self._new_parameters is not None
            or following.error is not None
            or operating.signals.link is not Link.HEALTHY
            or not operating.rests
            or (session.held == session.reference and not following.is_resting)
        )

    def _end_rest_by(
        self, rest: Rest, telegram: ControllerTelegram, decision: TelegramDecision
    ) -> None:
        """End the rest if a telegram is not the ordinary next one of a robot that stands."""
        is_next = decision.kind is TelegramKind.NORMAL and decision.steps == 1
        is_ordinary = is_next and not decision.missed and telegram.unready is None
        robot, before = telegram.robot, rest.robot
        is_same = robot.delay == before.delay and robot.digital_in == before.digital_in
        pairs = zip(self._axes(robot), rest.axes, strict=True)
        is_still = all(abs(now - then) <= STILL for now, then in pairs)
        if not (is_ordinary and is_same and is_still and self._is_quiet()):
            self.end_rest()

    def looks_at(self, stamp_ns: int) -> bool:
        """Return whether sensors and watches are judged at a telegram of a rest [ns]."""
        return stamp_ns - self._looked_ns >= round(1e9 * LOOK_S)

    def _goes_on(self, stamp_ns: int) -> bool:
        """Judge sensors and watches if it is time, and return whether the rest goes on."""
        if self.looks_at(stamp_ns):
            self._judge(stamp_ns)
            if self.machine.state is not State.IDLE or not self._is_quiet():
                self.end_rest()
        return self.is_resting

    def _judge(self, stamp_ns: int) -> None:
        """Decide the operating state as in a step with a telegram [ns]."""
        self._looked_ns = self._stamp_ns = stamp_ns
        self._drain_samples(self._opened())
        self.operating.decide(stamp_ns, self.samples, self._situation(), telegram=True)
