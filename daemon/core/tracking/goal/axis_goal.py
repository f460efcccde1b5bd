"""Plan of the linear axis, which travels with the conveyor unit."""

from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking import approach, linear_axis
from linemate.daemon.core.tracking.conveyor import ConveyorEstimate
from linemate.daemon.core.tracking.tracker_state import Tracker, TrackerState


def advance_axis(
    tracker: Tracker, state: TrackerState, view: ConveyorEstimate | None, along: Array | None
) -> TrackerState:
    """Return the state with the plan of the linear axis one step further.

    The axis travels as far as the conveyor unit since the task's clock started, as it is estimated
    and predicted. The unit is position plus offset: no image that corrects the offset moves it.
    """
    file, T0 = tracker.task.linear_axis, tracker.cycle_s
    goal, departure, left = state.axis.goal, state.departure, state.object_left
    moving = state.started and 0.0 < state.time < tracker.reference.times[-1]
    if moving and view is not None and along is not None:
        if departure is None:
            departure = goal, view.position + view.offset
        begun, unit = departure
        # A conveyor that runs is caught up with gradually: a ramp long.
        step = len(tracker.span)
        share = approach.smoothstep_at((state.time + float(tracker.ahead[step])) / file.ramp)
        travelled = float(along[step]) + view.offset - unit
        wanted = begun + tracker.axis_travel * share * travelled
        low, high = tracker.axis_range
        goal = min(max(wanted, low), high)
        # The goal is ahead of the axis by the plan's length and lag: time to hold or to retreat.
        left = goal != wanted
    axis = linear_axis.advance(state.axis, goal, file.ramp, T0)
    return replace(state, axis=axis, departure=departure, object_left=left)
