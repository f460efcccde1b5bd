"""Windup of the axes with the direction of motion: where the links are, where motors must be.

    link = motor - depth w,   dw = (sgn(dq) - w) |dq| / travel      (Dahl), q the motor

A controller reports its motors. Forward kinematics needs the links, and commands the motors.

Invariants:
- Plain floats: for a few axes and a dozen steps they are faster than arrays.
- An arm without windup has no ``Windup`` (None), and its steps compute nothing of this.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from msgspec import Struct

from linemate.daemon.core.control.settings import AxisWindup
from linemate.daemon.core.horizon import Array

JITTER = 5e-6  # a motion within it turns no hysteresis: noise of encoders and of the plan [rad]
LARGEST_SLOPE = 0.67  # of the windup over the motor; a gear with more would move backwards


@dataclass(frozen=True, slots=True)
class Windup:
    """The axes that wind up: their numbers, depths [rad] and travels [rad]."""

    axes: tuple[int, ...]
    depths: tuple[float, ...]
    travels: tuple[float, ...]


class WindupState(Struct, frozen=True):
    """State of the hysteresis of each axis that winds up.

    Attributes:
        motor: position up to which the motion is taken in [rad].
        w: windup as a share of the depth, -1 to 1.
    """

    motor: tuple[float, ...]
    w: tuple[float, ...]


def compile_windup(settings: Sequence[AxisWindup], axes: int) -> Windup | None:
    """Return the axes that wind up, None if there are none."""
    wound = [(i, each) for i, each in enumerate(settings[:axes]) if each.depth > 0.0]
    if not wound:
        return None
    return Windup(
        tuple(i for i, _ in wound),
        tuple(each.depth for _, each in wound),
        tuple(each.travel for _, each in wound),
    )


def begin(windup: Windup, motors: Array) -> WindupState:
    """Return the state of an arm of unknown history, its motors (axes,) at rest."""
    values = motors.tolist()
    return WindupState(tuple(values[i] for i in windup.axes), (0.0,) * len(windup.axes))


def follow(windup: Windup, state: WindupState, motors: Array) -> WindupState:
    """Return the state after a way of the motors (axes,) in one direction."""
    values = motors.tolist()
    rows = [
        turned(x, w, values[axis] - x, travel)
        for axis, x, w, travel in zip(
            windup.axes, state.motor, state.w, windup.travels, strict=True
        )
    ]
    return WindupState(tuple(x for x, _ in rows), tuple(w for _, w in rows))


def links(windup: Windup, state: WindupState, motors: Array) -> Array:
    """Return the positions (axes,) of the links."""
    placed = motors.copy()
    for axis, depth, w in zip(windup.axes, windup.depths, state.w, strict=True):
        placed[axis] -= depth * w
    return placed


def motors(windup: Windup, state: WindupState, wanted: Array) -> tuple[Array, WindupState]:
    """Return the positions (m, axes) of the motors for those of the links (m, axes), m >= 2.

    Args:
        state: at the first row.

    Returns:
        The motors, and the state at the second row.
    """
    placed = wanted.copy()
    second: list[tuple[float, float]] = []
    for n, axis in enumerate(windup.axes):
        column = wanted[:, axis].tolist()
        at = state.motor[n], state.w[n]
        placed[:, axis], later = _led(column, at, windup.depths[n], windup.travels[n])
        second.append(later)
    return placed, WindupState(tuple(x for x, _ in second), tuple(w for _, w in second))


def _led(
    wanted: list[float], at: tuple[float, float], depth: float, travel: float
) -> tuple[list[float], tuple[float, float]]:
    """Return one motor's positions for its link's, and its hysteresis at the second of them."""
    x, w = at
    led, later = [wanted[0] + depth * w], None
    append, exp = led.append, math.exp
    # A tenth of a step's calls were in this loop: ``turned`` and ``min`` are written out.
    for q in wanted[1:]:
        way = q + depth * w - x
        end = 1.0 if way > 0.0 else -1.0
        # The motor has to go farther than the link by what winds up on the way.
        slope = depth * (1.0 - end * w) / travel
        slope = slope if slope < LARGEST_SLOPE else LARGEST_SLOPE  # noqa: FURB136
        taken = end * way / (1.0 - slope) - JITTER
        if taken > 0.0:
            x, w = x + end * taken, end + (w - end) * exp(-taken / travel)
        if later is None:
            later = x, w
        append(q + depth * w)
    return led, later or at


def turned(x: float, w: float, way: float, travel: float) -> tuple[float, float]:
    """Return position and windup after a way, of which the last ``JITTER`` is not taken in."""
    way = way - math.copysign(JITTER, way) if abs(way) > JITTER else 0.0
    if way == 0.0:
        return x, w
    end = math.copysign(1.0, way)
    return x + way, end + (w - end) * math.exp(-abs(way) / travel)
