"""The way of an ordinary telegram, from the socket to the socket, is as short as the page says."""

import re
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from linemate.drivers.udp.robot_udp import RobotLink
from linemate.simulators.lab.faults.dst_plan import FaultPlan
from linemate.simulators.lab.faults.dst_run import Simulation

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "architecture.md"
MOST_RETURNS = 15
SHIPPED = ("daemon/", "drivers/", "protocol/")


def walked(duration_s: float, patch: pytest.MonkeyPatch) -> list[str]:
    """Return the files of the last telegram with a ready reply, in the order of their calls."""
    way: list[str] = []
    attend = RobotLink.attend
    outside = 0

    def note(frame: FrameType, event: str, _arg: Any) -> None:
        nonlocal outside
        path = frame.f_code.co_filename.removeprefix(f"{ROOT}/")
        if path.startswith("simulators/") and event in {"call", "return"}:
            outside += 1 if event == "call" else -1
        elif event == "call" and not outside and path.startswith(SHIPPED):
            called.append(path)

    called: list[str] = []

    def attended(link: RobotLink, until_ns: int) -> bool:
        before = link.counters["answered"]
        called.clear()
        profile = sys.getprofile()
        sys.setprofile(note)
        try:
            return attend(link, until_ns)
        finally:
            sys.setprofile(profile)
            if link.counters["answered"] > before:
                way[:] = called

    patch.setattr(RobotLink, "attend", attended)
    Simulation(FaultPlan(0, duration_s=duration_s, lead_ms=3.0)).live()
    return [path for n, path in enumerate(way) if n == 0 or way[n - 1] != path]


def test_an_ordinary_telegram_visits_the_ten_files_of_the_page(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    way = walked(0.1, monkeypatch)
    page = PAGE.read_text().partition("## One telegram")[2].partition("\n## ")[0]
    named = re.findall(r"^\| `([a-z0-9_/]+\.py)` \|", page, re.MULTILINE)
    assert list(dict.fromkeys(way)) == named
    assert len(way) - len(named) <= MOST_RETURNS
