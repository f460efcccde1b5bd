"""Answers to operators' orders: the state after the order, or why it was refused.

Invariants:
- An accepted order is answered after the decision that it was part of.
- Without a decision, it is answered after ``CYCLES`` cycles with the state as it is.
"""

import asyncio
from dataclasses import dataclass, field
from typing import Any, Final

from linemate.daemon.cycle.operating import Operating
from linemate.daemon.cycle.states import MOVING, State, unfit

CYCLES: Final = 4
"""Cycles that an answer waits for a decision at most."""

REACHED: Final[dict[str, frozenset[State]]] = {
    "arm": MOVING | {State.ARMED},
    "start": MOVING,
    "home": MOVING,
    "follow": MOVING,
}
"""States of which one must be reached, by order; the other orders are good in any."""

Answer = dict[str, Any]


@dataclass(frozen=True, slots=True)
class _Waiting:
    op: str
    decisions: int
    promise: "asyncio.Future[Answer]"


@dataclass(slots=True)
class Answers:
    """Orders that wait for their decision."""

    operating: Operating
    cycle_s: float
    _waiting: list[_Waiting] = field(default_factory=list)

    def promise(self, op: str) -> "asyncio.Future[Answer]":
        """Return the answer to an order that was accepted just now."""
        loop = asyncio.get_running_loop()
        waiting = _Waiting(op, self.operating.decisions, loop.create_future())
        self._waiting.append(waiting)
        loop.call_later(CYCLES * self.cycle_s, self._answer, waiting)
        return waiting.promise

    def keep(self) -> None:
        """Answer the orders that were part of a decision; to be called after each step."""
        if not self._waiting:
            return
        decided = [w for w in self._waiting if w.decisions < self.operating.decisions]
        for waiting in decided:
            self._answer(waiting)

    def _answer(self, waiting: _Waiting) -> None:
        if waiting not in self._waiting:
            return
        self._waiting.remove(waiting)
        if not waiting.promise.done():
            decided = waiting.decisions < self.operating.decisions
            waiting.promise.set_result(outcome(waiting.op, self.operating, decided=decided))


def outcome(op: str, operating: Operating, *, decided: bool) -> Answer:
    """Return the answer to an order.

    Args:
        decided: whether a decision was made since.
    """
    machine = operating.machine
    if decided and machine.state not in REACHED.get(op, frozenset(State)):
        why = unfit(operating.signals) or operating.cause
        return {"refused": f"{op}: the state is {machine.state.upper()}: {why}"}
    return {"state": machine.state.value}
