"""Sequence of production: wait for the next part, arm, start, mate, retreat, go home, report.

The supervisor orders what an operator would order, through the same refusals and states. It never
acknowledges a fault.

Invariants:
- Pure: the time and what is seen are arguments, orders go out by ``CellControl``.
- It begins on hold. A hold is ended by the order ``next`` alone.
- Each part that was announced gets one result.
- One order at a time: the next one waits for the decision on the last.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Final, Protocol

from msgspec import Struct

from linemate.daemon.config.settings import ProductionSettings
from linemate.daemon.cycle.states import Machine, State
from linemate.daemon.production.object_queue import AnnouncedPart, ObjectQueue

WHO: Final = "production"
"""Operator that the log names for an order of the supervisor."""

SETTLED_DECISIONS: Final = 3  # decisions after which an order has had its effect
MOST_WAYS_HOME: Final = 3  # attempts after which the cell is put on hold
RUNNING: Final = frozenset({State.TRACK, State.CONTACT, State.RETREAT})
FIRST_HOLD: Final = "start of the daemon"


class Stage(StrEnum):
    """What is done for the present part."""

    NONE = "none"
    PREPARE = "prepare"
    MATE = "mate"


class CellView(Struct, frozen=True):
    """What the supervisor sees in one cycle.

    Attributes:
        cause: why the state was entered.
        decisions: of the operating state so far.
        reading: newest reading of the distance sensor [m], None before one.
        is_home: the robot stands at the first pose of the present task.
        stands: the robot is at rest and nothing is about to move it.
        unseen: the object was not seen since the part began.
        waiting: why the tool waits before contact, None if it does not.
    """

    stamp_ns: int
    machine: Machine
    cause: str
    decisions: int
    reading: float | None
    is_home: bool
    stands: bool
    unseen: bool = False
    waiting: str | None = None


class PartResult(Struct, frozen=True):
    """What became of a part.

    Attributes:
        reason: why it is not good, empty if it is.
    """

    part: AnnouncedPart
    is_good: bool
    reason: str


class CellControl(Protocol):
    """What the supervisor can do."""

    def refusal(self, op: str) -> str | None:
        """Return why an order would be refused now, None if it would not."""

    def order(self, op: str) -> str | None:
        """Give an order; return why it is refused, or None."""

    def begin_part(self, part: AnnouncedPart) -> None:
        """Use the task of the part's variant from now on, for a robot that stands."""

    def end_part(self, result: PartResult) -> None:
        """Take the result of a part."""


