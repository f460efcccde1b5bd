"""Tracking, one step: measurements in, a horizon of desired poses out (Sect. III).

remember -> predict -> correct -> classify -> predict over the horizon -> approach -> merge
"""

import math

from msgspec.structs import replace

from linemate.daemon.core.horizon import Array, Horizon
from linemate.daemon.core.tracking import merge
from linemate.daemon.core.tracking.conveyor import ConveyorEstimate, Motion
from linemate.daemon.core.tracking.damping import horizon_shares
from linemate.daemon.core.tracking.estimation.contact_compliance import complied, comply
from linemate.daemon.core.tracking.estimation.estimate import estimate
from linemate.daemon.core.tracking.estimation.force_use import is_seated
from linemate.daemon.core.tracking.go_no_go.evidence import decide, note
from linemate.daemon.core.tracking.goal import object_prediction, retraction, searches, sensed_goal
from linemate.daemon.core.tracking.goal.axis_goal import advance_axis
from linemate.daemon.core.tracking.goal.programmed_poses import programmed_poses
from linemate.daemon.core.tracking.observation import Wrench
from linemate.daemon.core.tracking.task import Gate, Phase
from linemate.daemon.core.tracking.task_clock import (
    advance_clock,
    elapsed,
    is_about_to_touch,
    open_gates,
    standing_time,
)
from linemate.daemon.core.tracking.touch import (
    bolt_search,
    compliance,
    force_sign,
    guard,
    touch_proof,
)
from linemate.daemon.core.tracking.tracker_state import (
    Report,
    StepSamples,
    Tracker,
    TrackerState,
    with_distance_noise,
)


def track(
    tracker: Tracker, state: TrackerState, samples: StepSamples, *, start: bool, retreat: bool
) -> tuple[TrackerState, Horizon, Report]:
    """Return the state, the horizon x_t(k, 0..n) and a report of one step of a robot that tracks.

    ``contact_decision`` follows later: it needs the delivery of the last command.
    """
    tracker = with_distance_noise(tracker, state.distance_noise.inflation)
    if is_seated(tracker, state) and state.search is not guard.NO_SEARCH:
        state = searches.end_search(state)
    was_soft = state.compliance.is_softened
    state, view, rejected, wrench = estimate(tracker, state, samples)
    if start and not state.started:
        state = replace(state, started=True)
    if retreat and not state.started and state.anchor is None:
        state = replace(state, anchor=state.poses[-1])
    stood = retreat and state.anchor is None and bool((state.poses == state.poses[0]).all())
    state = searches.search_bolts(tracker, state, None if retreat else wrench)
    state = advance_clock(tracker, decide(tracker, state, view, samples), view, samples, retreat)
    span = tracker.span
    limit = standing_time(tracker, state, retreat) if state.started else state.time
    goal, relative = programmed_poses(tracker, state, limit, retreat)
    is_searching = not retreat and searches.is_searching(tracker, state)
    if is_searching:
        state = replace(state, search=searches.advance_search(tracker, state))
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
        state, target, part = object_prediction.predict_object(
            tracker, state, view, samples.stamp_ns, along, relative
        )
        state = sensed_goal.ease_target(tracker, state, view, samples.stamp_ns, target, part)
        state = comply(tracker, state, samples, view, wrench, part)
        target, part = complied(tracker, state, target, part)
        target = bolt_search.turned(target, state.bolts, span)
        state, goal = sensed_goal.blend_goal(tracker, state, goal, target)
        state, goal = sensed_goal.lead_goal(tracker, state, view, goal, along, relative)
    if stood or state.anchor is not None:
        state, goal = retraction.anchor_goal(state, goal)
    if state.withdrawn is not None:
        state, goal = retraction.withdraw(tracker, state, goal, part, relative)
    goal = merge.rounded(goal, tracker.corner)
    in_contact = state.contact or (not retreat and is_about_to_touch(tracker, state))
    plan = tracker.merge_plan(in_contact=in_contact, retreats=retreat, lead=state.lead)
    poses, calming = merge.merge(state.poses, goal, plan, state.calming)
    state = advance_axis(tracker, state, view, along)
    state = replace(state, poses=poses, calming=calming, distance=float(relative[0, 2]))
    free = horizon_shares(tracker, state, limit)
    horizon = Horizon(poses, state.axis.positions, free, tracker.reference.nominal, plan.commit)
    outcome = report(tracker, state, view, wrench, rejected, target, part)
    return state, horizon, _with_oscillation(tracker, outcome, was_soft=was_soft, state=state)


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
        state, target, part = object_prediction.predict_observed(
            tracker, state, view, samples.stamp_ns
        )
        target, part = complied(tracker, state, target, part)
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
