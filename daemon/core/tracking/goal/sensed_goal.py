"""Goal by the sensed object: eased after a jump, blended with the programme, led for a lag."""

import math

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking import approach, merge
from linemate.daemon.core.tracking.conveyor import ConveyorEstimate, Motion
from linemate.daemon.core.tracking.estimation.mount_sag import sagging
from linemate.daemon.core.tracking.go_no_go import target_shift
from linemate.daemon.core.tracking.goal import object_prediction
from linemate.daemon.core.tracking.task_clock import is_blended
from linemate.daemon.core.tracking.tracker_state import Tracker, TrackerState

STEADY_S = 1.0  # of the conveyor, before a robot's lag is judged [s]


def ease_target(
    tracker: Tracker,
    state: TrackerState,
    view: ConveyorEstimate | None,
    now_ns: int,
    target: Array,
    part: Array,
) -> TrackerState:
    """Return the state with the shift of the target, which it adds to the target (m, 6)."""
    speed, eases = 0.0 if view is None else view.speed, not state.contact
    slope = math.nan
    if state.releasing is not None:
        slope = float(target[1, merge.ALONG] - target[0, merge.ALONG]) / tracker.cycle_s
    shift = target_shift.advanced(
        state.shift, now_ns, float(part[1]), speed, eases=eases, slope=slope
    )
    if shift.begun or shift.rate:
        target[:, merge.ALONG] += target_shift.remaining(shift, tracker.span)
    return replace(state, shift=shift)


def blend_goal(
    tracker: Tracker, state: TrackerState, goal: Array, target: Array
) -> tuple[TrackerState, Array]:
    """Return the state and the goal (m, 6) between programmed and sensed motion."""
    blended = state.blended
    if blended is None:
        return state, goal
    if state.blend_s == math.inf:
        way = float(np.linalg.norm(target[0, :3] - goal[0, :3]))
        blend_s = approach.catch_up_time(way, tracker.settings.merge.blend)
        state = replace(state, blend_s=blend_s)
    sensed = sagging(state, target)
    if is_blended(state):
        return state, sensed
    share = approach.smoothstep((blended + tracker.span) / state.blend_s)
    return state, approach.blend(goal, sensed, share)


def lead_goal(
    tracker: Tracker,
    state: TrackerState,
    view: ConveyorEstimate | None,
    goal: Array,
    along: Array,
    relative: Array,
) -> tuple[TrackerState, Array]:
    """Return the state and the goal (m, 6) ahead of the object for a robot that lags.

    It is learnt while object and programme move steadily.

    Args:
        along: (m,) or longer: positions of the object along the conveyor [m].
        relative: (m, 6) the programmed tcp in the object.
    """
    is_steady = (
        view is not None
        and view.motion is Motion.RUNNING
        and not view.tentative
        and view.speed > 0.5 * tracker.task.conveyor.nominal_speed
        and state.steady_s > STEADY_S
        and state.withdrawn is None
    )
    if view is not None and is_steady and is_blended(state):
        off = float(rotations.exp(state.poses[0, 3:])[merge.ALONG].dot(state.following))
        waits = state.oscillated is not None  # for the mount to be bent less
        lead = approach.lead(state.lead, off, view.speed, tracker.cycle_s, is_whole=waits)
        state = state if lead == state.lead else replace(state, lead=lead)
    if state.lead == 0.0:
        return state, goal
    if not is_blended(state) or state.transverse is None:
        return replace(state, lead=0.0), goal
    filtered = tracker.transverse
    estimate = filtered.believed(state.transverse)
    swing = filtered.swing_angles(estimate, tracker.span)
    part = object_prediction.part_ahead(tracker, state, along[: len(goal)], tracker.span, swing)
    lead, turned = state.lead, tracker.reference.turned
    modes = filtered.swing
    moved = approach.ahead(part, lead, tracker.cycle_s, modes, relative, turned=turned)
    return state, goal + moved
