"""``linemate status --watch``: its screen, alone and on a pseudo-terminal, and Ctrl-C."""

import fcntl
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from command_ends import open_port, served

from linemate.daemon.operator import render
from linemate.daemon.operator.main import main

LINEMATE = (sys.executable, "-m", "linemate.daemon.operator.main")
LINK = {"up": True, "rate_hz": 83.3, "age_s": 0.004, "reason": "", "counters": {"answered": 9}}
STATUS: dict[str, Any] = {
    "version": 1, "health": "degraded",
    "complaints": [f"complaint {i} of a sensor that has a long reason to be complained of " * 2
                   for i in range(9)],
    "task": "wheel", "pid": 4711, "uptime_s": 3723.4, "state": "track",
    "because": "start", "cause": "start: the part is in reach",
    "links": dict.fromkeys(("robot", "distance", "camera", "force_torque"), LINK),
    "sensors": {"camera": {"out": "frozen: no change for 0.15 s", "since_s": 1.0}},
    "turnaround_us": {"p50": 300.0, "p99": 420.0, "p999": 700.0, "max": 1310.0},
    "late": 2, "missing": 1, "clock": {"period_ms": 12.0012},
    "dead_time": {"drift_ms": 32.5, "least_ms": 0.0, "most_ms": 110.0}, "host": ["a", "b"],
    "recording": {"recording": True, "file": "/var/x/run.mcap", "written": 12, "dropped": 0},
    "phase": "approach", "task_time": 4.321, "ready": None, "scenario": "running",
    "scenario_state": "confirmed", "confidence": 4.25, "speed": 0.1063, "held": None,
    "contact": False, "target": [1.0, 0, 0, 1, 0, 0, 0], "sensed": [1.001, 0, 0, 1, 0, 0, 0],
    "part": [1.2, 0, 0, 1, 0, 0, 0], "command": [0.0] * 7,
}  # fmt: skip


def shown(status: Mapping[str, Any] | None, *args: Any) -> str:
    return "\n".join(render.screen(status, *args))


def test_a_screen_has_the_head_of_the_view() -> None:
    text = shown(STATUS)
    for part in (
        "wheel", "up 1:02:03", "TRACK", "the part is in reach", "degraded", "approach", "4.32 s",
        "running confirmed", "106 mm/s", "plan 1.00 mm", "tool to part 200.00 mm", "late 2",
        "dead time drifted by 32.5 ms",
        "max 1.31 ms of 12.00 ms", "83 Hz", "excluded: frozen", "run.mcap: 12 steps",
    ):  # fmt: skip
        assert part in text, part


@pytest.mark.parametrize("size", [(80, 24), (200, 60), (79, 20), (40, 10), (10, 3), (1, 1)])
def test_a_screen_never_exceeds_24_lines_of_80_columns_or_the_terminal(
    size: tuple[int, int],
) -> None:
    for status in (STATUS, {}, {"health": "healthy"}, None):
        for trouble in ("", "no answer " * 30):
            lines = render.screen(status, trouble, *size)
            assert 0 < len(lines) <= min(24, size[1])
            assert max(map(len, lines)) <= min(80, size[0])


def test_complaints_leave_space_for_the_rest() -> None:
    lines = render.screen(STATUS)
    assert len(lines) == 24
    assert lines[-1].startswith("--all")
    assert any("more, see --all" in line for line in lines)


def test_control_characters_of_a_status_do_not_reach_the_terminal() -> None:
    text = shown({"state": "\x1b[2J", "cause": "a\nb", "complaints": ["\x07"]}, "\x1b]0;x\x07")
    assert not set(text) & set("\x1b\x07")


def test_a_status_of_odd_values_is_drawn() -> None:
    odd = {**STATUS, "speed": None, "target": None, "links": None, "turnaround_us": {"p99": None}}
    assert "plan -" in shown(odd)
    assert "no answer" in shown(STATUS, "no answer").lower()


class Daemon:
    """A server of one status."""

    def __init__(self) -> None:
        self.asked = 0

    def handle(self, op: str, params: object, role: str, who: str) -> dict[str, Any]:
        del op, params, role, who
        self.asked += 1
        return STATUS


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Daemon]:
    daemon = Daemon()
    with open_port(tmp_path, (), daemon.handle) as port, served(port):
        yield daemon


class Terminal:
    """The other end of a command's pseudo-terminal."""

    def __init__(self, fd: int, process: "subprocess.Popen[bytes]") -> None:
        self.fd = fd
        self.process = process
        self.text = ""

    def resize(self, columns: int, lines: int) -> None:
        fcntl.ioctl(self.fd, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))

    def read(self, wanted: str, timeout_s: float = 20.0) -> str:
        """What comes until a text is in it."""
        end, text = time.monotonic() + timeout_s, ""
        while wanted not in text:
            ready, _, _ = select.select([self.fd], [], [], max(0.0, end - time.monotonic()))
            assert ready, f"{wanted!r} not in {text[-500:]!r}"
            try:
                data = os.read(self.fd, 65536)
            except OSError:  # the command has ended
                data = b""
            assert data, f"{wanted!r} not in {text[-500:]!r}"
            text += data.decode()
        return text


