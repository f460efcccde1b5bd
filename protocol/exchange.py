"""Cyclic exchange, daemon's side: classify each telegram by counter and arrival.

Invariants:
    ``TABLE`` has the next state, the kind and whether to answer, for each state and event.
    Stamps are arguments, decisions are return values. The controller's side is
    ``exchange_controller``.
    A wrong counter costs at most two telegrams. Three refused telegrams in one line begin a new
    session.
"""

from collections.abc import Hashable
from dataclasses import dataclass
from enum import StrEnum

from msgspec import Struct

WINDOW = 100  # an accepted telegram is at most so many cycles ahead of the last one
CONSISTENT = 3  # telegrams in one line that overrule the counter before
TURN = 2**32  # a counter of 32 bits goes on from zero
TOLERANCE = 4  # cycles by which counter and arrival may differ: a flipped bit is not a gap

SESSION_GAP_S = 2.0  # silence that ends a session
PEER_GAP_S = 0.1  # silence after which another peer may begin a session


class TelegramKind(StrEnum):
    """Kind of a telegram."""

    FIRST = "first"
    NORMAL = "normal"
    GAP = "gap"
    DUPLICATE = "duplicate"
    BACKWARD = "backward"
    LATE = "late"
    NEW_SESSION = "new_session"
    REFUSED = "refused"


class ExchangeState(StrEnum):
    """State of the exchange."""

    IDLE = "no telegram yet"
    LEARNING = "a session, its step not yet sure"
    RUNNING = "a session with its step"


class TelegramEvent(StrEnum):
    """What a telegram is in the present state."""

    OPENING = "nothing before it, or silence, or another peer after the first one's end"
    FOREIGN = "another peer while the first one is alive"
    NEXT = "one step ahead"
    SETTLED = "the same step for the second time"
    AHEAD = "some steps ahead, in the window"
    OVERDUE = "in order, but its step was made by the clock already"
    SAME = "the same counter once more"
    MISSED = "one that was missed comes after its successor"
    OLDER = "behind"
    STRAY = "outside the window, between the steps, or too far ahead of the time that passed"
    RESUME = "third of a line that continues the confirmed one"
    RESYNC = "third, at the cycle's rate, of a line that continues nothing"


@dataclass(frozen=True, slots=True)
class Transition:
    """One entry of the table."""

    state: ExchangeState
    kind: TelegramKind
    answer: bool


def _in_session(state: ExchangeState) -> dict[TelegramEvent, Transition]:
    """Return the entries that LEARNING and RUNNING have in common."""
    return {
        TelegramEvent.OPENING: Transition(
            ExchangeState.LEARNING, TelegramKind.NEW_SESSION, answer=True
        ),
        TelegramEvent.FOREIGN: Transition(state, TelegramKind.REFUSED, answer=False),
        TelegramEvent.NEXT: Transition(state, TelegramKind.NORMAL, answer=True),
        TelegramEvent.AHEAD: Transition(state, TelegramKind.GAP, answer=True),
        TelegramEvent.OVERDUE: Transition(state, TelegramKind.LATE, answer=True),
        TelegramEvent.SAME: Transition(state, TelegramKind.DUPLICATE, answer=False),
        TelegramEvent.MISSED: Transition(state, TelegramKind.LATE, answer=False),
        TelegramEvent.OLDER: Transition(state, TelegramKind.BACKWARD, answer=False),
        TelegramEvent.STRAY: Transition(state, TelegramKind.REFUSED, answer=False),
        TelegramEvent.RESYNC: Transition(
            ExchangeState.RUNNING, TelegramKind.NEW_SESSION, answer=True
        ),
    }


TABLE: dict[ExchangeState, dict[TelegramEvent, Transition]] = {
    ExchangeState.IDLE: {
        TelegramEvent.OPENING: Transition(ExchangeState.LEARNING, TelegramKind.FIRST, answer=True)
    },
    ExchangeState.LEARNING: {
        **_in_session(ExchangeState.LEARNING),
        TelegramEvent.SETTLED: Transition(ExchangeState.RUNNING, TelegramKind.NORMAL, answer=True),
    },
    ExchangeState.RUNNING: {
        **_in_session(ExchangeState.RUNNING),
        TelegramEvent.RESUME: Transition(ExchangeState.RUNNING, TelegramKind.GAP, answer=True),
    },
}

_KNOWN = frozenset({TelegramEvent.SAME, TelegramEvent.MISSED})
_UNCONFIRMED = _KNOWN | {TelegramEvent.OLDER, TelegramEvent.STRAY}


