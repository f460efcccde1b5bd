"""Contact made or lost: what a step decides on once it knows whether its command was delivered."""

import math

from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.estimation.force_use import BLIND_S, is_pulling
from linemate.daemon.core.tracking.estimation.mount_sag import elastic
from linemate.daemon.core.tracking.observation import History
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.touch import (
    contact,
    force_jump,
    force_sign,
    guard,
    release,
    tare,
    touch_proof,
)
from linemate.daemon.core.tracking.touch.touch_profile import TIPS_RESERVE
from linemate.daemon.core.tracking.tracker_state import Report, Tracker, TrackerState


def update_contact(
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
        return _while_in_contact(tracker, before, after, report)
    if after.blended is None or Gate.WHEEL_RELEASED in after.passed:
        return after
    # Without a force sensor a retreat that waits for the clamp learns nothing of a touch.
    if after.withdrawn is not None or (after.clamped and not before.contact_state.forces):
        return after
    x, y, force = (0.0, 0.0, None) if report.force is None else report.force.tolist()
    speed = _approach_speed(tracker, before, after)
    after, force = _without_jumps(tracker, before, after, force, speed)
    felt = contact.record_force(
        before.contact_state,
        tracker.vibration,
        force,
        after.acceleration[2],
        held=held,
        samples=after.sampled,
    )
    across = None if report.force is None else (x, y)
    felt = contact.record_across(felt, tracker.across, across, after.acceleration[:2], held=held)
    if felt.forces:
        felt = contact.count_touches(
            felt,
            tracker.vibration,
            before.distance,
            contact.reach(tracker.task.guard.clearance),
            is_new=report.force is not None,
            off=_doubted_from(tracker, before, after),
        )
    else:
        # With a force sensor the watch ends TRACK long before: there is none in this cell.
        is_due = before.time >= tracker.search_time and not is_open
        felt = contact.assume_touch(felt, before.distance, is_due=is_due)
    return _decided(tracker, before, after, report, felt, (x, y, force))


def _while_in_contact(
    tracker: Tracker, before: TrackerState, after: TrackerState, report: Report
) -> TrackerState:
    """Return the state of a tool in contact; one that is released or holds nothing loses it."""
    # A retreat that keeps the clamp closed takes the part off the object.
    lost = after.keeps or Gate.WHEEL_RELEASED in after.passed
    lost = lost or _holds_nothing(tracker, after, report)
    return replace(
        after,
        contact=not lost,
        touching=before.touching + tracker.cycle_s,
        contact_state=contact.NO_CONTACT,
        beyond_s=0.0 if lost else _beyond(tracker, after, report),
    )


def _decided(
    tracker: Tracker,
    before: TrackerState,
    after: TrackerState,
    report: Report,
    felt: contact.ContactState,
    forces: tuple[float, float, float | None],
) -> TrackerState:
    """Return the state with a contact as the touch shows it, or none.

    Args:
        felt: the touch, this step counted.
        forces: across the tool's axis and along it, there without jumps of the sensor [N].
    """
    x, y, force = forces
    has_contact = felt.touches >= contact.TOUCHES
    # An estimate that is corrected accelerates the tool across, which gives a force as well.
    if after.clamped and after.blind_s > BLIND_S and not felt.doubtful:
        has_contact = has_contact or contact.is_held_across(felt, tracker.across)
    assumed = has_contact and not felt.forces
    search, touched, sign = after.search, guard.UNTOUCHED, force_sign.TRUSTED
    if has_contact and force is not None and report.part is not None and after.history is not None:
        reach = _touched_reach(tracker, after, after.history, report.part, force)
        has_contact = _is_object(tracker, before, after, felt, reach, math.hypot(x, y))
        if has_contact:
            # A clamp that closes on a tool which was led back from the object pulls at it.
            stands_off = after.clamped and before.distance < -release.HELD_OFF
            shown = stands_off or tare.shows_weight(after.tare, tracker.settings.tactile)
            sign = force_sign.at_touch(force, tracker.vibration.force, shows_weight=shown)
        if has_contact and not after.clamped:
            touched = _touched_programme(tracker, before, after, reach)
            search = guard.ContactSearch(reach, search.lasted)
    return replace(
        after,
        contact_state=felt,
        contact=has_contact,
        assumed=assumed,
        touching=0.0,
        beyond_s=0.0,
        touched=touched,
        search=search,
        force_sign=sign,
    )


def _is_object(
    tracker: Tracker,
    before: TrackerState,
    after: TrackerState,
    felt: contact.ContactState,
    reach: float,
    across: float,
) -> bool:
    """Return whether a touch is the object's, and no rubbing of the bolts.

    Args:
        reach: how far beyond its estimate the object was touched [m].
        across: force across the tool's axis [N].
    """
    bolts = tracker.settings.payload.bolts
    backs = contact.backs_off(felt, tracker.vibration, before.distance)
    backs = backs and bolts > 0.0 and not after.clamped
    rubs = backs or contact.may_rub(reach, bolts)
    return not rubs or _is_face(tracker, felt, across)


def _doubted_from(tracker: Tracker, before: TrackerState, after: TrackerState) -> float:
    """Return the distance before the object from which on a force may be doubted [m]."""
    if after.clamped and not before.contact_state.doubtful:
        return math.inf  # it may have touched before
    bolts = tracker.settings.payload.bolts
    return max(contact.OFF_M, bolts + TIPS_RESERVE if bolts > 0.0 else 0.0)


def _holds_nothing(tracker: Tracker, state: TrackerState, report: Report) -> bool:
    """Return whether a contact was none: the clamp has opened, or closed on nothing."""
    if state.releasing is None or report.force is None:
        return False
    swings = release.swings(state.pull, state.pull_power)
    return release.holds_nothing(
        opening=state.releasing,
        timeout=tracker.task.tool.release_timeout,
        touching=0.0 if touch_proof.is_doubted(state.beyond_s) else state.touching,
        distance=state.distance,
        pulls=is_pulling(tracker, state) and not swings,
    )


def _beyond(tracker: Tracker, state: TrackerState, report: Report) -> float:
    """Return for how long a touch has given more force than an object does [s]."""
    push = 0.0 if report.force is None else -float(report.force[2])
    stiffness = tracker.settings.tactile.stiffness[2]
    times = state.touching, tracker.cycle_s
    planned, advance = state.poses[0], 0.0
    if touch_proof.is_due(state.touching):
        tcp = planned if state.history is None else state.history.poses[-1]
        advance = touch_proof.advance(state.distance, tcp, planned)
    return touch_proof.advanced(state.beyond_s, push, advance, stiffness, *times)


def _approach_speed(tracker: Tracker, before: TrackerState, after: TrackerState) -> float:
    """Return the programmed speed of the tool towards the object [m/s]; 0 where it has none."""
    advance = after.distance - before.distance
    return max(advance, 0.0) / tracker.cycle_s if math.isfinite(advance) else 0.0


def _without_jumps(
    tracker: Tracker, before: TrackerState, after: TrackerState, force: float | None, speed: float
) -> tuple[TrackerState, float | None]:
    """Return the state and the force along the tool's axis without jumps of its sensor.

    Args:
        after: the state, with the samples of the force.
        speed: programmed, of the tool towards the object [m/s].
    """
    felt, offset = before.contact_state, before.force_offset
    if force is None or not after.sampled:
        return replace(after, force_offset=replace(offset, last=None)), force
    samples = [force + each for each in after.sampled]
    if not contact.is_observable(felt, tracker.vibration):
        # The tool may swing at any speed after a hold.
        return replace(after, force_offset=force_jump.ForceOffset(0.0, samples[-1])), force
    largest = force_jump.largest_change(
        felt, tracker.vibration, max(speed, tracker.task.guard.touch_speed), 1.0 / len(samples)
    )
    offset, samples = force_jump.without_jumps(offset, samples, largest, felt.free or 0.0)
    mean = sum(samples) / len(samples)
    sampled = tuple([each - mean for each in samples])
    return replace(after, force_offset=offset, sampled=sampled), mean


def _is_face(tracker: Tracker, state: contact.ContactState, across: float) -> bool:
    """Return whether an early touch is the face of an object that is nearer than estimated.

    A face pushes. Bolts that slip into their holes let the bent mount spring: that is a pull.

    Args:
        across: force across the tool's axis [N].
    """
    least = guard.face_force(tracker.task.guard, tracker.settings.tactile.stiffness[2], across)
    least = max(least, tracker.vibration.force)
    return contact.is_push(state, tracker.vibration, least)


def _touched_reach(
    tracker: Tracker, state: TrackerState, history: History, part: Array, force: float
) -> float:
    """Return how far beyond its estimate the object was touched [m]."""
    guarded, stiffness = tracker.task.guard, tracker.settings.tactile.stiffness[2]
    limit = max(guarded.clearance, guarded.overrun, contact.NEAR)
    tcp = elastic(state, history.poses[-1])
    return guard.touched_reach(tcp, part, force_sign.nearer(force), stiffness, limit)


def _touched_programme(
    tracker: Tracker, before: TrackerState, after: TrackerState, reach: float
) -> guard.TouchedProgramme:
    """Return where the programme was as the tool touched the object.

    Args:
        reach: how far beyond its estimate the object was touched [m].
    """
    search = after.search
    speed = tracker.task.guard.speed if search.lasted > 0.0 else 0.0
    # What is commanded already leads the tool on for so many cycles.
    cycles = tracker.merge_free.committed_s / tracker.cycle_s
    led = after.distance + cycles * (after.distance - before.distance) - reach
    duration = guard.pressing_time(led - tracker.press)
    return guard.TouchedProgramme(search.reach - reach, speed, duration)
