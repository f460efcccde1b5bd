"""Cyclic exchange, controller's side: number the telegrams and judge the replies.

Invariants:
    A late reply, a wrong counter and an unreadable reply are the same as no reply.
    Stamps and deadlines are arguments.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

HISTORY = 100  # cycles remembered, to distinguish late replies from duplicates


class Judgement(StrEnum):
    """Judgement of a reply, or of a cycle at its end."""

    ACCEPTED = "accepted"
    LATE = "late"
    DUPLICATE = "duplicate"
    WRONG_COUNTER = "wrong_counter"
    REFUSED = "refused"
    MISSING = "missing"


class ControllerState(StrEnum):
    """State of the exchange."""

    BETWEEN = "no cycle open"
    WAITING = "telegram sent, no good reply yet"
    ANSWERED = "the cycle's reply is there"
    BROKEN = "broken off"


class ReplyEvent(StrEnum):
    """What happens to the exchange."""

    OPEN = "a cycle begins"
    CLOSE = "a cycle ends"
    BREAK = "the time-out is exceeded"
    GOOD = "the open cycle's counter in time"
    OVERDUE = "the open cycle's counter past the deadline"
    OLD = "an earlier cycle's counter, that cycle unanswered"
    REPEATED = "the counter of a cycle that has its reply"
    WRONG = "a counter never sent"
    UNREADABLE = "malformed, or of another sender"


_REPLIES = (ReplyEvent.OLD, ReplyEvent.REPEATED, ReplyEvent.WRONG, ReplyEvent.UNREADABLE)


def _same(state: ControllerState) -> dict[ReplyEvent, ControllerState]:
    """Return the entries of replies that change only the counters."""
    return dict.fromkeys(_REPLIES, state)


TABLE: dict[ControllerState, dict[ReplyEvent, ControllerState]] = {
    ControllerState.BETWEEN: {
        ReplyEvent.OPEN: ControllerState.WAITING,
        ReplyEvent.BREAK: ControllerState.BROKEN,
        **_same(ControllerState.BETWEEN),
    },
    ControllerState.WAITING: {
        ReplyEvent.CLOSE: ControllerState.BETWEEN,
        ReplyEvent.GOOD: ControllerState.ANSWERED,
        ReplyEvent.OVERDUE: ControllerState.WAITING,
        **_same(ControllerState.WAITING),
    },
    ControllerState.ANSWERED: {
        ReplyEvent.CLOSE: ControllerState.BETWEEN,
        **_same(ControllerState.ANSWERED),
    },
    ControllerState.BROKEN: _same(ControllerState.BROKEN),
}

JUDGEMENTS: dict[ReplyEvent, Judgement] = {
    ReplyEvent.GOOD: Judgement.ACCEPTED,
    ReplyEvent.OVERDUE: Judgement.LATE,
    ReplyEvent.OLD: Judgement.LATE,
    ReplyEvent.REPEATED: Judgement.DUPLICATE,
    ReplyEvent.WRONG: Judgement.WRONG_COUNTER,
    ReplyEvent.UNREADABLE: Judgement.REFUSED,
}


_OPEN = frozenset({ControllerState.WAITING, ControllerState.ANSWERED})
_REPLIED = frozenset({Judgement.ACCEPTED, Judgement.LATE})


@dataclass(slots=True)
class ControllerCounts:
    """Counts. Each closed cycle is one of answered, late, refused and lost.

    Attributes:
        sent: telegrams, the open cycle's included.
        answered: cycles with a good reply.
        late: cycles whose reply came after its time.
        refused: cycles that only got a wrong counter, a wrong sender or something malformed.
        lost: cycles that got nothing.
        wrong_counter: replies with a counter never sent.
        unreadable: replies malformed or of another sender.
        duplicate: replies to a cycle that had one.
    """

    sent: int = 0
    answered: int = 0
    late: int = 0
    refused: int = 0
    lost: int = 0
    wrong_counter: int = 0
    unreadable: int = 0
    duplicate: int = 0


@dataclass(slots=True)
class _Cycle:
    """Outcome of a cycle; ``faulty`` if a further reply was refused."""

    outcome: Judgement = Judgement.MISSING
    faulty: bool = False


class ControllerExchange:
    """Controller's side of the exchange.

    Example::

        counter = exchange.next_counter()            # send the telegram
        exchange.on_reply(reply.counter, stamp_ns, deadline_ns)
        if exchange.close_cycle() is not Judgement.ACCEPTED: ...   # the setpoint holds
        if exchange.broken: ...                # the controller breaks off
    """

    def __init__(
        self,
        step: int,
        timeout: int = 100,
        rule: Literal["total", "row"] = "total",
        *,
        first_counter: int = 0,
        patient: bool = False,
    ) -> None:
        """Begin before the first cycle.

        Args:
            step: what the counter grows by each cycle (milliseconds on a real controller).
            timeout: faulty cycles that are tolerated.
            rule: whether they count in total or in a row. The manual does not say.
            first_counter: the first cycle's counter.
            patient: do not charge cycles before the first good reply. A real controller does.

        Raises:
            ValueError: a step that is not positive, a negative time-out or counter, another rule.
        """
        if step < 1 or timeout < 0 or first_counter < 0 or rule not in {"total", "row"}:
            raise ValueError(f"{step=} {timeout=} {rule=} {first_counter=}")
        self._step = step
        self._timeout = timeout
        self._rule = rule
        self._patient = patient
        self._counts = ControllerCounts()
        self._delay = 0
        self.restart(first_counter)

    def restart(self, first_counter: int) -> None:
        """Begin a new session, as after a restart of the program; the counts stay."""
        self._state = ControllerState.BETWEEN
        self._first = self._next = first_counter
        self._delay = 0
        self._row = 0
        self._was_answered = False
        self._cycles: dict[int, _Cycle] = {}

    @property
    def state(self) -> ControllerState:
        """State of the exchange."""
        return self._state

    @property
    def broken(self) -> bool:
        """True once the time-out was exceeded: no more telegrams until :meth:`restart`."""
        return self._state is ControllerState.BROKEN

    @property
    def delay(self) -> int:
        """Faulty cycles of this session."""
        return self._delay

    @property
    def row(self) -> int:
        """Cycles without a good reply, in a row."""
        return self._row

    @property
    def counts(self) -> ControllerCounts:
        """The counters; read only."""
        return self._counts

    def next_counter(self) -> int:
        """Close the open cycle, open the next one and return its counter.

        After :attr:`broken` it returns the last counter: check before sending.
        """
        self.close_cycle()
        if self.broken:
            return self._next - self._step
        self._move(ReplyEvent.OPEN)
        counter = self._next
        self._next += self._step
        self._counts.sent += 1
        self._cycles[counter] = _Cycle()
        self._cycles.pop(counter - HISTORY * self._step, None)
        return counter

    def on_reply(
        self, counter: int, stamp_ns: int = 0, deadline_ns: int | None = None
    ) -> Judgement:
        """Judge a readable reply that arrived at ``stamp_ns``.

        Args:
            deadline_ns: end of the open cycle [ns]; a reply at or after it is late. None if
                the caller closes the cycle in time.
        """
        overdue = deadline_ns is not None and stamp_ns >= deadline_ns
        event = self._classify(counter, overdue=overdue)
        self._move(event)
        self._count(event, counter)
        return JUDGEMENTS[event]

    def on_unreadable(self) -> Judgement:
        """Judge a reply that is malformed or of another sender."""
        self._move(ReplyEvent.UNREADABLE)
        self._counts.unreadable += 1
        self._blame()
        return JUDGEMENTS[ReplyEvent.UNREADABLE]

    def close_cycle(self) -> Judgement | None:
        """End the open cycle and count it; return its outcome, None if none was open."""
        if self._state not in _OPEN:
            return None
        cycle = self._cycles[self._next - self._step]
        self._move(ReplyEvent.CLOSE)
        answered = cycle.outcome is Judgement.ACCEPTED
        self._tally(cycle.outcome, 1)
        self._row = 0 if answered else self._row + self._charged
        if cycle.faulty or not answered:
            self._delay += self._charged
        if (self._delay if self._rule == "total" else self._row) > self._timeout:
            self._move(ReplyEvent.BREAK)
        return cycle.outcome

    @property
    def _charged(self) -> int:
        return 0 if self._patient and not self._was_answered else 1

    def _move(self, event: ReplyEvent) -> None:
        self._state = TABLE[self._state][event]

    def _classify(self, counter: int, *, overdue: bool) -> ReplyEvent:
        behind = self._next - self._step - counter
        if behind < 0 or behind % self._step or counter < self._first:
            return ReplyEvent.WRONG
        cycle = self._cycles.get(counter)
        if cycle is not None and cycle.outcome in _REPLIED:
            return ReplyEvent.REPEATED
        if behind or self._state is not ControllerState.WAITING:
            return ReplyEvent.OLD
        return ReplyEvent.OVERDUE if overdue else ReplyEvent.GOOD

    def _count(self, event: ReplyEvent, counter: int) -> None:
        """Note a reply in its cycle, or in the open one."""
        match event:
            case ReplyEvent.GOOD:
                self._was_answered = True
                self._cycles[counter].outcome = Judgement.ACCEPTED
            case ReplyEvent.OVERDUE:
                self._cycles[counter].outcome = Judgement.LATE
            case ReplyEvent.OLD:
                self._count_old(counter)
            case ReplyEvent.REPEATED:
                self._counts.duplicate += 1
            case _:
                self._counts.wrong_counter += 1
                self._blame()

    def _count_old(self, counter: int) -> None:
        """Count a closed cycle as late: its reply has come."""
        cycle = self._cycles.get(counter)
        if cycle is not None:
            self._tally(cycle.outcome, -1)
            cycle.outcome = Judgement.LATE
            self._tally(Judgement.LATE, 1)

    def _blame(self) -> None:
        if self._state in _OPEN:
            cycle = self._cycles[self._next - self._step]
            cycle.faulty = True
            if cycle.outcome is Judgement.MISSING:
                cycle.outcome = Judgement.REFUSED

    def _tally(self, outcome: Judgement, change: int) -> None:
        match outcome:
            case Judgement.ACCEPTED:
                self._counts.answered += change
            case Judgement.LATE:
                self._counts.late += change
            case Judgement.REFUSED:
                self._counts.refused += change
            case _:
                self._counts.lost += change
