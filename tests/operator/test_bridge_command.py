"""A bridge between two real daemons and a subscriber of another process, over loopback alone."""

import json
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from daemon_process import LINEMATE, DaemonProcess

from linemate.daemon.operator import bridge_messages as messages

zenoh = pytest.importorskip("zenoh", reason="zenoh is in the extra fleet")

TEXT = "task: wheel.yaml\nrsi: {port: 0}\ncommand: {socket: c.sock}\n"
PATIENCE_S = 15.0


def free_port() -> int:
    with closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class Fleet:
    """Two daemons, a bridge, and the session of a subscriber that knows the bridge alone."""

    daemons: dict[str, DaemonProcess]
    bridge: subprocess.Popen[str]
    session: Any
    heard: list[tuple[str, dict[str, Any]]] = field(default_factory=list)

    def until(self, found: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE_S
        while not found():
            assert time.monotonic() < end, self.heard[-5:]
            time.sleep(0.02)

    def asked(self, selector: str) -> list[dict[str, Any]]:
        """Answers; an error is a map with its text."""
        replies = self.session.get(selector, timeout=8.0)
        return [
            json.loads(reply.ok.payload.to_string())
            if reply.ok
            else {"error": reply.err.payload.to_string()}
            for reply in replies
        ]

    def events(self, station: str) -> list[dict[str, Any]]:
        return [told["data"] for key, told in self.heard if key == f"linemate/{station}/events"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    with ExitStack() as stack:
        daemons = {
            name: stack.enter_context(DaemonProcess(tmp_path_factory.mktemp(name), TEXT))
            for name in ("east", "west")
        }
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        stations = [
            f"--station={name}={daemon.listening['command']['socket']}"
            for name, daemon in daemons.items()
        ]
        bridge = stack.enter_context(
            subprocess.Popen(
                [*LINEMATE, "bridge", "--listen", endpoint, "--rate", "20", *stations],
                stdout=subprocess.PIPE,
                text=True,
            )
        )
        stack.callback(bridge.kill)
        assert bridge.stdout is not None
        assert bridge.stdout.readline().startswith("2 stations")
        from linemate.daemon.operator.bridge_command import open_session

        session = stack.enter_context(open_session([], [endpoint]))
        fleet = Fleet(daemons, bridge, session)

        def hear(sample: Any) -> None:
            told = json.loads(sample.payload.to_string())
            fleet.heard.append((str(sample.key_expr), told))

        session.declare_subscriber("linemate/**", hear)
        yield fleet


def test_status_and_telemetry_of_every_station_come_by_themselves(made: Fleet) -> None:
    wanted = {
        f"linemate/{name}/{what}" for name in made.daemons for what in ("status", "telemetry")
    }
    made.until(lambda: wanted <= {key for key, _ in made.heard})
    for key, told in list(made.heard):
        assert told["version"] == 1
        assert key.split("/")[1] == told["station"]
    pids = {told["data"]["pid"] for key, told in made.heard if key.endswith("/status")}
    assert pids == {daemon.process.pid for daemon in made.daemons.values()}


def test_a_query_is_answered_by_each_station_with_its_own_word(made: Fleet) -> None:
    answers: list[dict[str, Any]] = []
    made.until(
        lambda: len(answers[:] or answers.extend(made.asked("linemate/*/status")) or answers) == 2
    )
    assert {told["station"] for told in answers} == set(made.daemons)
    (told,) = made.asked("linemate/east/get?names=tracking.camera.gate,control.horizon_s")
    assert set(told["data"]["values"]) == {"tracking.camera.gate", "control.horizon_s"}
    (told,) = made.asked("linemate/west/params?prefix=tracking.camera")
    assert all(one["name"].startswith("tracking.camera") for one in told["data"]["params"])


@pytest.mark.parametrize(
    ("selector", "why"),
    [
        ("linemate/east/get", "names is missing"),
        ("linemate/east/get?names=x.y", "no parameter x.y"),
    ],
)
def test_a_query_that_cannot_be_answered_says_why(made: Fleet, selector: str, why: str) -> None:
    (told,) = made.asked(selector)
    assert why in told["error"]


def test_nothing_can_be_ordered_through_it(made: Fleet) -> None:
    before = made.daemons["east"].status()["commands"]["counters"]
    for op in ("arm", "set", "stop", "save", "record"):
        assert made.asked(f"linemate/east/{op}") == []
        made.session.put(f"linemate/east/{op}", b"{}")
    after = made.daemons["east"].status()["commands"]["counters"]
    refusals = {name for name in after if after[name] != before.get(name, 0)}
    assert not refusals & {"role", "lease", "unknown", "refused"}


def test_a_station_that_dies_is_an_event_and_the_other_goes_on(made: Fleet) -> None:
    alive = {str(reply.ok.key_expr) for reply in made.session.liveliness().get("linemate/*")}
    assert alive == {"linemate/east", "linemate/west"}
    west = made.daemons["west"].process
    west.send_signal(signal.SIGKILL)
    west.wait()
    gone = messages.event("answers", True, False)
    made.until(lambda: gone in made.events("west"))
    alive = {str(reply.ok.key_expr) for reply in made.session.liveliness().get("linemate/*")}
    assert alive == {"linemate/east"}
    heard = len(made.heard)
    made.until(lambda: any(key == "linemate/east/telemetry" for key, _ in made.heard[heard:]))
    (told,) = made.asked("linemate/west/status")
    assert "error" in told


def test_it_ends_as_told_and_refuses_to_be_reached_by_others(made: Fleet, tmp_path: Path) -> None:
    made.bridge.terminate()
    assert made.bridge.wait(10.0) == 0
    done = subprocess.run(
        [*LINEMATE, "bridge", "--listen", "tcp/0.0.0.0:7447"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "--allow-remote" in done.stderr


def test_what_changes_is_told_once_and_ages_are_no_events() -> None:
    before = {
        "state": "idle",
        "health": "healthy",
        "complaints": [],
        "links": {"robot": {"up": True}},
    }
    after = {
        "state": "fault",
        "health": "healthy",
        "complaints": ["link robot is down"],
        "links": {"robot": {"up": False, "age_s": 2.0}},
    }
    assert list(messages.changes(before, after)) == [
        messages.event("state", "idle", "fault"),
        messages.event("link robot", "up", "down"),
        messages.event("complaint", None, "link robot is down"),
    ]
    assert list(messages.changes(after, {**after, "links": {"robot": {"up": False}}})) == []
    assert list(messages.changes(None, before)) == [messages.event("answers", False, True)]
