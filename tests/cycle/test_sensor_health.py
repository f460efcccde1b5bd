"""Sensors go out and come back in by rule, sample by sample."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linemate.daemon.cycle.sensing.samples import SensorQueues
from linemate.daemon.cycle.sensing.sensor_health import (
    BAD,
    CONTRADICTIONS,
    GOOD,
    OUTVOTING,
    REPEATED,
    SAME_POSES,
    SAME_WRENCHES,
    SMALL_JUMP,
    UNITS,
    CameraHealth,
    Conditions,
    DistanceHealth,
    Health,
    WrenchHealth,
)
from linemate.protocol.stamped_samples import CameraSample, DistanceSample, WrenchSample

PERIOD_NS = 10_000_000
SPEED = 0.106
SIGMA = 0.25e-3
MOVING = Conditions(moving=True, deviation=SIGMA)
RESTING = Conditions(moving=False, deviation=SIGMA)
APPROACHING = Conditions(moving=True, deviation=SIGMA, last_approach=True)
ONE = (1.0, 0.0, 0.0, 0.0)


class Conveyor:
    """A distance sensor at a conveyor, and its health."""

    def __init__(self, unit: float = 1e-3, seed: int = 1, conditions: Conditions = RESTING) -> None:
        self.health = DistanceHealth()
        self._conditions = conditions
        self.k = 0
        self.place = 0.5
        self._unit = unit
        self._chance = random.Random(seed)

    def reads(self) -> float:
        return round((self.place + self._chance.gauss(0.0, SIGMA)) / self._unit) * self._unit

    def run(self, samples: int, speed: float = SPEED) -> list[bool]:
        return [self.shows(None, speed) for _ in range(samples)]

    def shows(self, reading: float | None, speed: float = SPEED) -> bool:
        self.k += 1
        self.place += speed * PERIOD_NS * 1e-9
        shown = self.reads() if reading is None else reading
        return self.health.accepts(DistanceSample(self.k * PERIOD_NS, shown), self._conditions)


@pytest.mark.parametrize("unit", [1e-4, 1e-3, 1e-2])
def test_a_conveyor_that_runs_brakes_stands_and_starts_is_believed_throughout(unit: float) -> None:
    conveyor = Conveyor(unit)
    assert all(conveyor.run(300))
    for speed in (SPEED - 0.104 * 0.01 * n for n in range(102)):
        assert conveyor.shows(None, max(0.0, speed))
    assert all(conveyor.run(300, 0.0))
    assert all(conveyor.run(300))
    assert conveyor.health.outs == 0


def test_one_outlier_is_refused_and_nothing_else() -> None:
    conveyor = Conveyor()
    conveyor.run(100)
    assert not conveyor.shows(conveyor.place + 0.08)
    assert all(conveyor.run(100))
    assert conveyor.health.reason is None


@pytest.mark.parametrize("unit", [1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_jump_near_the_object_is_judged_by_the_sensors_own_deviation_and_unit(
    unit: float, sign: float
) -> None:
    conveyor = Conveyor(unit, conditions=APPROACHING)
    conveyor.run(100)
    least = max(SMALL_JUMP, UNITS * unit)
    conveyor.place += 2.2 * sign * least
    assert not any(conveyor.run(20))
    reason = conveyor.health.reason
    assert reason is not None
    assert "jumped" in reason


def test_a_jump_near_the_object_is_not_believed_because_time_has_passed() -> None:
    conveyor = Conveyor(conditions=APPROACHING)
    conveyor.run(100)
    conveyor.place += 0.03
    assert not any(conveyor.run(150))
    # Where it was heading before is forgotten after 2 s: it may have been wrong itself.
    assert conveyor.run(100)[-1]


def test_a_jump_stays_out_until_it_is_taken_back_though_a_stop_brings_it_where_it_headed() -> None:
    conveyor = Conveyor(conditions=APPROACHING)
    conveyor.run(100)
    conveyor.place += 0.03
    speeds = [max(0.0, SPEED - 0.104 * k * PERIOD_NS * 1e-9) for k in range(110)]
    assert not any(conveyor.shows(None, speed) for speed in speeds)
    # Where the sensor is right again at the place that it headed for, it is back.
    conveyor = Conveyor(conditions=APPROACHING)
    conveyor.run(100)
    for _ in range(20):
        conveyor.shows(conveyor.place + SPEED * PERIOD_NS * 1e-9 + 0.03)
    assert conveyor.run(GOOD)[-1]


def test_a_sensor_whose_deviation_is_not_known_yet_may_jump_by_30_mm() -> None:
    conveyor = Conveyor(conditions=APPROACHING)
    conveyor.run(OUTVOTING)
    assert conveyor.shows(conveyor.place + 0.02)


def test_a_jump_of_20_mm_is_left_to_the_camera_before_the_last_approach() -> None:
    conveyor = Conveyor()
    conveyor.run(100)
    conveyor.place += 0.02
    assert all(conveyor.run(20))


@pytest.mark.parametrize("unit", [1e-4, 1e-3, 1e-2])
def test_a_conveyor_that_runs_brakes_and_starts_is_believed_near_the_object(unit: float) -> None:
    conveyor = Conveyor(unit, conditions=APPROACHING)
    assert all(conveyor.run(300))
    for speed in (SPEED - 0.104 * 0.01 * n for n in range(102)):
        assert conveyor.shows(None, max(0.0, speed))
    assert all(conveyor.run(300, 0.0))
    assert all(conveyor.run(300))


@pytest.mark.parametrize("wrong", [1000.0, 1e-3, -1.0])
def test_a_wrong_unit_or_sign_is_never_believed_and_puts_the_sensor_out(wrong: float) -> None:
    conveyor = Conveyor()
    conveyor.run(100)
    assert not any(conveyor.shows(conveyor.place * wrong) for _ in range(80))
    reason = conveyor.health.reason
    assert reason is not None
    assert "jumped" in reason
    changes = conveyor.health.status(conveyor.k * PERIOD_NS)
    assert changes["since_s"] == pytest.approx(0.01 * (80 - BAD))
    assert changes["refused"] == 80


def test_a_sensor_is_back_after_ten_good_samples() -> None:
    conveyor = Conveyor()
    conveyor.run(100)
    for _ in range(20):
        conveyor.shows(conveyor.place + 10.0)
    assert conveyor.run(GOOD) == [False] * (GOOD - 1) + [True]
    assert conveyor.health.reason is None
    assert conveyor.health.outs == 1


@pytest.mark.parametrize("wrong", [1000.0, 495.3, 1e-3, -1.0])
def test_a_sensor_that_began_with_a_wrong_unit_is_back_soon_after_it_is_right(wrong: float) -> None:
    conveyor = Conveyor()
    for _ in range(50):
        conveyor.shows(conveyor.place * wrong)
    believed = conveyor.run(300)
    assert any(believed[: 200 + GOOD + 1])
    assert all(believed[200 + GOOD + 1 :])


def test_a_distance_that_stays_stuck_stays_out() -> None:
    conveyor = Conveyor()
    conveyor.run(100)
    stuck = conveyor.reads()
    for _ in range(16):
        conveyor.shows(stuck)
    assert not any(conveyor.shows(stuck) for _ in range(1000))


@pytest.mark.parametrize("unit", [1e-4, 1e-3])
def test_a_distance_that_is_stuck_is_out_within_160_ms(unit: float) -> None:
    conveyor = Conveyor(unit)
    conveyor.run(100)
    stuck = conveyor.reads()
    believed = sum(conveyor.shows(stuck) for _ in range(60))
    assert believed <= 16
    assert "stands still all at once" in str(conveyor.health.reason)


def test_a_coarse_sensor_is_given_the_time_of_its_own_unit() -> None:
    conveyor = Conveyor(unit=0.02)
    assert all(conveyor.run(400))


def camera(k: int, x: float) -> CameraSample:
    stamp_ns = k * 25_000_000
    return CameraSample(stamp_ns, stamp_ns, "c", "camera", "hub", k, (x, 0.0, 1.0), ONE)


def test_a_camera_that_repeats_itself_is_out_while_something_moves_and_only_then() -> None:
    health = CameraHealth()
    assert all(health.accepts(camera(k, 0.5), RESTING) for k in range(50))
    health = CameraHealth()
    alike = [health.accepts(camera(k, 0.5), MOVING) for k in range(SAME_POSES)]
    assert alike == [True] * (SAME_POSES - 1) + [False]
    assert "alike" in str(health.reason)
    believed = [health.accepts(camera(k, 0.6 + 1e-9 * k), MOVING) for k in range(GOOD)]
    assert believed == [False] * (GOOD - 1) + [True]


def test_poses_that_the_tracker_refuses_in_a_row_contradict_until_one_is_taken() -> None:
    health = CameraHealth()
    for _ in range(CONTRADICTIONS):
        assert not health.contradicts
        health.add_result(1, 1)
        health.add_result(0, 0)
    assert health.contradicts
    health.add_result(1, 0)
    assert not health.contradicts


def wrench(k: int, force: float, torque: float = 0.0) -> WrenchSample:
    return WrenchSample(k * 4_000_000, (force, 0.0, 0.0), (0.0, torque, 0.0))


def test_a_wrench_that_is_stuck_is_out_within_100_ms_of_motion() -> None:
    health = WrenchHealth()
    alike = [health.accepts(wrench(k, 7.0), MOVING) for k in range(SAME_WRENCHES)]
    assert alike == [True] * REPEATED + [False] * (SAME_WRENCHES - REPEATED)
    assert "alike" in str(health.reason)
    assert SAME_WRENCHES * 0.004 <= 0.1
    assert all(WrenchHealth().accepts(wrench(k, 7.0), RESTING) for k in range(100))


def test_a_wrench_that_repeats_itself_for_a_moment_is_used_again_at_once() -> None:
    health = WrenchHealth()
    used = [health.accepts(wrench(k, 7.0), MOVING) for k in range(SAME_WRENCHES - 1)]
    assert used.count(True) == REPEATED
    assert health.reason is None
    assert health.accepts(wrench(SAME_WRENCHES, 7.01), MOVING)


@pytest.mark.parametrize(("force", "torque"), [(1e30, 0.0), (-3e5, 0.0), (0.0, 1e300)])
def test_what_is_beyond_all_measure_is_no_overload_but_no_measurement(
    force: float, torque: float
) -> None:
    queues = SensorQueues()
    for k in range(5):
        queues.wrench.push(wrench(k, force, torque))
    samples = queues.drain(MOVING, 500.0)
    assert samples.wrench == ()
    assert not queues.overloaded
    assert queues.wrench.newest_ns is None
    assert queues.status(0)["sensors"]["wrench"]["out"] == "it is beyond all measure"


def test_bad_for_100_ms_is_out_even_where_samples_are_rare() -> None:
    health = Health()
    assert health.judge(0, None)
    assert not health.judge(1, "bad")
    assert health.reason is None
    assert not health.judge(100_000_001, "bad")
    assert health.reason == "bad"


@given(st.lists(st.booleans(), max_size=200))
def test_out_needs_three_bad_of_five_and_back_needs_ten_good(accepted: list[bool]) -> None:
    health = Health()
    for k, good in enumerate(accepted):
        was_out = health.reason is not None
        used = health.judge(k * 1_000_000, None if good else "bad")
        if used:
            assert good
        if was_out and health.reason is None:
            assert all(accepted[k - GOOD + 1 : k + 1])
        if not was_out and health.reason is not None:
            lately = accepted[max(0, k - 4) : k + 1]
            assert lately.count(False) >= BAD or accepted[max(0, k - 100) : k + 1].count(True) == 0
    assert health.refused <= len(accepted)


@pytest.mark.parametrize(("conditions", "is_used"), [(MOVING, False), (RESTING, True)])
def test_a_distance_that_runs_backwards_is_no_measurement_while_the_tool_moves(
    conditions: Conditions, is_used: bool
) -> None:
    health = DistanceHealth()
    used = [
        health.accepts(DistanceSample(k * PERIOD_NS, -0.106 * k * PERIOD_NS * 1e-9), conditions)
        for k in range(60)
    ]
    assert used[-1] is is_used
    assert (health.reason is None) is is_used
