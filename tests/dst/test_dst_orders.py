"""Orders over the command protocol: real frames, keys, sessions and the control lease."""

from typing import Any

import pytest

from linemate.daemon.service.app import App
from linemate.protocol.command.authenticated import CommandServer
from linemate.simulators.lab.faults.dst_orders import NAMES, CommandWire

NOW_NS = 10**15


class Port:
    """The command port of a daemon without its socket."""

    def __init__(self) -> None:
        self._server = CommandServer((), lambda: bytes(range(32)))

    def replace_keys(self, keys: Any) -> None:
        self._server.replace_keys(keys)


class Daemon:
    """A daemon that notes what reaches it."""

    def __init__(self, refusal: str | None = None) -> None:
        self._commands = Port()
        self.orders: list[tuple[str, dict[str, Any], str, str]] = []
        self._refusal = refusal

    def _handle(self, op: str, params: dict[str, Any], role: str, who: str) -> dict[str, Any]:
        self.orders.append((op, dict(params), role, who))
        return {"refused": self._refusal} if self._refusal else {"state": "idle"}


def give(wire: CommandWire, daemon: Daemon, op: str, name: str = NAMES[0], **params: Any) -> Any:
    app: App = daemon  # type: ignore[assignment]
    return wire.order(app, name, op, params, NOW_NS)


def test_an_order_reaches_the_daemon_with_its_name_and_role() -> None:
    daemon, wire = Daemon(), CommandWire()
    assert give(wire, daemon, "arm") is None
    assert give(wire, daemon, "set", values={"tracking.mixture": False}) is None
    assert daemon.orders == [
        ("arm", {}, "operate", "operator"),
        ("set", {"values": {"tracking.mixture": False}}, "operate", "operator"),
    ]


def test_a_refusal_comes_back_with_its_reason() -> None:
    assert give(CommandWire(), Daemon("not now: because"), "arm") == "not now: because"


def test_two_operators_have_sessions_of_their_own_and_one_control() -> None:
    daemon, wire = Daemon(), CommandWire()
    assert give(wire, daemon, "arm") is None
    assert "control is held by operator" in give(wire, daemon, "start", NAMES[1])
    assert give(wire, daemon, "stop", NAMES[1]) is None
    assert daemon._commands._server.sessions == 2


def test_a_daemon_that_was_started_again_gets_a_handshake_of_its_own() -> None:
    wire, first, second = CommandWire(), Daemon(), Daemon()
    assert give(wire, first, "stop") is None
    assert give(wire, second, "stop") is None
    assert second._commands._server.sessions == 1


def test_an_operation_that_there_is_not_is_an_error_of_the_harness() -> None:
    with pytest.raises(Exception, match="no operation"):
        give(CommandWire(), Daemon(), "dance")
