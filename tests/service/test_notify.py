"""What systemd hears, on real sockets."""

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from linemate.daemon.service.host.notify import Notifier


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[socket.socket, str]]:
    address = str(tmp_path / "notify") if request.param == "path" else f"@linemate-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind("\0" + address[1:] if address[0] == "@" else address)
        listening.setblocking(False)
        yield listening, address


def test_the_manager_gets_its_own_messages(manager: tuple[socket.socket, str]) -> None:
    listening, address = manager
    notifier = Notifier(address)
    notifier.ready("IDLE")
    assert listening.recv(200) == b"READY=1\nSTATUS=IDLE"
    notifier.stopping()
    assert listening.recv(200) == b"STOPPING=1"
    notifier.reloading()
    assert listening.recv(200).startswith(b"RELOADING=1\nMONOTONIC_USEC=")


def test_the_watchdog_is_fed_three_times_in_its_period(manager: tuple[socket.socket, str]) -> None:
    listening, address = manager
    notifier = Notifier(address, watchdog_s=0.3)
    for ms in range(0, 300, 4):
        notifier.alive(1_000_000_000 + ms * 1_000_000)
    assert [listening.recv(50) for _ in range(3)] == [b"WATCHDOG=1"] * 3
    with pytest.raises(BlockingIOError):
        listening.recv(50)


def test_without_a_manager_nothing_happens_and_nothing_is_raised(tmp_path: Path) -> None:
    assert not Notifier().send("READY=1")
    assert not Notifier(str(tmp_path / "gone")).send("READY=1")
    Notifier().alive(5)


@pytest.mark.parametrize(
    ("environment", "watchdog_s"),
    [
        ({}, None),
        ({"WATCHDOG_USEC": "2000000"}, 2.0),
        ({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getpid())}, 2.0),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
    ],
)
def test_the_environment_says_whether_we_are_watched(
    monkeypatch: pytest.MonkeyPatch, environment: dict[str, str], watchdog_s: float | None
) -> None:
    for name in ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    notifier = Notifier.from_environment()
    assert notifier.watchdog_s == watchdog_s
    assert not notifier.address
