"""Search for the angle of bolts: a tool whose bolts do not enter tries again, turned.

The camera sees the object, but hardly its bolts' angle about its axis. Bolts that meet the face
between their holes stop the tool, and no force shows to which side they have to turn. So the tool
backs off, turns about its axis, and comes again.

Invariants:
- The tool turns where its tips are clear of the object, and stays turned until the task is over.
- A chamfer that draws the bolts in pushes aside as hard as it pushes back: that is no jam.
- A force that lasts is one, however small: the tips push an object on a soft carrier away.
- After the last angle the tool waits before contact: pressing on would drive the object away.
"""

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.approach import smoothstep
from linemate.daemon.core.tracking.touch.touch_profile import TIPS_RESERVE

TURNS = (0.0, 0.5, -0.5, 1.0, -1.0)  # angles that are tried, as shares of the bolts' range
LAST = len(TURNS) - 1
JAMMED_SHARE = 0.17  # of the overload, as force along the axis; the tool moves on for 0.2 s
SURE_SHARE = 0.3  # more than a chamfer gives to a tool 1.5 mm off it
ASIDE = 0.5  # share of it across the axis: less is friction, more is a chamfer
RUBS = 0.35  # share of the force across that bolts in their holes give along the axis
LASTING_S = 0.3  # for which more than that is a jam; a chamfer is passed in less than 0.1 s [s]
DEEPEST = 0.4  # share of the bolts' length from the face, within which a force may be the face's
TURN_S = 1.0  # time of a turn [s]


class BoltSearch(Struct, frozen=True):
    """State of the search in one approach.

    Attributes:
        tried: index of the angle in ``TURNS``.
        is_jammed: the bolts do not enter at it: the tool backs off, or turns.
        before: angle of the tool before the last turn [rad].
        angle: to which it turns, about its axis [rad].
        turning: time since that turn began [s].
        pressed_s: for how long the tips have pressed, less the time for which they have not [s].
    """

    tried: int = 0
    is_jammed: bool = False
    before: float = 0.0
    angle: float = 0.0
    turning: float = TURN_S
    pressed_s: float = 0.0

    @property
    def is_over(self) -> bool:
        """Whether the bolts do not enter at the last angle either."""
        return self.is_jammed and self.tried == LAST


NO_BOLT_SEARCH = BoltSearch()


def is_at_tips(length: float, distance: float) -> bool:
    """Return whether the tips of the bolts may touch, and the face does not.

    Args:
        length: of the bolts from the face [m]; 0 for none.
        distance: programmed, from the tcp to the object along its z [m].
    """
    return -length - TIPS_RESERVE < distance < -max(DEEPEST * length, TIPS_RESERVE)


def is_clear(length: float, distance: float) -> bool:
    """Return whether the tips of the bolts are so far off that a tool may turn."""
    return distance < -length - TIPS_RESERVE


def is_pressed(force: Sequence[float], length: float, distance: float, least: float) -> bool:
    """Return whether the tips of the bolts press on the object by more than they rub in holes.

    Args:
        force: of the contact on the tool, in its axes [N].
        least: force of a contact [N].
    """
    x, y, z = force
    return is_at_tips(length, distance) and z < -least - RUBS * math.hypot(x, y)


def is_jammed(force: Sequence[float], length: float, distance: float, overload: float) -> bool:
    """Return whether the tips of the bolts rest between their holes.

    Args:
        force: of the contact on the tool, in its axes [N].
        length: of the bolts from the face [m]; 0 for none.
        distance: programmed, from the tcp to the object along its z [m].
        overload: limit of the force on the tool [N].
    """
    if not is_at_tips(length, distance):
        return False
    x, y, z = force
    if z < -SURE_SHARE * overload:
        return True
    return z < -JAMMED_SHARE * overload and math.hypot(x, y) < -ASIDE * z


def pressing(search: BoltSearch, dt: float, *, presses: bool) -> BoltSearch:
    """Return the search with the time for which the tips have pressed.

    Args:
        presses: they press by more than they rub in holes.
    """
    pressed_s = max(search.pressed_s + (dt if presses else -dt), 0.0)
    return search if pressed_s == search.pressed_s else replace(search, pressed_s=pressed_s)


def advanced(
    search: BoltSearch, spread: float, dt: float, *, jams: bool, is_clear: bool
) -> BoltSearch:
    """Return the search one step later.

    Args:
        spread: by which the bolts' angle may be off to each side [rad].
        jams: the tips rest between their holes.
        is_clear: its tips are clear of the object.
    """
    if not search.is_jammed and (jams or search.pressed_s > LASTING_S):
        # Without other angles the search is over.
        tried = search.tried if spread > 0.0 else LAST
        return replace(search, is_jammed=True, tried=tried, pressed_s=0.0)
    if search.turning < TURN_S:
        turning = search.turning + dt
        return replace(search, turning=turning, is_jammed=turning < TURN_S)
    if search.is_jammed and is_clear and not search.is_over:
        tried = search.tried + 1
        return BoltSearch(tried, True, search.angle, TURNS[tried] * spread, 0.0)
    return search


def turned(target: Array, search: BoltSearch, span: Array) -> Array:
    """Return the target (m, 6) of the tcp, turned about its axis.

    Args:
        target: (m, 6), stays as it is.
        span: (m,) times from now [s].
    """
    if search.before == search.angle == 0.0:
        return target
    share = smoothstep((search.turning + span) / TURN_S)
    angles = search.before + share * (search.angle - search.before)
    turns = rotations.exp_many(np.outer(angles, (0.0, 0.0, 1.0)))
    changed = target.copy()
    changed[:, 3:] = rotations.log_many(rotations.exp_many(target[:, 3:]) @ turns)
    return changed


def unturned(rotation: Array, search: BoltSearch) -> Array:
    """Return the object's orientation (3, 3) that a turned tool measures with its own."""
    back: Array = rotation @ rotations.exp(np.array((0.0, 0.0, -search.angle)))
    return back
