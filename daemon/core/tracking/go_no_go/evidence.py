"""Evidence of go or no-go before contact, and the decision in one step."""

import math

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.tracking.across.transverse_state import STATIC, TURN, X
from linemate.daemon.core.tracking.conveyor import ConveyorEstimate, Motion
from linemate.daemon.core.tracking.estimation import prediction_error
from linemate.daemon.core.tracking.estimation.step_measurements import distance_measurement
from linemate.daemon.core.tracking.go_no_go import decision, target_shift
from linemate.daemon.core.tracking.go_no_go.decision import GoEvidence, GoOrder, Zone
from linemate.daemon.core.tracking.observation import mean_distances
from linemate.daemon.core.tracking.reference import last_step
from linemate.daemon.core.tracking.tracker_state import StepSamples, Tracker, TrackerState

NOW = np.zeros(1)
EVALUATED_S = 0.6  # before the far gate the decision begins: longer than the horizon [s]
FOLLOWING_S = 0.2  # time constant of the mean following error [s]
LONGEST_SPACING_S = 0.1  # between two images of a camera that sees the object [s]
FOLLOWED_S = 0.5  # a change of class is confirmed and the tool follows it after this time [s]
TAKEN_BACK_S = 0.75  # for which a change that was taken back counts in addition to STEADY_S [s]
MIXED = 1.0  # log odds below even ones from which a change of class moves a prediction by 1 mm
NEAREST_BACK = 0.005  # a tool without a force backs off only from farther away [m]
_ENDS = {Motion.STANDING: Motion.STOPPING, Motion.RUNNING: Motion.STARTING}


def zone(tracker: Tracker, state: TrackerState) -> Zone:
    """Return where the tool is on its last approach."""
    time, T0 = state.time, tracker.cycle_s
    is_over = (
        tracker.sight_time == -math.inf
        or state.contact
        or state.withdrawn is not None
        or tracker.foresight is not None
    )
    # A clock that stands for a no-go does so behind what is committed: it may get there.
    goes = state.go.order is GoOrder.GO
    if is_over or (goes and not time <= tracker.final_time):
        return Zone.FINAL
    if time <= tracker.sight_time:
        return Zone.FAR
    if time + 1.5 * T0 > tracker.final_time:
        return Zone.LAST
    if time < tracker.near_time:
        return Zone.MIDDLE
    return Zone.NEAR if time < tracker.near_time + T0 else Zone.CLOSE


