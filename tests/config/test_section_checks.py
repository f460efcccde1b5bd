"""Which gates wait for a signal, and what to set instead."""

from dataclasses import replace

from linemate.daemon.config import task_file
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.config.section_checks import waiting_gates

WHEEL = task_file.load(DAEMON_DATA / "wheel.yaml").file


def test_the_shipped_task_waits_for_both_signals() -> None:
    assert list(waiting_gates(WHEEL)) == [
        ("waypoints[5] waits for screws_fixed", "tool.fixed_after"),
        ("waypoints[7] waits for wheel_released", "tool.released_after"),
    ]


def test_a_time_stands_for_a_signal() -> None:
    tool = replace(WHEEL.tool, fixed_after=1.0, released_after=0.5)
    assert list(waiting_gates(replace(WHEEL, tool=tool))) == []
