"""The daemon's process next to a robot: what its replies take, with stalled views and without."""

import contextlib
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from daemon_process import DaemonProcess
from plain_robot import CYCLE_S, PlainRobot

from linemate.protocol.command.local_client import LocalClient

TEXT = """
task: wheel.yaml
rsi: {port: 0}
command: {socket: c.sock}
realtime: {freeze_collector: false}
"""
ROUNDS = 3
CYCLES = 60
STALLED = 3
LONG_ENOUGH = round(6.0 / CYCLE_S)
"""Cycles in which a socket's buffer fills at 50 telemetries a second."""


@contextlib.contextmanager
def stalled(path: Path) -> Iterator[socket.socket]:
    """One who subscribes at the highest rate and never reads again."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as end:
        end.settimeout(5.0)
        end.connect(str(path))
        core = LocalClient()
        end.send(core.hello(time.monotonic_ns()))
        core.on_datagram(end.recv(4096), time.monotonic_ns())
        assert core.ready
        wanted = {"rate_hz": 50.0, "duration_s": 30.0}
        end.send(core.request("subscribe", wanted, time.monotonic_ns() + 4_000_000_000).frame)
        yield end


def quick_ms(took: list[float | None]) -> float:
    """What a tenth of the replies took at most: what the daemon needs, without the machine's own
    troubles, which are the same with and without subscribers."""
    came = sorted(seconds for seconds in took if seconds is not None)
    assert len(came) > len(took) // 2
    return 1e3 * came[len(came) // 10]


@pytest.mark.timeout(120)
def test_replies_take_no_longer_with_views_that_do_not_read(tmp_path: Path) -> None:
    alone: list[float | None] = []
    watched: list[float | None] = []
    with DaemonProcess(tmp_path, TEXT) as daemon:
        path = Path(daemon.listening["command"]["socket"])
        robot = PlainRobot(daemon.robot())
        with contextlib.closing(robot):
            robot.cycles(CYCLES)  # it settles
            for _ in range(ROUNDS):
                alone += robot.cycles(CYCLES)
                with contextlib.ExitStack() as stack:
                    for _ in range(STALLED):
                        stack.enter_context(stalled(path))
                    watched += robot.cycles(CYCLES)
            # Six seconds of a shared machine are held against those on either side of them.
            alone += robot.cycles(LONG_ENOUGH // 2)
            with contextlib.ExitStack() as stack:
                ends = [stack.enter_context(stalled(path)) for _ in range(STALLED)]
                watched += robot.cycles(LONG_ENOUGH)
                counters = daemon.status()["commands"]["counters"]
                assert len(ends) == STALLED
            alone += robot.cycles(LONG_ENOUGH // 2)
        assert counters["connections_dropped"] == STALLED
        assert quick_ms(watched) < quick_ms(alone) + 0.2, (quick_ms(alone), quick_ms(watched))
