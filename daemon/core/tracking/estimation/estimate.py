"""Estimation of the object in one step: predict and correct, along and across the conveyor."""

import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.across.body_sway import NO_SWAY
from linemate.daemon.core.tracking.across.transverse_state import TransverseState
from linemate.daemon.core.tracking.classifiers import stop_input
from linemate.daemon.core.tracking.classifiers.classifier_bank import BankClassifier
from linemate.daemon.core.tracking.classifiers.sway_bank import FARTHEST
from linemate.daemon.core.tracking.conveyor import ConveyorEstimate, PositionMeasurement, Source
from linemate.daemon.core.tracking.estimation import bolt_corrections, prediction_error
from linemate.daemon.core.tracking.estimation.deflection import felt_pose, felt_row
from linemate.daemon.core.tracking.estimation.force_use import (
    average_pull,
    is_force_used,
    update_sign,
)
from linemate.daemon.core.tracking.estimation.prediction_error import PredictionMonitor
from linemate.daemon.core.tracking.estimation.step_measurements import (
    along_measurement,
    distance_rows,
    pose_measurements,
)
from linemate.daemon.core.tracking.estimation.tool_acceleration import update_acceleration
from linemate.daemon.core.tracking.estimation.tool_weight import update_tare
from linemate.daemon.core.tracking.observation import PoseMeasurement, Wrench, mean_wrench, remember
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.touch import compliance, tare
from linemate.daemon.core.tracking.tracker_state import StepSamples, Tracker, TrackerState

UNITS_S = 0.35  # for which positions of the conveyor unit are remembered [s]
BLIND_S = 0.1  # without a distance, after which the camera alone shows the object [s]
FIRST_READINGS = 4  # readings of the distance sensor that start the classifier
FIRST_SPREAD = 0.015  # largest range of these readings: none is an outlier [m]
LARGEST_TURN = 0.8  # of the object from its nominal pose, before it is known [rad]: bodies by 0.4


def estimate(
    tracker: Tracker, state: TrackerState, samples: StepSamples
) -> tuple[TrackerState, ConveyorEstimate | None, int, Wrench | None]:
    """Return the state one step later, the conveyor, the number of rejected poses, the wrench."""
    history = state.history
    if samples.tcp is not None:
        history = remember(history, samples.tcp_stamp_ns, samples.tcp, tracker.history_length)
    transverse = _predicted(tracker, state)
    state = _announced(tracker, state, samples)
    raw = mean_wrench(samples.wrench)
    state = update_acceleration(tracker, state, raw, samples)
    state = update_tare(tracker, state, raw)
    wrench = tare.tared(state.tare, raw, tracker.settings.tactile)
    pull, pull_power = average_pull(tracker, state, wrench)
    state = update_sign(tracker, state, wrench)
    felt = wrench if is_force_used(tracker, state, wrench) else None
    felt = tare.bending(state.tare, felt, tracker.settings.tactile)
    first_poses = pose_measurements(tracker, history, samples, felt, state.bolts)
    rows, distance_noise = distance_rows(tracker, state, samples)
    oscillation = compliance.uncertainty(state.compliance, tracker.compliance)
    seen, waiting, rejected, pose_ns = _see(
        tracker, state, transverse, first_poses, rows, oscillation, samples.stamp_ns
    )
    rows, placed, elsewhere = _placed_rows(tracker, state, rows)
    rejected += elsewhere
    leaning = bolt_corrections.average_force(tracker, state, wrench)
    transverse = bolt_corrections.correct_across(
        tracker, state, seen, history, samples, wrench, leaning, rows
    )
    engaged = bolt_corrections.place_along(tracker, state, seen, history, samples, wrench)
    conveyor, readings = _follow_conveyor(tracker, state, rows, engaged)
    view = None if conveyor is None else tracker.classifier.estimate(conveyor)
    sway = NO_SWAY
    if view is not None and state.contact:
        sway = state.sway.moved(view.swayed, tracker.cycle_s)
    state = replace(
        state,
        monitor=_compared(tracker, state, samples.stamp_ns, first_poses),
        history=history,
        conveyor=conveyor,
        transverse=transverse,
        first_poses=waiting,
        readings=readings,
        pull=pull,
        pull_power=pull_power,
        pose_ns=state.pose_ns if elsewhere else pose_ns,
        placed=placed,
        blind_s=0.0 if samples.distance else state.blind_s + tracker.cycle_s,
        speed=0.0 if view is None else view.speed,
        unit=None if view is None else view.unit,
        sway=sway,
        held=bolt_corrections.moved_by(tracker, state, seen, transverse),
        leaning=leaning,
        units=_with_unit(tracker, state, samples.stamp_ns, view),
        distance_noise=distance_noise,
    )
    return state, view, rejected, wrench


