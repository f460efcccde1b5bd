"""Whether the force on a tool measures the object: clamped, seated, and of the right sign."""

import math

from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.tracking.observation import Wrench
from linemate.daemon.core.tracking.touch import compliance, force_sign, release, tare, touch_proof
from linemate.daemon.core.tracking.tracker_state import Tracker, TrackerState
from linemate.protocol.stamped_samples import Vector3

SEATING_S = 0.012  # a clamp closes in 0.04 s; contact is detected 0.03 s after it or later [s]
BLIND_S = 0.06  # without a distance for longer than this the object is not seen [s]


def is_force_used(tracker: Tracker, state: TrackerState, wrench: Wrench | None) -> bool:
    """Return whether the force measures where the object is: the tool is surely clamped to it.

    A clamp that was ordered to open may be open without reporting it. A tool that hangs free would
    measure the object at its own position, and would follow itself. Soon after a touch the clamp is
    closed, whatever was ordered, unless the tool swung: that may be the touch.
    """
    if (
        not is_seated(tracker, state)
        or _is_overload(tracker, wrench)
        or state.force_sign.is_suspect
        or touch_proof.is_doubted(state.beyond_s)
    ):
        return False
    if state.releasing is None:
        return state.contact
    if release.swings(state.pull, state.pull_power):
        return False
    # In the task's own release the tool stands at the object: a mean is early enough there.
    is_closed = state.clamped and release.opens(state.releasing, state.touching)
    # Where a contact is assumed no touch was felt: the clamp may have closed on nothing.
    is_closed = not state.assumed and (is_closed or state.touching < release.PULL_S)
    return state.contact and (is_closed or is_pulling(tracker, state))


def is_seated(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether a closing clamp has drawn the tool in.

    Before that the mount is bent by the tool's offset from the object: the force does not measure
    the object. Its change would be detected as a stop, a start or an impulse. A tool that touches
    blind waits a cycle less: only the force shows that the object stops.
    """
    sooner = tracker.cycle_s if state.blind_s > BLIND_S else 0.0
    return state.contact and state.touching >= SEATING_S - sooner


def _is_overload(tracker: Tracker, wrench: Wrench | None) -> bool:
    """Return whether a force is beyond the tool's limit: then it does not measure the object.

    A wrong sensor would move the object by 10 mm for 500 N, and the clamped tool would follow.
    """
    limit = tracker.settings.tactile.overload_force
    return wrench is not None and math.hypot(*wrench.force.tolist()) > limit


def is_pulling(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether the mean force on the tool is one that only a closed clamp gives."""
    pulling = release.PULLING * tracker.settings.tactile.contact_force
    return math.hypot(*state.pull) > pulling


def average_pull(
    tracker: Tracker, state: TrackerState, wrench: Wrench | None
) -> tuple[Vector3, float]:
    """Return the mean force [N] and its mean square [N^2] on a tool that may be clamped."""
    if not state.contact and state.releasing is None:
        return state.pull, state.pull_power
    pull = release.averaged(state.pull, wrench, tracker.cycle_s)
    return pull, release.averaged_square(state.pull_power, wrench, tracker.cycle_s)


def update_sign(tracker: Tracker, state: TrackerState, wrench: Wrench | None) -> TrackerState:
    """Return the state with what a force on the clamped tool says of its sign."""
    if wrench is None or not is_seated(tracker, state) or state.history is None:
        return state
    before, force = state.force_sign, float(wrench.force[2])
    mount = tracker.settings.tactile
    if force < -mount.contact_force and before == force_sign.TRUSTED:
        return state  # whatever the offset is, as in most of a contact
    axis = rotations.exp(state.history.poses[-1][3:])[:, 2]
    # The compliance begins where the tool touched: that is no advance of the target.
    begun = state.compliance.press is not None
    offset = float(axis @ state.compliance.offset) if begun else None
    right_dt = tracker.cycle_s if tare.shows_weight(state.tare, mount) else None
    sign = force_sign.advanced(before, force, offset, mount.contact_force, right_dt)
    if sign.is_suspect and state.releasing is None and state.touching > force_sign.SEATED_S:
        sign = force_sign.tested(sign, force, tracker.cycle_s)
    if sign == before:
        return state
    way = sign.way - before.way if sign.is_suspect else 0.0
    x, y, z = (way * axis).tolist()
    return replace(
        state, force_sign=sign, compliance=compliance.shifted(state.compliance, (x, y, z))
    )