class TelegramDecision(Struct, frozen=True):
    """Decision on one telegram.

    Attributes:
        answer: answer it. Of several waiting telegrams only the newest with True is answered.
        missed: cycles between it and the telegram accepted before it.
        steps: sampling steps to make now, so that their count follows the controller's cycles.
            Missed cycles are included, steps already made by the clock are not.
        session: number of the session, 1 for the first; a change re-zeroes and disarms.
        step: the learned step of the counter, None while unknown.
    """

    kind: TelegramKind
    answer: bool
    missed: int
    steps: int
    session: int
    step: int | None


@dataclass(slots=True)
class _TelegramLine:
    """The last telegrams, accepted or not, with counters at equal distances.

    Attributes:
        paced: of these, in a row, those that came a cycle apart. A controller keeps its rate, a
            burst of forged or delayed datagrams does not.
        known: of these, in a row, those that are the last one, or were missed before it.
    """

    counter: int = 0
    step: int = 0
    length: int = 0
    stamp_ns: int = 0
    paced: int = 0
    known: int = 0

    @property
    def is_new(self) -> bool:
        """Enough telegrams at the cycle's rate, of which one at least was not known."""
        return self.paced >= CONSISTENT > self.known

    def extend(
        self, counter: int, stamp_ns: int, reach: int, cycle_ns: int, *, known: bool = False
    ) -> bool:
        """Add a telegram; return whether the line is long enough."""
        passed_ns = stamp_ns - self.stamp_ns
        if self.length and counter == self.counter:
            if passed_ns >= cycle_ns // 2:  # else the network has duplicated it
                self.paced, self.stamp_ns = 1, stamp_ns
            return False
        in_line = self._extend(counter, reach)
        is_paced = self.length > 1 and cycle_ns // 2 <= passed_ns <= TOLERANCE * cycle_ns
        self.paced = self.paced + 1 if is_paced else 1
        self.known = self.known + 1 if known else 0
        self.stamp_ns = stamp_ns
        return in_line

    def _extend(self, counter: int, reach: int) -> bool:
        delta = counter - self.counter
        if self.length and 0 < delta <= reach:
            self.length = self.length + 1 if delta == self.step else 2
            self.step = delta
        else:
            self.length, self.step = 1, 0
        self.counter = counter
        return self.length >= CONSISTENT


