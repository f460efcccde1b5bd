"""The task's clock with its gates, and the order of the tool's signals."""

import math

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking import merge
from linemate.daemon.core.tracking.conveyor import ConveyorEstimate
from linemate.daemon.core.tracking.go_no_go import clock_ramp
from linemate.daemon.core.tracking.go_no_go.clock_ramp import ClockRamp
from linemate.daemon.core.tracking.go_no_go.decision import GoOrder
from linemate.daemon.core.tracking.reference import barrier, last_step
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.touch import guard, release, tare, touch_proof
from linemate.daemon.core.tracking.tracker_state import StepSamples, Tracker, TrackerState

LARGEST_BEND = 0.008  # of the mount; a tool farther off is not on the object any more [m]
STANDS = 1e-4  # way of a programme that stands, at most [m, rad]
CALMING_S = 0.5  # before the wheel is released the contact is watched [s]
CLAMP_OPEN = 2  # bit of the tool's signals: the wheel is released


def standing_time(tracker: Tracker, state: TrackerState, retreat: bool) -> float:
    """Return the step's time at which the task's clock stops [s]; infinity without a stop."""
    if retreat and is_before_contact(tracker, state):
        return state.time
    # The programme's own retreat would add its speed to the retraction's.
    passed = state.passed - {Gate.WHEEL_RELEASED} if retreat else state.passed
    closed = barrier(tracker.reference, state.time, passed)
    if state.oscillated is not None and not retreat:
        closed = min(closed, tracker.task.tool.release_wheel - 0.01 * tracker.cycle_s)
    if state.go.order is not GoOrder.GO and not retreat:
        if state.time > tracker.sight_time:
            return state.time
        closed = min(closed, tracker.sight_time)
    return last_step(closed, tracker.cycle_s)


def programme_times(tracker: Tracker, state: TrackerState) -> Array | None:
    """Return the times (n+1,) of a clock that does not simply run over the horizon [steps].

    None for a clock that runs up to its gate.
    """
    T0, ramp = tracker.cycle_s, state.ramp
    if ramp == clock_ramp.RUNNING and _withdraws_moving(tracker, state):
        # The clock stands at once, and the tool comes to rest behind what is committed.
        planned = _braked_ramp(tracker, ramp, state.time / T0).planned
        ramp = ClockRamp(0, planned[round(state.clock_stood / T0) :] or planned[-1:])
    if ramp == clock_ramp.RUNNING or not is_before_contact(tracker, state):
        return None
    times = clock_ramp.times_ahead(ramp, state.time / T0, tracker.steps)
    low, high = _bounds(tracker, state)
    return np.clip(times, min(low, state.time / T0), high)


