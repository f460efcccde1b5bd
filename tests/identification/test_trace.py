"""Recorded steps become arrays: who answered what, and what the controller held."""

from dataclasses import dataclass, replace
from itertools import count

import numpy as np
import pytest

from linemate.daemon.core import rotations
from linemate.daemon.core.inputs import Inputs
from linemate.daemon.identification.trace import build_trace, tcp_path
from linemate.protocol.stamped_samples import (
    CameraSample,
    DistanceSample,
    RobotSample,
    WrenchSample,
)

T0_NS = 12_000_000
EPOCH_NS = 8_000_000_000
NOMINAL = rotations.matrix((0.7071067811865476, 0.0, 0.7071067811865476, 0.0))


@dataclass(frozen=True)
class Step:
    counter: int | None
    inputs: Inputs
    command: tuple[float, ...]
    contact: bool = False
    limited: bool = False


def kinematics(joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A robot whose first three axes are the tcp's position in base."""
    return joints[:3], NOMINAL @ rotations.exp(joints[3:6])


def steps(n: int = 60, silent: tuple[int, ...] = (), touching: range = range(0)) -> list[Step]:
    """The robot answers 0.01 k in cycle k; step k is given the telegram of k - 1."""
    made = []
    numbers = count(1)
    for k in range(n):
        stamp = EPOCH_NS + k * T0_NS
        robot = None
        if k > 0 and k - 1 not in silent:
            at = 0.01 * (k - 1)
            joints = (at, 0.0, 0.0, 0.0, 0.0, 0.0)
            robot = RobotSample(stamp - T0_NS, 1000 + k - 1, joints, (0.5 * at,))
        inputs = Inputs(
            k=k,
            stamp_ns=stamp,
            robot=robot,
            distance=(DistanceSample(stamp - 1, 0.1 * k),),
            camera=(
                CameraSample(
                    stamp, stamp - 100_000_000, "camera", "camera", "hub", next(numbers),
                    (0.0, 0.0, 0.4), (1.0, 0.0, 0.0, 0.0),
                    tuple(1e-6 if i in {0, 6, 11} else 4e-6 for i in range(21)) if k % 2 else None,
                ),
            ),
            wrench=(WrenchSample(stamp - 2, (float(k), 0.0, 0.0), (0.0, 0.0, 1.0)),),
        )  # fmt: skip
        command = (0.02 * k, *[0.0] * 6)
        counter = None if k in silent else 1000 + k
        made.append(Step(counter, inputs, command, k in touching))
    return made


def test_answers_stand_next_to_the_commands_of_their_own_telegram() -> None:
    trace = build_trace(steps(), kinematics, NOMINAL)
    assert trace.cycle_s == pytest.approx(0.012)
    assert trace.commands[:, 0] == pytest.approx(0.02 * np.arange(60))
    assert trace.answers[:59, 0] == pytest.approx(0.01 * np.arange(59))
    assert trace.answers[:59, 6] == pytest.approx(0.005 * np.arange(59))
    assert np.isnan(trace.answers[59]).all()


def test_where_no_command_was_sent_the_controller_held() -> None:
    trace = build_trace(steps(silent=(20, 21)), kinematics, NOMINAL)
    assert trace.commands[19:23, 0] == pytest.approx([0.38, 0.38, 0.38, 0.44])
    assert np.isnan(trace.answers[20:22]).all()
    assert np.isfinite(trace.answers[22]).all()


def test_samples_keep_their_own_times() -> None:
    trace = build_trace(steps(), kinematics, NOMINAL)
    assert trace.distances[1] == pytest.approx([0.012 - 1e-9, 0.1])
    assert trace.images.exposures[10] == pytest.approx(0.12 - 0.1)
    assert trace.images.arrivals[10] == pytest.approx(0.12)
    assert np.isnan(trace.images.deviations[10]).all()
    assert trace.images.deviations[11] == pytest.approx([1e-3] * 3 + [2e-3] * 3)
    assert trace.wrenches[5, 1:] == pytest.approx([5.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def test_the_way_of_the_tcp_is_known_between_telegrams_and_not_across_gaps() -> None:
    trace = build_trace(steps(silent=tuple(range(30, 36))), kinematics, NOMINAL)
    path = tcp_path(trace)
    asked = np.array([0.1, 0.1234, 0.39, 0.6, 5.0])
    assert path.known(asked).tolist() == [True, True, False, True, False]
    position, _ = path.at(asked[:2])
    in_base = position @ NOMINAL.T
    assert in_base[:, 0] == pytest.approx(0.01 * asked[:2] / 0.012)
    assert path.rates(asked[:1])[0, 2] == pytest.approx(0.01 / 0.012)


def test_contacts_are_remembered_with_begin_and_end() -> None:
    trace = build_trace(steps(touching=range(20, 30)), kinematics, NOMINAL)
    assert trace.contact == pytest.approx(np.array([[0.24, 0.36]]))
    asked = np.array([0.2, 0.3, 0.4])
    assert trace.in_contact(asked).tolist() == [False, True, False]
    assert trace.in_contact(asked, 0.05).tolist() == [True, True, True]
    endless = build_trace(steps(touching=range(50, 60)), kinematics, NOMINAL)
    assert endless.contact[0, 1] == pytest.approx(59 * 0.012)


def test_answers_to_setpoints_at_their_limits_are_left_out_for_a_while() -> None:
    made = steps(200)
    made[50] = replace(made[50], limited=True)
    answers = build_trace(made, kinematics, NOMINAL).answers[:, 0]
    assert np.isfinite(answers[[49, 140]]).all()
    assert np.isnan(answers[50:130]).all()


def test_too_little_to_work_with_is_refused() -> None:
    with pytest.raises(ValueError, match="too short"):
        build_trace(steps(5), kinematics, NOMINAL)
    with pytest.raises(ValueError, match="no telegrams"):
        build_trace(steps(silent=tuple(range(60))), kinematics, NOMINAL)
