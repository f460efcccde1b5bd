"""Servos are learned again from a whole wheel, by nothing but commands and answers."""

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
from msgspec import structs

from linemate.daemon.core.control import adaptation
from linemate.daemon.core.control.adaptation import AdaptationSettings
from linemate.daemon.core.control.settings import ServoModel
from linemate.daemon.core.horizon import Array
from linemate.daemon.cycle.learning.servos import WORTH, Learner
from linemate.daemon.cycle.step_log import LogEntry
from linemate.simulators.harness import lockstep, setup


@cache
def wheel(factor: float) -> tuple[tuple[ServoModel, ...], tuple[LogEntry, ...]]:
    """The servos that the daemon believed in, and all steps of a wheel with others."""
    axes = setup.make("wheel").scenario.robot.axes
    slower = [
        f"scenario.robot.axes.{n}.frequency_hz={factor * axis.frequency_hz:.6g}"
        for n, axis in enumerate(axes)
    ]
    made = setup.make("wheel", slower)
    entries: list[LogEntry] = []
    lockstep.run(made, 0, on_step=entries.append)
    return made.control.servos, tuple(entries)


def learner(servos: tuple[ServoModel, ...], **bounds: float) -> Learner:
    return Learner(AdaptationSettings(**bounds), servos, 0.012)


@pytest.mark.row
@pytest.mark.parametrize("factor", [0.9, 1.0])
def test_a_wheel_tells_how_quick_the_servos_have_become(factor: float) -> None:
    servos, entries = wheel(factor)
    mine = learner(servos)
    for entry in entries:
        mine.record_motion([entry])
    assert mine.ripe
    values = mine.keep(mine.estimate_servos(mine.motion()), servos)
    assert not mine.ripe
    if factor == 1.0:
        assert not values
        return
    # A1, A2, A3 and E1 carry the approach; an axis that hardly moved keeps what it has.
    for axis in (0, 1, 2):
        found = values[f"control.servos.{axis}.frequency_hz"]
        assert found == pytest.approx(factor * servos[axis].frequency_hz, rel=0.02)
    for name, found in values.items():
        axis = int(name.split(".")[2])
        assert factor - 0.02 < found / servos[axis].frequency_hz < 1.0 - WORTH


def test_what_is_learned_stays_within_its_reach() -> None:
    servos, entries = wheel(0.9)
    mine = learner(servos, reach=0.04)
    mine.record_motion(entries)
    values = mine.keep(mine.estimate_servos(mine.motion()), servos)
    assert values
    for name, found in values.items():
        axis = int(name.split(".")[2])
        assert found >= (1.0 - 0.04 - 1e-5) * servos[axis].frequency_hz


def test_models_that_were_taken_back_are_learned_as_at_first() -> None:
    servos, entries = wheel(0.9)
    mine = learner(servos)
    mine.record_motion(entries)
    first = mine.keep(mine.estimate_servos(mine.motion()), servos)
    assert first
    mine.record_motion([entry for entry in entries if entry.state == "idle"])
    assert mine.keep(mine.estimate_servos(mine.motion()), servos) == {}
    mine.record_motion(entries)
    assert mine.keep(mine.estimate_servos(mine.motion()), servos) == first


def test_a_robot_that_did_not_move_teaches_nothing() -> None:
    servos, entries = wheel(0.9)
    mine = learner(servos)
    mine.record_motion([entry for entry in entries if entry.state == "idle"])
    assert not mine.ripe
    assert not mine.keep(mine.estimate_servos(mine.motion()), servos)


def windows_of(patch: pytest.MonkeyPatch, entries: Sequence[LogEntry]) -> list[Array]:
    """The setpoints (n, 7) of each window that is evaluated."""
    windows: list[Array] = []

    def update(*arguments: object) -> object:
        windows.append(arguments[3].commands)  # type: ignore[attr-defined]
        return arguments[2]

    patch.setattr(adaptation, "update", update)
    mine = learner(wheel(0.9)[0])
    mine.record_motion(entries)
    mine.estimate_servos(mine.motion())
    return windows


def test_a_window_joins_no_cycles_that_are_not_neighbours(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps that the log has lost looked like a jump of the setpoints."""
    _, entries = wheel(0.9)
    largest = max(np.abs(np.diff(each, axis=0)).max() for each in windows_of(monkeypatch, entries))
    lost = [*entries[:600], *entries[660:]]
    windows = windows_of(monkeypatch, lost)
    assert len(windows) >= 4
    assert max(np.abs(np.diff(each, axis=0)).max() for each in windows) <= largest


def test_a_robot_without_a_command_holds_the_one_before(monkeypatch: pytest.MonkeyPatch) -> None:
    _, entries = wheel(0.9)
    n, lost = 600, list(entries)
    lost[n] = structs.replace(lost[n], inputs=structs.replace(lost[n].inputs, sent=False))
    windows = np.vstack(windows_of(monkeypatch, lost))
    whole = np.vstack(windows_of(monkeypatch, entries))
    (row,) = np.flatnonzero((windows != whole).any(axis=1))
    assert windows[row].tolist() == whole[row - 1].tolist() == list(entries[n - 2].outputs.command)
