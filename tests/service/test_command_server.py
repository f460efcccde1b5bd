"""The command server on real sockets: modes, peers, floods, and nothing that waits."""

import asyncio
import contextlib
import os
import socket
import stat
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_ends import key_of, open_port, served

from linemate.daemon.service.command_server import CommandPort
from linemate.daemon.service.endpoints import (
    MAX_CONNECTIONS,
    CommandPortError,
    LocalEndpoint,
    UdpEndpoint,
)
from linemate.daemon.transport.client import Client, RefusedError
from linemate.protocol.command.authenticated import CommandClient
from linemate.protocol.command.client_core import Answer, Telemetry
from linemate.protocol.command.frame_codec import FrameType, Role, cut_local, local_body
from linemate.protocol.command.local_client import LocalClient
from linemate.protocol.command.local_server import LocalAccess
from linemate.protocol.command.preshared_keys import PresharedKey
from linemate.protocol.command.requests import encode_request

ALICE = key_of("alice", Role.OPERATE, 1)
EVE = key_of("eve", Role.VIEW, 2)


@contextlib.contextmanager
def connected(port: CommandPort) -> Iterator[tuple[socket.socket, LocalClient]]:
    """A local client whose server is polled by the test: no thread, no waiting."""
    assert port._local is not None
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as end:
        end.settimeout(2.0)
        end.connect(str(port._local.path))
        core = LocalClient()
        end.send(core.hello(time.monotonic_ns()))
        port.poll()
        port.poll()
        core.on_datagram(end.recv(4096), time.monotonic_ns())
        assert core.ready
        yield end, core


@contextlib.contextmanager
def shaken(port: CommandPort, key: PresharedKey) -> Iterator[tuple[socket.socket, CommandClient]]:
    """A UDP client likewise."""
    address = port.udp_address
    assert address is not None
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.settimeout(2.0)
        end.connect(address)
        core = CommandClient(key, 77)
        end.send(core.hello(time.monotonic_ns()))
        port.poll()
        core.on_datagram(end.recv(4096), time.monotonic_ns())
        assert core.ready
        yield end, core


def ask(
    port: CommandPort, end: socket.socket, core: Any, op: str, params: dict[str, Any] | None = None
) -> Answer:
    end.send(core.request(op, params or {}, time.monotonic_ns() + 10**9).frame)
    port.poll()
    answer = core.on_datagram(end.recv(1 << 17), time.monotonic_ns())
    assert isinstance(answer, Answer)
    return answer


# --- the local socket ---------------------------------------------------------------------


