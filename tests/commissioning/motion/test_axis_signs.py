"""Sign and size of axes from made commands and answers."""

import numpy as np
import pytest

from linemate.daemon.commissioning.motion.axis_signs import find_signs
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.inputs import Inputs
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal
from linemate.daemon.recording.step_codec import StepRecord
from linemate.protocol.stamped_samples import RobotSample

STEP = 0.0035


def moved(gains: Array, moves: int = 7, state: str = "track") -> dict[str, Outcome]:
    """Each axis turns and comes back; the robot answers 100 ms later, by gains (7, 7)."""
    rng = np.random.default_rng(1)
    commands = [np.zeros(7)] * 120
    for axis in range(moves):
        for begin, end in ((0.0, STEP), (STEP, 0.0)):
            way = np.zeros((167, 7))
            way[:, axis] = np.linspace(begin, end, 167)
            commands += [*way, *([way[-1]] * 100)]
    records = []
    for k, command in enumerate(commands):
        answer = gains @ commands[max(0, k - 8)] + rng.normal(0.0, 1e-6, 7)
        robot = RobotSample(12_000_000 * k, k, tuple(answer[:6].tolist()), (float(answer[6]),))
        inputs = Inputs(k, 12_000_000 * k, robot)
        records.append(StepRecord(k, state, inputs, {"command": tuple(command.tolist())}))
    return {line.name: line.outcome for line in find_signs(records)}


def test_axes_that_move_as_commanded_have_the_size_one() -> None:
    lines = moved(np.eye(7))
    assert list(lines)[-1] == "E1 moved for commanded"
    assert len(lines) == 7
    for outcome in lines.values():
        assert isinstance(outcome, Estimate)
        assert outcome.value == pytest.approx(1.0, abs=2e-3)


def test_an_axis_that_moves_the_other_way_is_named() -> None:
    gains = np.eye(7)
    gains[2, 2] = -1.0
    lines = moved(gains)
    outcome = lines["A3 moved for commanded"]
    assert isinstance(outcome, Refusal)
    assert outcome.reason.startswith("A3 moves the other way: -1.000 of its command")
    assert sum(isinstance(each, Refusal) for each in lines.values()) == 1


def test_degrees_instead_of_radians_and_a_dead_axis_are_refused() -> None:
    gains = np.eye(7)
    gains[0, 0], gains[5, 5] = np.pi / 180.0, 0.0
    lines = moved(gains)
    for name in ("A1", "A6"):
        outcome = lines[f"{name} moved for commanded"]
        assert isinstance(outcome, Refusal)
        assert "should be 1 +-0.05" in outcome.reason


def test_a_linear_axis_that_moves_the_other_way_is_named() -> None:
    gains = np.eye(7)
    gains[6, 6] = -1.0
    outcome = moved(gains)["E1 moved for commanded"]
    assert isinstance(outcome, Refusal)
    assert outcome.reason.startswith("E1 moves the other way: -1.000 of its command")


def test_a_command_that_follows_a_robot_moved_by_hand_proves_no_sign() -> None:
    (line,) = moved(np.eye(7), state="idle").values()
    assert isinstance(line, Refusal)
    assert line.reason.startswith("the axes were not moved")


def test_axes_that_are_exchanged_are_named() -> None:
    gains = np.eye(7)
    gains[[3, 4]] = gains[[4, 3]]
    outcome = moved(gains)["A4 moved for commanded"]
    assert isinstance(outcome, Refusal)
    assert "a command for A4 moves A5 by 1.00 of it" in outcome.reason


def test_an_axis_that_was_not_moved_is_refused_and_so_is_a_robot_at_rest() -> None:
    assert isinstance(moved(np.eye(7), moves=5)["A6 moved for commanded"], Refusal)
    (line,) = find_signs([])
    assert isinstance(line.outcome, Refusal)
