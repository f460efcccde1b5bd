"""Tracking, one step: measurements in, a horizon of desired poses out.

Law of this file: the straight line through Sect. III, room by room: remember where the robot was,
predict, correct, classify, predict over the horizon, approach, merge. Pure: time is in the inputs.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array, Horizon
from linemate.daemon.core.tracking import approach, contact, guard, linear_axis, merge, release
from linemate.daemon.core.tracking.conveyor import (
    Classifier,
    ConveyorEstimate,
    Motion,
    PositionMeasurement,
    Source,
)
from linemate.daemon.core.tracking.observation import (
    History,
    Sighting,
    Wrench,
    mean_wrench,
    pose_at,
    rate_now,
    remember,
    sight,
    touch,
)
from linemate.daemon.core.tracking.reference import Reference, ReferenceTable, barrier, last_step
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.daemon.core.tracking.task import Gate, Phase, TaskFile
from linemate.daemon.core.tracking.transverse import Transverse, TransverseState
from linemate.protocol.samples import CameraSample, DistanceSample, Vector3, WrenchSample

AWAY = 0.15  # way of an emergency retraction [m]
AWAY_TIME = 0.6  # and its duration [s]
CLEAR = 0.05  # way from the object at which a released tool has cleared it [m]
BENT = 0.008  # a tool farther from its place is not on the object any more: the mount gives way [m]
CLAMP_OPEN = 2  # bit of the tool's signals: the wheel is released
LATE = 0.25  # share of the damping that is still there at contact
SEATING = 0.012  # a clamp closes in 0.04 s; a contact is felt 0.03 s after the touch or later [s]
AGREEING = 4  # readings of the distance sensor that start the filter, against an outlier first
AGREEMENT = 0.015  # when they lie within this [m]


Foresight = Callable[[int, Array], tuple[Array, Array]]


@dataclass(frozen=True, slots=True, eq=False)
class Tracker:
    """What tracking needs, compiled.

    Attributes:
        task, settings: as given.
        reference, classifier, transverse: the models.
        table: the reference at every step of the task's clock.
        camera: position (3,) and rotation (3, 3) of the camera in the tcp.
        cycle_s: T0 [s].
        commit: nc, the last step that a merge keeps.
        matrices: (6, n - nc, 5) of the merge.
        corner: (2 h + 1,) kernel that rounds the goal's corners along the conveyor.
        history_length: poses of the robot that are remembered.
        span: (n+1,) times of the horizon from now [s].
        axis_steps: length of the linear axis' plan: as far as control reads it.
        axis_range: positions that the linear axis can take [m]; unbounded without one.
        ahead: (n+2,) times from now of which the conveyor's position is predicted [s]: the span,
            and the time for which the linear axis is given its goal.
        free: (t,) where the tool hangs free, at every step of the task's clock.
        ringing: of the tool along its axis.
        sight_time: when the tool leaves its last waypoint before contact [s].
        search_time: when the tool should have touched the object at the latest [s].
        press: programmed tcp in the object along its axis at that time [m].
        damped_until: last task time before contact at which the tool is damped in full [s].
        foresight: the true object at a stamp [ns] and times from it (m,) [s], as positions (m, 3)
            and rotation vectors (m, 3) in c, taken instead of the estimate; an oracle, for
            campaigns only.
    """

    task: TaskFile
    settings: TrackingSettings
    reference: Reference
    classifier: Classifier
    transverse: Transverse
    table: ReferenceTable
    camera: tuple[Array, Array]
    cycle_s: float
    steps: int
    commit: int
    matrices: Array
    corner: Array
    history_length: int
    span: Array
    axis_steps: int
    axis_range: tuple[float, float]
    ahead: Array
    free: Array
    ringing: contact.Ringing
    sight_time: float
    search_time: float
    press: float
    damped_until: float
    foresight: Foresight | None = None


class TrackerState(Struct, frozen=True, eq=False):
    """What tracking remembers.

    Attributes:
        history: of the undeflected tcp.
        belief: of the classifier; None before the first distance.
        across: belief across the conveyor; None before enough images.
        sightings: images that wait to start it.
        poses: (n+1, 6) x_t of the last step.
        axis: plan of the linear axis.
        object_left: the object is about to be beyond what the linear axis reaches.
        departure: where the linear axis and the conveyor unit were as the task's clock started
            [m]; None before.
        time: task time of step k; it stands before the start.
        started: the start edge has come.
        passed: gates that are open.
        blended: time since the sensed motion began to take over [s], None before.
        feeling: of the tool's force, until it touches.
        contact: the tool is clamped to the object.
        assumed: nothing measured that contact, for the cell has no force sensor.
        touching: how long it has been [s].
        fixing, releasing: time since the tool was asked to fix, to release [s]; None before.
        withdrawn: time since an emergency retraction began [s]; None without.
        clamped: a retreat waits for the clamp, which is closed on the object or may be.
        anchor: (6,) of a robot at rest from which an emergency retraction began: its pose, or its
            offset from the object while the task is started; None if it tracked.
        distance: programmed, from the tcp to the object along its z [m].
        readings: of the distance sensor, before the first belief [m].
        pull: mean force on the clamped tool [N].
        search: for an object that is farther away than estimated.
        seen_ns: exposure of the camera's last accepted pose [ns], None before.
        stood: time for which the robot has got no command and stood still [s].
    """

    history: History | None
    belief: Any
    across: TransverseState | None
    sightings: tuple[Sighting, ...]
    poses: Array
    axis: linear_axis.AxisPlan
    departure: tuple[float, float] | None = None
    object_left: bool = False
    time: float = 0.0
    started: bool = False
    passed: frozenset[Gate] = frozenset()
    blended: float | None = None
    feeling: contact.Feeling = contact.NOTHING
    contact: bool = False
    assumed: bool = False
    touching: float = 0.0
    fixing: float | None = None
    releasing: float | None = None
    withdrawn: float | None = None
    clamped: bool = False
    anchor: Array | None = None
    distance: float = math.inf
    readings: tuple[float, ...] = ()
    pull: Vector3 = (0.0, 0.0, 0.0)
    search: guard.Search = guard.NO_SEARCH
    seen_ns: int | None = None
    stood: float = 0.0


class Report(Struct, frozen=True, eq=False):
    """What one step of tracking has to say beside the horizon.

    Attributes:
        sensed: x_f(k, 0) (6,) in c, or None.
        part: the object now (6,) in c, or None.
        speed: of the conveyor [m/s], or None.
        motion, tentative, confidence, events: of the classifier.
        force: mean force [N], or None without a sample.
        overload: the force is beyond what the tool may bear.
        object_left: the object is about to be beyond what the linear axis reaches.
        refused: sightings that the gate refused in this step.
    """

    sensed: Array | None
    part: Array | None
    speed: float | None
    motion: Motion
    tentative: bool
    confidence: float
    events: tuple[tuple[str, str], ...]
    phase: Phase
    force: Array | None
    overload: bool
    object_left: bool
    refused: int


class Measurements(Struct, frozen=True, eq=False):
    """One step's samples, and where the robot is."""

    stamp_ns: int
    tcp: Array | None
    tcp_stamp_ns: int
    distance: Sequence[DistanceSample]
    camera: Sequence[CameraSample]
    wrench: tuple[WrenchSample, ...]
    digital_in: int


