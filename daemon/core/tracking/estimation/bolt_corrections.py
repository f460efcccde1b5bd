"""Corrections of the object by bolts in their holes, before the tool touches."""

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.across.transverse_state import TransverseState
from linemate.daemon.core.tracking.conveyor import PositionMeasurement, Source
from linemate.daemon.core.tracking.estimation.step_measurements import along_measurement
from linemate.daemon.core.tracking.observation import History, Wrench, pose_at
from linemate.daemon.core.tracking.touch import held_bolts, tare
from linemate.daemon.core.tracking.tracker_state import StepSamples, Tracker, TrackerState
from linemate.protocol.stamped_samples import Vector3

NO_FORCE = (0.0, 0.0, 0.0)
UNHELD = (0.0, 0.0)  # bolts in their holes have shown nothing yet
HELD_GATE = 5.0  # of a place that bolts in their holes show [sigma]


def correct_across(
    tracker: Tracker,
    state: TrackerState,
    transverse: TransverseState | None,
    history: History | None,
    samples: StepSamples,
    wrench: Wrench | None,
    leaning: Vector3,
    rows: list[PositionMeasurement],
) -> TransverseState | None:
    """Return the estimate across the conveyor by bolts in their holes.

    Args:
        wrench: of the contact alone.
        leaning: its mean force [N].
        rows: gets what they show along the conveyor.
    """
    settings = tracker.settings
    payload, mount = settings.payload, settings.tactile
    # A clamp that was ordered to open leaves the bolts in the object: its tool springs free.
    is_free = state.started and not state.contact and state.releasing is None
    if not is_free or not held_bolts.is_entered(payload, state.distance):
        return transverse
    bent = _bent(tracker, state, history, wrench)
    if transverse is None or wrench is None or bent is None:
        return transverse
    tcp, bending = bent
    where = payload, mount, state.distance, leaning
    place = held_bolts.place(wrench.force, bending, tcp, *where)
    if place is None:
        return transverse
    if state.held == UNHELD:
        # Images have an error of the camera's mount that their number does not make smaller.
        transverse = tracker.transverse.unsure_across(transverse, held_bolts.MOUNT_DEVIATION)
    delay = (samples.stamp_ns - wrench.stamp_ns) * 1e-9
    held = held_bolts.measured(place, tcp, delay, tracker.cycle_s)
    transverse, is_accepted = tracker.transverse.correct(transverse, held, HELD_GATE)
    if is_accepted:
        rows.append(along_measurement(tracker, transverse, Source.CAMERA, held, HELD_GATE))
    return transverse


def place_along(
    tracker: Tracker,
    state: TrackerState,
    transverse: TransverseState | None,
    history: History | None,
    samples: StepSamples,
    wrench: Wrench | None,
) -> PositionMeasurement | None:
    """Return where along the conveyor bolts in their holes hold the object."""
    mount, is_free = tracker.settings.tactile, state.started and not state.contact
    if not is_free or not held_bolts.are_in(tracker.settings.payload.bolts, state.distance):
        return None
    bent = _bent(tracker, state, history, wrench)
    if wrench is None or bent is None:
        return None
    tcp, bending = bent
    place = tcp[:3] + rotations.exp(tcp[3:]).dot(bending / np.array(mount.stiffness))
    delay = (samples.stamp_ns - wrench.stamp_ns) * 1e-9
    held = held_bolts.measured(place, tcp, delay, tracker.cycle_s)
    shown = along_measurement(tracker, transverse, Source.TACTILE, held, HELD_GATE)
    return replace(shown, play=tracker.settings.payload.bolt_play)


def _bent(
    tracker: Tracker, state: TrackerState, history: History | None, wrench: Wrench | None
) -> tuple[Array, Array] | None:
    """Return the tcp (6,) at a wrench, and the force (3,) that bends its mount [N]; or None."""
    bending = tare.bending(state.tare, wrench, tracker.settings.tactile)
    if history is None or wrench is None or bending is None:
        return None
    tcp = pose_at(history, wrench.stamp_ns, 2.5 * tracker.cycle_s)
    return None if tcp is None else (tcp, bending.force)


def moved_by(
    tracker: Tracker,
    state: TrackerState,
    before: TransverseState | None,
    after: TransverseState | None,
) -> tuple[float, float]:
    """Return by what bolts in their holes have moved the estimate of x and z [m].

    Args:
        before, after: the estimate without and with what they show in this step.
    """
    if after is not before and before is not None and after is not None:
        x, z = (after.x - before.x)[:2].tolist()
        return state.held[0] + x, state.held[1] + z
    is_near = state.contact or held_bolts.is_entered(tracker.settings.payload, state.distance)
    return state.held if is_near else UNHELD


def average_force(tracker: Tracker, state: TrackerState, wrench: Wrench | None) -> Vector3:
    """Return the mean force of bolts in their holes [N], nothing where there are none."""
    if state.contact:
        return state.leaning  # with which the tool touched
    if not held_bolts.is_entered(tracker.settings.payload, state.distance):
        return NO_FORCE
    if wrench is None:
        return state.leaning
    return held_bolts.averaged(state.leaning, wrench.force, tracker.cycle_s)
