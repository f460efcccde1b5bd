"""Exact step of x'' + 2 zeta w x' + w^2 x = 0.

Invariants:
    Closed form for any damping and any duration.
    A piecewise linear input has a shifted ramp as its particular solution.
"""

import math
from functools import lru_cache

Transition = tuple[float, float, float, float]
"""Row by row: [x, x'](t + dt) = Phi(dt) [x, x'](t)."""


@lru_cache(maxsize=4096)
def transition(omega: float, zeta: float, dt: float) -> Transition:
    """The matrix exponential of the oscillator.

    Args:
        omega: natural frequency [rad/s], positive.
        zeta: damping ratio, not negative.

    Returns:
        phi11, phi12, phi21, phi22.
    """
    return solved(omega, zeta, dt)


def solved(omega: float, zeta: float, dt: float) -> Transition:
    """Return ``transition`` of values that do not come again: it is not kept."""
    damped = omega * math.sqrt(abs(1.0 - zeta * zeta))
    if damped * dt < 1e-9:
        cosine, sine = 1.0, dt
    elif zeta < 1.0:
        cosine, sine = math.cos(damped * dt), math.sin(damped * dt) / damped
    else:
        cosine, sine = math.cosh(damped * dt), math.sinh(damped * dt) / damped
    shrink = math.exp(-zeta * omega * dt)
    lean = zeta * omega * sine
    return (
        shrink * (cosine + lean),
        shrink * sine,
        -shrink * omega * omega * sine,
        shrink * (cosine - lean),
    )
