"""Guarded approach: advance beyond the estimated object until contact, up to a bound.

Invariants:
- The tool advances only while a contact is observable and there is none.
- It advances by at most the overrun of the task.
- From the contact on, the tool presses from there, wherever the object was estimated.
"""

import math

import numpy as np
from msgspec import Struct

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.approach import smoothstep
from linemate.daemon.core.tracking.task import GuardedApproach
from linemate.daemon.core.tracking.touch.contact import ContactState, ToolVibration, is_observable

PRESSING_S = 0.06  # least time in which the programme goes over into the press [s]
ACCELERATION = 1.5  # largest one of that, from which a longer time follows [m/s^2]
PEAK = 7.52  # largest second derivative of the step from 0 to 1 in unit time
GOES_ON_S = 0.15  # for which the motion goes on after a touch [s]
FACE_SHARE = 0.33  # of the force that a face gives over that way
RUBBING = 0.5  # largest coefficient of friction of bolts in their holes
TIMEOUT_FACTOR = 2.0  # a search that cannot advance ends after so many times its duration


class ContactSearch(Struct, frozen=True):
    """How far the tool has searched for the object.

    Attributes:
        reach: beyond the programme, along the tool's axis [m]. Less than 0 if the object was
            touched before it.
        lasted: time since the search began [s].
    """

    reach: float = 0.0
    lasted: float = 0.0


NO_SEARCH = ContactSearch()


class TouchedProgramme(Struct, frozen=True):
    """Where the programme was as the tool touched the object, and where it went on to.

    Attributes:
        beyond: programme, beyond the touched object along the tool's axis [m].
        speed: of the search that it went on at [m/s].
        pressing_s: time in which it goes over into the press [s].
    """

    beyond: float = 0.0
    speed: float = 0.0
    pressing_s: float = PRESSING_S


UNTOUCHED = TouchedProgramme()


def face_force(guard: GuardedApproach, stiffness: float, across: float = 0.0) -> float:
    """Return the force along the tool's axis from which an early touch is the object's face [N].

    The face stops the tool, and the force grows with the way on. Bolts that rub in their holes
    resist less, however far the tool goes: by their friction under the force across the axis.

    Args:
        stiffness: of the mount along that axis [N/m].
        across: force across the tool's axis [N].
    """
    return FACE_SHARE * guard.touch_speed * GOES_ON_S * stiffness + RUBBING * across


def advanced(
    search: ContactSearch,
    guard: GuardedApproach,
    contact_state: ContactState,
    vibration: ToolVibration,
    dt: float,
) -> ContactSearch:
    """Return the search one step later.

    Args:
        contact_state: forces along the tool's axis.
        vibration: of the tool, with the force of a contact.
    """
    reach = search.reach
    # A force that is no contact yet may become one: wait for it.
    if is_observable(contact_state, vibration) and abs(contact_state.forces[-1]) < vibration.force:
        reach = min(reach + guard.speed * dt, guard.overrun)
    return ContactSearch(reach, search.lasted + dt)


def has_failed(search: ContactSearch, guard: GuardedApproach) -> bool:
    """Return whether the object was not found within the overrun."""
    if guard.overrun <= 0.0 or search.lasted <= 0.0:
        return False
    duration = guard.overrun / guard.speed
    return search.reach >= guard.overrun or search.lasted > TIMEOUT_FACTOR * duration


def reached(
    relative: Array, search: ContactSearch, guard: GuardedApproach, span: Array, *, is_on: bool
) -> Array:
    """Return the programmed tcp in the object (m, 6) with the search added along the tool's axis.

    Args:
        relative: (m, 6) programmed; not written to.
        span: (m,) times from now [s].
        is_on: the search goes on; otherwise it stays where it is.
    """
    if math.isclose(search.reach, 0.0) and not is_on:
        return relative
    way = search.reach + (guard.speed * span if is_on else 0.0 * span)
    changed = relative.copy()
    changed[:, 2] += np.minimum(way, guard.overrun)
    return changed


def pressing_time(way: float) -> float:
    """Return the time in which the programme goes over into the press [s].

    Short, because the tool moves on until then.

    Args:
        way: to the press, from where the programme leads the tool until it changes [m].
    """
    return max(PRESSING_S, math.sqrt(PEAK * abs(way) / ACCELERATION))


def pressing(
    relative: Array, press: float, steps: int, times: tuple[Array, float], touched: TouchedProgramme
) -> Array:
    """Return the programmed tcp in the object (m, 6) of a tool that has touched it.

    A tool that touches early would move on or back with the programme: it presses instead. What is
    commanded already moves it into the object. So the programme goes over into the press behind
    that: a goal that stopped at once would throw it back, or deeper.

    Args:
        relative: (m, 6) programmed; not written to.
        press: programmed at the waypoint of contact, along the tool's axis [m].
        steps: of them that are before the waypoint of contact.
        times: (m,) since the contact began [s], and until when it was commanded already.
    """
    since, commanded = times
    if steps <= 0 and since[0] - commanded >= touched.pressing_s:
        return relative
    share = smoothstep((since - commanded) / touched.pressing_s)
    if steps <= 0 and share[0] >= 1.0:
        return relative
    changed = relative.copy()
    changed[: max(steps, 0), 2] = press
    wanted = changed[:, 2]
    going_on = relative[:, 2] + touched.beyond + touched.speed * since
    pressed = going_on + share * (wanted - going_on)
    changed[:, 2] = np.where(wanted > 0.0, pressed, wanted)
    return changed


def touched_reach(tcp: Array, part: Array, force: float, stiffness: float, limit: float) -> float:
    """Return how far beyond its estimate the object was touched [m], less than 0 if before it.

    Args:
        tcp: (6,) undeflected tcp in c.
        part: (6,) estimated object in c.
        force: along the tool's axis, less than 0 if it pushes the tool back [N].
        stiffness: of the mount along that axis [N/m].
        limit: largest distance that is used [m].
    """
    depth = float(rotations.exp(part[3:])[:, 2] @ (tcp[:3] - part[:3]))
    return min(max(depth + force / stiffness, -limit), limit)
