"""A daemon asked by the view: what comes, what it costs the daemon, and one who stops reading."""

import asyncio
import contextlib
import os
import signal
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from command_ends import key_of, open_port, served
from rerun import LINEMATE, Rerun, recording, rerun

from linemate.daemon.operator import main as tool
from linemate.daemon.service.command_server import CommandPort
from linemate.daemon.service.endpoints import LocalEndpoint
from linemate.daemon.transport.client import Client, KeyFileError
from linemate.daemon.view.broadcast_hub import BroadcastHub
from linemate.daemon.view.live_feed import LiveFeed
from linemate.protocol.command.frame_codec import Role
from linemate.protocol.command.local_client import LocalClient

PERIOD_NS = 12_000_000
SUBSCRIBERS = 3


def shown(
    folder: Path, until: int = 12, make: Callable[[], Client] | None = None
) -> tuple[BroadcastHub, list[str]]:
    """Return a hub with some frames of the daemon of a folder."""
    client = make or (lambda: Client.local(folder / "command.sock"))
    links: list[str] = []

    class Watched(BroadcastHub):
        def publish(self, name: str, data: object) -> None:  # type: ignore[override]
            if name == "link":
                links.append(str(data))
            super().publish(name, data)  # type: ignore[arg-type]

    hub = Watched()

    async def main() -> None:
        call = asyncio.get_running_loop().call_soon_threadsafe
        feed = LiveFeed(client, hub, call)
        feed.start()
        async with asyncio.timeout(20):
            while hub.frames < until and len(links) < 5:  # noqa: ASYNC110 - of threads
                await asyncio.sleep(0.02)
        await asyncio.to_thread(feed.end)

    asyncio.run(main())
    return hub, links


def test_a_daemon_is_asked_for_its_cell_its_status_and_its_telemetry(tmp_path: Path) -> None:
    rerunning = Rerun(1.0, 5.0)
    with rerun(tmp_path, rerunning):
        hub, links = shown(tmp_path)
    assert hub.frames >= 12
    assert links == ["{'up': True, 'reason': ''}"]
    assert set(rerunning.asked) == {"scene", "status"}
    with hub.subscribe() as subscriber:
        data = asyncio.run(subscriber.drain())
    assert b"event: scene" in data
    assert b'"arm":' in data
    assert b'"health":"healthy"' in data


def test_a_daemon_elsewhere_is_shown_by_datagrams_and_a_key_that_may_only_view(
    tmp_path: Path,
) -> None:
    rerunning, key = Rerun(1.0, 5.0), key_of("eve", Role.VIEW, 2)
    opening = open_port(tmp_path, (key,), rerunning.handle, rerunning.telemetry)
    with opening as port, served(port):
        assert port.udp_address is not None
        host, number = port.udp_address
        hub, links = shown(tmp_path, make=lambda: Client.udp(host, number, key))
    assert hub.frames >= 12
    assert links == ["{'up': True, 'reason': ''}"]
    with hub.subscribe() as subscriber:
        assert b'"arm":' in asyncio.run(subscriber.drain())


def test_a_daemon_without_the_operation_scene_is_shown_without_its_arm(tmp_path: Path) -> None:
    class Older(Rerun):
        def handle(self, op: str, *rest: object) -> dict[str, object]:  # type: ignore[override]
            return {"refused": "no such operation"} if op == "scene" else self.status

    with rerun(tmp_path, Older()):
        hub, _ = shown(tmp_path)
    with hub.subscribe() as subscriber:
        data = asyncio.run(subscriber.drain())
    assert b"does not describe its cell" in data
    assert b'"arm":' not in data


def test_a_missing_daemon_is_reported_at_each_attempt(tmp_path: Path) -> None:
    hub, links = shown(tmp_path)
    assert hub.frames == 0
    assert len(links) >= 5
    assert "command.sock" in links[0]


def test_any_failure_is_reported_and_tried_again(tmp_path: Path) -> None:
    rerunning, tries = Rerun(1.0, 5.0), []

    def make() -> Client:
        tries.append(1)
        if len(tries) <= 2:
            raise KeyFileError("key: gone for a moment")
        return Client.local(tmp_path / "command.sock")

    with rerun(tmp_path, rerunning):
        hub, links = shown(tmp_path, make=make)
    assert hub.frames >= 12
    assert "gone for a moment" in links[0]
    assert "True" in links[-1]


