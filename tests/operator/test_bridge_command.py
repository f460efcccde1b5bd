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
TIMEOUT_S = 15.0


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
    endpoint: str
    heard: list[tuple[str, dict[str, Any]]] = field(default_factory=list)

    def until(self, found: Callable[[], bool]) -> None:
        end = time.monotonic() + TIMEOUT_S
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
        return [
            message["data"] for key, message in self.heard if key == f"linemate/{station}/events"
        ]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
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
        fleet = Fleet(daemons, bridge, session, endpoint)

        def hear(sample: Any) -> None:
            message = json.loads(sample.payload.to_string())
            fleet.heard.append((str(sample.key_expr), message))

        session.declare_subscriber("linemate/**", hear)
        yield fleet


def test_status_and_telemetry_of_every_station_come_by_themselves(fleet: Fleet) -> None:
    wanted = {
        f"linemate/{name}/{what}" for name in fleet.daemons for what in ("status", "telemetry")
    }
    fleet.until(lambda: wanted <= {key for key, _ in fleet.heard})
    for key, message in list(fleet.heard):
        assert message["version"] == 1
        assert key.split("/")[1] == message["station"]
    pids = {message["data"]["pid"] for key, message in fleet.heard if key.endswith("/status")}
    assert pids == {daemon.process.pid for daemon in fleet.daemons.values()}


def test_the_fleet_stands_in_one_table(fleet: Fleet) -> None:
    words = [*LINEMATE, "fleet", "--connect", fleet.endpoint]
    shown = subprocess.run(words, capture_output=True, text=True, check=False)
    assert shown.returncode == 1, shown.stderr  # without a robot no station is healthy
    head, *lines = shown.stdout.splitlines()
    assert head.startswith("station  health    state")
    assert [line.split()[:4] for line in lines] == [
        [name, "degraded", "init", "wheel"] for name in ("east", "west")
    ]
    shown = subprocess.run([*words, "--json"], capture_output=True, text=True, check=False)
    stations = json.loads(shown.stdout)["stations"]
    assert [(one["station"], one["in_sync"]) for one in stations] == [
        ("east", None),
        ("west", None),
    ]


def test_an_endpoint_without_a_station_gives_no_table() -> None:
    words = [*LINEMATE, "fleet", "--connect", f"tcp/127.0.0.1:{free_port()}"]
    shown = subprocess.run(words, capture_output=True, text=True, check=False)
    assert shown.returncode != 0
    assert not shown.stdout


def test_a_query_is_answered_by_each_station_itself(fleet: Fleet) -> None:
    answers: list[dict[str, Any]] = []
    fleet.until(
        lambda: len(answers[:] or answers.extend(fleet.asked("linemate/*/status")) or answers) == 2
    )
    assert {message["station"] for message in answers} == set(fleet.daemons)
    (message,) = fleet.asked("linemate/east/get?names=tracking.camera.gate,control.horizon_s")
    assert set(message["data"]["values"]) == {"tracking.camera.gate", "control.horizon_s"}
    (message,) = fleet.asked("linemate/west/params?prefix=tracking.camera")
    assert all(one["name"].startswith("tracking.camera") for one in message["data"]["params"])


@pytest.mark.parametrize(
    ("selector", "why"),
    [
        ("linemate/east/get", "names is missing"),
        ("linemate/east/get?names=x.y", "no parameter x.y"),
    ],
)
def test_a_query_that_cannot_be_answered_says_why(fleet: Fleet, selector: str, why: str) -> None:
    (message,) = fleet.asked(selector)
    assert why in message["error"]


def test_nothing_can_be_ordered_through_it(fleet: Fleet) -> None:
    before = fleet.daemons["east"].status()["commands"]["counters"]
    for op in ("arm", "set", "stop", "save", "record"):
        assert fleet.asked(f"linemate/east/{op}") == []
        fleet.session.put(f"linemate/east/{op}", b"{}")
    after = fleet.daemons["east"].status()["commands"]["counters"]
    refusals = {name for name in after if after[name] != before.get(name, 0)}
    assert not refusals & {"role", "lease", "unknown", "refused"}


def test_a_station_that_dies_is_an_event_and_the_other_goes_on(fleet: Fleet) -> None:
    alive = {str(reply.ok.key_expr) for reply in fleet.session.liveliness().get("linemate/*")}
    assert alive == {"linemate/east", "linemate/west"}
    west = fleet.daemons["west"].process
    west.send_signal(signal.SIGKILL)
    west.wait()
    gone = messages.event("answers", True, False)
    fleet.until(lambda: gone in fleet.events("west"))
    alive = {str(reply.ok.key_expr) for reply in fleet.session.liveliness().get("linemate/*")}
    assert alive == {"linemate/east"}
    heard = len(fleet.heard)
    fleet.until(lambda: any(key == "linemate/east/telemetry" for key, _ in fleet.heard[heard:]))
    (message,) = fleet.asked("linemate/west/status")
    assert "error" in message


def test_it_ends_by_a_signal_and_refuses_to_be_reached_by_others(
    fleet: Fleet, tmp_path: Path
) -> None:
    fleet.bridge.terminate()
    assert fleet.bridge.wait(10.0) == 0
    done = subprocess.run(
        [*LINEMATE, "bridge", "--listen", "tcp/0.0.0.0:7447"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "--allow-remote" in done.stderr


def test_a_change_is_one_event_and_ages_are_no_events() -> None:
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