class Exchange:
    """Daemon's side: one call for each telegram, one for each cycle without.

    Attributes:
        step: the learned step of the counter, None while unknown; it is sure in RUNNING.
        session: number of the present session, 0 before the first.
    """

    def __init__(
        self, cycle_s: float, session_gap_s: float = SESSION_GAP_S, peer_gap_s: float = PEER_GAP_S
    ) -> None:
        """Begin before the first telegram.

        Args:
            cycle_s: the configured cycle [s]. The counter's step is learned, not derived from it.
            session_gap_s: silence after which the next telegram is a new session [s].
            peer_gap_s: silence after which another peer may begin a session [s].
        """
        self._cycle_ns = max(1, round(cycle_s * 1e9))
        self._session_gap_ns = round(session_gap_s * 1e9)
        self._peer_gap_ns = round(peer_gap_s * 1e9)
        # A counter counts milliseconds on a real controller and cycles in some simulators.
        self._reach = WINDOW * max(1, round(cycle_s * 1e3))
        self._counts = dict.fromkeys(TelegramKind, 0)
        self._missed_total = 0
        self._overdue_total = 0
        self.session = 0
        self.reset()

    def reset(self) -> None:
        """Forget the session; the next telegram is a first one. Counters stay."""
        self.state = ExchangeState.IDLE
        self._peer: Hashable = None
        self.step: int | None = None
        self._last_counter = 0
        self._last_ns = 0
        self._peer_ns = 0
        # The last telegram that a later one confirmed, and the steps made since.
        self._anchor_counter = 0
        self._anchor_ns = 0
        self._steps_made = self._jumped = 0
        self._delta: int | None = None
        self._missed: frozenset[int] = frozenset()
        self._line = _TelegramLine()

    @property
    def counters(self) -> dict[str, int]:
        """Telegrams by kind, missed cycles, cycles stepped by the clock, sessions."""
        return {
            **{kind.value: count for kind, count in self._counts.items()},
            "missed": self._missed_total,
            "overdue": self._overdue_total,
            "sessions": self.session,
        }

    def resume(self, step: int) -> None:
        """Continue with a known step of the counter: the new session continues the one before."""
        self.step, self.state = step, ExchangeState.RUNNING

    def would_open(self, stamp_ns: int, peer: Hashable) -> bool:
        """Whether a telegram with this arrival [ns] begins a session, whatever its counter."""
        if self.state is ExchangeState.IDLE or peer != self._peer:
            return True
        return stamp_ns - self._last_ns >= self._session_gap_ns

    def foreseen(self) -> tuple[int, Hashable] | None:
        """Return counter and peer of the telegram that is normal next and asks for one step.

        None if there is no such telegram.
        """
        if self.state is not ExchangeState.RUNNING or self._steps_made or self.step is None:
            return None
        return self._last_counter + self.step, self._peer

    @property
    def ahead(self) -> int:
        """Steps that were made for cycles after the last telegram."""
        confirmed = (self._last_counter - self._anchor_counter) // (self.step or 1)
        return max(0, self._steps_made - confirmed)

    def on_missing(self) -> None:
        """Note that the clock made a step because no telegram came in time."""
        self._undo_jump()
        if self.state is not ExchangeState.IDLE:
            self._overdue_total += 1
            self._steps_made = min(self._steps_made + 1, WINDOW)

    def note_jump(self, steps: int) -> None:
        """Note that steps of the last decision were not made: the time for them has not passed.

        The counter has jumped if the next telegram goes on from there. Else it was flipped, and
        the cycles of these steps are still to come.
        """
        self._jumped = steps

    def _undo_jump(self) -> None:
        self._steps_made -= self._jumped
        self._jumped = 0

    def on_telegram(self, counter: int, stamp_ns: int, peer: Hashable = None) -> TelegramDecision:
        """Return the decision on one telegram that arrived at ``stamp_ns``.

        Args:
            peer: its sender; another value is another controller.
        """
        event = self._classify(counter, stamp_ns, peer)
        if event is not TelegramEvent.NEXT:
            self._undo_jump()
        self._jumped = 0
        transition = TABLE[self.state][event]
        missed, steps = self._apply(event, counter, stamp_ns, peer)
        self.state = transition.state
        self._counts[transition.kind] += 1
        self._missed_total += missed
        return TelegramDecision(
            transition.kind, transition.answer, missed, steps, self.session, self.step
        )

    def _turn_over(self, counter: int) -> None:
        """Count what came before from the side of a counter's end on which it is now."""
        off = counter - self._last_counter
        turn = TURN if off > 0 else -TURN
        if self.step is None or abs(off - turn) > WINDOW * self.step:
            return
        self._last_counter += turn
        self._anchor_counter += turn
        self._line.counter += turn
        self._missed = frozenset(old + turn for old in self._missed)

    def _classify(self, counter: int, stamp_ns: int, peer: Hashable) -> TelegramEvent:
        if self.state is ExchangeState.IDLE:
            return TelegramEvent.OPENING
        if peer != self._peer:
            alive = stamp_ns - self._peer_ns < self._peer_gap_ns
            return TelegramEvent.FOREIGN if alive else TelegramEvent.OPENING
        self._peer_ns = stamp_ns
        if stamp_ns - self._last_ns >= self._session_gap_ns:
            return TelegramEvent.OPENING
        self._turn_over(counter)
        event = self._place(counter, stamp_ns)
        known = event in _KNOWN and stamp_ns - self._last_ns < self._peer_gap_ns
        in_line = self._line.extend(counter, stamp_ns, self._reach, self._cycle_ns, known=known)
        if event not in _UNCONFIRMED or not in_line:
            return event
        if self._goes_on(counter, stamp_ns):
            return TelegramEvent.RESUME
        # Missed telegrams that arrive late are in one line too, up to the one accepted before
        # them. No session begins with those, unless all has been silent for longer.
        return TelegramEvent.RESYNC if self._line.is_new else event

    def _place(self, counter: int, stamp_ns: int) -> TelegramEvent:
        delta = counter - self._last_counter
        if delta == 0:
            return TelegramEvent.SAME
        if delta < 0:
            return TelegramEvent.MISSED if counter in self._missed else TelegramEvent.OLDER
        passed = (stamp_ns - self._last_ns) // self._cycle_ns
        if self.state is ExchangeState.LEARNING or self.step is None:
            return self._place_learning(delta, passed)
        cycles, rest = divmod(delta, self.step)
        if rest or cycles > min(WINDOW, passed + TOLERANCE):
            return TelegramEvent.STRAY
        if (counter - self._anchor_counter) // self.step <= self._steps_made:
            return TelegramEvent.OVERDUE
        return TelegramEvent.NEXT if cycles == 1 else TelegramEvent.AHEAD

    def _place_learning(self, delta: int, passed: int) -> TelegramEvent:
        """Two equal differences in a row settle the step; until then the last one is used."""
        if delta > self._reach:
            return TelegramEvent.STRAY
        if delta in {self._delta, self.step}:
            return TelegramEvent.SETTLED
        if self.step is None or delta % self.step or delta // self.step > passed + 1:
            return TelegramEvent.NEXT
        return TelegramEvent.AHEAD

    def _goes_on(self, counter: int, stamp_ns: int) -> bool:
        """Whether the line continues the telegram that was confirmed last."""
        if self.state is not ExchangeState.RUNNING or self._line.step != self.step:
            return False
        cycles, rest = divmod(counter - self._anchor_counter, self._line.step)
        if rest or not 0 < cycles <= WINDOW:
            return False
        off, last = self._off(counter, stamp_ns), self._off(self._last_counter, self._last_ns)
        # Delayed telegrams are a line too, but the telegram before them agrees better with the
        # clock than they do. A flipped counter agrees less. A counter that is ahead by less is
        # reached by the line before it could be overruled.
        return off <= min(TOLERANCE, last) and last >= CONSISTENT

    def _off(self, counter: int, stamp_ns: int) -> float:
        """Return by how many cycles counter and clock differ since the anchor."""
        passed = (stamp_ns - self._anchor_ns) / self._cycle_ns
        return abs(passed - (counter - self._anchor_counter) / self._line.step)

    def _apply(
        self, event: TelegramEvent, counter: int, stamp_ns: int, peer: Hashable
    ) -> tuple[int, int]:
        """Remember the telegram; return the missed cycles before it and the steps to make."""
        match event:
            case TelegramEvent.OPENING | TelegramEvent.RESYNC:
                self._open(event, counter, stamp_ns, peer)
                return 0, 1
            case (
                TelegramEvent.NEXT
                | TelegramEvent.SETTLED
                | TelegramEvent.AHEAD
                | TelegramEvent.OVERDUE
            ):
                return self._accept(event, counter, stamp_ns)
            case TelegramEvent.RESUME:
                return self._resume(counter, stamp_ns)
            case TelegramEvent.MISSED:
                self._missed -= {counter}
        return 0, 0

    def _open(self, event: TelegramEvent, counter: int, stamp_ns: int, peer: Hashable) -> None:
        line = self._line if event is TelegramEvent.RESYNC else _TelegramLine(counter, 0, 1)
        self.reset()
        self._line = line
        self.session += 1
        self._peer = peer
        self.step = self._delta = line.step or None
        self._peer_ns = stamp_ns
        self._trust(counter, stamp_ns)

    def _trust(self, counter: int, stamp_ns: int) -> None:
        """Make a confirmed telegram the last one and the anchor."""
        self._last_counter = self._anchor_counter = counter
        self._last_ns = self._anchor_ns = stamp_ns

    def _accept(self, event: TelegramEvent, counter: int, stamp_ns: int) -> tuple[int, int]:
        delta = counter - self._last_counter
        if self.state is ExchangeState.LEARNING:
            if event is not TelegramEvent.AHEAD:
                self.step = delta
            self._delta = delta
        step = self.step or delta
        cycles = delta // step
        # Accepting relative to the last telegram confirms that one, so it is the new anchor.
        self._steps_made -= (self._last_counter - self._anchor_counter) // step
        steps = max(0, cycles - self._steps_made)
        self._steps_made += steps
        if cycles == 1 or self.state is ExchangeState.LEARNING:
            self._steps_made -= cycles
            self._trust(counter, stamp_ns)
        else:
            self._anchor_counter, self._anchor_ns = self._last_counter, self._last_ns
            self._remember_missed(counter, step)
            self._last_counter, self._last_ns = counter, stamp_ns
        return cycles - 1, steps

    def _remember_missed(self, counter: int, step: int) -> None:
        kept = (old for old in self._missed if old > counter - WINDOW * step)
        self._missed = frozenset((*kept, *range(self._last_counter + step, counter, step)))

    def _resume(self, counter: int, stamp_ns: int) -> tuple[int, int]:
        cycles = (counter - self._anchor_counter) // self._line.step
        steps = max(0, cycles - self._steps_made)
        self._steps_made = max(0, self._steps_made - cycles)
        self._missed = frozenset()
        self._trust(counter, stamp_ns)
        return cycles - 1, steps