def at_rest(tracker: Tracker, pose: Array, axis: float) -> TrackerState:
    """Return the state of a robot that stands with its tcp at ``pose`` (6,) in c."""
    return TrackerState(
        history=None,
        belief=None,
        across=None,
        sightings=(),
        poses=np.tile(pose, (tracker.steps + 1, 1)),
        axis=linear_axis.at_rest(axis, tracker.axis_steps),
    )


def rest(tracker: Tracker, state: TrackerState, pose: Array, axis: float) -> TrackerState:
    """Return the state with its plan at rest and the task over; the estimate lives on.

    A tool that is on the object, or has not cleared it, is remembered as in contact: it has to be
    withdrawn from there.
    """
    poses = np.tile(pose, (tracker.steps + 1, 1))
    if _is_engaged(state):
        return replace(
            state,
            poses=poses,
            axis=linear_axis.at_rest(axis, tracker.axis_steps),
            contact=True,
            departure=None,
            withdrawn=None,
            clamped=False,
            anchor=None,
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
        feeling=contact.NOTHING,
        contact=False,
        fixing=None,
        releasing=None,
        withdrawn=None,
        clamped=False,
        anchor=None,
        search=guard.NO_SEARCH,
        distance=math.inf,
        stood=0.0,
    )


def _is_engaged(state: TrackerState) -> bool:
    """Return whether the tool is clamped to the object, or was and has not cleared it."""
    is_released = state.started and Gate.WHEEL_RELEASED in state.passed
    if state.withdrawn is not None:
        return (state.contact or is_released) and state.withdrawn <= AWAY_TIME
    return state.contact or (is_released and state.distance > -CLEAR)


