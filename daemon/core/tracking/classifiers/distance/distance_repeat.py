"""A distance sensor that repeats itself while no conveyor can have stopped: readings are dropped.

The sensor's health excludes a frozen sensor after 0.15 s. The bank confirmed a stop after 0.02 s.
"""

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers import onset_bank
from linemate.daemon.core.tracking.classifiers.bank_model import (
    ACCELERATION,
    BankModel,
    BankState,
    V,
)
from linemate.daemon.core.tracking.classifiers.onset_bank import AmplitudePrior
from linemate.daemon.core.tracking.conveyor import Motion, PositionMeasurement, Source

FROZEN_S = 0.25  # in which the sensor's health excludes a frozen sensor [s]
LARGEST_RAMP = 1.0  # acceleration that no conveyor exceeds [m/s^2]
# The sensor's health goes by the mean speed over 0.3 s, which is 0.05 m/s as a conveyor that brakes
# by 0.1 m/s^2 is down to:
SLOW_RAMP = 0.04  # [m/s], to the resolution
STEP_OF_SIGMA = math.sqrt(12.0)  # of the resolution, in which a sound sensor repeats itself
# The same for a step u and a normal noise of sigma s: u + 3 sqrt(2) s is at most this of both.
CERTAIN_OF_SIGMA = math.sqrt(12.0 + 2.0 * 3.0**2)


def without_repeated(
    model: BankModel, state: BankState, measurements: Sequence[PositionMeasurement], dt: float
) -> tuple[BankState, Sequence[PositionMeasurement]]:
    """Return the measurements without those of a distance sensor that repeats itself.

    Once that is certain, what supported a change may be the readings that it repeated before.
    """
    read = [each for each in measurements if each.source is Source.DISTANCE]
    repeats = partial(_repeats_itself, model, state, dt=dt)
    repeated = [each for each in read if repeats(each)]
    if not read or not (repeated or state.is_repeating):
        return state, measurements
    kept = [each for each in measurements if each not in repeated]
    is_certain = any(repeats(each, sigmas=CERTAIN_OF_SIGMA) for each in repeated)
    if is_certain and not state.is_repeating:
        state = _before_repeated(model, state)
    return replace(state, is_repeating=is_certain), kept


def _before_repeated(model: BankModel, state: BankState) -> BankState:
    """Return the state without what supports a change, and the repeated readings but one."""
    first, faster = _first_of_last(state.readings), state.faster
    if faster is not None:
        prior = AmplitudePrior(1.0, faster.variance)
        faster = replace(faster, bank=onset_bank.without_support(faster.bank, prior))
    return replace(
        state,
        changes=onset_bank.without_support(state.changes, model.change_prior),
        faster=faster,
        readings=state.readings[:, : first + 1],
    )


def _repeats_itself(
    model: BankModel,
    state: BankState,
    measurement: PositionMeasurement,
    dt: float,
    sigmas: float = STEP_OF_SIGMA,
) -> bool:
    """Return whether the distance sensor repeats itself while no conveyor can have stopped.

    None brakes by more than ``LARGEST_RAMP``. The sensor's health needs 0.15 s for it, and the bank
    confirmed a stop after 0.02 s. Below ``SLOW_RAMP`` a conveyor may stop at once within few steps
    of the resolution; a stop that is known brakes on as it did.

    Args:
        state: of the bank, one step before this reading is taken.
        sigmas: way that the conveyor must have made since, in deviations of a reading.
    """
    ages, values = state.readings
    is_read = measurement.source is Source.DISTANCE and len(values) > 0
    if not is_read or values[-1] != measurement.value:
        return False
    first = _first_of_last(state.readings)
    if not first:
        return False
    since, speed = float(ages[first - 1]), float(state.x[V])
    least = sigmas * model.distance_deviation
    # It may have begun to brake at the reading before.
    slower = max(speed - LARGEST_RAMP * (since - float(ages[first])), 0.0)
    braked = min(float(ages[first]) + dt - measurement.delay, slower / LARGEST_RAMP)
    if since < FROZEN_S and braked * (slower - 0.5 * LARGEST_RAMP * braked) > least:
        return True
    slowed = -since * float(state.x[ACCELERATION])
    is_slow = state.motion is Motion.STOPPING and speed + slowed < SLOW_RAMP
    return is_slow and since * (speed + 0.5 * slowed) > least


def _first_of_last(readings: Array) -> int:
    """Return the index of the first of the last readings (2, m) that are all alike; m > 0."""
    values = readings[1]
    return int(np.flatnonzero(values != values[-1]).max(initial=-1)) + 1
