"""The line's controller as an OPC UA client alone: it calls methods and reads variables.

Invariants:
- It is as ``LineController``, over another wire.
- Client and server stand in another process; the time of the shift stands while they talk.
"""

import multiprocessing
import multiprocessing.connection
import os
from typing import Any, Final

from linemate.daemon.service.app import App
from linemate.simulators.lab.faults.dst_orders import NAMES
from linemate.simulators.lab.shift import opc_process
from linemate.simulators.lab.shift.line_controller import LineController

METHODS: Final = {"announce": "Announce", "next": "Start", "ack": "Ack"}


class OpcLineController(LineController):
    """An OPC UA client of the daemon's server."""

    def __init__(self) -> None:
        """Start server and client, in one process."""
        super().__init__()
        spawned = multiprocessing.get_context("spawn")
        self._orders, their_orders = spawned.Pipe()
        self._requests, their_requests = spawned.Pipe()
        self._process = spawned.Process(
            target=opc_process.main, args=(their_orders, their_requests, os.getpid())
        )
        self._process.start()
        their_orders.close()
        their_requests.close()

    def close(self) -> None:
        """End server and client."""
        self._orders.close()
        self._requests.close()
        self._process.join(10.0)
        if self._process.is_alive():
            self._process.kill()

    def _answer(
        self, app: App, op: str, params: dict[str, Any], now_ns: int
    ) -> tuple[dict[str, Any] | None, str]:
        if op == "queue":
            shown = self._do(app, now_ns, None)
            if not shown["Connected"]:
                return None, "the OPC UA server has no answer from the daemon"
            state = "fault" if shown["Fault"] else shown["State"]
            return {"held": shown["Held"] or None, "state": state}, ""
        is_done, why = self._do(app, now_ns, METHODS[op], *params.values())
        return ({} if is_done else None), why

    def _do(self, app: App, now_ns: int, method: str | None, *arguments: Any) -> Any:
        """Return what the client got, and answer the requests of the server until then."""
        self._orders.send((method, arguments))
        while True:
            ready = multiprocessing.connection.wait([self._orders, self._requests])
            if self._requests in ready:
                op, params = self._requests.recv()
                answer = self._wire.ask(app, NAMES[0], op, params, now_ns)
                is_good = answer is not None and answer.ok
                why = "no answer" if answer is None else answer.reason or answer.code
                self._requests.send((answer.result if answer and is_good else None, why))
            elif self._orders in ready:
                return self._orders.recv()