def estimate(
    tracker: Tracker, state: TrackerState, seen: Measurements
) -> tuple[TrackerState, int, Wrench | None]:
    """Return the state with its beliefs one step later, the refused sightings, the wrench."""
    history = state.history
    if seen.tcp is not None:
        history = remember(history, seen.tcp_stamp_ns, seen.tcp, tracker.history_length)
    across = state.across
    if across is not None:
        seating = state.fixing is not None and Gate.SCREWS_FIXED not in state.passed
        across = tracker.transverse.predict(across, tracker.cycle_s, seating=seating)
    wrench = mean_wrench(seen.wrench)
    pull = release.averaged(state.pull, wrench, tracker.cycle_s) if state.contact else state.pull
    felt = wrench if _counts(tracker, state) else None
    sightings = _sightings(tracker, history, seen, felt)
    rows = [_distance_row(tracker, seen.stamp_ns, sample) for sample in seen.distance]
    refused = 0
    waiting, seen_ns = state.sightings, state.seen_ns
    for source, sighting, gate in sightings:
        if across is None:
            waiting = (*waiting, sighting)[-tracker.settings.fusion.initial_images :]
            if len(waiting) == tracker.settings.fusion.initial_images:
                across = tracker.transverse.initial(list(waiting))
        else:
            doubted = source is Source.CAMERA
            across, taken = tracker.transverse.correct(across, sighting, gate, doubted=doubted)
            refused += not taken
            if not taken:
                continue
        if source is Source.CAMERA:
            seen_ns = seen.stamp_ns - round(sighting.delay * 1e9)
        rows.append(_along_row(tracker, across, source, sighting, gate))
    belief, readings = state.belief, state.readings
    if belief is None:
        heard = (*readings, *(row.value for row in rows if row.source is Source.DISTANCE))
        readings = heard[-AGREEING:]
        if len(readings) == AGREEING and max(readings) - min(readings) < AGREEMENT:
            belief = tracker.classifier.initial(readings[-1])
    else:
        belief = tracker.classifier.advance(belief, rows, tracker.cycle_s)
    state = replace(
        state,
        history=history,
        belief=belief,
        across=across,
        sightings=waiting,
        readings=readings,
        pull=pull,
        seen_ns=seen_ns,
    )
    return state, refused, wrench


def _distance_row(tracker: Tracker, now_ns: int, sample: DistanceSample) -> PositionMeasurement:
    """Return (10)'s row: the sensor reads the start position as the object is at its origin."""
    noise = tracker.settings.distance
    value = sample.position - tracker.task.conveyor.start_position + tracker.reference.origin[1]
    delay = (now_ns - sample.stamp_ns) * 1e-9 + noise.delay
    return PositionMeasurement(Source.DISTANCE, float(value), delay, noise.deviation**2, noise.gate)


def _along_row(
    tracker: Tracker,
    across: TransverseState | None,
    source: Source,
    sighting: Sighting,
    gate: float,
) -> PositionMeasurement:
    """Return a sighting's component along the conveyor, its swing taken out."""
    value, variance = float(sighting.position[1]), float(sighting.variance[1])
    if across is not None:
        if source is Source.CAMERA:
            variance *= across.doubt
        angles = tracker.transverse.swing_now(across, sighting.delay)
        for mode, angle in zip(tracker.transverse.swing, angles, strict=True):
            value -= mode.levers[1] * angle
    return PositionMeasurement(source, value, sighting.delay, variance, gate)


