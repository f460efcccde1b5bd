"""Programmed poses of the tool over the horizon."""

import math

import numpy as np

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking import merge
from linemate.daemon.core.tracking.task_clock import is_before_contact, is_blended, programme_times
from linemate.daemon.core.tracking.touch import guard, release, touch_proof
from linemate.daemon.core.tracking.tracker_state import Tracker, TrackerState


def programmed_poses(
    tracker: Tracker, state: TrackerState, limit: float, retreat: bool
) -> tuple[Array, Array]:
    """Return the programmed tcp x_r and the programmed tcp in the object, (m, 6) each.

    Args:
        limit: task time at which the clock stops [s].
    """
    times = programme_times(tracker, state)
    goal, relative = tracker.table.ahead(state.time, limit, tracker.steps)
    if not is_blended(state):
        stands = not retreat or state.clock_stood > 0.0
        goal = _going_on(tracker, state, goal, limit if stands else math.inf)
    if times is not None:
        relative = tracker.table.between(times)[1]
    if state.contact and not is_before_contact(tracker, state):
        return goal, _pressing_poses(tracker, state, relative)
    return goal, _waiting_poses(tracker, state, relative) if retreat else relative


def _going_on(tracker: Tracker, state: TrackerState, goal: Array, limit: float) -> Array:
    """Return the programmed tcp (m, 6) of a tool that comes to rest while its clock stands.

    Args:
        limit: task time at which the clock stops [s]; infinity if it need not come to rest.
    """
    before = max(limit - state.time, 0.0)
    if before >= tracker.span[-1] and not state.carried:
        return goal
    goal = goal.copy()
    goal[:, merge.ALONG] += state.carried
    if limit < math.inf:
        stood = state.clock_stood + np.maximum(tracker.span - before, 0.0)
        goal += tracker.reference.way_on(limit, stood)
    return goal


def _pressing_poses(tracker: Tracker, state: TrackerState, relative: Array) -> Array:
    """Return the programmed tcp in the object (m, 6) of a tool in contact."""
    before = math.ceil((tracker.search_time - state.time) / tracker.cycle_s - 1e-6)
    commanded = tracker.merge_clamped.committed_s
    times = state.touching + tracker.span, commanded
    relative = guard.pressing(relative, tracker.press, before, times, state.touched)
    if state.releasing is None:
        return relative
    since = state.releasing + tracker.span
    return release.unloading(relative, since, commanded, state.unloading_s)


def _waiting_poses(tracker: Tracker, state: TrackerState, relative: Array) -> Array:
    """Return the programmed tcp in the object (m, 6) of a tool that is to retreat."""
    relative = release.without_press(relative)
    if state.contact and touch_proof.is_doubted(state.beyond_s):
        since = (state.releasing or 0.0) + tracker.span
        return release.standing_off(relative, since, tracker.merge_clamped.committed_s)
    is_near = state.clamped and not state.contact_state.doubtful
    if is_near and is_before_contact(tracker, state):
        relative = release.at_stand_off(relative)
    return relative