class Supervisor:
    """Brings one part after the other through the cell.

    Attributes:
        held: why no further part is begun, None while production runs.
        part: the present part, None between two.
        counts: results by ``good`` and ``bad``.
    """

    def __init__(
        self, settings: ProductionSettings, control: CellControl, starts: Mapping[str, float]
    ) -> None:
        """Begin on hold.

        Args:
            starts: ``conveyor.start_position`` by variant [m].
        """
        self.queue = ObjectQueue(settings.variants)
        self.held: str | None = FIRST_HOLD
        self.part: AnnouncedPart | None = None
        self.stage = Stage.NONE
        self.counts = {"good": 0, "bad": 0}
        self._settings = settings
        self._control = control
        self._starts = starts
        self._decisions = 0
        self._ordered_at = -SETTLED_DECISIONS
        self._ways_home = 0
        self._is_paused = False
        self._was_programmed = False
        self._trouble: str | None = None

    def position(self, part: AnnouncedPart, reading: float) -> float:
        """Return where a part is relative to the start position of its task [m]."""
        return reading - part.distance + self._settings.announced_at

    def offset(self, part: AnnouncedPart) -> float:
        """Return what makes a reading of the sensor the task's own reading for a part [m]."""
        return self._starts[part.variant] + self._settings.announced_at - part.distance

    def release(self) -> None:
        """End the hold: production goes on with the next part."""
        self.held, self._ways_home, self._is_paused = None, 0, False

    def hold(self, why: str) -> None:
        """Begin no further part. The present one is finished."""
        self.held = self.held or why

    def interrupt(self, why: str) -> None:
        """Order nothing more, for an operator has stopped the robot."""
        self.held, self._is_paused = why, True
        self._trouble = self._trouble or why

    def skip(self, part: str | None) -> str | None:
        """Let a part go, the next one if none is named; return why it is refused, or None."""
        if part is None and self.queue.next is not None:
            part = self.queue.next.part
        if part is None:
            return "no part waits"
        if self.part is not None and self.part.part == part:
            return f"part {part!r} is being assembled. Order stop or retreat."
        skipped = self.queue.remove(part)
        if skipped is None:
            return f"part {part!r} does not wait"
        self._report(skipped, "skipped by order")
        return None

    def supervise(self, view: CellView) -> None:
        """Give the order that is due in this cycle, if there is one."""
        machine, self._decisions = view.machine, view.decisions
        if machine.state is State.RETREAT:
            self._was_programmed = machine.programmed
            if not machine.programmed:
                self._trouble = self._trouble or view.cause
        if machine.state is State.FAULT:
            self._on_fault(view)
        if view.decisions - self._ordered_at < SETTLED_DECISIONS:
            return
        if self.part is not None:
            self._lead(self.part, view)
        else:
            self._let_pass(view)
            self._go_on(view)

    def _on_fault(self, view: CellView) -> None:
        """End the part, and wait for an operator."""
        if self.part is not None:
            self._finish(view.cause)
        self.hold(f"fault: {view.cause}")

    def _lead(self, part: AnnouncedPart, view: CellView) -> None:
        """Bring the present part on."""
        state = view.machine.state
        if state is State.INIT:
            self._finish(f"the robot link was lost: {view.cause}")
        elif self.stage is Stage.PREPARE:
            self._prepare(part, view)
        elif state is State.HOLD:
            self._trouble = self._trouble or _held_because(view)
            self._order("retreat")
        elif state in {State.IDLE, State.ARMED}:
            if not view.stands:
                return
            is_good = self._was_programmed and self._trouble is None
            self._finish(None if is_good else self._trouble or view.cause)
        elif state in {State.TRACK, State.CONTACT} and self._is_beyond(part, view):
            abort = self._settings.window.abort
            seen = f": {view.waiting}" if view.waiting else ""
            seen = ": the part was not seen by the camera" if view.unseen else seen
            self._trouble = f"not done {abort:g} m behind the start position{seen}"
            self._order("retreat")

    def _prepare(self, part: AnnouncedPart, view: CellView) -> None:
        """Arm and start."""
        state, reading = view.machine.state, view.reading
        if state in RUNNING:
            self.stage = Stage.MATE
            return
        due = {State.IDLE: "arm", State.ARMED: "start"}.get(state)
        reason = f"the state is {state.upper()}" if due is None else self._control.refusal(due)
        late = self._settings.window.latest_start
        if reading is not None and self.position(part, reading) > late:
            self._finish(f"not started up to {late:g} m: {reason or view.cause}")
            if state is State.ARMED:
                self._order("stop")
        elif due is not None and reason is None:
            self._order(due)
        elif state is State.IDLE and view.stands and not view.is_home:
            self._go_home()  # the variant begins elsewhere

    def _is_beyond(self, part: AnnouncedPart, view: CellView) -> bool:
        reading = view.reading
        return reading is not None and self.position(part, reading) > self._settings.window.abort

    def _let_pass(self, view: CellView) -> None:
        """Report parts that have passed without being begun."""
        part = self.queue.next
        if part is None or view.reading is None:
            return
        late = self._settings.window.latest_start
        if self.position(part, view.reading) > late:
            why = f"on hold: {self.held}" if self.held else "the robot was not ready"
            self._report(self.queue.pop_part(), f"let go at {late:g} m: {why}")

    def _go_on(self, view: CellView) -> None:
        """Bring the robot home, then begin the next part once it is near enough."""
        if self.held is not None or view.machine.state is not State.IDLE or not view.stands:
            return
        if not view.is_home:
            self._go_home()
            return
        self._ways_home = 0
        part, reading = self.queue.next, view.reading
        if part is None or reading is None:
            return
        if self.position(part, reading) >= self._settings.window.start:
            self.part, self.stage = self.queue.pop_part(), Stage.PREPARE
            self._was_programmed, self._trouble = False, None
            self._ordered_at = view.decisions
            self._control.begin_part(part)

    def _go_home(self) -> None:
        if not self._settings.goes_home or self._control.refusal("home") is not None:
            return
        if self._ways_home >= MOST_WAYS_HOME:
            self.hold(f"{MOST_WAYS_HOME} ways home have ended early")
            return
        self._ways_home += 1
        self._order("home")

    def _order(self, op: str) -> None:
        if not self._is_paused and self._control.order(op) is None:
            self._ordered_at = self._decisions

    def _finish(self, reason: str | None) -> None:
        """End the present part: good without a reason."""
        part, self.part, self.stage = self.part, None, Stage.NONE
        if part is not None:
            self._report(part, reason)

    def _report(self, part: AnnouncedPart, reason: str | None) -> None:
        self.counts["bad" if reason else "good"] += 1
        self._control.end_part(PartResult(part, not reason, reason or ""))


def _held_because(view: CellView) -> str:
    if view.unseen:
        return f"the part was not seen by the camera: {view.cause}"
    return view.cause
