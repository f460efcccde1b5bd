"""Tracking, one step: measurements in, a horizon of desired poses out (Sect. III).

remember -> predict -> correct -> classify -> predict over the horizon -> approach -> merge
"""

import math

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array, Horizon
from linemate.daemon.core.tracking import approach, linear_axis, merge
from linemate.daemon.core.tracking.conveyor import ConveyorEstimate, Motion
from linemate.daemon.core.tracking.damping import horizon_shares
from linemate.daemon.core.tracking.estimation.contact_compliance import comply, felt_part
from linemate.daemon.core.tracking.estimation.estimate import estimate
from linemate.daemon.core.tracking.estimation.force_use import is_seated
from linemate.daemon.core.tracking.estimation.mount_sag import sagging
from linemate.daemon.core.tracking.estimation.tool_weight import CLEAR_WAY
from linemate.daemon.core.tracking.go_no_go import prediction_error, target_shift
from linemate.daemon.core.tracking.go_no_go.clock_ramp import RUNNING
from linemate.daemon.core.tracking.go_no_go.decision import GO
from linemate.daemon.core.tracking.go_no_go.evidence import decide, is_certain, note
from linemate.daemon.core.tracking.observation import Wrench
from linemate.daemon.core.tracking.task import Gate, Phase
from linemate.daemon.core.tracking.task_clock import (
    LARGEST_BEND,
    advance_clock,
    elapsed,
    is_about_to_touch,
    is_before_contact,
    is_blended,
    open_gates,
    programme_times,
    standing_time,
)
from linemate.daemon.core.tracking.touch import (
    bolt_search,
    compliance,
    contact,
    force_sign,
    guard,
    release,
    tare,
    touch_proof,
    withdrawal,
)
from linemate.daemon.core.tracking.tracker_state import (
    Report,
    StepSamples,
    Tracker,
    TrackerState,
    with_distance_noise,
)

LONGEST_CATCH_UP_S = 0.03  # a retraction without commands for longer begins again at rest [s]
HUB_DEPTH = 0.01  # way from the object from which on a released tool may lag behind it [m]
STEADY_S = 1.0  # of the conveyor, before a robot's lag is judged [s]


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
        poses=poses,
        axis=linear_axis.at_rest(axis, tracker.axis_steps),
        departure=None,
        object_left=False,
        time=0.0,
        started=False,
        passed=frozenset(),
        blended=None,
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
        go=GO,
        ramp=RUNNING,
        compliance=compliance.NO_COMPLIANCE,
        tare=tare.NO_TARE,
        bolts=bolt_search.NO_BOLT_SEARCH,
    )


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


def _withdraw(
    tracker: Tracker, state: TrackerState, goal: Array, part: Array | None
) -> tuple[TrackerState, Array]:
    """Return the state and the goal (m, 6) of a tool that withdraws.

    One that begins again at rest takes up the object's speed as gradually as its own.

    Args:
        part: (6,) the object now, None while it is not seen.
    """
    if state.withdrawn == 0.0 and state.gone <= 0.0:
        state = replace(state, further=_further(tracker, state, part))
    times = (state.withdrawn or 0.0) + tracker.span
    goal = approach.withdraw(goal, tracker.withdrawal.way(times, state.gone, state.further))
    if state.gone > 0.0:
        goal[:, merge.ALONG] -= state.speed * withdrawal.lag(times)
    return state, goal


def _further(tracker: Tracker, state: TrackerState, part: Array | None) -> float:
    """Return the way of a retraction behind the least one [m]; none from an unseen object."""
    if part is None:
        return 0.0
    axis = rotations.exp(state.poses[0, 3:])[:, 2]
    return tracker.withdrawal.further(float(axis @ (part[:3] - state.poses[0, :3])))


