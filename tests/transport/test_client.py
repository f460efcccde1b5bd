"""The blocking client with real servers, without one, and with slow ones."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from command_ends import key_of, open_port, served

from linemate.daemon.service.command_server import CommandPort
from linemate.daemon.transport.client import (
    Client,
    KeyFileError,
    NoAnswerError,
    RefusedError,
    default_key_path,
    default_socket_path,
    read_key,
)
from linemate.protocol.command.client_core import ClientCore
from linemate.protocol.command.frame_codec import CommandError, Role
from linemate.protocol.command.preshared_keys import key_line

ALICE = key_of("alice", Role.OPERATE, 1)
EVE = key_of("eve", Role.VIEW, 2)
LONG = {"params": [{"name": f"p{i}", "value": i} for i in range(500)]}


def where(port: CommandPort) -> tuple[str, int]:
    assert port.udp_address is not None
    return port.udp_address


def handle(op: str, params: dict[str, Any], role: str, who: str) -> dict[str, Any]:
    if op == "params":
        return LONG
    return {"op": op, "params": params, "role": role, "who": who}


@pytest.fixture
def port(tmp_path: Path) -> Iterator[CommandPort]:
    count = iter(range(10**9))
    with (
        open_port(tmp_path, (ALICE, EVE), handle, lambda: {"k": next(count)}) as port,
        served(port),
    ):
        yield port


@pytest.fixture(params=["local", "udp"])
def client(request: pytest.FixtureRequest, port: CommandPort, tmp_path: Path) -> Iterator[Client]:
    if request.param == "local":
        made = Client.local(tmp_path / "command.sock")
    else:
        made = Client.udp(*where(port), ALICE)
    with made:
        yield made


def test_a_call_gives_the_handlers_result(client: Client) -> None:
    answer = client.call("set", {"values": {"a": [1.5, 2]}})
    assert (answer["op"], answer["role"]) == ("set", "operate")
    assert answer["params"] == {"values": {"a": [1.5, 2]}}


def test_a_long_answer_comes_whole(client: Client) -> None:
    assert client.call("params") == LONG


def test_many_calls_use_one_session(client: Client, port: CommandPort) -> None:
    for _ in range(100):
        client.call("status")
    assert port.status()["sessions"] + port.status()["connections"] == 1


def test_telemetry_comes_in_order_at_its_rate_and_ends(client: Client) -> None:
    began = time.monotonic()
    seen = [data["k"] for data in client.telemetry(50.0, 0.5)]
    assert 0.4 < time.monotonic() - began < 2.0
    assert seen == list(range(seen[0], seen[0] + len(seen)))
    assert 10 <= len(seen) <= 28


def test_a_call_after_the_session_was_lost_begins_a_new_one(
    port: CommandPort, tmp_path: Path
) -> None:
    with Client.udp(*where(port), ALICE) as client:
        client.call("status")
        port.replace_keys([EVE])
        port.replace_keys([ALICE, EVE])
        with pytest.raises(NoAnswerError):
            client.call("status", timeout_s=0.15)
        assert client.call("status")["who"] == "alice"


def test_a_view_key_is_refused_with_a_reason(port: CommandPort) -> None:
    with (
        Client.udp(*where(port), EVE) as client,
        pytest.raises(RefusedError, match="may view") as caught,
    ):
        client.call("retreat")
    assert caught.value.code == "role"


def test_an_unknown_key_gets_no_answer(port: CommandPort) -> None:
    stranger = key_of("stranger", Role.OPERATE, 9)
    with (
        Client.udp(*where(port), stranger) as client,
        pytest.raises(NoAnswerError, match="no answer"),
    ):
        client.call("status", timeout_s=0.15)


def test_a_wrong_request_is_not_even_sent(client: Client) -> None:
    with pytest.raises(CommandError):
        client.call("format")


def test_a_missing_daemon_gives_no_answer(tmp_path: Path) -> None:
    with (
        Client.local(tmp_path / "missing") as client,
        pytest.raises(NoAnswerError, match="missing"),
    ):
        client.call("status")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        address: tuple[str, int] = taken.getsockname()
        with Client.udp(*address, ALICE) as client, pytest.raises(NoAnswerError):
            client.call("status", timeout_s=0.15)
    with Client.udp(*address, ALICE) as client, pytest.raises(NoAnswerError, match="refused"):
        client.call("status", timeout_s=0.15)


def test_a_daemon_that_hangs_is_no_answer_in_time(tmp_path: Path) -> None:
    with open_port(tmp_path), Client.local(tmp_path / "command.sock") as client:
        began = time.monotonic()
        with pytest.raises(NoAnswerError):
            client.call("status", timeout_s=0.2)
        assert 0.15 < time.monotonic() - began < 1.0


def test_a_daemon_that_ends_is_no_answer_at_once(tmp_path: Path) -> None:
    with open_port(tmp_path) as port, Client.local(tmp_path / "command.sock") as client:
        with served(port):
            client.call("status")
        port.close()
        with pytest.raises(NoAnswerError):
            client.call("status", timeout_s=5.0)


class Lossy:
    """A relay between a client and a server that loses what it receives."""

    def __init__(self, server: tuple[str, int], lose: Callable[[int], bool]) -> None:
        self._front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._front.bind(("127.0.0.1", 0))
        self._back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._back.connect(server)
        self._lose = lose
        self.address: tuple[str, int] = self._front.getsockname()
        self._threads = [threading.Thread(target=self._up), threading.Thread(target=self._down)]
        self._client: Any = None
        self._count = 0
        self._ended = False

    def __enter__(self) -> "Lossy":
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended = True
        for thread in self._threads:
            thread.join(2.0)
        self._front.close()
        self._back.close()

    def _pass(self) -> bool:
        self._count += 1
        return not self._lose(self._count)

    def _up(self) -> None:
        self._front.settimeout(0.05)
        while not self._ended:
            try:
                data, self._client = self._front.recvfrom(4096)
            except TimeoutError:
                continue
            if self._pass():
                self._back.send(data)

    def _down(self) -> None:
        self._back.settimeout(0.05)
        while not self._ended:
            try:
                data = self._back.recv(4096)
            except TimeoutError:
                continue
            if self._pass():
                self._front.sendto(data, self._client)


def test_lost_datagrams_are_sent_again_and_orders_are_carried_out_once(tmp_path: Path) -> None:
    done: list[str] = []

    def counting(op: str, params: object, role: str, who: str) -> dict[str, Any]:
        done.append(op)
        return LONG

    with (
        open_port(tmp_path, (ALICE,), counting) as port,
        served(port),
        Lossy(where(port), lambda count: count in {1, 3, 6, 8, 11}) as relay,
        Client.udp(*relay.address, ALICE) as client,
    ):
        assert client.call("save", timeout_s=2.0) == LONG
    assert done == ["save"]
    assert port.counters["replies_repeated"] >= 1


def test_a_key_is_read_from_a_file_of_ones_own_only(tmp_path: Path) -> None:
    path = tmp_path / "key"
    path.write_text(f"{key_line(ALICE)}\n{key_line(EVE)}\n")
    path.chmod(0o600)
    assert read_key(path) == ALICE
    assert read_key(path, "eve") == EVE
    with pytest.raises(KeyFileError, match="no key named bob"):
        read_key(path, "bob")
    path.chmod(0o644)
    with pytest.raises(KeyFileError, match="0644"):
        read_key(path)
    with pytest.raises(KeyFileError):
        read_key(tmp_path / "missing")


def test_the_socket_is_where_the_surroundings_say(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("LINEMATE_SOCKET", "/x/y.sock")
    assert default_socket_path() == Path("/x/y.sock")
    monkeypatch.delenv("LINEMATE_SOCKET")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert default_socket_path() in {
        tmp_path / "linemate/command.sock",
        Path("/run/linemate/command.sock"),
    }
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert default_key_path() == tmp_path / "linemate/key"


@pytest.mark.parametrize(("op", "is_asked_again"), [("status", True), ("arm", False)])
def test_what_only_reads_is_asked_again_if_its_deadline_passed_on_the_way_and_no_order_is(
    client: Client, monkeypatch: pytest.MonkeyPatch, op: str, is_asked_again: bool
) -> None:
    sound, deadlines = ClientCore.request, iter((-(10**9), 10**9, 10**9))

    def request(core: ClientCore, op: str, params: dict[str, Any], _: int) -> Any:
        return sound(core, op, params, time.monotonic_ns() + next(deadlines))

    monkeypatch.setattr(ClientCore, "request", request)
    if is_asked_again:
        assert client.call(op)
    else:
        with pytest.raises(RefusedError, match="after its deadline"):
            client.call(op)


def test_what_is_always_too_late_is_refused_in_the_end(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    sound = ClientCore.request

    def request(core: ClientCore, op: str, params: dict[str, Any], _: int) -> Any:
        return sound(core, op, params, time.monotonic_ns() - 10**9)

    monkeypatch.setattr(ClientCore, "request", request)
    with pytest.raises(RefusedError, match="after its deadline"):
        client.call("status")
