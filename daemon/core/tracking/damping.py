"""Share of the damping (11) over the horizon: full while the tool hangs free, none when clamped."""

import math

import numpy as np

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.reference import Reference
from linemate.daemon.core.tracking.tracker_state import Tracker, TrackerState

CONTACT_SHARE = 0.25  # share of the damping that is still there at contact
FREED_S = 0.06  # in which it is blended in as an emergency retraction begins [s]


def damping_time(tracker: Tracker, state: TrackerState) -> float:
    """Return the task time by which the tool is damped [s]: a clamped one is not.

    A tool that touched early is in contact before its programme is.
    """
    if state.contact and state.time < tracker.search_time:
        return max(state.time, tracker.damped_until + state.touching)
    return state.time


def horizon_shares(tracker: Tracker, state: TrackerState, limit: float) -> Array:
    """Return where over the horizon the tool hangs free (n+1,).

    Args:
        limit: task time at which the clock stops [s].
    """
    shares = free_shares(tracker, damping_time(tracker, state), limit)
    if state.withdrawn is None:
        return shares
    # The clock may stand where the tool is clamped.
    freed = np.minimum((state.withdrawn + tracker.span) / FREED_S, 1.0)
    return np.asarray(np.maximum(shares, freed))


def free_shares(tracker: Tracker, time: float, limit: float) -> Array:
    """Return where over the horizon the tool hangs free by the task's clock (n+1,)."""
    first = round(time / tracker.cycle_s)
    last = first + tracker.steps
    if limit >= last * tracker.cycle_s and last < len(tracker.free):
        return tracker.free[first : last + 1]
    end = len(tracker.free) - 1
    if limit < math.inf:
        end = min(end, round(limit / tracker.cycle_s))
    return tracker.free[np.minimum(np.arange(first, last + 1), end)]


def damped_until(reference: Reference, blend: float) -> float:
    """Return the last task time before contact at which ``free_table`` is 1 [s]."""
    return reference.contact_time - (1.0 - CONTACT_SHARE) * blend


def free_table(reference: Reference, leave: float, blend: float, times: Array) -> Array:
    """Return where at some task times the tool hangs free (m,): 0 from contact to retreat.

    The tool is damped until contact and not while clamped. What (11) adds is blended out: three
    quarters of the blend before contact, a quarter after it. Then the errors before and after are
    alike: 0.04 mm, instead of 0.07 mm on one side.

    Args:
        reference: with the time of contact.
        leave: when the tool leaves the object [s].
        blend: duration of the blend [s].
    """
    before = (reference.contact_time - times) / blend + CONTACT_SHARE
    after = (times - leave) / blend
    return np.asarray(np.clip(np.maximum(before, after), 0.0, 1.0))
