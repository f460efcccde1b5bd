"""Noise of the distance sensor as its readings show it, against the configured one.

Three readings in a row show their noise, whatever the object's position and speed are: the middle
one lies off the line through the others. A sensor that is noisier than configured is believed
less. Else its gate rejects good readings, and each outlier looks like a stop or a start.
"""

import math

from msgspec import Struct

from linemate.daemon.core.tracking.conveyor import PositionMeasurement, Source

MEMORY = 100  # readings over which the NIS is averaged; correct ones reach 1.8
FEWEST = 30  # readings that the first NIS counts for
# Largest ratio of a reading to the average NIS: 5 % outliers raise it to 1.7, 10 % to 3.
LARGEST_RATIO = 2.0
MEAN_RATIO = 0.742  # its mean with that limit, of a squared normal variable
LEAST_NIS = 3.0  # from which readings are noisier than configured
SMALLEST_NIS = 0.25  # of a coarse sensor that repeats itself on a conveyor that stands
ABOVE = 1.25  # NIS over the inflation from which that grows
BELOW = 0.25  # or shrinks
LARGEST_INFLATION = 64.0  # of the variance
ACCELERATION = 0.2  # of an object that readings may show without noise [m/s^2]
LONGEST_S = 0.2  # between the first and the last of three readings [s]

Reading = tuple[float, float, float]
"""Age now [s], position [m], configured variance [m^2]."""


class MeasuredNoise(Struct, frozen=True):
    """Average NIS of the readings about each other.

    Attributes:
        latest: the last two readings.
        count: readings compared, up to ``MEMORY``.
        inflation: factor of the configured variance that is believed: 1, or a power of 2.
    """

    latest: tuple[Reading, ...] = ()
    nis: float = 1.0
    count: int = FEWEST
    inflation: float = 1.0


AS_CONFIGURED = MeasuredNoise()


def update(
    noise: MeasuredNoise, measurements: list[PositionMeasurement], dt: float
) -> MeasuredNoise:
    """Return the noise ``dt`` seconds later, with the distance readings of a step."""
    latest = tuple([(age + dt, position, variance) for age, position, variance in noise.latest])
    nis, count = noise.nis, noise.count
    for each in measurements:
        if each.source is not Source.DISTANCE:
            continue
        newest = (each.delay, each.value, each.variance)
        off = _off(latest, newest)
        # A noisy sensor that repeats itself is no better: it is coarse, and the conveyor stands.
        if off is not None and (off != 0.0 or noise.inflation == 1.0):
            count = min(count + 1, MEMORY)
            # In this order a NaN counts as an outlier.
            ratio = min(LARGEST_RATIO, off / nis)
            nis = max(nis + nis * (ratio / MEAN_RATIO - 1.0) / count, SMALLEST_NIS)
        latest = (*latest[-1:], newest)
    inflation = _inflation(noise.inflation, nis)
    # What was known of a smaller noise was wrong.
    count = FEWEST if inflation > noise.inflation else count
    return MeasuredNoise(latest, nis, count, inflation)


def _off(latest: tuple[Reading, ...], newest: Reading) -> float | None:
    """Return the squared way of the middle reading off the others' line, over its variance."""
    if len(latest) < 2:
        return None
    (first_s, first, before), (middle_s, middle, between) = latest
    last_s, last, after = newest
    span = first_s - last_s
    if not last_s < middle_s < first_s or span > LONGEST_S:
        return None
    share = (middle_s - last_s) / span
    off = middle - share * first - (1.0 - share) * last
    variance = between + share**2 * before + (1.0 - share) ** 2 * after
    bend = 0.5 * ACCELERATION * (first_s - middle_s) * (middle_s - last_s)
    return off * off / (variance + bend * bend)


def _inflation(inflation: float, nis: float) -> float:
    if nis > max(LEAST_NIS, ABOVE * inflation):
        return min(2.0 ** math.ceil(math.log2(nis)), LARGEST_INFLATION)
    if inflation > 1.0 and nis < BELOW * inflation:
        return 0.5 * inflation
    return inflation
