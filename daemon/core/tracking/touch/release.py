"""Opening of the clamp: when it may be ordered, when the tool may withdraw, and that it lets go.

Invariants:
    * The programme orders the opening of a tool that oscillates with the object only after a wait.
    * The press goes as the opening is ordered, before the clamp is open.
    * The tool does not withdraw while the clamp is closed on the object, or may be.
    * An unreported opening ends: the tool is overdue after ``tool.release_timeout``.
"""

import math
from collections.abc import Sequence

import numpy as np

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.approach import smoothstep
from linemate.daemon.core.tracking.observation import Wrench
from linemate.daemon.core.tracking.task import Gate
from linemate.protocol.stamped_samples import Vector3

LEADING_S = 0.15  # commanded motion goes on for this long, whatever is decided now
STANDING_S = 0.1  # the last command leads a robot on for this long: servos, and the tool's swing
TOUCHING = 0.005  # within this distance the object may have been touched without a force [m]
STAND_OFF = 0.003  # a closed clamp holds the pull at this distance, 150 N by the shipped mount [m]
PULLING = 3.0  # times the force of a contact, as a mean: only a closed clamp gives so much
CALM_N = 60.0  # rms of a force with which the clamp may open: 1.7 mm of swing on 50 N/mm
LATERAL_N = 30.0  # mean force across the tool's axis with which it may: the object springs back
LONGEST_WAIT_S = 10.0  # for both; the object may leave the robot's reach
# The press is gone so long after the clamp was ordered to open: it needs as long [s].
UNLOADING_S = 0.3
RETREAT_S = 0.1  # the press needs to go, at least: at once it swung the tool deeper [s]
OPENING_S = 0.3  # a shipped clamp needs so long; a mean shows later whether one is still closed [s]
PULL_S = 0.2  # time constant of that mean [s]; an open tool rings at 4 Hz or more
SWING_N = 80.0  # rms of a force that may swing a free tool: 1.6 mm on 50 N/mm
STEADY = 0.35  # share of the mean square that the mean's square has in a closed clamp
HELD_OFF = 0.002  # so far off the object a closed clamp pulls with more than PULLING [m]


def may_be_clamped(
    *, contact: bool, released: bool, distance: float, opening: float | None, timeout: float
) -> bool:
    """Return whether to withdraw could pull at a closed clamp.

    After a contact the clamp is closed until it is reported open. Without one it may still have
    closed on an object this near, for example without a force-torque sensor. It was ordered to
    open: after the timeout it is open, or holds nothing.

    Args:
        released: the opening was reported, or its configured time is over.
        distance: programmed in ``LEADING_S`` from now, from the tcp to the object along z [m].
        opening: time since the clamp was ordered to open, None before [s].
        timeout: of the opening [s].
    """
    if released or contact:
        return not released
    return distance > -TOUCHING and (opening is None or opening < timeout)


def opens(opening: float, touching: float) -> bool:
    """Return whether a clamp that was felt to close has hardly had the time to open again.

    Args:
        opening: time since the clamp was ordered to open [s].
        touching: time since the touch [s].
    """
    return opening < min(OPENING_S, touching)


def holds_nothing(
    *, opening: float, timeout: float, touching: float, distance: float, pulls: bool
) -> bool:
    """Return whether a touch that was felt after the clamp was ordered to open was none.

    A closed clamp pulls at a tool that stands off. If it does not, it is open or holds nothing.

    Args:
        opening: time since the clamp was ordered to open [s].
        timeout: of the opening [s].
        touching: time since the touch [s].
        distance: programmed, from the tcp to the object along z [m].
        pulls: the mean force is one that only a closed clamp gives.
    """
    return opening >= timeout and opening > touching and distance < -HELD_OFF and not pulls


def is_overdue(opening: float | None, timeout: float, *, contact: bool) -> bool:
    """Return whether a clamp that was felt to close should have been reported open by now."""
    return contact and opening is not None and opening >= timeout


def is_calm(power: float, pull: Vector3) -> bool:
    """Return whether tool and object stay together as the clamp opens.

    Args:
        power: mean square of the oscillation's force [N^2].
        pull: mean force on the tool, in its axes [N].
    """
    return power < CALM_N**2 and math.hypot(pull[0], pull[1]) < LATERAL_N


