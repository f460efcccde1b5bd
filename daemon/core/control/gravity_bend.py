"""Bend of the gears under weight: where the links are, where motors must be.

    link = motor - c g(q),   g: moments that the motors hold against gravity at q (pinocchio)

A controller reports its motors. The camera rides on the links, so that no sensor sees this bend.

Invariants:
- An arm whose gears are taken for stiff has no ``BentArm`` (None), and its steps compute nothing
  of this.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from linemate.daemon.core.control.kinematics import Arm
from linemate.daemon.core.control.settings import GravityBend
from linemate.daemon.core.horizon import Array

BALANCED_AXIS = 1  # index of A2, whose moment a counterbalance takes in part


@dataclass(frozen=True, slots=True, eq=False)
class BentArm:
    """An arm with the compliance (axes,) of its gears [rad/Nm], less the counterbalance."""

    arm: Arm
    compliance: Array


def compile_bend(settings: GravityBend, arm: Arm) -> BentArm | None:
    """Return the arm that bends; None for stiff gears or an arm without weight."""
    if not settings.loads or not any(settings.compliance):
        return None
    compliance = np.zeros(arm.axes)
    compliance[: len(settings.compliance)] = settings.compliance
    compliance[BALANCED_AXIS] *= 1.0 - settings.balanced
    return BentArm(arm, compliance)


def links(bent: BentArm, motors: Array) -> Array:
    """Return the positions (axes,) of the links."""
    placed: Array = motors - bent.compliance * bent.arm.gravity(motors)
    return placed


def motors(bent: BentArm, wanted: Array) -> Array:
    """Return the positions (m, axes) of the motors for those of the links (m, axes), m >= 2.

    The moments are computed at both ends and interpolated between them: over 0.2 s of an approach
    they are straight within a hundredth of a millimetre at the tcp.
    """
    first = bent.compliance * bent.arm.gravity(wanted[0])
    last = bent.compliance * bent.arm.gravity(wanted[-1])
    placed: Array = wanted + first + _shares(len(wanted)) * (last - first)
    return placed


@lru_cache(maxsize=4)
def _shares(count: int) -> Array:
    """Return the share of the way from the first to the last of some rows (count, 1)."""
    shares = (np.arange(count) / (count - 1.0))[:, None]
    shares.setflags(write=False)
    return shares