def _predicted(tracker: Tracker, state: TrackerState) -> TransverseState | None:
    """Return the prediction across the conveyor, None before enough poses have come."""
    if state.transverse is None:
        return None
    return tracker.transverse.predict(
        state.transverse,
        tracker.cycle_s,
        seating=state.fixing is not None and Gate.SCREWS_FIXED not in state.passed,
        speed=state.speed,
        unit=state.unit,
        swayed=state.sway.way,
    )


def _see(
    tracker: Tracker,
    state: TrackerState,
    transverse: TransverseState | None,
    first_poses: Sequence[tuple[Source, PoseMeasurement, float]],
    rows: list[PositionMeasurement],
    oscillation: float,
    stamp_ns: int,
) -> tuple[TransverseState | None, tuple[PoseMeasurement, ...], int, int | None]:
    """Return the transverse state, the poses of its start, how many are rejected, the last's time.

    Args:
        transverse: predicted; None until enough poses have come.
        first_poses: of this step: source, pose and gate.
        rows: measurements along the conveyor, which the accepted poses join.
        oscillation: variance that it adds to a measured deflection [m^2].
    """
    rejected, waiting, pose_ns = 0, state.first_poses, state.pose_ns
    for source, measured, gate in first_poses:
        if transverse is None and not _is_upright(measured.rotation):
            rejected += 1
            continue
        if transverse is None:
            waiting = (*waiting, measured)[-tracker.settings.fusion.initial_images :]
            if len(waiting) == tracker.settings.fusion.initial_images:
                transverse = tracker.transverse.initial(list(waiting))
        else:
            is_camera = source is Source.CAMERA
            across = measured if is_camera else felt_pose(tracker, state, measured, oscillation)
            # A wheel that is let go shows its weight, and no sway.
            is_steady = tracker.settings.tactile.holds and state.releasing is None
            if not is_camera and is_steady:
                transverse = tracker.transverse.correct_ratio(transverse, across, tracker.cycle_s)
            transverse, is_accepted = _correct(
                tracker, state, transverse, source, across, gate, stamp_ns
            )
            rejected += not is_accepted
            if not is_accepted:
                continue
        if source is Source.CAMERA:
            pose_ns = stamp_ns - round(measured.delay * 1e9)
        row = along_measurement(tracker, transverse, source, measured, gate)
        rows.append(row if source is Source.CAMERA else felt_row(tracker, state, row, oscillation))
    return transverse, waiting, rejected, pose_ns


def _placed_rows(
    tracker: Tracker, state: TrackerState, rows: list[PositionMeasurement]
) -> tuple[list[PositionMeasurement], bool, int]:
    """Return the rows without images of an object that is elsewhere, ``placed``, their number.

    A body sways by ``FARTHEST`` at most along the conveyor, whose unit the distance sensor shows.
    An image that has seen it there, and sees it farther off as the tool moves, shows that the tool
    does not go where its joints say: an axis of the URDF counts the other way.
    """
    images = [row for row in rows if row.source is Source.CAMERA]
    if not images or state.conveyor is None or state.blind_s > BLIND_S:
        return rows, state.placed, 0
    view, T0 = tracker.classifier.estimate(state.conveyor), tracker.cycle_s
    ways = [row.value - view.position - view.speed * (T0 - row.delay) for row in images]
    far = [row for row, way in zip(images, ways, strict=True) if not abs(way) < FARTHEST]
    if not (state.placed and state.started):
        return rows, state.placed or len(far) < len(images), 0
    return [row for row in rows if row not in far], True, len(far)


def _is_upright(rotation: Array) -> bool:
    """Return whether an object may be turned so (3, 3): the tool would turn as far with it."""
    return float(np.trace(rotation)) > 1.0 + 2.0 * math.cos(LARGEST_TURN)