def is_held_by_hub(
    gated: Sequence[tuple[float, Gate]], passed: frozenset[Gate], time: float
) -> bool:
    """Return whether the object holds the wheel, and the programme has gone on to its release.

    Args:
        gated: task times of the gates [s].
        passed: gates that are open.
        time: of the task's clock [s].
    """
    if Gate.SCREWS_FIXED not in passed:
        return False
    return any(gate is Gate.SCREWS_FIXED and time > at for at, gate in gated)


def averaged(pull: Vector3, wrench: Wrench | None, dt: float) -> Vector3:
    """Return the mean force on the tool one step later [N]."""
    if wrench is None:
        return pull
    gain = 1.0 - math.exp(-dt / PULL_S)
    (x, y, z), (a, b, c) = pull, wrench.force.tolist()
    return x + gain * (a - x), y + gain * (b - y), z + gain * (c - z)


def averaged_square(power: float, wrench: Wrench | None, dt: float) -> float:
    """Return the mean square of the force on the tool one step later [N^2]."""
    if wrench is None:
        return power
    square = math.hypot(*wrench.force.tolist()) ** 2
    return power + (1.0 - math.exp(-dt / PULL_S)) * (square - power)


def swings(pull: Vector3, power: float) -> bool:
    """Return whether a force swings a free tool: it is large, and its mean is small.

    Args:
        pull: mean force on the tool [N].
        power: mean square of that force [N^2].
    """
    return power > SWING_N**2 and math.hypot(*pull) ** 2 < STEADY * power


def without_press(relative: Array) -> Array:
    """Return the programmed tcp in the object (m, 6), not beyond its surface.

    A tool that waits for its clamp does not press: a loaded mount rings as the clamp opens.

    Args:
        relative: (m, 6) programmed tcp in the object; not written to.
    """
    if float(relative[:, 2].max()) <= 0.0:
        return relative
    changed = relative.copy()
    changed[:, 2] = np.minimum(relative[:, 2], 0.0)
    return changed


def unloading(
    relative: Array, since: Array, commanded: float, lasting: float = UNLOADING_S
) -> Array:
    """Return the programmed tcp in the object (m, 6) of a tool whose clamp was ordered to open.

    The press goes before the clamp opens: a loaded mount would throw the tool, and push the object.

    Args:
        relative: (m, 6) programmed tcp in the object; not written to.
        since: (m,) times since the order [s].
        commanded: time for which the motion is commanded already [s].
        lasting: time from the order until the press is gone [s]; it needs ``RETREAT_S`` to go.
    """
    if float(relative[:, 2].max()) <= 0.0:
        return relative
    changed = relative.copy()
    going = max(lasting - commanded, RETREAT_S)
    left = 1.0 - smoothstep((since - commanded) / going)
    changed[:, 2] = np.where(relative[:, 2] > 0.0, left * relative[:, 2], relative[:, 2])
    return changed


def at_stand_off(relative: Array) -> Array:
    """Return the programmed tcp in the object (m, 6), which ends no farther off than the stand-off.

    A tool that was led to the object before it was to retreat may be clamped without having felt
    it: farther away it would tear its mount. It is not led nearer either: it could touch.

    Args:
        relative: (m, 6) programmed tcp in the object; not written to.
    """
    changed = relative.copy()
    # As a whole: a corner in what is committed would swing the tool into the object.
    changed[:, 2] += max(0.0, -STAND_OFF - float(relative[-1, 2]))
    return changed


def standing_off(relative: Array, since: Array, commanded: float) -> Array:
    """Return the programmed tcp in the object (m, 6), which goes back to the stand-off.

    A closed clamp pulls there, and shows that it is closed.

    Args:
        relative: (m, 6) programmed tcp in the object; not written to.
        since: (m,) times since the clamp was ordered to open [s].
        commanded: time for which the motion is commanded already [s].
    """
    changed = relative.copy()
    back = -STAND_OFF * smoothstep((since - commanded) / UNLOADING_S)
    changed[:, 2] = np.minimum(relative[:, 2], back)
    return changed
