"""Friction of the drives: by how much it holds an axis back, and a command that overcomes it.

    s' = (sgn(q') - s) |q'| / travel       presliding after a reversal      (Dahl)
    r' = (s - r) / recovery_s              integral action of the controller
    q  = servo(q_c - level (s - r))

So q_c gets ``level (s - r)`` of the instant at which it acts. The motion there is planned: nothing
that is measured enters.

Invariants:
- Plain floats: for a few axes they are faster than arrays.
- An arm whose drives do not rub has none of this (None), and its steps compute nothing of it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from msgspec import Struct

from linemate.daemon.core.control import windup
from linemate.daemon.core.control.settings import AxisFriction, ServoModel
from linemate.daemon.core.horizon import Array


@dataclass(frozen=True, slots=True)
class _RubbingAxis:
    """An axis that rubs.

    Attributes:
        lead: steps after which a command acts: the dead time, and half of the cycle in which the
            controller interpolates.
        kept: share of ``r`` that stays over a cycle.
    """

    axis: int
    level: float
    travel: float
    lead: float
    kept: float


@dataclass(frozen=True, slots=True)
class RubbingDrives:
    """The axes that rub, and the cycle [s]."""

    axes: tuple[_RubbingAxis, ...]
    cycle_s: float


class FrictionState(Struct, frozen=True):
    """State of each axis that rubs, at the instant at which the last command acts.

    Attributes:
        motor: position up to which the motion is taken in [rad, m].
        s: friction as a share of its level, -1 to 1.
        r: what the controller's integral action has removed of it.
    """

    motor: tuple[float, ...]
    s: tuple[float, ...]
    r: tuple[float, ...]


def compile_friction(
    settings: Sequence[AxisFriction], servos: Sequence[ServoModel], axes: int, cycle_s: float
) -> RubbingDrives | None:
    """Return the axes that rub, None if there are none."""
    rubbing = tuple(
        _RubbingAxis(
            axis,
            each.level,
            each.travel,
            servo.dead_time / cycle_s + 0.5,
            math.exp(-cycle_s / each.recovery_s),
        )
        for axis, (each, servo) in enumerate(zip(settings[:axes], servos, strict=False))
        if each.level > 0.0
    )
    return RubbingDrives(rubbing, cycle_s) if rubbing else None


def begin(friction: RubbingDrives | None, motors: Array) -> FrictionState | None:
    """Return the state of an arm of unknown history, its motors (axes,) at rest."""
    if friction is None:
        return None
    values = motors.tolist()
    zeros = (0.0,) * len(friction.axes)
    return FrictionState(tuple([values[each.axis] for each in friction.axes]), zeros, zeros)


def overcome(
    friction: RubbingDrives,
    state: FrictionState,
    motors: Array,
    command: Array,
    drift_s: float = 0.0,
) -> tuple[Array, FrictionState]:
    """Return a command (axes,) with what friction takes of it, and the state one cycle later.

    Args:
        motors: (m, axes) planned, from this step on.
        drift_s: of the dead times.
    """
    corrected, rows = command.copy(), []
    planned, last = motors.item, len(motors) - 1
    later = drift_s / friction.cycle_s
    for each, x, s, r in zip(friction.axes, state.motor, state.s, state.r, strict=True):
        place = min(max(each.lead + later, 0.0), float(last))
        low = min(int(place), last - 1)
        before, after = planned(low, each.axis), planned(low + 1, each.axis)
        way = before + (place - low) * (after - before) - x
        x_later, s_later = windup.turned(x, s, way, each.travel)
        r_later = s_later + (r - s_later) * each.kept
        corrected[each.axis] += each.level * (s_later - r_later)
        rows.append((x_later, s_later, r_later))
    return corrected, FrictionState(*zip(*rows, strict=True))
