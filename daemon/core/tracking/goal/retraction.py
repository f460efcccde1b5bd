"""Retraction of a tool: back from the object, from a robot that tracked or stood."""

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking import approach, linear_axis, merge
from linemate.daemon.core.tracking.go_no_go import target_shift
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.task_clock import LARGEST_BEND
from linemate.daemon.core.tracking.touch import release, withdrawal
from linemate.daemon.core.tracking.tracker_state import Tracker, TrackerState

LONGEST_CATCH_UP_S = 0.03  # a retraction without commands for longer begins again at rest [s]
HUB_DEPTH = 0.01  # way from the object from which on a released tool may lag behind it [m]
LARGEST_LAG = 0.009  # of one that is nearer [m]; beyond it the plan runs on, and it keeps only
KEPT = 0.4  # this share of it: one that keeps the whole is dragged along the hub
CAUGHT_UP = 0.6  # of half a period: the free tool swings less if a shorter silence is caught up
REPORT_CYCLES = 2.5  # until telegrams report that the clamp is open


def is_interrupted(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether a retraction got no commands for so long that it has to begin again.

    A released tool that has not cleared the object goes back to its place instead.
    """
    if state.withdrawn is None or state.stood <= LONGEST_CATCH_UP_S:
        return False
    return Gate.WHEEL_RELEASED not in state.passed or _gone(tracker, state) > HUB_DEPTH


def withdraw_again(tracker: Tracker, state: TrackerState, pose: Array, axis: float) -> TrackerState:
    """Return the state of a retraction that begins again with its plan at rest."""
    return replace(
        state,
        poses=np.tile(pose, (tracker.steps + 1, 1)),
        axis=linear_axis.at_rest(axis, tracker.axis_steps),
        departure=None,
        withdrawn=0.0,
        gone=_gone(tracker, state),
        anchor=None,
    )


def _gone(tracker: Tracker, state: TrackerState) -> float:
    """Return the way of a retraction to which the last command leads that the robot got [m]."""
    before = (state.withdrawn or 0.0) - state.stood
    if before <= 0.0:  # it has begun again in the last step already
        return state.gone
    times = np.array([before + release.STANDING_S])
    return state.gone + float(tracker.withdrawal.way(times, state.gone, state.further)[0])


def withdraw(
    tracker: Tracker, state: TrackerState, goal: Array, part: Array | None, relative: Array
) -> tuple[TrackerState, Array]:
    """Return the state and the goal (m, 6) of a tool that withdraws.

    One that begins again at rest takes up the object's speed as gradually as its own. Where the
    task's own retreat runs, both together are no faster than either.

    Args:
        part: (6,) the object now, None while it is not seen.
        relative: (m, 6) the programmed tcp in the object.
    """
    if state.withdrawn == 0.0 and state.gone <= 0.0:
        leaving = float(np.max(relative[:-1, 2] - relative[1:, 2])) / tracker.cycle_s
        state = replace(state, further=_further(tracker, state, part), leaving=leaving)
    times = (state.withdrawn or 0.0) + tracker.span
    way = tracker.withdrawal.way(times, state.gone, state.further)
    goal = approach.withdraw(goal, tracker.withdrawal.share(state.leaving) * way)
    if state.gone > 0.0:
        goal[:, merge.ALONG] -= state.speed * withdrawal.lag(times)
    return state, goal


def may_have_opened(tracker: Tracker, before: TrackerState, after: TrackerState) -> bool:
    """Return whether the clamp may have opened while no telegram could report it."""
    if after.releasing is None or after.withdrawn is not None or not before.contact:
        return False
    is_long = max(before.stood, after.stood) > CAUGHT_UP * max(_half_periods(tracker))
    return is_long and after.releasing >= release.OPENING_S


def is_reported(
    tracker: Tracker, before: TrackerState, after: TrackerState, *, is_lost: bool
) -> bool:
    """Return whether a clamp that may have opened in silence is known to be open or closed.

    A tool that is far behind waits for the first telegram alone.

    Args:
        is_lost: the robot did not get the last command.
    """
    if Gate.WHEEL_RELEASED in after.passed:
        return True
    is_far = after.speed * before.stood > LARGEST_LAG
    late = (after.releasing or 0.0) - release.OPENING_S
    return not is_lost and (is_far or late >= REPORT_CYCLES * tracker.cycle_s)


def kept_share(way: Array) -> float:
    """Return which share of its way from the plan (6,) a tool keeps that may be free."""
    return KEPT if abs(float(way[merge.ALONG])) > LARGEST_LAG else 1.0


def stay_behind(tracker: Tracker, state: TrackerState, way: Array, axis: float) -> TrackerState:
    """Return the state of a tool that goes on from where it is, and follows the object gently.

    Args:
        way: (6,) from its plan to where it is.
        axis: the same of the linear axis [m].
    """
    shift = _left_behind(tracker, state, -float(way[merge.ALONG]))
    plan = linear_axis.displaced(state.axis, axis)
    return replace(state, poses=state.poses + way, axis=plan, shift=shift)


def _left_behind(tracker: Tracker, state: TrackerState, way: float) -> target_shift.TargetShift:
    """Return the target's shift of a tool that stayed behind its object by one more way [m]."""
    delay = tracker.merge_free.first_free * tracker.cycle_s
    return target_shift.left_behind(state.shift, way, delay)


def _half_periods(tracker: Tracker) -> list[float]:
    """Return half the periods of the free tool [s]."""
    return [swing.half * tracker.cycle_s for swing in (tracker.vibration, *tracker.across)]


def pause(
    tracker: Tracker, before: TrackerState, after: TrackerState, *, is_lost: bool
) -> tuple[TrackerState, bool]:
    """Return the state of a tool that may leave, and whether its last plan is commanded once more.

    Where the plan ran on, the robot caught up with it half a period of the free tool after its
    stop: both swings added up. So the object alone goes on, and the tool follows it gently.

    Args:
        before: of the step that made that plan.
        after: of the step that would follow it.
        is_lost: the robot did not get that command; else the plan goes on at half its speed.
    """
    is_leaving = Gate.WHEEL_RELEASED in after.passed and after.releasing is not None
    if not is_leaving or after.withdrawn is not None:
        return after, False
    shift = _left_behind(tracker, after, after.speed * tracker.cycle_s)
    if is_lost:
        _, off = tracker.table.ahead(before.time + release.STANDING_S, np.inf, 0)
        is_near = off[0, 2] > -HUB_DEPTH
        if after.slowed < 0:
            return replace(after, shift=_left_behind(tracker, after, 0.0)), False
        if is_near and abs(shift.begun) > LARGEST_LAG:
            shift = replace(shift, begun=KEPT * shift.begun, rate=0.0)
            return replace(after, shift=shift, slowed=-1), False
        # Two halves of a start, half a period apart, cancel each other's swing.
        is_slow = not is_near and after.stood > LONGEST_CATCH_UP_S
        half = np.mean(_half_periods(tracker)) / tracker.cycle_s
        slowed = 2 * round(0.5 * half) if is_slow else 0
    else:
        slowed = max(after.slowed - 1, 0)
        if slowed % 2 == 0:
            return replace(after, slowed=slowed), False
    plan = replace(
        after,
        poses=before.poses,
        calming=before.calming,
        axis=before.axis,
        distance=before.distance,
        time=before.time,
        ramp=before.ramp,
        shift=shift,
        slowed=slowed,
    )
    return plan, True


def _further(tracker: Tracker, state: TrackerState, part: Array | None) -> float:
    """Return the way of a retraction behind the least one [m]; none from an unseen object."""
    if part is None:
        return 0.0
    axis = rotations.exp(state.poses[0, 3:])[:, 2]
    return tracker.withdrawal.further(float(axis @ (part[:3] - state.poses[0, :3])))


def anchor_goal(state: TrackerState, goal: Array) -> tuple[TrackerState, Array]:
    """Return the state and the goal (m, 6) of a retraction that began from a robot at rest."""
    anchor = state.anchor
    if anchor is None:
        off = state.poses[0] - goal[0]
        anchor = off if state.gone > 0.0 else _rest_offset(off)
        state = replace(state, anchor=anchor)
    return state, goal + anchor if state.started else np.tile(anchor, (len(goal), 1))


def _rest_offset(off: Array) -> Array:
    """Return what a robot that stood keeps between its tcp and the object (6,).

    Nothing as long as the tool can still be on the object: then it is brought back to its place.
    Else it follows the object from where it is, for it would be led into the object again.
    """
    return np.zeros(6) if float(np.linalg.norm(off[:3])) <= LARGEST_BEND else off