def _is_engaged(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether the tool is clamped to the object, or was and has not cleared it.

    A tool that may be clamped counts: a clamp closes before the contact is felt.
    """
    is_released = state.started and Gate.WHEEL_RELEASED in state.passed
    if state.withdrawn is not None:
        return (state.contact or is_released) and state.withdrawn <= tracker.withdrawal.duration
    is_near = is_released and state.distance > -CLEAR_WAY
    return state.contact or state.clamped or is_near


def track(
    tracker: Tracker, state: TrackerState, samples: StepSamples, *, start: bool, retreat: bool
) -> tuple[TrackerState, Horizon, Report]:
    """Return the state, the horizon x_t(k, 0..n) and a report of one step of a robot that tracks.

    ``contact_decision`` follows later: it needs the delivery of the last command.
    """
    tracker = with_distance_noise(tracker, state.distance_noise.inflation)
    if is_seated(tracker, state) and state.search is not guard.NO_SEARCH:
        state = _end_search(state)
    was_soft = state.compliance.is_softened
    state, view, rejected, wrench = estimate(tracker, state, samples)
    if start and not state.started:
        state = replace(state, started=True)
    if retreat and not state.started and state.anchor is None:
        state = replace(state, anchor=state.poses[-1])
    stood = retreat and state.anchor is None and bool((state.poses == state.poses[0]).all())
    state = _searching_bolts(tracker, state, None if retreat else wrench)
    state = advance_clock(tracker, decide(tracker, state, view, samples), view, samples, retreat)
    span = tracker.span
    limit = standing_time(tracker, state, retreat) if state.started else state.time
    goal, relative = _programmed_poses(tracker, state, limit, retreat)
    is_searching = not retreat and _is_searching(tracker, state)
    if is_searching:
        state = replace(state, search=_advance_search(tracker, state))
    guarded = tracker.task.guard
    # Without a force sensor the tool waits at the waypoint of contact: it could detect no contact.
    advances = is_searching and bool(state.contact_state.forces)
    relative = guard.reached(relative, state.search, guarded, span, is_on=advances)
    target = part = along = None
    if state.conveyor is not None:
        along = tracker.classifier.predict_positions(state.conveyor, tracker.ahead)
        if not tracker.settings.predict:
            along[: len(span)] = along[0]
    if state.transverse is not None and along is not None:
        state, target, part = _predict_object(
            tracker, state, view, samples.stamp_ns, along, relative
        )
        state = _ease(tracker, state, view, samples.stamp_ns, target, part)
        state = comply(tracker, state, samples, view, wrench, part)
        target, part = _complied(tracker, state, target, part)
        target = bolt_search.turned(target, state.bolts, span)
        state, goal = _blend(tracker, state, goal, target)
        state, goal = _lead(tracker, state, view, goal, along, relative)
    if stood or state.anchor is not None:
        state, goal = _anchor(state, goal)
    if state.withdrawn is not None:
        state, goal = _withdraw(tracker, state, goal, part)
    goal = merge.rounded(goal, tracker.corner)
    in_contact = state.contact or (not retreat and is_about_to_touch(tracker, state))
    plan = tracker.merge_plan(in_contact=in_contact, retreats=retreat, lead=state.lead)
    poses, calming = merge.merge(state.poses, goal, plan, state.calming)
    state = _advance_axis(tracker, state, view, along)
    state = replace(state, poses=poses, calming=calming, distance=float(relative[0, 2]))
    free = horizon_shares(tracker, state, limit)
    horizon = Horizon(poses, state.axis.positions, free, tracker.reference.nominal, plan.commit)
    outcome = report(tracker, state, view, wrench, rejected, target, part)
    return state, horizon, _with_oscillation(tracker, outcome, was_soft=was_soft, state=state)


def _programmed_poses(
    tracker: Tracker, state: TrackerState, limit: float, retreat: bool
) -> tuple[Array, Array]:
    """Return the programmed tcp x_r and the programmed tcp in the object, (m, 6) each.

    Args:
        limit: task time at which the clock stops [s].
    """
    times = programme_times(tracker, state)
    if times is None:
        goal, relative = tracker.table.ahead(state.time, limit, tracker.steps)
        if not is_blended(state):
            stands = not retreat or state.clock_stood > 0.0
            goal = _going_on(tracker, state, goal, limit if stands else math.inf)
    else:
        goal, relative = tracker.table.between(times)
    if state.contact and not is_before_contact(tracker, state):
        return goal, _pressing_poses(tracker, state, relative)
    return goal, _waiting_poses(tracker, state, relative) if retreat else relative


def _blend(
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


def _lead(
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
    part = _part(tracker, state, along[: len(goal)], tracker.span, swing)
    lead, turned = state.lead, tracker.reference.turned
    modes = filtered.swing
    moved = approach.ahead(part, lead, tracker.cycle_s, modes, relative, turned=turned)
    return state, goal + moved


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


def _is_searching(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether the tool is where it should touch the object, and no contact was detected."""
    if state.contact or state.releasing is not None or state.blended is None:
        return False
    return state.time >= tracker.search_time


def _searching_bolts(tracker: Tracker, state: TrackerState, wrench: Wrench | None) -> TrackerState:
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


def _advance_search(tracker: Tracker, state: TrackerState) -> guard.ContactSearch:
    """Return the search one step later."""
    return guard.advanced(
        state.search, tracker.task.guard, state.contact_state, tracker.vibration, tracker.cycle_s
    )


def _end_search(state: TrackerState) -> TrackerState:
    """Return the state of a tool that has found the object beyond its estimate.

    The tactile sensor places the object from now on. The estimate must follow it at once, because
    the programme counts from there and the search is over.
    """
    history = state.history
    axis = np.zeros(3) if history is None else rotations.exp(history.poses[-1][3:])[:, 2]
    x, y, z = (state.search.reach * axis).tolist()
    complied = compliance.displaced((x, y, z))
    return replace(state, compliance=complied, search=guard.NO_SEARCH)


def _complied(
    tracker: Tracker, state: TrackerState, target: Array, part: Array
) -> tuple[Array, Array]:
    """Return the target (m, 6) and the object (6,) moved by the compliance's offset.

    An object whose future is known needs none.
    """
    if tracker.foresight is not None or not any(state.compliance.offset):
        return target, part
    moved = target.copy()
    moved[:, :3] += state.compliance.offset
    return moved, felt_part(state, part)


def _anchor(state: TrackerState, goal: Array) -> tuple[TrackerState, Array]:
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


def observe(
    tracker: Tracker, state: TrackerState, samples: StepSamples
) -> tuple[TrackerState, Report]:
    """Return the state and the report of one step in which the robot does not track.

    A tool on the object is asked to release it: the object may go on.
    """
    tracker = with_distance_noise(tracker, state.distance_noise.inflation)
    state, view, rejected, wrench = estimate(tracker, state, samples)
    state = note(tracker, state, view)
    if state.contact:
        passed = open_gates(tracker, state, view, samples)
        releasing = elapsed(state.releasing, True, tracker.cycle_s)
        touching = state.touching + tracker.cycle_s
        state = replace(state, passed=passed, fixing=None, releasing=releasing, touching=touching)
    target = part = None
    if state.transverse is not None and state.conveyor is not None:
        _, relative = tracker.table.ahead(state.time, math.inf, 0)
        # As one that tracks: what is checked before the start counts.
        times = np.array((0.0, *tracker.leads))
        along = tracker.classifier.predict_positions(state.conveyor, times)
        rows = np.concatenate((relative, np.zeros((len(tracker.leads), 6))))
        target, part = _sensed_poses(
            tracker,
            state,
            samples.stamp_ns,
            along,
            times,
            rows,
            _added_way(tracker, state, view, along, times),
        )
        if _is_prediction_due(tracker, state, view, samples.stamp_ns):
            state = _kept_prediction(tracker, state, view, samples.stamp_ns, target[1:], along[1:])
        target, part = _complied(tracker, state, target, part)
    return state, report(tracker, state, view, wrench, rejected, target, part)


def report(
    tracker: Tracker,
    state: TrackerState,
    view: ConveyorEstimate | None,
    wrench: Wrench | None,
    rejected: int,
    target: Array | None,
    part: Array | None,
) -> Report:
    """Return what one step has to say."""
    force = None if wrench is None else wrench.force
    limit = tracker.settings.tactile.overload_force
    return Report(
        sensed=None if target is None else target[0],
        part=part,
        speed=None if view is None else view.speed,
        motion=Motion.RUNNING if view is None else view.motion,
        tentative=False if view is None else view.tentative,
        confidence=0.0 if view is None else view.confidence,
        events=() if view is None else view.events,
        phase=tracker.reference.phase(state.time) if state.time > 0.0 else Phase.WAIT,
        force=force,
        overload=force is not None and math.hypot(*force.tolist()) > limit,
        object_left=state.object_left,
        rejected=rejected,
    )


def swinging(tracker: Tracker, state: TrackerState) -> float | None:
    """Return the rms force [N] of an oscillation in contact that goes on though softened."""
    if not state.contact:
        return None
    share = compliance.UNENDING
    if Gate.SCREWS_FIXED not in state.passed and state.releasing is None:
        gates = [gate for _, gate in tracker.reference.gated]
        share = compliance.UNSECURED if Gate.SCREWS_FIXED in gates else share
    return compliance.unending(state.compliance, tracker.settings.tactile.overload_force, share)


def unanswered(tracker: Tracker, state: TrackerState) -> float | None:
    """Return the mean force [N] of a contact that is none, or has answered none of its tests."""
    if not state.contact or state.releasing is not None:
        return None
    if touch_proof.is_doubted(state.beyond_s):
        return math.hypot(*state.pull)
    overload = tracker.settings.tactile.overload_force
    return force_sign.unanswered(state.force_sign, math.hypot(*state.pull), overload)


def _with_oscillation(
    tracker: Tracker, report: Report, *, was_soft: bool, state: TrackerState
) -> Report:
    """Return the report with the begin or the end of an oscillation that softens the contact.

    And with the begin of a wait for a calm contact, before the wheel is released.
    """
    events = report.events
    if state.compliance.is_softened is not was_soft:
        events = (*events, ("oscillation", "over" if was_soft else "perceived"))
    if state.oscillated is not None and 0.0 < state.oscillated < 1.5 * tracker.cycle_s:
        events = (*events, ("release", "delayed"))
    return report if events is report.events else replace(report, events=events)


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


def _predict_object(
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
    added[:count] = merge.smoothed(added[:count], tracker.corner)
    if not tracker.settings.predict:
        ahead = 0.0 * ahead
    if not _is_prediction_due(tracker, state, view, now_ns):
        poses, part = _sensed_poses(tracker, state, now_ns, steady, ahead, relative, added[:count])
        return state, poses, part
    later, times = along[-leads:], tracker.ahead[-leads:]
    poses, part = _sensed_poses(
        tracker,
        state,
        now_ns,
        np.concatenate((steady, later)),
        np.concatenate((ahead, times)),
        np.concatenate((relative, np.zeros((leads, 6)))),
        np.concatenate((added[:count], added[-leads:])),
    )
    state = _kept_prediction(tracker, state, view, now_ns, poses[count:], later)
    return state, poses[:count], part


def _added_way(
    tracker: Tracker, state: TrackerState, view: ConveyorEstimate | None, along: Array, times: Array
) -> Array:
    """Return what a change of speed adds to the conveyor's way (m,) [m].

    Zeros in contact, where the tool holds the object, and where nothing across depends on it.

    Args:
        along: (m,) predicted positions of the object along the conveyor [m].
        times: (m,) from now [s].
    """
    if view is None or state.contact or not tracker.transverse.is_driven:
        return np.zeros(len(along))
    sway = tracker.classifier.predict_sway(state.conveyor, times)
    steady = view.position - view.sway + view.speed * times
    added: Array = along - sway - steady
    return added


def _ease(
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


def _sensed_poses(
    tracker: Tracker,
    state: TrackerState,
    stamp_ns: int,
    along: Array,
    ahead: Array,
    relative: Array,
    added: Array,
) -> tuple[Array, Array]:
    """Return x_f at some times (m, 6), (9) under the class, and the object now (6,).

    Args:
        state: with the object's estimate across the conveyor.
        along: (m,) predicted positions along the conveyor [m].
        ahead: (m,) the times from now [s], of which the first is 0.
        relative: (m, 6) the programmed tcp in the object.
        added: (m,) what a change of the conveyor's speed adds to its way [m].
    """
    if tracker.foresight is not None:
        positions, vectors = tracker.foresight(stamp_ns, ahead)
        return approach.known(positions, vectors, relative, turned=tracker.reference.turned)
    filtered = tracker.transverse
    assert state.transverse is not None  # noqa: S101 - the caller has checked
    estimate = filtered.believed(state.transverse)
    swing = filtered.swing_angles(estimate, ahead)
    if added.any():  # zeros in contact, a third of a task
        swing += filtered.driven_angles(estimate, ahead, added)
    part = _part(tracker, state, along, ahead, swing)
    return approach.sensed(part, filtered.swing, relative, turned=tracker.reference.turned)


def _part(
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


def _advance_axis(
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
