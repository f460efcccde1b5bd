"""Compliance of the clamped tool in one step: its offset by force."""

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.conveyor import ConveyorEstimate, Motion, has_changed_class
from linemate.daemon.core.tracking.estimation.force_use import is_force_used
from linemate.daemon.core.tracking.merge import ALONG
from linemate.daemon.core.tracking.observation import Wrench, pose_at, rate_now
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.touch import compliance, tare
from linemate.daemon.core.tracking.tracker_state import StepSamples, Tracker, TrackerState


def comply(
    tracker: Tracker,
    state: TrackerState,
    samples: StepSamples,
    view: ConveyorEstimate | None,
    wrench: Wrench | None,
    part: Array,
) -> TrackerState:
    """Return the state with the compliance of a clamped tool one step later.

    Args:
        view: whose change of class has taken the offset along the conveyor over.
        part: (6,) the object now in c, as the target has it without the compliance's offset.
    """
    history = state.history
    if wrench is None and state.compliance.press is not None:
        return replace(state, compliance=compliance.waiting(state.compliance))
    if wrench is None or history is None:
        return state
    tcp = pose_at(history, wrench.stamp_ns, 2.5 * tracker.cycle_s)
    if tcp is None:
        return state
    R = rotations.exp(tcp[3:])
    if not is_force_used(tracker, state, wrench):
        return _observed(tracker, state, R.dot(wrench.force))
    mount = tracker.settings.tactile
    bending = tare.bending(state.tare, wrench, mount) or wrench
    shift = R.dot(bending.force / np.array(mount.stiffness))
    # The clamped tool moves with the object: it carries the measurement on to now.
    late = (samples.stamp_ns - wrench.stamp_ns) * 1e-9
    off = tcp[:3] + shift + late * rate_now(history)[:3] - part[:3]
    fx, fy, fz = R.dot(wrench.force).tolist()
    x, y, z = off.tolist()
    if not (mount.holds or Gate.SCREWS_FIXED in state.passed):
        fx = fy = x = y = 0.0
    before, events = state.compliance, () if view is None else view.events
    if before.press is None and state.touching < compliance.SEATED_S:
        before = compliance.displaced((x, y, z))
    elif before.is_firm or has_changed_class(events):
        before = compliance.taken_over(before, ALONG)
    later = compliance.advance(
        before,
        tracker.compliance,
        (fx, fy, fz),
        (x, y, z),
        state.touching,
        is_pushed=("push", "confirmed") in events,
        is_at_rest=view is not None and view.motion in {Motion.STANDING, Motion.STARTING},
    )
    return replace(state, compliance=later)


def _observed(tracker: Tracker, state: TrackerState, force: Array) -> TrackerState:
    """Return the state with the oscillation of a suspect force, which moves no target.

    Whatever its sign, a force that swings and does not fall has to end.

    Args:
        force: (3,) on the clamped tool, in c [N].
    """
    is_seated_long = state.contact and state.touching > compliance.SEATED_S
    if not (is_seated_long and state.force_sign.is_suspect and state.releasing is None):
        return state
    before, (x, y, z) = state.compliance, force.tolist()
    later = compliance.advance(before, tracker.compliance, (x, y, z), before.offset, state.touching)
    return replace(state, compliance=replace(later, offset=before.offset))


def felt_part(state: TrackerState, part: Array) -> Array:
    """Return the object (6,) in c where it is felt: at its estimate and the compliance's offset."""
    x, y, z = state.compliance.offset
    felt: Array = part + np.array((x, y, z, 0.0, 0.0, 0.0))
    return felt


def complied(
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