@contextmanager
def terminal(*words: str, size: tuple[int, int] = (80, 24)) -> Iterator[Terminal]:
    ours, theirs = pty.openpty()
    fcntl.ioctl(ours, termios.TIOCSWINSZ, struct.pack("HHHH", size[1], size[0], 0, 0))

    def take_terminal() -> None:
        os.setsid()
        fcntl.ioctl(theirs, termios.TIOCSCTTY, 0)

    with subprocess.Popen(
        [*LINEMATE, *words], stdin=theirs, stdout=theirs, stderr=theirs,
        preexec_fn=take_terminal,  # noqa: PLW1509 - two calls of the kernel, no lock
    ) as process:  # fmt: skip
        os.close(theirs)
        try:
            yield Terminal(ours, process)
        finally:
            process.kill()
            os.close(ours)


def drawn(text: str) -> list[str]:
    """The lines of the last whole screen in what a terminal received."""
    screen = text.rpartition("\x1b[J")[0].rpartition("\x1b[H")[2]
    return [re.sub(r"\x1b\[K", "", line) for line in screen.split("\r\n")]


@pytest.mark.usefixtures("daemon")
def test_the_screen_fits_the_terminal_and_follows_its_size(tmp_path: Path) -> None:
    socket = str(tmp_path / "command.sock")
    words = ("status", "--watch", "--interval", "60", "--socket", socket)
    with terminal(*words, size=(80, 24)) as pseudo:
        lines = drawn(pseudo.read("\x1b[J"))
        assert (len(lines), max(map(len, lines))) == (24, 80)
        # A new size draws again at once, not after the interval.
        for columns, rows in ((60, 15), (200, 60)):
            pseudo.resize(columns, rows)
            lines = drawn(pseudo.read("\x1b[J"))
            assert (len(lines), max(map(len, lines))) == (min(24, rows), min(80, columns))


@pytest.mark.usefixtures("daemon")
def test_ctrl_c_ends_it_within_a_second_and_restores_the_terminal(tmp_path: Path) -> None:
    words = ("status", "--watch", "--interval", "60", "--socket", str(tmp_path / "command.sock"))
    with terminal(*words) as pseudo:
        pseudo.read("\x1b[J")
        began = time.monotonic()
        os.write(pseudo.fd, b"\x03")
        text = pseudo.read("Ctrl-C ends")
        assert pseudo.process.wait(5.0) == 130
        assert time.monotonic() - began < 1.0
        assert "\x1b[?25h\x1b[?1049l" in text
        assert "Traceback" not in text


@pytest.mark.usefixtures("daemon")
def test_sigterm_restores_the_terminal(tmp_path: Path) -> None:
    words = ("status", "--watch", "--interval", "60", "--socket", str(tmp_path / "command.sock"))
    with terminal(*words) as pseudo:
        pseudo.read("\x1b[J")
        pseudo.process.send_signal(signal.SIGTERM)
        pseudo.read("\x1b[?25h\x1b[?1049l")


def test_a_daemon_that_ends_is_shown_with_its_last_status(tmp_path: Path) -> None:
    words = ("status", "--watch", "--interval", "0.1", "--socket", str(tmp_path / "command.sock"))
    with terminal(*words) as pseudo:
        pseudo.read("NO ANSWER")
        with open_port(tmp_path, (), Daemon().handle) as port, served(port):
            assert "NO ANSWER" not in drawn(pseudo.read("TRACK") + pseudo.read("\x1b[J"))[0]
        text = pseudo.read("NO ANSWER") + pseudo.read("\x1b[J")
        assert any("TRACK" in line for line in drawn(text))


Out = pytest.CaptureFixture[str]


def test_it_is_drawn_again_and_again_without_a_terminal_too(
    daemon: Daemon, tmp_path: Path, capsys: Out
) -> None:
    words = ["--socket", str(tmp_path / "command.sock"), "--for", "0.3", "--interval", "0.05"]
    assert main(["status", "--watch", *words]) == 1
    text = capsys.readouterr().out
    assert text.count("TRACK") == daemon.asked >= 3
    assert "\x1b" not in text


def test_every_key_is_behind_all_and_json_is_a_line_a_look(
    daemon: Daemon, tmp_path: Path, capsys: Out
) -> None:
    words = ["--socket", str(tmp_path / "command.sock"), "--for", "0.2", "--interval", "0.05"]
    assert main(["status", "--watch", "--all", *words]) == 1
    text = capsys.readouterr().out
    assert all(name in text for name, _ in render.rows(STATUS))
    assert main(["status", "--watch", "--json", *words]) == 1
    looks = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert looks[0] == STATUS
    assert daemon.asked > len(looks) > 1
