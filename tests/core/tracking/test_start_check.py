"""A declared start is compared with the readings of the distance sensor."""

import numpy as np
import pytest
from conveyor_truth import DEVIATION, NOMINAL, START, STOP, T0, row
from msgspec import structs

from linemate.daemon.core.tracking.classifiers import start_check
from linemate.daemon.core.tracking.classifiers.distance import distance_check
from linemate.daemon.core.tracking.classifiers.distance.distance_check import NO_READINGS
from linemate.daemon.core.tracking.classifiers.start_check import StartCheck, StartRejection
from linemate.daemon.core.tracking.conveyor import Motion
from linemate.daemon.core.tracking.task import ConveyorClasses

CONVEYOR = ConveyorClasses()
DECLARED = 0.004  # estimated speed as a start is confirmed: 0.3 s after its onset [m/s]


def judged(
    before: Motion,
    speed: float,
    acceleration: float,
    seconds: float,
    *,
    seed: int = 0,
    declared: float = DECLARED,
    outliers: float = 0.0,
) -> tuple[float, StartRejection] | None:
    """When a declared start is denied [s] and how, None if it never is.

    The truth begins with ``speed`` and keeps ``acceleration`` until it stands or cruises.
    """
    rng = np.random.default_rng(seed)
    check, position = None, 0.0
    for k in range(round(seconds / T0)):
        speed = min(max(speed + acceleration * T0, 0.0), NOMINAL)
        position += speed * T0
        value = position + rng.normal(0.0, DEVIATION)
        if rng.random() < outliers:
            value += 0.1
        check = start_check.update(check, before, Motion.STARTING, declared, [row(value)], T0)
        denial = start_check.reject(check, CONVEYOR, NOMINAL, DEVIATION)
        if denial is not None:
            return k * T0, denial
    return None


@pytest.mark.parametrize("seed", range(5))
def test_a_start_that_stands_still_is_denied_within_half_a_second(seed: int) -> None:
    found = judged(Motion.STANDING, 0.0, 0.0, 1.0, seed=seed, outliers=0.02)
    assert found is not None
    assert found[0] <= 0.5
    assert found[1] == StartRejection(Motion.STANDING, 0.0)


@pytest.mark.parametrize("seed", range(5))
def test_a_start_declared_while_the_conveyor_brakes_is_denied(seed: int) -> None:
    found = judged(Motion.STOPPING, 0.09, -STOP, 1.0, seed=seed, declared=0.09)
    assert found is not None
    assert found[0] <= 0.5
    assert found[1].motion is Motion.STOPPING
    assert found[1].speed == pytest.approx(0.09 - STOP * found[0], abs=0.01)