def _counts(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether the force tells where the object is: the tool is clamped to it for certain.

    A clamp that was ordered to open may be open without having reported it. A tool that hangs free
    would place the object where the tool is, and would follow itself.
    """
    if not _is_seated(state):
        return False
    if state.releasing is None:
        return state.contact
    pulling = release.PULLING * tracker.settings.tactile.contact_force
    return state.contact and math.hypot(*state.pull) > pulling


def _is_seated(state: TrackerState) -> bool:
    """Return whether a clamp that closes has drawn the tool in.

    Before that the mount is bent by what the tool is beside the object: the force does not measure
    where the object is. Its change would be taken for a stop, a start or a push of the conveyor.
    """
    return state.contact and state.touching >= SEATING


def _sightings(
    tracker: Tracker,
    history: History | None,
    seen: Measurements,
    wrench: Wrench | None,
) -> list[tuple[Source, Sighting, float]]:
    """Return what the camera saw of the object, and the tactile sensor.

    Args:
        wrench: of the clamped tool; None if it tells nothing of the object.
    """
    found: list[tuple[Source, Sighting, float]] = []
    if history is None or not (seen.camera or wrench is not None):
        return found
    settings, rate = tracker.settings, rate_now(history)
    for sample in seen.camera:
        tcp = pose_at(history, sample.exposure_ns, tracker.cycle_s)
        delay = (seen.stamp_ns - sample.exposure_ns) * 1e-9
        if tcp is not None and delay <= settings.camera.longest_delay:
            sighting = sight(sample, tcp, tracker.camera, settings.camera, seen.stamp_ns, rate)
            found.append((Source.CAMERA, sighting, settings.camera.gate))
    if wrench is not None:
        tcp = pose_at(history, wrench.stamp_ns, 2.5 * tracker.cycle_s)
        if tcp is not None:
            sighting = touch(wrench, tcp, settings.tactile, seen.stamp_ns, rate)
            found.append((Source.TACTILE, sighting, settings.tactile.gate))
    return found


def track(
    tracker: Tracker, state: TrackerState, seen: Measurements, *, start: bool, retreat: bool
) -> tuple[TrackerState, Horizon, Report]:
    """Return the state, the horizon x_t(k, 0..n) and a report of one step under way.

    Whether the tool touches is ``touched``'s to say: a robot that held did not ring.
    """
    if _is_seated(state) and state.search is not guard.NO_SEARCH:
        state = _found(tracker, state)
    state, refused, wrench = estimate(tracker, state, seen)
    view = _view(tracker, state)
    if start and not state.started:
        state = replace(state, started=True)
    if retreat and not state.started and state.anchor is None:
        state = replace(state, anchor=state.poses[-1])
    stood = retreat and state.anchor is None and bool((state.poses == state.poses[0]).all())
    state = _clock(tracker, state, view, seen, retreat)
    span = tracker.span
    limit = _stand(tracker, state, seen.stamp_ns, retreat) if state.started else state.time
    goal, relative = tracker.table.ahead(state.time, limit, tracker.steps)
    relative = _programmed(tracker, state, relative, retreat)
    is_searching = not retreat and _searches(tracker, state)
    if is_searching:
        state = replace(state, search=_searched(tracker, state))
    guarded = tracker.task.guard
    # Without a force sensor the tool waits at the waypoint of contact: it would feel nothing.
    advances = is_searching and bool(state.feeling.forces)
    relative = guard.reached(relative, state.search, guarded, span, is_on=advances)
    target = part = along = None
    if state.belief is not None:
        along = tracker.classifier.predict_positions(state.belief, tracker.ahead)
        if not tracker.settings.predict:
            along[:-1] = along[0]
    if state.across is not None and along is not None:
        target, part = _sensed(tracker, state, seen.stamp_ns, along[:-1], span, relative)
        if state.blended is not None and state.blended >= tracker.settings.merge.blend:
            goal = target
        elif state.blended is not None:
            share = approach.smoothstep((state.blended + span) / tracker.settings.merge.blend)
            goal = approach.blend(goal, target, share)
    if stood or state.anchor is not None:
        state, goal = _anchored(state, goal)
    if state.withdrawn is not None:
        s = approach.smoothstep((state.withdrawn + span) / AWAY_TIME)
        goal = approach.withdraw(goal, AWAY * s)
    goal = merge.rounded(goal, tracker.corner)
    poses = merge.merge(state.poses, goal, tracker.matrices, tracker.commit)
    state = _following(tracker, state, view, along)
    state = replace(state, poses=poses, distance=float(relative[0, 2]))
    free = _free(tracker, _damping_time(tracker, state), limit)
    horizon = Horizon(poses, state.axis.positions, free, tracker.reference.nominal, tracker.commit)
    return state, horizon, report(tracker, state, view, wrench, refused, target, part)


def _programmed(tracker: Tracker, state: TrackerState, relative: Array, retreat: bool) -> Array:
    """Return the programmed tcp in the object (m, 6) for a tool in contact or in retreat."""
    if state.contact:
        relative = _pressing(tracker, state, relative)
    return _waiting(state, relative) if retreat else relative


def _pressing(tracker: Tracker, state: TrackerState, relative: Array) -> Array:
    """Return the programmed tcp in the object (m, 6) of a tool in contact."""
    before = math.ceil((tracker.search_time - state.time) / tracker.cycle_s - 1e-6)
    share = approach.smoothstep((state.touching + tracker.span) / guard.PRESSING_S)
    return guard.pressing(relative, tracker.press, before, share)


def _waiting(state: TrackerState, relative: Array) -> Array:
    """Return the programmed tcp in the object (m, 6) of a tool that is to retreat."""
    relative = release.without_press(relative)
    if state.clamped and _is_before_contact(state):
        relative = release.at_stand_off(relative)
    return relative


def _searches(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether the tool is where it should touch the object, and has felt nothing."""
    if state.contact or state.releasing is not None or state.blended is None:
        return False
    return state.time >= tracker.search_time


def _searched(tracker: Tracker, state: TrackerState) -> guard.Search:
    """Return the search one step later."""
    return guard.advanced(
        state.search, tracker.task.guard, state.feeling, tracker.ringing, tracker.cycle_s
    )


def _found(tracker: Tracker, state: TrackerState) -> TrackerState:
    """Return the state of a tool that has found the object beyond its estimate.

    The tactile sensor places the object from now on. The estimate must follow it at once, because
    the programme counts from there and the search is over.
    """
    across = state.across
    if across is not None:
        across = tracker.transverse.widened(across, state.search.reach)
    return replace(state, across=across, search=guard.NO_SEARCH)


def _anchored(state: TrackerState, goal: Array) -> tuple[TrackerState, Array]:
    """Return the state and the goal (m, 6) of a retraction that began from a robot at rest."""
    anchor = state.anchor
    if anchor is None:
        anchor = _offset(state.poses[0], goal[0])
        state = replace(state, anchor=anchor)
    return state, goal + anchor if state.started else np.tile(anchor, (len(goal), 1))


def _offset(pose: Array, wanted: Array) -> Array:
    """Return what a robot that stood keeps between its tcp and the object (6,).

    Nothing as long as the tool can still be on the object: then it is brought back to its place.
    Else it follows the object from where it is, for it would be led into the object again.
    """
    off = pose - wanted
    return np.zeros(6) if float(np.linalg.norm(off[:3])) <= BENT else off


def observe(
    tracker: Tracker, state: TrackerState, seen: Measurements
) -> tuple[TrackerState, Report]:
    """Return the state and the report of one step in which the robot does not track.

    A tool on the object is asked to release it: the object may go on.
    """
    state, refused, wrench = estimate(tracker, state, seen)
    if state.contact:
        passed = _passed(tracker, state, _view(tracker, state), seen)
        releasing = _since(state.releasing, True, tracker.cycle_s)
        touching = state.touching + tracker.cycle_s
        state = replace(state, passed=passed, fixing=None, releasing=releasing, touching=touching)
    target = part = None
    if state.across is not None and state.belief is not None:
        _, relative = tracker.table.ahead(state.time, math.inf, 0)
        now = np.zeros(1)
        along = tracker.classifier.predict_positions(state.belief, now)
        target, part = _sensed(tracker, state, seen.stamp_ns, along, now, relative)
    view = _view(tracker, state)
    return state, report(tracker, state, view, wrench, refused, target, part)


def _view(tracker: Tracker, state: TrackerState) -> ConveyorEstimate | None:
    """Return what the classifier believes, None before it does."""
    return None if state.belief is None else tracker.classifier.estimate(state.belief)


def report(
    tracker: Tracker,
    state: TrackerState,
    view: ConveyorEstimate | None,
    wrench: Wrench | None,
    refused: int,
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
        refused=refused,
    )


def _sensed(
    tracker: Tracker,
    state: TrackerState,
    stamp_ns: int,
    along: Array,
    span: Array,
    relative: Array,
) -> tuple[Array, Array]:
    """Return x_f over the horizon, (9) under the class, and the object now.

    Args:
        state: with the object's estimate across the conveyor.
        stamp_ns: of now [ns].
        along: (m,) predicted positions along the conveyor [m].
        span: (m,) their times from now [s].
        relative: (m, 6) the programmed tcp in the object.
    """
    assert state.across is not None  # noqa: S101 - callers have checked
    ahead = span if tracker.settings.predict else 0.0 * span
    if tracker.foresight is not None:
        positions, vectors = tracker.foresight(stamp_ns, ahead)
        return approach.known(positions, vectors, relative, turned=tracker.reference.turned)
    part = approach.Part(
        x=float(state.across.x[0]),
        z=float(state.across.x[1]),
        along=along,
        rotation=state.across.rotation,
        swing=tracker.transverse.swing_angles(state.across, ahead),
    )
    swing, turned = tracker.transverse.swing, tracker.reference.turned
    return approach.sensed(part, swing, relative, turned=turned)


def _stand(tracker: Tracker, state: TrackerState, now_ns: int, retreat: bool) -> float:
    """Return at which step's time the task's clock stands [s]; infinity if nothing stops it."""
    if retreat and _is_before_contact(state):
        return state.time
    closed = barrier(tracker.reference, state.time, state.passed)
    if state.time <= tracker.sight_time < closed and not retreat:
        # Beyond this waypoint the camera goes blind, and contact relies on what it saw last.
        oldest_ns = round(tracker.task.guard.sight * 1e9)
        if state.seen_ns is None or now_ns - state.seen_ns > oldest_ns:
            closed = tracker.sight_time
    return last_step(closed, tracker.cycle_s)


def _is_before_contact(state: TrackerState) -> bool:
    """Return whether the tool has not felt the object yet: a retreat must not lead it there."""
    return not state.contact and Gate.WHEEL_RELEASED not in state.passed


def _clock(
    tracker: Tracker,
    state: TrackerState,
    view: ConveyorEstimate | None,
    seen: Measurements,
    retreat: bool,
) -> TrackerState:
    """Return the state with the task's clock one step further, as far as its gates let it."""
    T0 = tracker.cycle_s
    tool, passed = tracker.task.tool, _passed(tracker, state, view, seen)
    if retreat and state.releasing is None and not state.contact:
        state = _set_back(tracker, state)
    stood = max(state.stood - release.STANDING_S, 0.0)
    moved = 0.0 if view is None else abs(view.speed) * stood
    clamped = retreat and state.withdrawn is None
    clamped = clamped and _may_be_clamped(tracker, state, passed, moved)
    if retreat:
        state = replace(
            state,
            clamped=clamped,
            releasing=_since(state.releasing, True, T0),
            withdrawn=_since(state.withdrawn, not clamped, T0),
        )
    if not state.started:
        return state
    # Counted in steps: a sum of many periods is no multiple of one.
    steps = round(state.time / T0) + 1
    stand = _stand(tracker, replace(state, passed=passed), seen.stamp_ns, retreat)
    time = min(steps * T0, stand)
    blended = state.blended
    if blended is not None:
        blended += T0
    elif time > 0.0 and state.across is not None:
        blended = 0.0
    screwing = time >= tool.fix_screws and not retreat and _is_pressed(tracker, state)
    releasing = time >= tool.release_wheel
    return replace(
        state,
        passed=passed,
        time=time,
        blended=blended,
        fixing=_since(state.fixing, screwing, T0),
        releasing=state.releasing if retreat else _since(state.releasing, releasing, T0),
    )


def _set_back(tracker: Tracker, state: TrackerState) -> TrackerState:
    """Return the state with the task's clock where the robot got its last command.

    A retreat that begins while commands are lost must not lead the tool on to where it should be
    by now: nearer to the object, at the speed of a catch-up.
    """
    if state.stood <= 0.0:
        return state
    T0 = tracker.cycle_s
    steps = round(state.time / T0) - round(state.stood / T0)
    return replace(state, time=max(steps, 0) * T0)


def _is_pressed(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether the tool is in contact and the object has pushed it back for a while.

    A tool that slows down feels its own mass for a moment, as if it touched.
    """
    if state.assumed:
        return state.contact
    return state.contact and state.pull[2] < -tracker.settings.tactile.contact_force


def _may_be_clamped(
    tracker: Tracker, state: TrackerState, passed: frozenset[Gate], moved: float
) -> bool:
    """Return whether to withdraw now could pull at a closed clamp.

    Args:
        tracker: compiled.
        state: with the task's clock at the last command that the robot got.
        passed: gates that are open.
        moved: way of the object while the robot stood, for it got no commands [m].
    """
    if moved > BENT and not state.contact:
        return False
    leading = release.LEADING_S if state.stood <= 0.0 else release.STANDING_S
    steps = math.ceil(leading / tracker.cycle_s)
    _, relative = tracker.table.ahead(state.time, math.inf, steps)
    return release.may_be_clamped(
        contact=state.contact,
        released=Gate.WHEEL_RELEASED in passed,
        distance=float(relative[-1, 2]) if state.started else -math.inf,
        opening=state.releasing,
        timeout=tracker.task.tool.release_timeout,
    )


def is_overdue(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether the clamp has not opened in time, or contact was not found in reach."""
    timeout = tracker.task.tool.release_timeout
    if release.is_overdue(state.releasing, timeout, contact=state.contact):
        return True
    searched = not state.contact and state.releasing is None
    return searched and guard.has_failed(state.search, tracker.task.guard)


def _passed(
    tracker: Tracker, state: TrackerState, view: ConveyorEstimate | None, seen: Measurements
) -> frozenset[Gate]:
    """Return the gates that are open, with those that what is known now opens."""
    tool, fixing, releasing = tracker.task.tool, state.fixing, state.releasing
    gates = []
    if view is not None and view.position + view.offset >= tracker.reference.origin[1]:
        gates.append(Gate.OBJECT_CLOSE)
    if state.blended is not None and state.blended >= tracker.settings.merge.blend:
        gates.append(Gate.OBJECT_SEEN)
    if seen.digital_in & 1 or _lasted(fixing, tool.fixed_after):
        gates.append(Gate.SCREWS_FIXED)
    # A clamp that is open before it was ordered to open has not closed yet.
    opened = releasing is not None and seen.digital_in & CLAMP_OPEN
    if opened or _lasted(releasing, tool.released_after):
        gates.append(Gate.WHEEL_RELEASED)
    return state.passed if state.passed.issuperset(gates) else state.passed.union(gates)


def _lasted(age: float | None, needed: float | None) -> bool:
    """Tell whether something has lasted as long as is needed; without a need it never has."""
    return age is not None and needed is not None and age >= needed


def _since(age: float | None, begun: bool, dt: float) -> float | None:
    """Return how long something has lasted: None before, 0 as it begins."""
    if age is not None:
        return age + dt
    return 0.0 if begun else None


def touched(
    tracker: Tracker,
    before: TrackerState,
    after: TrackerState,
    report: Report,
    *,
    held: bool,
    is_open: bool = False,
) -> TrackerState:
    """Return the state of ``track`` with contact made or lost, which the next step knows of.

    Args:
        after: it, contact as it was.
        held: the robot did not get the last command and stood still.
        is_open: the tool reports an open clamp, or no telegram says that it does not.
    """
    if held or before.stood > 0.0:
        after = replace(after, stood=before.stood + tracker.cycle_s if held else 0.0)
    if before.contact:
        lost = Gate.WHEEL_RELEASED in after.passed
        touching = before.touching + tracker.cycle_s
        return replace(after, contact=not lost, touching=touching, feeling=contact.NOTHING)
    if after.blended is None or Gate.WHEEL_RELEASED in after.passed:
        return after
    if after.clamped or after.withdrawn is not None:
        # A retreat waits for the clamp already, and its own motion feels like a touch.
        return after
    force = None if report.force is None else float(report.force[2])
    acceleration = _planned_acceleration(tracker, before.poses)
    feeling = contact.feel(before.feeling, tracker.ringing, force, acceleration, held=held)
    if feeling.forces:
        near = max(contact.NEAR, tracker.task.guard.clearance + contact.MARGIN)
        feeling = contact.touched(feeling, tracker.ringing, before.distance, near)
    else:
        # With a force sensor the watch ends TRACK long before: there is none in this cell.
        is_due = before.time >= tracker.search_time and not is_open
        feeling = contact.assumed(feeling, before.distance, is_due=is_due)
    made = feeling.touches >= contact.TOUCHES
    assumed = made and not feeling.forces
    search = after.search
    if made and force is not None and report.part is not None and after.history is not None:
        reach = _touched_reach(tracker, after.history, report.part, force)
        search = guard.Search(reach, search.lasted)
    return replace(
        after, feeling=feeling, contact=made, assumed=assumed, touching=0.0, search=search
    )


def _planned_acceleration(tracker: Tracker, poses: Array) -> float:
    """Return the acceleration along the tool's axis at the second of some poses [m/s^2]."""
    axis = rotations.exp(poses[1, 3:])[:, 2]
    bend = poses[0, :3] - 2.0 * poses[1, :3] + poses[2, :3]
    return float(axis @ bend) / tracker.cycle_s**2


def _touched_reach(tracker: Tracker, history: History, part: Array, force: float) -> float:
    """Return how far beyond its estimate the object was touched [m]."""
    guarded, stiffness = tracker.task.guard, tracker.settings.tactile.stiffness[2]
    limit = max(guarded.clearance, guarded.overrun, contact.NEAR)
    return guard.touched_reach(history.poses[-1], part, force, stiffness, limit)


def _following(
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
        share = approach.smoothstep((state.time + tracker.ahead[-1:]) / file.ramp)
        travelled = float(along[-1]) + view.offset - unit
        wanted = begun + file.travel * float(share[0]) * travelled
        low, high = tracker.axis_range
        goal = min(max(wanted, low), high)
        # The goal is ahead of the axis by the plan's length and lag: time to hold or to retreat.
        left = goal != wanted
    axis = linear_axis.advance(state.axis, goal, file.ramp, T0)
    return replace(state, axis=axis, departure=departure, object_left=left)


def _damping_time(tracker: Tracker, state: TrackerState) -> float:
    """Return the task time by which the tool is damped [s]: a clamped one is not.

    A tool that touched early is in contact before its programme is.
    """
    if state.contact and state.time < tracker.search_time:
        return max(state.time, tracker.damped_until + state.touching)
    return state.time


def _free(tracker: Tracker, time: float, limit: float) -> Array:
    """Return where over the horizon the tool hangs free (n+1,)."""
    first = round(time / tracker.cycle_s)
    last = first + tracker.steps
    if limit >= last * tracker.cycle_s and last < len(tracker.free):
        return tracker.free[first : last + 1]
    end = len(tracker.free) - 1
    if limit < math.inf:
        end = min(end, round(limit / tracker.cycle_s))
    return tracker.free[np.minimum(np.arange(first, last + 1), end)]


def damped_until(reference: Reference, blend: float) -> float:
    """Return the last task time before contact at which ``hanging`` is 1 [s]."""
    return reference.contact_time - (1.0 - LATE) * blend


def hanging(reference: Reference, leave: float, blend: float, times: Array) -> Array:
    """Return where at some task times the tool hangs free (m,): 0 from contact to retreat.

    The tool is damped until it touches, and not damped once it is clamped; what (11) adds cannot
    go at once. A quarter of it goes after contact: then what is missing before and what is left
    behind are alike, 0.04 mm instead of 0.07 on one side.

    Args:
        reference: with the time of contact.
        leave: when the tool leaves the object [s].
        blend: time in which one gives way to the other [s].
        times: (m,) [s].
    """
    before = (reference.contact_time - times) / blend + LATE
    after = (times - leave) / blend
    return np.asarray(np.clip(np.maximum(before, after), 0.0, 1.0))
