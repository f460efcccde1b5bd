"""The line's controller of a shift: announces cars and keeps production going.

It knows what a PLC knows: the light barrier, the encoder, and the daemon's answers to requests of
the command protocol.

Invariants:
- It gives no order to arm, start, go home or retreat.
"""

from typing import Any

from linemate.daemon.service.app import App
from linemate.simulators.lab.faults.dst_orders import NAMES, CommandWire

POLL_S = 0.25


class LineController:
    """A client of the command protocol.

    Attributes:
        refusals: requests that were refused, the newest.
        orders: number of requests by operation.
    """

    def __init__(self) -> None:
        self.refusals: list[str] = []
        self.acknowledged = 0
        self.orders: dict[str, int] = {}
        self._wire = CommandWire()
        self._polled_s = 0.0

    def announce(self, app: App, part: str, variant: str, reading: float, now_ns: int) -> None:
        """Announce a car that passes the light barrier."""
        params = {"part": part, "variant": variant, "distance": reading}
        self._ask(app, "announce", params, now_ns)

    def poll(self, app: App, now_s: float, now_ns: int) -> None:
        """Look at production, acknowledge a fault, and let it go on."""
        if now_s - self._polled_s < POLL_S:
            return
        self._polled_s = now_s
        shown = self._ask(app, "queue", {}, now_ns)
        if shown is None or shown["held"] is None:
            return
        if shown["state"] == "fault":
            if self._ask(app, "ack", {}, now_ns) is not None:
                self.acknowledged += 1
        elif shown["state"] == "idle":
            self._ask(app, "next", {}, now_ns)

    def close(self) -> None:
        """End what was begun for it."""

    def _ask(self, app: App, op: str, params: dict[str, Any], now_ns: int) -> dict[str, Any] | None:
        """Return the result of a request, None if it was refused."""
        self.orders[op] = self.orders.get(op, 0) + 1
        result, why = self._answer(app, op, params, now_ns)
        if result is None:
            self.refusals = [*self.refusals, f"{op}: {why}"][-16:]
        return result

    def _answer(
        self, app: App, op: str, params: dict[str, Any], now_ns: int
    ) -> tuple[dict[str, Any] | None, str]:
        """Return the result of a request, or None and why it was refused."""
        answer = self._wire.ask(app, NAMES[0], op, params, now_ns)
        if answer is not None and answer.ok:
            return answer.result, ""
        return None, "no answer" if answer is None else answer.reason or answer.code
