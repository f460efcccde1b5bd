"""Prediction of the object over the horizon, and of the tool that follows it, (5)-(9)."""

import math

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking import approach, merge
from linemate.daemon.core.tracking.conveyor import ConveyorEstimate
from linemate.daemon.core.tracking.estimation import prediction_error
from linemate.daemon.core.tracking.go_no_go.evidence import is_certain
from linemate.daemon.core.tracking.tracker_state import Tracker, TrackerState


def predict_object(
    tracker: Tracker,
    state: TrackerState,
    view: ConveyorEstimate | None,
    now_ns: int,
    along: Array,
    relative: Array,
) -> tuple[TrackerState, Array, Array]:
    """Return the state, x_f over the horizon (m, 6), (9) under the class, and the object now (6,).

    Predictions whose check is due are kept in the state: the object at the leads, two rows more.

    Args:
        state: with the object's estimate across the conveyor.
        along: positions of the conveyor at ``Tracker.ahead`` [m].
        relative: (m, 6) the programmed tcp in the object.
    """
    ahead = tracker.span
    count, leads = len(ahead), len(tracker.leads)
    steady = along[:count]
    added = _added_way(tracker, state, view, along, tracker.ahead)
    # What excites a swing has the corners of the conveyor's way.
    near = None if added is None else merge.smoothed(added[:count], tracker.corner)
    if not tracker.settings.predict:
        ahead = 0.0 * ahead
    if not _is_prediction_due(tracker, state, view, now_ns):
        poses, part = _sensed_poses(tracker, state, now_ns, steady, ahead, relative, near)
        return state, poses, part
    later, times = along[-leads:], tracker.ahead[-leads:]
    poses, part = _sensed_poses(
        tracker,
        state,
        now_ns,
        np.concatenate((steady, later)),
        np.concatenate((ahead, times)),
        np.concatenate((relative, np.zeros((leads, 6)))),
        None if added is None or near is None else np.concatenate((near, added[-leads:])),
    )
    state = _kept_prediction(tracker, state, view, now_ns, poses[count:], later)
    return state, poses[:count], part


def predict_observed(
    tracker: Tracker, state: TrackerState, view: ConveyorEstimate | None, now_ns: int
) -> tuple[TrackerState, Array, Array]:
    """Return the state, x_f now and at the leads (1 + leads, 6), and the object now (6,).

    For a robot that does not track: predictions that are checked before the start count.

    Args:
        state: with the object's estimate along and across the conveyor.
    """
    _, relative = tracker.table.ahead(state.time, math.inf, 0)
    times = np.array((0.0, *tracker.leads))
    along = tracker.classifier.predict_positions(state.conveyor, times)
    rows = np.concatenate((relative, np.zeros((len(tracker.leads), 6))))
    added = _added_way(tracker, state, view, along, times)
    poses, part = _sensed_poses(tracker, state, now_ns, along, times, rows, added)
    if _is_prediction_due(tracker, state, view, now_ns):
        state = _kept_prediction(tracker, state, view, now_ns, poses[1:], along[1:])
    return state, poses, part


def _is_prediction_due(
    tracker: Tracker, state: TrackerState, view: ConveyorEstimate | None, now_ns: int
) -> bool:
    """Return whether predictions of this step are kept for their check.

    Args:
        state: with the object's estimate across the conveyor.
    """
    is_due = not state.contact and prediction_error.is_due(state.monitor, now_ns)
    if view is None or not is_due or tracker.foresight is not None:
        return False
    return is_certain(tracker, state, view, tracker.leads[-1])


def _kept_prediction(
    tracker: Tracker,
    state: TrackerState,
    view: ConveyorEstimate | None,
    now_ns: int,
    poses: Array,
    along: Array,
) -> TrackerState:
    """Return the state with the predictions of this step kept for their check.

    Args:
        poses: (leads, 6) of the object at ``Tracker.leads`` in c.
        along: (leads,) of the conveyor then [m].
    """
    offset = 0.0 if view is None else view.offset
    # The distance sensor sees the conveyor unit, without the object's sway.
    sway = tracker.classifier.predict_sway(state.conveyor, np.array(tracker.leads))
    unit = along - sway + offset
    monitor = prediction_error.record(state.monitor, now_ns, tracker.leads, poses.copy(), unit)
    return replace(state, monitor=monitor)


def _added_way(
    tracker: Tracker, state: TrackerState, view: ConveyorEstimate | None, along: Array, times: Array
) -> Array | None:
    """Return what a change of speed adds to the conveyor's way (m,) [m].

    None in contact, where the tool holds the object, and where nothing across depends on it.

    Args:
        along: (m,) predicted positions of the object along the conveyor [m].
        times: (m,) from now [s].
    """
    if view is None or state.contact or not tracker.transverse.is_driven:
        return None
    sway = tracker.classifier.predict_sway(state.conveyor, times)
    steady = view.position - view.sway + view.speed * times
    added: Array = along - sway - steady
    return added


def _sensed_poses(
    tracker: Tracker,
    state: TrackerState,
    stamp_ns: int,
    along: Array,
    ahead: Array,
    relative: Array,
    added: Array | None,
) -> tuple[Array, Array]:
    """Return x_f at some times (m, 6), (9) under the class, and the object now (6,).

    Args:
        state: with the object's estimate across the conveyor.
        along: (m,) predicted positions along the conveyor [m].
        ahead: (m,) the times from now [s], of which the first is 0.
        relative: (m, 6) the programmed tcp in the object.
        added: (m,) what a change of the conveyor's speed adds to its way [m]; None for nothing.
    """
    if tracker.foresight is not None:
        positions, vectors = tracker.foresight(stamp_ns, ahead)
        return approach.known(positions, vectors, relative, turned=tracker.reference.turned)
    filtered = tracker.transverse
    assert state.transverse is not None  # noqa: S101 - the caller has checked
    estimate = filtered.believed(state.transverse)
    swing = filtered.swing_angles(estimate, ahead)
    if added is not None:
        swing += filtered.driven_angles(estimate, ahead, added)
    part = part_ahead(tracker, state, along, ahead, swing)
    return approach.sensed(part, filtered.swing, relative, turned=tracker.reference.turned)


def part_ahead(
    tracker: Tracker, state: TrackerState, along: Array, times: Array, swing: Array
) -> approach.Part:
    """Return the object at some times.

    Args:
        state: with the object's estimate across the conveyor.
        along: (m,) predicted positions along the conveyor [m].
        times: (m,) from now, of which the first is 0 [s].
        swing: (modes, m) predicted angles [rad].
    """
    assert state.transverse is not None  # noqa: S101 - the caller has checked
    estimate = tracker.transverse.believed(state.transverse)
    ratio, lifted = tracker.transverse.ratio(estimate), None
    if state.sway.at is not None and ratio:
        sway = tracker.classifier.predict_sway(state.conveyor, times)
        lifted = ratio * (sway - sway[0] + state.sway.way)
    return approach.Part(
        x=float(estimate.x[0]),
        z=float(estimate.x[1]),
        along=along,
        rotation=estimate.rotation,
        swing=swing,
        slopes=tracker.transverse.slopes(estimate),
        lifted=lifted,
    )