def _withdraws_moving(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether a tool withdraws that moved along its programme as the clock stood."""
    if state.withdrawn is None:
        return False
    return 0.0 < state.clock_stood - state.withdrawn < 1.5 * tracker.cycle_s


def _bounds(tracker: Tracker, state: TrackerState) -> tuple[float, float]:
    """Return the least and the greatest time of a clock near its last approach [steps]."""
    T0 = tracker.cycle_s
    low = round(last_step(tracker.sight_time, T0) / T0)
    high = last_step(barrier(tracker.reference, state.time, state.passed), T0) / T0
    return low, high


def _next_time(tracker: Tracker, state: TrackerState, retreat: bool) -> tuple[float, ClockRamp]:
    """Return the clock's time of this step [s] and how it goes on.

    Args:
        state: of the last step, with the gates that are open now.
    """
    # Counted in steps: a sum of many periods is no multiple of one.
    T0 = tracker.cycle_s
    now, ramp = state.time / T0, state.ramp
    if retreat and ramp != clock_ramp.RUNNING and is_before_contact(tracker, state):
        if ramp.rate != 0:
            ramp = _braked_ramp(tracker, ramp, now)
        ramp = clock_ramp.advanced(ramp)
        return (ramp.planned[0] if ramp.planned else now) * T0, ramp
    is_ramped = ramp != clock_ramp.RUNNING or state.go.order is not GoOrder.GO
    if retreat or not is_ramped or not is_before_contact(tracker, state):
        if ramp.planned:
            state = replace(state, time=last_step(state.time, T0))
        stand = standing_time(tracker, state, retreat)
        step = max(round(state.time / T0) + 1, round(_leaving(tracker, state) / T0))
        return min(step * T0, stand), clock_ramp.RUNNING
    low, high = _bounds(tracker, state)
    rate = clock_ramp.RATES[state.go.order]
    if now <= low and rate < 1:
        # The programme rests there: the clock stands at once.
        ramp = clock_ramp.RUNNING if now < low else clock_ramp.STANDING
        return min(round(now) + ramp.rate, low) * T0, ramp
    if len(ramp.planned) <= 1 and rate != ramp.rate:
        ramp = clock_ramp.extended(_changed_ramp(tracker, ramp, round(now), rate), low, high)
    ramp = clock_ramp.advanced(ramp)
    time = ramp.planned[0] if ramp.planned else round(now) + ramp.rate
    if ramp.rate == 1 and not ramp.planned:
        ramp = clock_ramp.RUNNING
    return min(max(time, low), high) * T0, ramp


def _leaving(tracker: Tracker, state: TrackerState) -> float:
    """Return the time at which a tool with an open clamp leaves [s]; 0 for the programmed one.

    A released object on a soft hanger sinks and swings off the tool by 20 mm in 0.3 s. A programme
    that stands up to the gate has nothing to wait for.
    """
    if Gate.WHEEL_RELEASED not in state.passed or state.time < tracker.task.tool.release_wheel:
        return 0.0
    at = barrier(tracker.reference, state.time, state.passed - {Gate.WHEEL_RELEASED})
    if at == math.inf:
        return 0.0
    _, (here, there) = tracker.reference.poses(np.array((state.time, at)))
    return at if np.allclose(here, there, atol=STANDS) else 0.0


def _changed_ramp(tracker: Tracker, ramp: ClockRamp, now: int, rate: int) -> ClockRamp:
    """Return the ramp of a clock that changes its rate behind what is committed.

    Args:
        now: time of the clock [steps].
    """
    # A merge amplifies a corner in what it reads by (tau/T0)^4.
    delay = tracker.merge_free.first_free
    length = clock_ramp.ramp_steps(_speed_near(tracker, now), rate - ramp.rate, tracker.cycle_s)
    return clock_ramp.changed(ramp, now, rate, delay, length)


def _braked_ramp(tracker: Tracker, ramp: ClockRamp, now: float) -> ClockRamp:
    """Return the ramp of a clock that comes to stand for a retreat.

    Without it the part of a ramp that is committed already is a corner for the merge: at 4 ms it
    led a tool that waited 6 mm before the object 50 mm on. So is a tool that moves and stands at
    once: the retreat came to 0.53 m/s, its limits bent the way, and the tool swung with 350 N.

    Args:
        now: time of the clock [steps].
    """
    length = clock_ramp.ramp_steps(_speed_near(tracker, round(now)), 1, tracker.cycle_s)
    return clock_ramp.braked(ramp, now, tracker.merge_free.first_free, max(length, 2))


def _speed_near(tracker: Tracker, now: int) -> float:
    """Return the largest speed of the programme near a time of its clock [m/s].

    Args:
        now: time of the clock [steps].
    """
    T0, delay = tracker.cycle_s, tracker.merge_free.first_free
    last = now + delay + math.ceil(clock_ramp.LONGEST_S / T0)
    way = np.diff(tracker.table.relative[max(now - delay, 0) : last, :3], axis=0)
    return math.sqrt(float((way * way).sum(axis=1).max(initial=0.0))) / T0


def is_before_contact(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether there was no contact yet: a retreat must not lead the tool there.

    A touch that is felt after the clamp was ordered to open is none, as is one that is doubted: the
    programme stays where it is.
    """
    is_none = touch_proof.is_doubted(state.beyond_s) or (state.releasing or 0.0) > state.touching
    is_late = state.releasing is not None and is_none
    # A clamp that a retreat has opened before is no release by the programme.
    is_released = Gate.WHEEL_RELEASED in state.passed and state.time >= tracker.search_time
    return (not state.contact or is_late) and not is_released


def is_about_to_touch(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether the tool is to touch the object before a new goal is taken up.

    The greater part of what a merge changes acts on a clamped tool then. A touch that is overdue
    may not come.
    """
    is_going = state.go.order is GoOrder.GO and state.withdrawn is None and is_blended(state)
    if state.contact or not is_going or not is_before_contact(tracker, state):
        return False
    plan, T0 = tracker.merge_clamped, tracker.cycle_s
    taken_up_s = plan.committed_s + T0 * merge.delay(plan.matrices[merge.ALONG])
    touch = tracker.reference.contact_time
    return touch - taken_up_s <= state.time < tracker.search_time


def advance_clock(
    tracker: Tracker,
    state: TrackerState,
    view: ConveyorEstimate | None,
    samples: StepSamples,
    retreat: bool,
) -> TrackerState:
    """Return the state with the task's clock one step later, unless a gate stops it."""
    T0 = tracker.cycle_s
    tool, passed = tracker.task.tool, open_gates(tracker, state, view, samples)
    # A robot that got no commands rests already.
    rests = state.stood > 0.0 or state.releasing is not None
    if retreat and state.releasing is None and not state.contact:
        state = _set_back(tracker, state)
    if state.releasing is None:
        # A merge amplifies a change of what is committed: the press goes as it was ordered to.
        state = _unloaded_in(state, release.RETREAT_S if retreat else release.UNLOADING_S)
    stood = max(state.stood - release.STANDING_S, 0.0)
    moved = 0.0 if view is None else abs(view.speed) * stood
    carries = retreat and _carries(tracker, state, passed)
    clamped = retreat and state.withdrawn is None and not carries
    clamped = clamped and _may_be_clamped(tracker, state, passed, moved)
    if retreat:
        keeps = carries or _keeps(state, clamped=clamped)
        # A clamp that was kept closed is ordered to open only now.
        begun = None if state.keeps and not keeps else state.releasing
        state = replace(
            state,
            clamped=clamped,
            keeps=keeps,
            releasing=elapsed(begun, True, T0),
            # A robot that gets no commands yet would catch up at its joints' limits.
            withdrawn=elapsed(state.withdrawn, not clamped and state.stood <= 0.0, T0),
        )
    if not state.started:
        return state
    oscillated = _oscillated(tracker, state, retreat)
    state = replace(state, oscillated=oscillated, passed=passed)
    time, ramp = _next_time(tracker, state, retreat)
    blended = state.blended
    if blended is not None:
        blended += T0
    elif time > 0.0 and state.transverse is not None:
        blended = 0.0
    stands = time == state.time and (not (retreat and rests) or state.clock_stood > 0.0)
    clock_stood, carried = _standing(tracker, state, stands=stands)
    screwing = time >= tool.fix_screws and not retreat and _is_pressed(tracker, state)
    releasing = time >= tool.release_wheel
    return replace(
        state,
        time=time,
        clock_stood=clock_stood,
        carried=carried,
        ramp=ramp,
        blended=blended,
        fixing=elapsed(state.fixing, screwing, T0),
        releasing=state.releasing if retreat else elapsed(state.releasing, releasing, T0),
    )


def _carries(tracker: Tracker, state: TrackerState, passed: frozenset[Gate]) -> bool:
    """Return whether the tool retreats with a part that it alone carries.

    Its clamp holds the part, and nothing holds that to the object before its screws turn.
    """
    if tracker.settings.tactile.clamps:
        return False
    if state.releasing is not None:
        return state.keeps
    return state.fixing is None and Gate.SCREWS_FIXED not in passed


def _keeps(state: TrackerState, *, clamped: bool) -> bool:
    """Return whether a retreat leaves the clamp closed: an open one drops what it carries."""
    begins_free = state.keeps or state.releasing is None
    return begins_free and not (clamped or state.contact)


def _standing(tracker: Tracker, state: TrackerState, *, stands: bool) -> tuple[float, float]:
    """Return for how long the clock has stood [s], and the tool's way while it stood before [m]."""
    if stands:
        return state.clock_stood + tracker.cycle_s, state.carried
    if state.clock_stood <= 0.0:
        return 0.0, state.carried
    way = tracker.reference.way_on(state.time, np.array([state.clock_stood]))
    return 0.0, state.carried + float(way[0, merge.ALONG])


def _oscillated(tracker: Tracker, state: TrackerState, retreat: bool) -> float | None:
    """Return for how long the release waits for a calm contact [s]; None if it does not.

    And for the object to take the weight over.
    """
    at = tracker.task.tool.release_wheel
    is_due = state.contact and not retreat and state.releasing is None
    if not is_due or not at - CALMING_S <= state.time < at:
        return None
    waited = 0.0 if state.oscillated is None else state.oscillated
    if waited >= release.LONGEST_WAIT_S:
        return None
    pull = tare.without_weight(state.tare, state.pull)
    if release.is_calm(state.compliance.power, pull) and not tare.is_lowering(state.tare):
        return None
    return waited + tracker.cycle_s if state.time >= at - 1.5 * tracker.cycle_s else waited


def _unloaded_in(state: TrackerState, unloading_s: float) -> TrackerState:
    """Return the state whose press goes in a given time once the clamp is ordered to open."""
    return state if state.unloading_s == unloading_s else replace(state, unloading_s=unloading_s)


def _set_back(tracker: Tracker, state: TrackerState) -> TrackerState:
    """Return the state with the task's clock where the robot got its last command.

    A retreat that begins while commands are lost must not lead the tool on to where it should be
    by now: nearer to the object, at the speed of a catch-up.
    """
    if state.stood <= 0.0:
        return state
    T0 = tracker.cycle_s
    steps = round(state.time / T0) - round(state.stood / T0)
    return replace(state, time=max(steps, 0) * T0, ramp=clock_ramp.RUNNING)


def _is_pressed(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether the tool is in contact and the object has pushed it back for a while.

    The inertia of a tool that slows down gives the force of a contact for a moment.
    """
    if state.assumed:
        return state.contact
    return state.contact and state.pull[2] < -tracker.settings.tactile.contact_force


def _may_be_clamped(
    tracker: Tracker, state: TrackerState, passed: frozenset[Gate], moved: float
) -> bool:
    """Return whether to withdraw now could pull at a closed clamp.

    Args:
        state: with the task's clock at the last command that the robot got.
        passed: gates that are open.
        moved: way of the object while the robot stood, for it got no commands [m].
    """
    if moved > LARGEST_BEND and not state.contact:
        return False
    leading = release.LEADING_S if state.stood <= 0.0 else release.STANDING_S
    steps = math.ceil(leading / tracker.cycle_s)
    times = clock_ramp.times_ahead(state.ramp, state.time / tracker.cycle_s, steps)
    _, relative = tracker.table.between(times)
    # A force that is doubted before the object may be one of a clamp that has closed.
    distance = 0.0 if state.contact_state.doubtful else float(relative[-1, 2])
    return release.may_be_clamped(
        contact=state.contact,
        released=Gate.WHEEL_RELEASED in passed,
        distance=distance if state.started else -math.inf,
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


def open_gates(
    tracker: Tracker, state: TrackerState, view: ConveyorEstimate | None, samples: StepSamples
) -> frozenset[Gate]:
    """Return the open gates, with those that open now."""
    tool, fixing = tracker.task.tool, state.fixing
    releasing = None if state.keeps else state.releasing
    gates = []
    if view is not None and view.position + view.offset >= tracker.reference.origin[1]:
        gates.append(Gate.OBJECT_CLOSE)
    if is_blended(state):
        gates.append(Gate.OBJECT_SEEN)
    if samples.digital_in & 1 or _has_lasted(fixing, tool.fixed_after):
        gates.append(Gate.SCREWS_FIXED)
    # A clamp that is open before it was ordered to open has not closed yet.
    opened = releasing is not None and samples.digital_in & CLAMP_OPEN
    if opened or _has_lasted(releasing, tool.released_after):
        gates.append(Gate.WHEEL_RELEASED)
    return state.passed if state.passed.issuperset(gates) else state.passed.union(gates)


def is_blended(state: TrackerState) -> bool:
    """Return whether the goal is that of the sensed object alone."""
    return state.blended is not None and state.blended >= state.blend_s


def _has_lasted(age: float | None, needed: float | None) -> bool:
    """Return whether an age has reached a duration; never without one."""
    return age is not None and needed is not None and age >= needed


def elapsed(age: float | None, begun: bool, dt: float) -> float | None:
    """Return the time since a beginning [s]: None before, 0 as it begins."""
    if age is not None:
        return age + dt
    return 0.0 if begun else None