def _correct(
    tracker: Tracker,
    state: TrackerState,
    transverse: TransverseState,
    source: Source,
    measured: PoseMeasurement,
    gate: float,
    now_ns: int,
) -> tuple[TransverseState, bool]:
    """Return the estimate across the conveyor after one pose, and whether it was accepted."""
    is_camera = source is Source.CAMERA
    transverse, is_accepted = tracker.transverse.correct(
        transverse, measured, gate, is_camera=is_camera
    )
    unit = _unit_at(state, now_ns - round(measured.delay * 1e9))
    if is_camera and is_accepted and unit is not None:
        transverse = tracker.transverse.correct_along(transverse, measured, unit)
    if is_camera and is_accepted:
        transverse = tracker.transverse.doubted(transverse)
    return transverse, is_accepted


def _follow_conveyor(
    tracker: Tracker,
    state: TrackerState,
    rows: list[PositionMeasurement],
    engaged: PositionMeasurement | None,
) -> tuple[Any, tuple[float, ...]]:
    """Return the conveyor's state one step later, and the distances of its start [m].

    Args:
        engaged: where bolts in their holes hold the object.
    """
    classifier, before, readings = tracker.classifier, state.conveyor, state.readings
    if before is None:
        recent = (*readings, *(row.value for row in rows if row.source is Source.DISTANCE))
        readings = recent[-FIRST_READINGS:]
        if len(readings) < FIRST_READINGS or max(readings) - min(readings) >= FIRST_SPREAD:
            return None, readings
        return classifier.initial(readings[-1]), readings
    if state.announced_s == 0.0:
        before = classifier.announce_stop(before)
    after = classifier.advance(before, _shown(tracker, rows), tracker.cycle_s)
    if engaged is not None and isinstance(classifier, BankClassifier):
        after = classifier.hang(before, after, engaged, tracker.cycle_s)
    return after, readings


def _shown(tracker: Tracker, rows: list[PositionMeasurement]) -> list[PositionMeasurement]:
    """Return what shows the object along the conveyor: no deflection of a contact that slides."""
    if tracker.settings.tactile.holds:
        return rows
    return [row for row in rows if row.source is not Source.TACTILE]


def _announced(tracker: Tracker, state: TrackerState, samples: StepSamples) -> TrackerState:
    """Return the state with a stop that the line announces in this step."""
    settings = tracker.task.conveyor.stop_input
    if settings.bit is None or samples.tcp is None:
        return state
    age = stop_input.edge_age(
        settings, state.announced_s + tracker.cycle_s, state.digital_in, samples.digital_in
    )
    return replace(state, digital_in=samples.digital_in, announced_s=age)


def _compared(
    tracker: Tracker,
    state: TrackerState,
    now_ns: int,
    poses: list[tuple[Source, PoseMeasurement, float]],
) -> PredictionMonitor:
    """Return the monitor of past predictions, compared with the images of one step."""
    transverse = state.transverse
    if state.conveyor is None or transverse is None:
        return state.monitor
    # A camera whose NIS is less than 1 has less noise than it states.
    honest = min(transverse.nis, 1.0)
    seen = [
        replace(
            tracker.transverse.without_errors(transverse, measured),
            variance=honest * measured.variance,
        )
        for source, measured, _ in poses
        if source is Source.CAMERA
    ]
    return prediction_error.compare_poses(state.monitor, now_ns, seen)


def _with_unit(
    tracker: Tracker, state: TrackerState, now_ns: int, view: ConveyorEstimate | None
) -> tuple[tuple[int, float], ...]:
    """Return the past positions of the conveyor unit, with that of now."""
    if view is None or state.contact:
        return ()
    count = math.ceil(UNITS_S / tracker.cycle_s)
    return (*state.units[-count:], (now_ns, view.position + view.offset))


def _unit_at(state: TrackerState, stamp_ns: int) -> float | None:
    """Return the position of the conveyor unit at a time [m], None if it is not known."""
    units = state.units
    i = bisect_right(units, (stamp_ns, math.inf))
    if not 0 < i < len(units):
        return None
    (before_ns, before), (after_ns, after) = units[i - 1], units[i]
    return before + (after - before) * (stamp_ns - before_ns) / (after_ns - before_ns)
