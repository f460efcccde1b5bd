"""States of tracking whose plan is at rest."""

import math

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking import linear_axis
from linemate.daemon.core.tracking.estimation.tool_weight import CLEAR_WAY
from linemate.daemon.core.tracking.go_no_go.clock_ramp import RUNNING
from linemate.daemon.core.tracking.go_no_go.decision import GO
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.touch import bolt_search, compliance, contact, guard, tare
from linemate.daemon.core.tracking.tracker_state import Tracker, TrackerState


def at_rest(tracker: Tracker, pose: Array, axis: float) -> TrackerState:
    """Return the state of a robot that stands with its tcp at ``pose`` (6,) in c."""
    return TrackerState(
        history=None,
        conveyor=None,
        transverse=None,
        first_poses=(),
        poses=np.tile(pose, (tracker.steps + 1, 1)),
        axis=linear_axis.at_rest(axis, tracker.axis_steps),
    )


def rest(tracker: Tracker, state: TrackerState, pose: Array, axis: float) -> TrackerState:
    """Return the state with its plan at rest and the task over; the estimate lives on.

    A tool that is on the object, or has not cleared it, is remembered as in contact: it has to be
    withdrawn from there.
    """
    poses = np.tile(pose, (tracker.steps + 1, 1))
    if _is_engaged(tracker, state):
        return replace(
            state,
            poses=poses,
            axis=linear_axis.at_rest(axis, tracker.axis_steps),
            contact=True,
            assumed=state.assumed or not state.contact,
            departure=None,
            withdrawn=None,
            clamped=False,
            keeps=False,
            anchor=None,
            gone=0.0,
            stood=0.0,
        )
    return replace(
        state,
        transverse=state.transverse and replace(state.transverse, felt=None),
        poses=poses,
        axis=linear_axis.at_rest(axis, tracker.axis_steps),
        departure=None,
        object_left=False,
        time=0.0,
        started=False,
        passed=frozenset(),
        blended=None,
        blend_s=math.inf,
        clock_stood=0.0,
        carried=0.0,
        contact_state=contact.NO_CONTACT,
        contact=False,
        fixing=None,
        releasing=None,
        withdrawn=None,
        clamped=False,
        keeps=False,
        anchor=None,
        gone=0.0,
        search=guard.NO_SEARCH,
        distance=math.inf,
        stood=0.0,
        slowed=0,
        go=GO,
        ramp=RUNNING,
        compliance=compliance.NO_COMPLIANCE,
        tare=tare.NO_TARE,
        bolts=bolt_search.NO_BOLT_SEARCH,
    )


def _is_engaged(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether the tool is clamped to the object, or was and has not cleared it.

    A tool that may be clamped counts: a clamp closes before the contact is felt.
    """
    is_released = state.started and Gate.WHEEL_RELEASED in state.passed
    if state.withdrawn is not None:
        return (state.contact or is_released) and state.withdrawn <= tracker.withdrawal.duration
    is_near = is_released and state.distance > -CLEAR_WAY
    return state.contact or state.clamped or is_near
