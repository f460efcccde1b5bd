"""A declared start is compared with the readings of the distance sensor."""

import numpy as np
import pytest
from conveyor_truth import DEVIATION, NOMINAL, START, STOP, T0, row

from linemate.daemon.core.tracking.classifiers import start_check
from linemate.daemon.core.tracking.classifiers.start_check import StartRejection
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