class LocalServer:
    """A daemon's local socket with a clock of the test, polled as by a cycle."""

    def __init__(self, folder: Path) -> None:
        self.now_ns = 10**12
        self.port = CommandPort(
            lambda *_: {},
            self._telemetry,
            LocalEndpoint(folder / "c.sock"),
            now_ns=lambda: self.now_ns,
        )
        self.path = folder / "c.sock"
        self._step = recording().steps[500]

    def _telemetry(self) -> dict[str, object]:
        data = {name: self._step.outputs[name] for name in ("target", "sensed", "part", "command")}
        return data | {"state": "track", "foreseen": [[0.1, 0.2, 0.3]] * 8, "stamp_ns": 10**18}

    @contextlib.contextmanager
    def subscriber(self) -> Iterator[socket.socket]:
        """One who subscribes for half a minute and says nothing more."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as end:
            end.connect(str(self.path))
            core = LocalClient()
            end.send(core.hello(self.now_ns))
            self.port.poll()
            self.port.poll()
            core.on_datagram(end.recv(4096), self.now_ns)
            wanted = {"rate_hz": 50.0, "duration_s": 30.0}
            deadline_ns = self.now_ns + 500_000_000
            end.send(core.request("subscribe", wanted, deadline_ns).frame)
            self.port.poll()
            yield end

    def cycles(self, count: int, reads: socket.socket | None = None) -> list[int]:
        """What each of some cycles paid for operators [ns]."""
        paid = []
        for _ in range(count):
            self.now_ns += PERIOD_NS
            began = time.perf_counter_ns()
            self.port.poll(8)
            paid.append(time.perf_counter_ns() - began)
            if reads is not None:
                with contextlib.suppress(BlockingIOError):
                    while reads.recv(65536, socket.MSG_DONTWAIT):
                        pass
        return paid


def test_a_view_that_does_not_read_costs_a_cycle_nothing_and_is_dropped(tmp_path: Path) -> None:
    server = LocalServer(tmp_path)
    server.port.open()
    try:
        alone = statistics.median(server.cycles(300))
        with contextlib.ExitStack() as stack:
            reading = stack.enter_context(server.subscriber())
            heard = statistics.median(server.cycles(300, reading))
            stalled = [stack.enter_context(server.subscriber()) for _ in range(SUBSCRIBERS)]
            paid = server.cycles(1800, reading)
            # Not one cycle waited: a full buffer is found out in microseconds.
            assert statistics.median(paid) < heard + 300_000
            assert server.port.counters["connections_dropped"] == SUBSCRIBERS
            assert server.port.status()["connections"] == 1
            assert len(stalled) == SUBSCRIBERS
        server.cycles(10)
        after = statistics.median(server.cycles(300))
        assert after < alone + 100_000
        assert server.port.status()["connections"] == 0
    finally:
        server.port.close()


def test_a_view_that_stands_still_receives_no_more_messages(tmp_path: Path) -> None:
    data = [0]

    class Counted(Rerun):
        def telemetry(self) -> dict[str, object]:
            data[0] += 1
            return super().telemetry()

    view = [*LINEMATE, "view", "--no-browser", "--socket", str(tmp_path / "command.sock")]
    with (
        rerun(tmp_path, Counted()),
        subprocess.Popen(view, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process,
    ):
        try:
            _until(lambda: data[0] > 10)
            os.kill(process.pid, signal.SIGSTOP)
            # A subscription lasts five seconds beyond its last renewal.
            _until(lambda: _rests(data))
            os.kill(process.pid, signal.SIGCONT)
            at = data[0]
            _until(lambda: data[0] > at + 10)
        finally:
            os.kill(process.pid, signal.SIGCONT)
            process.terminate()
        assert process.wait(20.0) == 0


def _until(holds: object, timeout_s: float = 30.0) -> None:
    end = time.monotonic() + timeout_s
    while not holds():  # type: ignore[operator]
        assert time.monotonic() < end
        time.sleep(0.05)


def _rests(count: list[int]) -> bool:
    before = count[0]
    time.sleep(0.5)
    return count[0] == before


def test_the_tool_says_in_one_line_what_it_cannot_show(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x.mcap").write_bytes(b"no")
    assert tool.main(["view", "--no-browser", str(tmp_path / "x.mcap")]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        assert tool.main(["view", "--no-browser", "--port", port]) == 2
    error = capsys.readouterr().err
    assert port in error
    assert error.count("\n") == 1
    key = str(tmp_path / "no-key")
    assert tool.main(["view", "--no-browser", "--udp", "127.0.0.1", "--key", key]) == 2
    assert "no-key" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--port", "70000"], ["--bind", "example.org"], ["--port", "x"]])
def test_a_wrong_word_is_a_usage_error(words: list[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        tool.main(["view", *words])
    assert ended.value.code == 2


def test_a_status_does_not_pay_for_the_view() -> None:
    asked = (
        "import sys, linemate.daemon.operator.main as m;"
        "print(sorted({'asyncio', 'numpy', 'yaml', 'webbrowser'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, check=True)
    assert done.stdout.strip() == b"[]"
