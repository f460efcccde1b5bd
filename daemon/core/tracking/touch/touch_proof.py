"""Proof of a touch: the force of an object is no more than the tool's advance gives.

A mount is bent by as much as the tool has gone beyond the object. A force sensor that drifts in
the last millimetres looks like a touch, and drifts on while the tool stands. A free tool that
followed such a force followed itself, and swung with 900 N.

Invariants:
- A doubted force moves no target and no estimate until the contact ends.
- A touch that stood for ``PROVEN_S`` is not doubted any more: an object may come nearer later.
"""

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array

SETTLED_S = 0.1  # after a touch the tool still runs on what was commanded [s]
PROVEN_S = 0.5  # after it the touch is proved [s]
EXCESS_M = 0.002  # of the mount's bend beyond the tool's advance: no object comes so near [m]
DOUBTED_S = 0.03  # for which the force must be beyond it [s]


def advance(programmed: float, tcp: Array, planned: Array) -> float:
    """Return how far the tool is beyond the object [m].

    A robot that is quicker than its servo models is ahead of its plan, and presses by that more.

    Args:
        programmed: along the tool's axis, from the object [m].
        tcp: (6,) measured, at the time of the planned one [m, rad].
        planned: (6,) the tcp that the plan has [m, rad].
    """
    ahead = rotations.exp(planned[3:])[:, 2].dot(tcp[:3] - planned[:3])
    return max(programmed, 0.0) + max(float(ahead), 0.0)


def advanced(
    beyond_s: float, push: float, advance: float, stiffness: float, touching: float, dt: float
) -> float:
    """Return for how long the force has been more than the object can give [s].

    Args:
        beyond_s: the same a step before.
        push: force by which the object pushes the tool back [N].
        advance: of the tool beyond the object, not negative [m].
        stiffness: of the mount along the tool's axis [N/m].
        touching: time since the touch [s].
        dt: since the step before [s].
    """
    if is_doubted(beyond_s):
        return beyond_s
    is_beyond = push > stiffness * (advance + EXCESS_M)
    return beyond_s + dt if is_due(touching) and is_beyond else 0.0


def is_due(touching: float) -> bool:
    """Return whether a touch may be doubted yet, or still.

    Args:
        touching: time since the touch [s].
    """
    return SETTLED_S < touching < PROVEN_S


def is_doubted(beyond_s: float) -> bool:
    """Return whether a touch was none."""
    return beyond_s >= DOUBTED_S
