"""The emulator's own judgement of setpoints."""

import math
import random

import pytest

from linemate.simulators.devices.limit_judge import KEPT, AxisLimit, LimitJudge

T0 = 0.012
LIMIT = AxisLimit(low=-1.0, high=1.0, speed=0.5, acceleration=2.0, jerk=50.0)


def _judge() -> LimitJudge:
    judge = LimitJudge(T0, (LIMIT,) * 7)
    judge.start((0.0,) * 7)
    return judge


def _feed(judge: LimitJudge, positions: list[float], axis: int = 0) -> None:
    for position in positions:
        setpoints = [0.0] * 7
        setpoints[axis] = position
        judge.judge(setpoints)


def _start_moving(judge: LimitJudge, speed: float) -> None:
    judge.start((0.0,) * 7)
    assert judge._past is not None
    judge._past[1, 0] = speed


def _ramp(jerk: float, acceleration: float, speed: float, count: int) -> list[float]:
    """Positions whose finite differences reach the given values and stay there."""
    positions, x, v, a = [], 0.0, 0.0, 0.0
    for _ in range(count):
        target = min(acceleration, (speed - v) / T0)
        a += max(min(target - a, jerk * T0), -jerk * T0)
        v += a * T0
        x += v * T0
        positions.append(x)
    return positions


def test_motion_within_every_limit_is_not_blamed() -> None:
    judge = _judge()
    _feed(judge, _ramp(jerk=40.0, acceleration=1.5, speed=0.2, count=30))
    assert judge.violations == 0
    assert 0.0 < judge.worst["speed"] < 1.0


@pytest.mark.parametrize(
    ("position", "kind"), [(1.01, "position"), (-1.01, "position"), (0.007, "speed")]
)
def test_each_kind_of_excess_is_named(position: float, kind: str) -> None:
    judge = _judge()
    _feed(judge, [position])
    assert judge.counts[kind] == 1
    assert judge.evidence[0].axis == 0
    assert judge.evidence[0].cycle == 1


def test_acceleration_and_jerk_are_judged_apart() -> None:
    judge = _judge()
    _feed(judge, [1.9 * T0 * T0])  # within the acceleration, not reached within the jerk
    assert judge.counts == {"jerk": 1}
    judge = _judge()
    _feed(judge, [0.5 * i * T0 * T0 * (i + 1) * 0.5 for i in range(1, 6)])
    assert judge.counts["acceleration"] == 0
    _feed(judge, [judge.evidence[-1].value if judge.evidence else 0.1])
    assert judge.counts["acceleration"] >= 1


def test_rounding_on_the_wire_is_granted_and_no_more() -> None:
    rng = random.Random(3)
    tight = AxisLimit(-1.0, 1.0, speed=0.1, acceleration=1e-9, jerk=1e-9)
    judge = LimitJudge(T0, (tight,) * 7)
    exact = [0.05 * T0 * n for n in range(200)]
    rounded = [math.radians(round(math.degrees(x), 8)) for x in exact]
    _start_moving(judge, 0.05)
    _feed(judge, rounded[1:])
    assert judge.violations == 0
    coarse = [math.radians(round(math.degrees(x), 6) + rng.choice((0, 1e-6))) for x in exact]
    _start_moving(judge, 0.05)
    _feed(judge, coarse[1:])
    assert judge.violations > 0


def test_a_cycle_in_which_the_controller_held_is_no_ones_fault() -> None:
    judge = _judge()
    moving = _ramp(jerk=40.0, acceleration=1.5, speed=0.3, count=30)
    _feed(judge, moving)
    judge.hold([moving[-1]] + [0.0] * 6)
    assert judge.violations == 0
    _feed(judge, [moving[-1] + 0.3 * T0])  # going on at full speed from rest is somebody's
    assert judge.counts["acceleration"] == 1


def test_evidence_is_bounded() -> None:
    judge = _judge()
    _feed(judge, [0.9, -0.9] * 100)
    assert len(judge.evidence) == KEPT
    assert judge.violations > KEPT


def test_what_is_not_a_number_is_an_excess() -> None:
    judge = _judge()
    _feed(judge, [math.nan])
    assert judge.counts["position"] == 1


@pytest.mark.parametrize("goes_on", [True, False])
def test_after_a_slip_going_on_and_beginning_from_rest_are_both_granted(goes_on: bool) -> None:
    judge = _judge()
    there = _ramp(jerk=40.0, acceleration=1.5, speed=0.2, count=60)
    _feed(judge, there)
    judge.slip()
    fresh = _ramp(jerk=40.0, acceleration=1.5, speed=0.2, count=30)
    onward = [0.2 * T0 * n for n in range(1, 31)]
    _feed(judge, [there[-1] + x for x in (onward if goes_on else fresh)])
    assert judge.violations == 0


def test_after_a_slip_speed_is_judged_at_once_and_the_rest_soon() -> None:
    judge = _judge()
    judge.slip()
    _feed(judge, [0.6 * T0])
    assert judge.counts == {"speed": 1}
    _feed(judge, [0.6 * T0])
    assert judge.counts == {"speed": 1, "acceleration": 1}
    _feed(judge, [0.6 * T0])
    assert judge.counts == {"speed": 1, "acceleration": 1, "jerk": 1}


def test_judging_many_at_once_is_judging_each_by_itself() -> None:
    rng = random.Random(4)
    together, singly = _judge(), _judge()
    position = [0.0] * 7
    for _ in range(600):
        position = [q + rng.gauss(0.0, 0.004) for q in position]
        act = rng.choices(("judge", "hold", "slip", "start"), (80, 5, 5, 2))[0]
        for judge in (together, singly):
            if act == "slip":
                judge.slip()
            else:
                getattr(judge, act)(position)
        assert singly.violations >= 0  # asked for each cycle
    assert together.violations > 100
    assert together.counts == singly.counts
    assert together.worst == singly.worst
    assert together.evidence == singly.evidence