def is_evaluated(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether the decision matters: the task runs and the far gate is near."""
    return state.started and state.time > tracker.sight_time - EVALUATED_S


def _compare_distances(tracker: Tracker, state: TrackerState, samples: StepSamples) -> TrackerState:
    """Return the state with its past predictions compared with the readings of one step."""
    monitor, latest = state.monitor, state.distance_noise.latest
    # A reading of 1 kHz, or one of several cycles, counts for the time since the one before.
    spacing_s = max(latest[0][0] - latest[-1][0], 0.0) if latest else 0.0
    for block in mean_distances(samples.distance):
        row = distance_measurement(tracker, samples.stamp_ns, *block)
        stamp_ns = samples.stamp_ns - round(row.delay * 1e9)
        monitor = prediction_error.compare_distance(monitor, stamp_ns, row.value, spacing_s)
    return state if monitor is state.monitor else replace(state, monitor=monitor)


def note(tracker: Tracker, state: TrackerState, view: ConveyorEstimate | None) -> TrackerState:
    """Return the state with what one step has shown of the conveyor's class and of its effect.

    It belongs into each step, also of a robot that does not track: what was seen before the start
    counts.
    """
    return _note_look(tracker, _note_class(tracker, state, view), state)


def decide(
    tracker: Tracker, state: TrackerState, view: ConveyorEstimate | None, samples: StepSamples
) -> TrackerState:
    """Return the state with go or no-go decided for this step."""
    state = _note_following(tracker, note(tracker, state, view))
    if not is_evaluated(tracker, state):
        return state if state.go is decision.GO else replace(state, go=decision.GO)
    if view is None or state.transverse is None:
        return state
    state = _compare_distances(tracker, state, samples)
    where, before = zone(tracker, state), state.go
    if where is Zone.FINAL:
        go = decision.next_state(before, (), where, tracker.cycle_s, stands=False, may_back=False)
        return replace(state, go=go)
    guard, evidence = tracker.task.guard, gather(tracker, state, view, samples.stamp_ns)
    waiting = before.order is not GoOrder.GO
    reasons = decision.find_reasons(evidence, guard, waiting=waiting)
    go = decision.next_state(
        before,
        reasons,
        where,
        tracker.cycle_s,
        stands=state.time >= last_step(tracker.sight_time, tracker.cycle_s),
        may_back=_may_back(state),
    )
    # A reason that has ended and is waited out keeps its words: its value is within the limit now.
    if go.reasons and go.reasons[0] in reasons:
        text = decision.describe(go.reasons[0], evidence, guard, waiting=waiting)
        go = replace(go, text=text)
    return state if go is before else replace(state, go=go)


def _may_back(state: TrackerState) -> bool:
    """Return whether no clamp can have closed: the tool is too far off, or has felt no touch."""
    felt = state.contact_state
    if felt.doubtful:
        return False
    return state.distance < -NEAREST_BACK or (bool(felt.forces) and not felt.touches)


def waiting(tracker: Tracker, state: TrackerState) -> str | None:
    """Return why the tool waits before contact, None if it does not."""
    is_free = state.go.order is GoOrder.GO or state.contact or state.withdrawn is not None
    if is_free or state.time < last_step(tracker.sight_time, tracker.cycle_s):
        return None
    return state.go.text


def gather(
    tracker: Tracker, state: TrackerState, view: ConveyorEstimate, now_ns: int
) -> GoEvidence:
    """Return the evidence of one step."""
    short, long = state.monitor.leads
    x, y, _ = state.following
    deviation, angle_deviation = contact_deviation(tracker, state, view)
    transverse = state.transverse
    assert transverse is not None  # noqa: S101 - callers have checked
    return GoEvidence(
        sight_s=_sight(tracker, state, now_ns),
        checked_s=min(short.checked_s, long.checked_s),
        prediction=max(short.lateral, long.lateral),
        angle=max(short.angle, long.angle),
        distance=state.monitor.distance,
        deviation=deviation,
        angle_deviation=angle_deviation,
        nis=transverse.nis,
        rejected=transverse.rejected,
        following=math.hypot(x, y) + abs(float(target_shift.remaining(state.shift, NOW)[0])),
        tentative=view.tentative and _moves(tracker, view) > tracker.task.guard.tolerance,
        steady_s=state.steady_s,
        position_s=min(state.blind_s, _pose_age(state, now_ns)),
        looked_s=state.looked_s if is_look_due(tracker, state, view) else math.inf,
        turns=state.bolts.is_jammed and not state.bolts.is_over,
        jams=state.bolts.is_over,
        force=state.contact_state.forces[-1] if state.contact_state.doubtful else None,
        along=view.deviation,
    )


def contact_deviation(
    tracker: Tracker, state: TrackerState, view: ConveyorEstimate
) -> tuple[float, float]:
    """Return one sigma of the object across the tool's axis [m] and of its angle [rad] at contact.

    The covariance is carried on to the contact without further images.
    """
    ahead = max(tracker.reference.contact_time - state.time, 0.0)
    return _deviation(tracker, state, view.deviation, ahead)


def is_certain(tracker: Tracker, state: TrackerState, view: ConveyorEstimate, ahead: float) -> bool:
    """Return whether a prediction is good enough for a touch by what the estimate knows of itself.

    Neither is its covariance too large, nor does it mix in a change of class that may be none.

    Args:
        ahead: how far ahead it is [s].
    """
    guard = tracker.task.guard
    if view.confidence > tracker.settings.bank.penalty - MIXED:
        return False
    # The conveyor's way beyond the short lead is measured again before the touch.
    along = math.hypot(view.deviation, view.speed_deviation * prediction_error.SHORT_LEAD_S)
    deviation, angle = _deviation(tracker, state, along, ahead)
    return (
        decision.DEVIATIONS * deviation <= guard.tolerance
        and decision.DEVIATIONS * angle <= guard.angle_tolerance
    )


def _deviation(
    tracker: Tracker, state: TrackerState, along: float, ahead: float
) -> tuple[float, float]:
    """Return one sigma of the object across the tool's axis [m] and of its angle [rad].

    Args:
        along: one sigma along the conveyor [m].
        ahead: time from now without further images [s].
    """
    transverse = state.transverse
    assert transverse is not None  # noqa: S101 - callers have checked
    H = tracker.transverse.observation_rows(transverse, -ahead)
    variance = np.add.reduce(H.dot(transverse.P) * H, axis=1)
    across = float(variance[X]) + tracker.settings.fusion.position**2 * ahead
    turned = float(variance[TURN:STATIC].sum()) + 3.0 * tracker.settings.fusion.angle**2 * ahead
    return math.sqrt(max(across + along**2, 0.0)), math.sqrt(max(turned, 0.0))


def _sight(tracker: Tracker, state: TrackerState, now_ns: int) -> float:
    """Return the age of the camera's last accepted pose [s], 0 where it is blind as configured."""
    if -state.distance < tracker.settings.camera.blind_below:
        return 0.0
    return _pose_age(state, now_ns)


def _pose_age(state: TrackerState, now_ns: int) -> float:
    """Return the age of the camera's last accepted pose [s]."""
    return math.inf if state.pose_ns is None else (now_ns - state.pose_ns) * 1e-9


def _note_class(
    tracker: Tracker, state: TrackerState, view: ConveyorEstimate | None
) -> TrackerState:
    """Return the state with the time since the conveyor's class changed.

    Predictions of the class before are no evidence any more. The end of a ramp is no change: it
    was predicted. A change that is taken back was decided wrongly: the next one may be as well, and
    counts for longer.
    """
    if view is None:
        return state
    is_taken_back = any(what == "cancelled" for _, what in view.events)
    is_end = _ENDS.get(view.motion) is state.motion and not is_taken_back
    has_changed = view.motion is not state.motion and not is_end
    if has_changed or ("push", "confirmed") in view.events:
        monitor = prediction_error.forget(state.monitor)
        looked_s = 0.0 if has_changed else state.looked_s
        steady_s = -TAKEN_BACK_S if has_changed and is_taken_back else 0.0
        return replace(
            state, motion=view.motion, steady_s=steady_s, monitor=monitor, looked_s=looked_s
        )
    return replace(state, motion=view.motion, steady_s=state.steady_s + tracker.cycle_s)


def _note_look(tracker: Tracker, state: TrackerState, before: TrackerState) -> TrackerState:
    """Return the state with the time for which the camera has seen what a change of class does.

    Args:
        before: the state with the class of the last step; its images are those up to this step.
    """
    now, last = state.pose_ns, state.look_ns
    if now is None or now == last:
        return state
    spacing = 0.0 if last is None else min((now - last) * 1e-9, LONGEST_SPACING_S)
    looked_s = state.looked_s if state.looked_s < before.looked_s else state.looked_s + spacing
    look_seen = state.look_seen
    if decision.LOOK_S <= looked_s < math.inf:
        look_seen = max(look_seen, _acceleration(tracker, state))
    return replace(state, look_ns=now, looked_s=looked_s, look_seen=look_seen)


def _acceleration(tracker: Tracker, state: TrackerState) -> float:
    """Return the nominal size of the last change's acceleration [m/s^2]."""
    conveyor = tracker.task.conveyor
    stops = state.motion in {Motion.STOPPING, Motion.STANDING}
    return conveyor.deceleration if stops else conveyor.acceleration


def _moves(tracker: Tracker, view: ConveyorEstimate) -> float:
    """Return how far a change out of the class moves the object before the tool can follow [m]."""
    conveyor = tracker.task.conveyor
    change = {Motion.RUNNING: conveyor.deceleration, Motion.STANDING: conveyor.acceleration}.get(
        view.motion, conveyor.deceleration + conveyor.acceleration
    )
    return 0.5 * change * FOLLOWED_S**2


def is_look_due(tracker: Tracker, state: TrackerState, view: ConveyorEstimate) -> bool:
    """Return whether a change of class has to be seen: what it does to the object is not known.

    It is if the sway that is not known can move the object beyond what the touch tolerates, and no
    change at least as strong has been seen in this run.
    """
    acceleration = _acceleration(tracker, state)
    moved = decision.DEVIATIONS * view.unknown_sway * acceleration
    return moved > tracker.task.guard.tolerance and acceleration > state.look_seen


def _note_following(tracker: Tracker, state: TrackerState) -> TrackerState:
    """Return the state with the mean following error, in the tool's axes [m]."""
    if state.history is None:
        return state
    (u, v, w, *_), (p, q, r, *turned) = state.history.poses[-1].tolist(), state.poses[0].tolist()
    a, b, c, d, e, f, g, h, i = rotations.exp_rows(*turned)
    u, v, w = u - p, v - q, w - r
    gain, (x, y, z) = 1.0 - math.exp(-tracker.cycle_s / FOLLOWING_S), state.following
    following = (
        x + gain * (a * u + d * v + g * w - x),
        y + gain * (b * u + e * v + h * w - y),
        z + gain * (c * u + f * v + i * w - z),
    )
    return replace(state, following=following)
