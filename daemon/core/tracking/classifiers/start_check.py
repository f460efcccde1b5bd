"""Check of a declared start against the readings of the distance sensor.

A classifier that declares a start predicts a rising speed. Its own filter cannot detect a wrong
start: it adapts until the class predicts as well as any other. Two checks compare the readings with
two hypotheses: the start, and the class before it. ``deny`` fits the readings before and after the
onset and needs some 0.1 s. ``reject`` compares speeds after the declaration alone and needs 0.4 s.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence

from msgspec import Struct
from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers.distance import distance_check
from linemate.daemon.core.tracking.classifiers.distance.distance_check import Ramp
from linemate.daemon.core.tracking.conveyor import Motion, PositionMeasurement, Source
from linemate.daemon.core.tracking.task import ConveyorClasses

SPAN_S = 0.4  # of the readings that are compared; a start must be cancelled within 0.5 s
LEAST_READINGS = 8  # an interquartile mean of each half needs four
SHARE = 0.3  # of the way from the class before to the start, below which the start is rejected
SIGMAS = 5.0  # by which a right start must exceed that share: it is checked in every cycle
SPREAD = 1.2  # sigma of an interquartile mean of normal noise, as a multiple of the mean's
LONGEST = 2.0  # a start of half the configured acceleration lasts twice as long
DENIED = -5.0  # log odds of the start by the distance sensor alone, below which there was none
LEAST_SHARE = 0.6  # of the start's acceleration that is tested: half of it is the limit
OLDEST_S = 0.8  # onset up to which enough readings before it are left


class StartCheck(Struct, frozen=True, eq=False):
    """Readings since a start was declared.

    Attributes:
        before: class before the start.
        speed: estimated at the declaration [m/s].
        readings: time since the declaration [s] and position [m], the last ``SPAN_S``.
        acceleration: of the start, as it was declared [m/s^2].
        braking: acceleration of the stop before it, 0 after a standstill [m/s^2].
        braked: time since that stop began, at the declaration [s].
        stood: how long the conveyor had stood at the declaration, infinity after a stop [s].
    """

    before: Motion
    speed: float
    age: float = 0.0
    readings: tuple[tuple[float, float], ...] = ()
    acceleration: float = 0.0
    braking: float = 0.0
    braked: float = 0.0
    stood: float = math.inf


class StartRejection(Struct, frozen=True):
    """A start that the readings contradict.

    Attributes:
        motion: class that is in force instead.
        speed: now, from the readings [m/s].
    """

    motion: Motion
    speed: float


def update(
    check: StartCheck | None,
    before: Motion,
    motion: Motion,
    speed: float,
    measurements: Sequence[PositionMeasurement],
    dt: float,
) -> StartCheck | None:
    """Return the check one step later: None unless the class is STARTING.

    Args:
        check: of the step before.
        before: class of the step before.
        dt: since the step before [s].
    """
    if motion is not Motion.STARTING:
        return None
    if check is None:
        return StartCheck(before, max(speed, 0.0))
    age = check.age + dt
    new = [
        (age - each.delay, each.value) for each in measurements if each.source is Source.DISTANCE
    ]
    first = bisect_right(check.readings, (age - SPAN_S, math.inf))
    return replace(check, age=age, readings=(*check.readings[first:], *new))


def deny(
    check: StartCheck | None, readings: Array, onset: float, rest_deviation: float, deviation: float
) -> StartRejection | None:
    """Return the class before the start if the distance sensor denies the start, else None.

    Args:
        check: of the start, None without one.
        readings: (2, m) as ``distance_check.keep`` returns them.
        onset: time since the start began [s].
        rest_deviation: one sigma of the steady speed of a conveyor that stands [m/s].
        deviation: one sigma of a reading [m].
    """
    if check is None or not check.acceleration or onset > OLDEST_S:
        return None
    ramp = Ramp(check.braked + check.age, check.braking) if check.braking else None
    # What the stop before a short standstill moved is no evidence against the start.
    readings = distance_check.since(readings, check.stood + check.age)
    change = LEAST_SHARE * check.acceleration - check.braking
    odds = distance_check.log_odds(readings, onset, change, rest_deviation, deviation, ramp)
    if odds is None or odds > DENIED:
        return None
    if ramp is None and _moves(distance_check.since(readings, SPAN_S), deviation):
        return None  # a start less steep than declared, or one that began earlier
    speed = None if ramp is None else distance_check.speed_now(readings, ramp, deviation)
    if speed is None or speed <= 0.0:
        return StartRejection(Motion.STANDING, 0.0)
    return StartRejection(Motion.STOPPING, speed)


def reject(
    check: StartCheck | None, conveyor: ConveyorClasses, cruise: float, deviation: float
) -> StartRejection | None:
    """Return the class that the readings speak for; None while they do not contradict the start.

    Args:
        check: of the start, None without one.
        conveyor: accelerations of the classes.
        cruise: speed at which a start ends [m/s].
        deviation: one sigma of a reading [m].
    """
    if check is None or check.age < SPAN_S:
        return None
    readings = [reading for reading in check.readings if reading[0] >= 0.0]
    half = len(readings) // 2
    if 2 * half < LEAST_READINGS:
        return None
    early, late = _mean_time(readings[:half]), _mean_time(readings[half:])
    span, time = late - early, 0.5 * (early + late)
    if span < 0.25 * SPAN_S:
        return None
    started, other = _expected_speeds(check, conveyor, cruise, time)
    apart = started - other
    is_clear = (1.0 - SHARE) * apart * span > SIGMAS * deviation * _difference_sigma(half)
    overdue = check.age > LONGEST * (cruise - check.speed) / conveyor.acceleration
    if not (is_clear or overdue):
        return None
    measured = (_middle(readings[half:]) - _middle(readings[:half])) / span
    if is_clear and measured < other + SHARE * apart:
        return _class_before(check, conveyor, measured, check.age - time)
    return StartRejection(Motion.RUNNING, measured) if overdue and started > 0.0 else None


def _expected_speeds(
    check: StartCheck, conveyor: ConveyorClasses, cruise: float, time: float
) -> tuple[float, float]:
    """Return the speeds at a time since the declaration if it was right and if it was wrong."""
    started = min(check.speed + conveyor.acceleration * time, max(cruise, check.speed))
    if check.before is Motion.STOPPING:
        return started, max(check.speed - conveyor.deceleration * time, 0.0)
    return started, 0.0


def _class_before(
    check: StartCheck, conveyor: ConveyorClasses, measured: float, ago: float
) -> StartRejection:
    """Return the class before the start, and its speed now from the one measured ``ago`` s ago."""
    speed = max(measured - conveyor.deceleration * ago, 0.0)
    if check.before is Motion.STOPPING and speed > 0.0:
        return StartRejection(Motion.STOPPING, speed)
    return StartRejection(Motion.STANDING, 0.0)


def _moves(readings: Array, deviation: float) -> bool:
    """Return whether the conveyor certainly moves while these readings (2, m) are taken."""
    speed, sigma = distance_check.mean_speed(readings, deviation)
    return speed > SIGMAS * sigma


def _mean_time(readings: Sequence[tuple[float, float]]) -> float:
    """Return the mean time of some readings."""
    return sum([time for time, _ in readings]) / len(readings)


def _middle(readings: Sequence[tuple[float, float]]) -> float:
    """Return the interquartile mean of some readings: robust to outliers."""
    values = sorted([value for _, value in readings])
    cut = len(values) // 4
    inner = values[cut : len(values) - cut]
    return sum(inner) / len(inner)


def _difference_sigma(half: int) -> float:
    """Return the sigma of the difference of two halves, as a multiple of a reading's."""
    return SPREAD * math.sqrt(2.0 / half)
