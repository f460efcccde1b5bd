"""Searches of a tool: for an object beyond its estimate, and for the angle of bolts."""

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.tracking.observation import Wrench
from linemate.daemon.core.tracking.touch import bolt_search, compliance, guard
from linemate.daemon.core.tracking.tracker_state import Tracker, TrackerState


def is_searching(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether the tool is where it should touch the object, and no contact was detected."""
    if state.contact or state.releasing is not None or state.blended is None:
        return False
    return state.time >= tracker.search_time


def advance_search(tracker: Tracker, state: TrackerState) -> guard.ContactSearch:
    """Return the search one step later."""
    return guard.advanced(
        state.search, tracker.task.guard, state.contact_state, tracker.vibration, tracker.cycle_s
    )


def end_search(state: TrackerState) -> TrackerState:
    """Return the state of a tool that has found the object beyond its estimate.

    The tactile sensor places the object from now on. The estimate must follow it at once, because
    the programme counts from there and the search is over.
    """
    history = state.history
    axis = np.zeros(3) if history is None else rotations.exp(history.poses[-1][3:])[:, 2]
    x, y, z = (state.search.reach * axis).tolist()
    complied = compliance.displaced((x, y, z))
    return replace(state, compliance=complied, search=guard.NO_SEARCH)


def search_bolts(tracker: Tracker, state: TrackerState, wrench: Wrench | None) -> TrackerState:
    """Return the state with the search for the angle of bolts one step later."""
    payload = tracker.settings.payload
    if payload.bolts <= 0.0 or state.contact or state.withdrawn is not None:
        return state
    mount, bolts, jams = tracker.settings.tactile, state.bolts, False
    if wrench is not None:
        where = wrench.force.tolist(), payload.bolts, state.distance
        jams = bolt_search.is_jammed(*where, mount.overload_force)
        presses = bolt_search.is_pressed(*where, mount.contact_force)
        bolts = bolt_search.pressing(bolts, tracker.cycle_s, presses=presses)
    is_clear = bolt_search.is_clear(payload.bolts, state.distance)
    bolts = bolt_search.advanced(
        bolts, payload.bolt_angle, tracker.cycle_s, jams=jams, is_clear=is_clear
    )
    if bolts is state.bolts:
        return state
    transverse = state.transverse
    if transverse is not None and bolts.is_jammed and not state.bolts.is_jammed:
        transverse = tracker.transverse.pushed(transverse)
    return replace(state, bolts=bolts, transverse=transverse)
