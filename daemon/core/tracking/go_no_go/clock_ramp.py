"""Ramp of the task's clock: it stands, turns and goes on with a bounded acceleration of the tool.

    times after a change: D steps as before, then rate(s) = r0 + (r1 - r0) s / N, s = 0..N

Invariants:
- What is committed of the plan stays on the programme: the change begins behind it.
- A ramp begins and ends at a whole step of the clock: N is even.
- Times are counted in steps of the clock: a sum of many periods is no multiple of one.
"""

import math

import numpy as np
from msgspec import Struct

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.go_no_go.decision import GoOrder

ACCELERATION = 2.0  # of the tool along its programme while the clock's rate changes [m/s^2]
LONGEST_S = 0.4  # a change of rate is over after this time [s]

RATES = {GoOrder.GO: 1, GoOrder.STAND: 0, GoOrder.BACK: -1}
"""Steps that the task's clock makes a step, by the order."""


class ClockRamp(Struct, frozen=True):
    """How the task's clock goes on.

    Attributes:
        rate: steps of the clock a step, after those that are planned: 1, 0 or -1.
        planned: times of the clock [steps], that of the present step first; empty without a change.
    """

    rate: int = 1
    planned: tuple[float, ...] = ()


RUNNING = ClockRamp()
STANDING = ClockRamp(rate=0)


def ramp_steps(speed: float, change: int, cycle_s: float) -> int:
    """Return the even number of steps in which the clock's rate changes.

    Args:
        speed: largest speed of the programme there [m/s].
        change: new rate less the one before.
    """
    needed = min(abs(change) * speed / ACCELERATION, LONGEST_S)
    return 2 * math.ceil(needed / (2.0 * cycle_s) - 1e-6)


def changed(ramp: ClockRamp, now: int, rate: int, delay: int, length: int) -> ClockRamp:
    """Return the ramp of a clock that changes its rate.

    Args:
        ramp: with no change planned.
        now: time of the clock [steps].
        rate: with which it goes on, 1, 0 or -1.
        delay: steps until the change begins.
        length: even number of steps that it takes.
    """
    begin = now + ramp.rate * delay
    steady = [float(now + ramp.rate * i) for i in range(delay + 1)]
    change = rate - ramp.rate
    turned = [begin + ramp.rate * i + change * i * i / (2.0 * length) for i in range(1, length + 1)]
    return ClockRamp(rate, tuple(steady + turned))


def braked(ramp: ClockRamp, now: float, delay: int, length: int) -> ClockRamp:
    """Return the ramp of a clock that comes to stand, whatever it had planned.

    Args:
        now: time of the clock [steps].
        delay: steps of the plan that are kept, at least 1.
        length: even number of steps that a stop from a rate of 1 takes.
    """
    kept = times_ahead(ramp, now, delay).tolist()
    rate = kept[-1] - kept[-2]
    slowing = [kept[-1] + rate * (i - i * i / (2.0 * length)) for i in range(1, length + 1)]
    return ClockRamp(0, tuple(kept + slowing))


def extended(ramp: ClockRamp, low: float, high: float) -> ClockRamp:
    """Return the ramp with the steps that a clock kept between two times does not show.

    A clock that turns beyond a bound comes back to it before it goes on.

    Args:
        low, high: bounds of the clock [steps].
    """
    last = ramp.planned[-1]
    bound = low if ramp.rate > 0 else high
    hidden = math.ceil((bound - last) * ramp.rate)
    if hidden <= 0 or math.isinf(bound):
        return ramp
    return ClockRamp(
        ramp.rate, (*ramp.planned, *(last + ramp.rate * i for i in range(1, hidden + 1)))
    )


def advanced(ramp: ClockRamp) -> ClockRamp:
    """Return the ramp one step later; after its last planned step nothing is planned."""
    return ClockRamp(ramp.rate, ramp.planned[1:])


def times_ahead(ramp: ClockRamp, now: float, steps: int) -> Array:
    """Return the clock's times (steps + 1,) over the horizon [steps].

    Args:
        now: time of the clock [steps].
    """
    planned = ramp.planned[: steps + 1] or (now,)
    later = planned[-1] + ramp.rate * np.arange(1.0, steps + 2 - len(planned))
    return np.concatenate((planned, later))
