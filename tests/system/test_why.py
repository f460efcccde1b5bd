"""A whole service says why it stopped: in its journal, and in its answers to orders."""

import asyncio
import logging
import re
from collections import Counter
from typing import Any

import pytest

from linemate.daemon.service.app import App
from linemate.simulators.lab.faults.dst_log import MOST_LINES
from linemate.simulators.lab.faults.dst_plan import FaultPlan
from linemate.simulators.lab.faults.dst_run import Simulation
from linemate.simulators.plants.scenario import Fault

Line = tuple[int, str, str]
FREE_S = -0.05
"""Before the last approach, in which a clamp may have closed: scenario time [s]."""


class Lines(logging.Handler):
    """The daemon's lines with their virtual second."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.simulation: Simulation | None = None
        self.lines: list[Line] = []

    def emit(self, record: logging.LogRecord) -> None:
        assert self.simulation is not None
        second = self.simulation._time.now_ns // 10**9
        self.lines.append((second, record.levelname, record.getMessage()))


def lived(*faults: Fault, monkeypatch: pytest.MonkeyPatch) -> tuple[list[Line], list[Any]]:
    """A run's journal, and what each order was answered in the end."""
    answers: list[tuple[str, Any]] = []
    handle = App._handle

    def noting(app: App, op: str, *rest: Any) -> Any:
        answer = handle(app, op, *rest)
        answers.append((op, answer))
        return answer

    monkeypatch.setattr(App, "_handle", noting)
    journal = Lines()
    logger = logging.getLogger("linemate")
    logger.addHandler(journal)
    try:
        journal.simulation = Simulation(FaultPlan(seed=3, duration_s=3.0, faults=faults))
        journal.simulation.live()
    finally:
        logger.removeHandler(journal)
    ended = [
        (op, answer.result() if isinstance(answer, asyncio.Future) else answer)
        for op, answer in answers
    ]
    return journal.lines, ended


def test_arm_and_start_answer_the_state_after_the_order(monkeypatch: pytest.MonkeyPatch) -> None:
    _, answers = lived(monkeypatch=monkeypatch)
    taken = [(op, answer) for op, answer in answers if "refused" not in answer]
    assert taken[:2] == [("arm", {"state": "armed"}), ("start", {"state": "track"})]
    assert all(answer["refused"] for _, answer in answers if "refused" in answer)


@pytest.mark.parametrize(
    ("faults", "cause"),
    [
        (
            (Fault(FREE_S, "camera", "silence", 3.0), Fault(FREE_S, "distance", "silence", 3.0)),
            r"track -> hold: no fresh position: distance silent for 0\.3\d s, camera silent for "
            r"0\.3\d s \(limit 0\.30 s\)\. Check the link of distance and camera\.",
        ),
        (
            (Fault(FREE_S, "force_torque", "silence", 3.0),),
            r"track -> hold: no fresh force: force_torque silent for 0\.1\d s \(limit 0\.1\d s\)",
        ),
        (
            (Fault(FREE_S, "robot", "silence", 0.5),),
            r"track -> hold: telegrams missing: no answered telegram for 0\.\d\d s, limit 0\.\d\d s"
            r"|track -> fault: robot link lost in motion: no answered telegram for 0\.\d\d s",
        ),
    ],
)
def test_the_journal_of_a_whole_run_says_why_it_stopped(
    faults: tuple[Fault, ...], cause: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines, _ = lived(*faults, monkeypatch=monkeypatch)
    changes = [text for _, level, text in lines if level == "INFO" and " -> " in text]
    assert any(re.match(cause, text) for text in changes), changes
    assert max(Counter(second for second, _, _ in lines).values()) <= MOST_LINES