@pytest.mark.parametrize("share", [0.6, 1.0, 1.5, 8.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_start_of_another_acceleration_is_not_denied(share: float, seed: int) -> None:
    seconds = 0.9 * NOMINAL / START
    assert judged(Motion.STANDING, DECLARED, share * START, seconds, seed=seed) is None


def test_a_start_that_stays_below_the_cruising_speed_ends_after_twice_its_time() -> None:
    found = judged(Motion.STANDING, 0.06, 0.0, 20.0)
    assert found is not None
    expected = start_check.LONGEST * (NOMINAL - DECLARED) / START
    assert found[0] == pytest.approx(expected, abs=3 * T0)
    assert found[1].motion is Motion.RUNNING
    assert found[1].speed == pytest.approx(0.06, abs=0.002)


def test_without_readings_nothing_is_denied() -> None:
    check = None
    for _ in range(round(3.0 / T0)):
        check = start_check.update(check, Motion.STANDING, Motion.STARTING, 0.0, [], T0)
        assert start_check.reject(check, CONVEYOR, NOMINAL, DEVIATION) is None


def test_a_check_ends_with_the_start_and_its_memory_is_bounded() -> None:
    check = None
    for k in range(1000):
        check = start_check.update(
            check, Motion.STANDING, Motion.STARTING, 0.0, [row(k * 1e-4)], T0
        )
    assert check is not None
    assert len(check.readings) <= start_check.SPAN_S / T0 + 1
    assert start_check.update(check, Motion.STARTING, Motion.RUNNING, NOMINAL, [], T0) is None


ONSET = 0.3  # time from the onset of a start to its declaration [s]
REST = 0.0003  # one sigma of the speed of a conveyor that stands [m/s]


def denied(
    before: Motion, speed: float, onset: float, acceleration: float, seed: int
) -> tuple[float, StartRejection] | None:
    """When a start is denied after its declaration [s] and how, None if it is not within 0.5 s.

    The truth has ``speed`` at the onset of the braking, 0.5 s before the declaration, if there is
    one. A start of ``acceleration`` begins ``onset`` s before the declaration.
    """
    rng = np.random.default_rng(seed)
    braking = -STOP if before is Motion.STOPPING else 0.0
    check = StartCheck(before, 0.0, acceleration=START, braking=braking, braked=0.5)
    kept, position = NO_READINGS, 0.0
    for k in range(round(1.5 / T0)):
        age = (k + 1) * T0 - 1.0
        begun = age + onset > 0.0
        speed += T0 * (acceleration if begun else braking if age > -0.5 else 0.0)
        position += speed * T0
        kept = distance_check.keep(kept, [row(position + rng.normal(0.0, DEVIATION))], T0)
        if age <= 0.0:
            continue
        check = structs.replace(check, age=age)
        denial = start_check.deny(check, kept, ONSET + age, REST, DEVIATION)
        if denial is not None:
            return age, denial
    return None


def test_a_start_that_never_was_is_denied_after_a_tenth_of_a_second() -> None:
    found = [denied(Motion.STANDING, 0.0, ONSET, 0.0, seed) for seed in range(20)]
    assert all(each is not None for each in found)
    assert np.median([each[0] for each in found if each]) <= 0.12
    assert {each[1] for each in found if each} == {StartRejection(Motion.STANDING, 0.0)}


def test_a_conveyor_that_goes_on_braking_is_found_with_its_speed() -> None:
    for seed in range(20):
        found = denied(Motion.STOPPING, 0.106, -9.0, 0.0, seed)
        assert found is not None
        age, denial = found
        assert age <= 0.1
        assert denial.motion is Motion.STOPPING
        assert denial.speed == pytest.approx(0.106 - STOP * (0.5 + age), abs=0.012)


@pytest.mark.parametrize("share", [0.6, 1.0, 1.5])
@pytest.mark.parametrize("before", [Motion.STANDING, Motion.STOPPING])
def test_a_true_start_is_not_denied(before: Motion, share: float) -> None:
    for seed in range(20):
        assert denied(before, 0.106, ONSET, share * START, seed) is None


def test_a_silent_sensor_denies_no_start() -> None:
    check = StartCheck(Motion.STANDING, 0.0, acceleration=START)
    assert start_check.deny(check, NO_READINGS, ONSET, REST, DEVIATION) is None
    assert start_check.deny(None, NO_READINGS, ONSET, REST, DEVIATION) is None


@pytest.mark.parametrize("stood", [0.5, np.inf])
def test_a_true_start_soon_after_a_stop_is_not_denied_by_what_the_stop_moved(stood: float) -> None:
    check, declared_s = StartCheck(Motion.STANDING, 0.0, acceleration=0.018, stood=stood), 2.0
    denials = 0
    for seed in range(20):
        rng, kept, position, speed = np.random.default_rng(seed), NO_READINGS, 0.0, NOMINAL
        for k in range(round(declared_s / T0)):
            left = declared_s - k * T0
            if left < 0.5 + NOMINAL / STOP:
                speed = max(speed + T0 * (0.006 if left < 0.4 else -STOP), 0.0)
            position += speed * T0
            kept = distance_check.keep(kept, [row(position + rng.normal(0.0, DEVIATION))], T0)
        denials += start_check.deny(check, kept, 0.4, REST, DEVIATION) is not None
    assert denials == (20 if stood == np.inf else 0)


@pytest.mark.parametrize(("acceleration", "expected"), [(0.013, 0), (0.0, 20)])
def test_a_start_is_denied_if_the_conveyor_stands_and_not_if_it_is_less_steep(
    acceleration: float, expected: int
) -> None:
    """A conveyor that is started again before it stands is never at rest."""
    check, declared_s = StartCheck(Motion.STANDING, 0.0, acceleration=0.073, stood=0.3), 0.37
    denials = 0
    for seed in range(20):
        rng, kept = np.random.default_rng(seed), NO_READINGS
        for k in range(round((0.52 + declared_s) / T0)):
            way = 0.5 * acceleration * (k * T0) ** 2 + rng.normal(0.0, DEVIATION)
            kept = distance_check.keep(kept, [row(way)], T0)
        check = structs.replace(check, age=declared_s)
        denials += start_check.deny(check, kept, 0.163 + declared_s, REST, DEVIATION) is not None
    assert denials == expected