def test_the_local_socket_has_mode_0660_whatever_the_umask(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        with open_port(tmp_path):
            mode = (tmp_path / "command.sock").stat().st_mode
            assert stat.S_IMODE(mode) == 0o660
            assert os.umask(0) == 0
    finally:
        os.umask(before)
    assert not (tmp_path / "command.sock").exists()


def test_a_local_user_operates_under_the_name_the_kernel_gives(tmp_path: Path) -> None:
    seen: list[tuple[str, dict[str, Any], str, str]] = []

    def handle(op: str, params: dict[str, Any], role: str, who: str) -> dict[str, Any]:
        seen.append((op, params, role, who))
        return {"old": 1, "new": 2}

    with open_port(tmp_path, handle=handle) as port, connected(port) as (end, core):
        answer = ask(port, end, core, "set", {"values": {"a": 2}})
        assert (answer.ok, answer.result) == (True, {"old": 1, "new": 2})
    assert seen == [("set", {"values": {"a": 2}}, "operate", f"uid:{os.getuid()}")]


def test_a_local_user_who_may_only_view_cannot_operate(tmp_path: Path) -> None:
    done: list[str] = []

    def handle(op: str, params: object, role: str, who: str) -> dict[str, Any]:
        done.append(op)
        return {}

    endpoint = LocalEndpoint(tmp_path / "s", LocalAccess(view_gids=frozenset({os.getgid()})))
    port = CommandPort(handle, dict, endpoint)
    port.open()
    try:
        with connected(port) as (end, core):
            assert ask(port, end, core, "status").ok
            assert ask(port, end, core, "stop").code == "role"
    finally:
        port.close()
    assert done == ["status"]


def test_a_local_user_without_a_role_is_turned_away(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    port = CommandPort(lambda *_: {}, dict, LocalEndpoint(tmp_path / "s", LocalAccess()))
    port.open()
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as end:
            end.connect(str(tmp_path / "s"))
            port.poll()
            assert end.recv(100) == b""
    finally:
        port.close()
    assert port.counters["connections_refused"] == 1
    assert f"uid {os.getuid()}" in caplog.text


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_the_mode_keeps_out_a_user_of_another_group(tmp_path: Path) -> None:
    for folder in (tmp_path, *list(tmp_path.parents)[:3]):
        folder.chmod(0o755)
    with open_port(tmp_path):
        pid = os.fork()
        if pid == 0:
            code = 1
            try:
                os.setgroups([])
                os.setgid(65534)
                os.setuid(65534)
                with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as end:
                    end.connect(str(tmp_path / "command.sock"))
            except PermissionError:
                code = 42
            finally:
                os._exit(code)
        assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 42


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_a_member_of_the_sockets_group_operates(tmp_path: Path) -> None:
    for folder in (tmp_path, *list(tmp_path.parents)[:3]):
        folder.chmod(0o755)
    access = LocalAccess(operate_gids=frozenset({4242}))
    port = CommandPort(lambda *_: {}, dict, LocalEndpoint(tmp_path / "s", access))
    port.open()
    os.chown(tmp_path / "s", -1, 4242)
    try:
        pid = os.fork()
        if pid == 0:
            code = 1
            try:
                os.setgroups([4242])
                os.setgid(65534)
                os.setuid(65534)
                with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as end:
                    end.settimeout(5.0)
                    end.connect(str(tmp_path / "s"))
                    end.send(local_body(FrameType.HELLO, 0, 0, 0))
                    code = 42 if end.recv(100) else 2
            finally:
                os._exit(code)
        deadline = time.monotonic() + 5.0
        while port.counters["received"] == 0 and time.monotonic() < deadline:
            port.poll()
        assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 42
        assert port.counters["connections_made"] == 1
        assert port.counters["connections_refused"] == 0
    finally:
        port.close()


def test_any_message_on_the_local_socket_leaves_the_daemon_whole(tmp_path: Path) -> None:
    with open_port(tmp_path) as port, connected(port) as (end, core):
        for junk in (b"x", b"LM", bytes(22), b"LM\x01\x03" + bytes(18), bytes(5000)):
            end.send(junk)
            port.poll()
        end.send(local_body(FrameType.REQUEST, 0, 0, 1, b"\xc1"))
        port.poll()
        answer = cut_local(end.recv(4096))
        assert answer.type is FrameType.REPLY
        assert ask(port, end, core, "status").ok
        assert port.counters["dropped_length"] == 3
        assert port.counters["refused_malformed"] == 1


def test_a_long_answer_comes_whole_on_the_local_socket(tmp_path: Path) -> None:
    result = {"params": [{"name": f"p{i}", "value": float(i)} for i in range(1500)]}
    with open_port(tmp_path, handle=lambda *_: result) as port, connected(port) as (end, core):
        assert ask(port, end, core, "params").result == result


def test_a_peer_that_does_not_read_is_dropped_and_no_one_waits_for_it(tmp_path: Path) -> None:
    big = {"a": bytes(60000)}
    with open_port(tmp_path, handle=lambda *_: big) as port, connected(port) as (end, core):
        started = time.monotonic()
        with contextlib.suppress(OSError):
            for _ in range(100):
                end.send(core.request("status", {}, time.monotonic_ns() + 10**9).frame)
                port.poll()
        assert port.counters["connections_dropped"] == 1
        assert time.monotonic() - started < 1.0


def test_connections_are_bounded_and_places_are_given_back(tmp_path: Path) -> None:
    with open_port(tmp_path) as port, contextlib.ExitStack() as stack:
        for _ in range(MAX_CONNECTIONS):
            stack.enter_context(connected(port))
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as late:
            late.connect(str(tmp_path / "command.sock"))
            port.poll(100)
            assert late.recv(10) == b""
        stack.close()
        port.poll(100)
        with connected(port) as (end, core):
            assert ask(port, end, core, "status").ok
        assert port.counters["connections_full"] == 1


def test_a_stale_socket_is_replaced_and_a_living_one_is_not(tmp_path: Path) -> None:
    path = tmp_path / "command.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead:
        dead.bind(str(path))
    with open_port(tmp_path) as first:
        second = CommandPort(lambda *_: {}, dict, LocalEndpoint(path))
        with pytest.raises(CommandPortError, match="another daemon"):
            second.open()
        with connected(first) as (end, core):
            assert ask(first, end, core, "status").ok


def test_a_file_in_the_sockets_place_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "command.sock"
    path.write_text("precious")
    with pytest.raises(CommandPortError, match="not a socket"):
        CommandPort(lambda *_: {}, dict, LocalEndpoint(path)).open()
    assert path.read_text() == "precious"


def test_a_path_that_is_too_long_or_missing_is_an_error_that_says_so(tmp_path: Path) -> None:
    for path in (tmp_path / ("x" * 120), tmp_path / "missing" / "s"):
        with pytest.raises(CommandPortError, match=str(path)):
            CommandPort(lambda *_: {}, dict, LocalEndpoint(path)).open()


# --- UDP ----------------------------------------------------------------------------------


def test_a_keyed_client_is_served_over_udp(tmp_path: Path) -> None:
    with open_port(tmp_path, (ALICE, EVE)) as port:
        with shaken(port, ALICE) as (end, core):
            assert ask(port, end, core, "stop").ok
        with shaken(port, EVE) as (end, core):
            assert ask(port, end, core, "stop").code == "role"
            assert ask(port, end, core, "status").ok


def test_udp_opens_on_loopback_only_and_never_without_a_key() -> None:
    for endpoint, why in (
        (UdpEndpoint("0.0.0.0", 0, (ALICE,)), "not loopback"),
        (UdpEndpoint("127.0.0.1", 0), "no keys"),
        (UdpEndpoint("127.0.0.1", 0, (), allow_remote=True), "no keys"),
        (UdpEndpoint("localhost.invalid", 0, (ALICE,)), "address"),
    ):
        with pytest.raises(CommandPortError, match=why):
            CommandPort(lambda *_: {}, dict, None, endpoint).open()


def test_a_port_that_is_taken_is_an_error(tmp_path: Path) -> None:
    with open_port(tmp_path, (ALICE,)) as first:
        address = first.udp_address
        assert address is not None
        other = CommandPort(lambda *_: {}, dict, None, UdpEndpoint(*address, (ALICE,)))
        with pytest.raises(CommandPortError, match="in use"):
            other.open()
        with shaken(first, ALICE) as (end, core):
            assert ask(first, end, core, "status").ok


def test_junk_is_dropped_by_the_kernel_before_it_costs_a_read(tmp_path: Path) -> None:
    with open_port(tmp_path, (ALICE,)) as port, shaken(port, ALICE) as (end, core):
        before = port.counters["received"]
        for junk in (b"", b"L", b"XX" + bytes(60), b"LM" + bytes(1300), os.urandom(54)):
            end.send(junk)
        end.send(b"LM" + bytes(52))
        for _ in range(10):
            port.poll()
        assert port.counters["received"] - before == 1
        assert port.status()["counters"]["kernel_drops"] == 5
        assert port.counters["dropped_version"] == 1
        assert ask(port, end, core, "status").ok


def test_a_poll_handles_no_more_than_its_budget(tmp_path: Path) -> None:
    with open_port(tmp_path, (ALICE,)) as port, shaken(port, ALICE) as (end, _):
        for _ in range(50):
            end.send(b"LM\x01\x03" + bytes(50))
        counts = [port.poll(8) for _ in range(10)]
        assert counts == [8, 8, 8, 8, 8, 8, 2, 0, 0, 0]


def test_a_flood_on_the_port_leaves_the_local_socket_its_share(tmp_path: Path) -> None:
    with (
        open_port(tmp_path, (ALICE,)) as port,
        shaken(port, ALICE) as (flood, _),
        connected(port) as (end, core),
    ):
        for _ in range(100):
            flood.send(b"LM\x01\x03" + bytes(50))
        for _ in range(4):
            assert ask(port, end, core, "status").ok
        assert port.counters["dropped_unknown_key"] < 40


def test_a_flood_is_cheap(tmp_path: Path) -> None:
    """Forged frames of a known key in a known session: all of a budget in far below a cycle."""
    with open_port(tmp_path, (ALICE,)) as port, shaken(port, ALICE) as (end, core):
        good = core.request("stop", {}, time.monotonic_ns() + 10**9).frame
        forged = good[:-1] + bytes([good[-1] ^ 1])
        spent: list[int] = []
        for _ in range(200):
            for _ in range(8):
                end.send(forged)
            before = time.perf_counter_ns()
            assert port.poll(8) == 8
            spent.append(time.perf_counter_ns() - before)
        assert sorted(spent)[100] < 2_000_000
        assert port.counters["dropped_no_session"] == 1600


def test_keys_are_replaced_while_running(tmp_path: Path) -> None:
    with open_port(tmp_path, (ALICE, EVE)) as port, shaken(port, ALICE) as (end, core):
        assert ask(port, end, core, "stop").ok
        port.replace_keys([EVE])
        end.send(core.request("stop", {}, time.monotonic_ns() + 10**9).frame)
        port.poll()
        end.settimeout(0.05)
        with pytest.raises(TimeoutError):
            end.recv(100)


def test_one_lease_holds_over_all_endpoints(tmp_path: Path) -> None:
    with (
        open_port(tmp_path, (ALICE,)) as port,
        shaken(port, ALICE) as (far, far_core),
        connected(port) as (near, near_core),
    ):
        assert ask(port, near, near_core, "arm").ok
        assert ask(port, far, far_core, "start").code == "lease"
        assert ask(port, far, far_core, "stop").ok
        assert port.status()["control"] == f"uid:{os.getuid()}"


# --- handlers and telemetry ---------------------------------------------------------------


def test_a_handler_that_raises_costs_its_request_and_no_more(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def handle(op: str, params: object, role: str, who: str) -> dict[str, Any]:
        if op == "save":
            raise ZeroDivisionError("planted")
        return {}

    with open_port(tmp_path, (ALICE,), handle) as port:
        for client in (connected(port), shaken(port, ALICE)):
            with client as (end, core):
                assert ask(port, end, core, "save").code == "internal"
                assert ask(port, end, core, "status").ok
        assert port.counters["handler_errors"] == 2
    assert "planted" in caplog.text


def test_operating_is_logged_with_name_and_result_and_looking_is_not(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")

    def handle(op: str, params: dict[str, Any], role: str, who: str) -> dict[str, Any]:
        if op == "set":
            return {"changed": {"speed": {"old": 0.1, "new": 0.2}}}
        return {"refused": "not armed\nforged line"} if op == "start" else {}

    with open_port(tmp_path, (ALICE,), handle) as port, shaken(port, ALICE) as (end, core):
        ask(port, end, core, "status")
        ask(port, end, core, "set", {"values": {"speed": 0.2}})
        ask(port, end, core, "start")
    lines = [record.getMessage() for record in caplog.records]
    assert len(lines) == 2
    assert "alice" in lines[0]
    assert "'old': 0.1" in lines[0]
    assert "'speed': 0.2" in lines[0]
    assert "not armed" in lines[1]
    assert "\n" not in lines[1]


def test_telemetry_is_made_once_for_all_subscribers(tmp_path: Path) -> None:
    made: list[int] = []

    def telemetry() -> dict[str, Any]:
        made.append(1)
        return {"k": len(made)}

    with (
        open_port(tmp_path, (ALICE,), telemetry=telemetry) as port,
        shaken(port, ALICE) as (far, far_core),
        connected(port) as (near, near_core),
    ):
        port.poll()
        assert not made
        far.send(far_core.request("subscribe", {"rate_hz": 1.0}, time.monotonic_ns() + 10**9).frame)
        near.send(
            near_core.request("subscribe", {"rate_hz": 1.0}, time.monotonic_ns() + 10**9).frame
        )
        port.poll()
        port.poll()
        for end, core in ((far, far_core), (near, near_core)):
            assert isinstance(core.on_datagram(end.recv(4096), time.monotonic_ns()), Answer)
            event = core.on_datagram(end.recv(4096), time.monotonic_ns())
            assert isinstance(event, Telemetry)
            assert event.data == {"k": 1}
        assert made == [1]


def test_telemetry_that_raises_is_logged_once_and_harms_no_one(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def telemetry() -> dict[str, Any]:
        raise ZeroDivisionError("planted")

    with open_port(tmp_path, telemetry=telemetry) as port, connected(port) as (end, core):
        ask(port, end, core, "subscribe", {"rate_hz": 50.0})
        deadline = time.monotonic() + 2.0
        while port.counters["telemetry_errors"] < 3 and time.monotonic() < deadline:
            port.poll()
        assert port.counters["telemetry_errors"] == 3
    assert caplog.text.count("telemetry failed") == 1


def test_closing_ends_every_conversation(tmp_path: Path) -> None:
    with open_port(tmp_path, (ALICE,)) as port:
        with connected(port) as (end, _):
            port.close()
            assert end.recv(10) == b""
        assert port.poll() == 0
        port.close()


def test_a_blocking_client_meets_refusals_as_errors(tmp_path: Path) -> None:
    with (
        open_port(tmp_path, handle=lambda *_: {"refused": "not armed"}) as port,
        served(port),
        Client.local(tmp_path / "command.sock") as client,
        pytest.raises(RefusedError, match="not armed"),
    ):
        client.call("start")


def test_a_deadline_in_the_past_is_refused_on_the_local_socket_too(tmp_path: Path) -> None:
    with open_port(tmp_path) as port, connected(port) as (end, _):
        end.send(local_body(FrameType.REQUEST, 0, 0, 1, encode_request("stop", {}, 1)))
        port.poll()
        assert b"expired" in end.recv(4096)
        assert port.counters["orders"] == 0


def test_the_kernel_filter_is_packed_as_the_kernel_wants_it() -> None:
    assert struct.calcsize("HBBI") == 8


def test_a_cycle_polls_unless_the_loop_watches_and_no_one_subscribes(tmp_path: Path) -> None:
    async def live() -> list[bool]:
        with (
            open_port(tmp_path) as port,
            socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as link,
        ):
            loop = asyncio.get_running_loop()
            polls = [port.has_to_poll]
            port.open_window(loop, time.monotonic_ns() + 10**10, 2)
            polls.append(port.has_to_poll)
            port.open_window(loop, time.monotonic_ns() - 1, 2)
            core = LocalClient()
            link.connect(str(tmp_path / "command.sock"))
            link.send(core.hello(time.monotonic_ns()))
            await asyncio.sleep(0.02)  # the window is over: what comes waits for the cycle
            polls.append(port.has_to_poll)
            port.poll()
            port.poll()
            core.on_datagram(link.recv(65536), time.monotonic_ns())
            port.open_window(loop, time.monotonic_ns() + 10**10, 2)
            polls.append(port.has_to_poll)
            link.send(
                core.request("subscribe", {"rate_hz": 10.0}, time.monotonic_ns() + 10**9).frame
            )
            await asyncio.sleep(0.02)
            return [*polls, port.has_to_poll]

    assert asyncio.run(live()) == [True, False, True, False, True]


def test_what_comes_between_two_cycles_is_answered_there_within_its_budget(tmp_path: Path) -> None:
    async def live() -> tuple[list[str], int]:
        done: list[str] = []
        with (
            open_port(tmp_path, handle=lambda op, *_: done.append(op) or {}) as port,
            socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as link,
        ):
            loop = asyncio.get_running_loop()
            core = LocalClient()
            link.connect(str(tmp_path / "command.sock"))
            link.setblocking(False)
            link.send(core.hello(time.monotonic_ns()))
            port.poll()  # takes the connection
            port.poll()
            core.on_datagram(link.recv(65536), time.monotonic_ns())
            far_ns = time.monotonic_ns() + 10**10
            # Without an invitation they wait for the cycle.
            for _ in range(5):
                link.send(core.request("status", {}, time.monotonic_ns() + 10**9).frame)
            await asyncio.sleep(0.05)
            assert done == []
            port.open_window(loop, far_ns, 2)
            await asyncio.sleep(0.05)
            assert len(done) == 2
            port.open_window(loop, time.monotonic_ns() - 1, 8)
            await asyncio.sleep(0.05)
            assert len(done) == 2
            port.open_window(loop, far_ns, 8)
            await asyncio.sleep(0.05)
            return done, port.poll()

    done, waiting = asyncio.run(live())
    assert (len(done), waiting) == (5, 0)
