"""Estimation of the object in one step: predict and correct, along and across the conveyor."""

import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.across.body_sway import NO_SWAY
from linemate.daemon.core.tracking.across.transverse_state import TransverseState
from linemate.daemon.core.tracking.classifiers import stop_input
from linemate.daemon.core.tracking.classifiers.classifier_bank import BankClassifier
from linemate.daemon.core.tracking.classifiers.distance import measured_noise
from linemate.daemon.core.tracking.classifiers.distance.measured_noise import MeasuredNoise
from linemate.daemon.core.tracking.conveyor import (
    ConveyorEstimate,
    Motion,
    PositionMeasurement,
    Source,
    has_changed_class,
)
from linemate.daemon.core.tracking.go_no_go import prediction_error
from linemate.daemon.core.tracking.go_no_go.prediction_error import PredictionMonitor
from linemate.daemon.core.tracking.merge import ALONG
from linemate.daemon.core.tracking.observation import (
    History,
    PoseMeasurement,
    Wrench,
    date_error,
    mean_distances,
    mean_wrench,
    measure_camera,
    measure_touch,
    motion_at,
    pose_at,
    rate_now,
    remember,
)
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.touch import (
    bolt_search,
    compliance,
    force_sign,
    held_bolts,
    release,
    tare,
    touch_proof,
)
from linemate.daemon.core.tracking.touch.bolt_search import BoltSearch
from linemate.daemon.core.tracking.tracker_state import StepSamples, Tracker, TrackerState
from linemate.protocol.stamped_samples import DistanceSample, Vector3

UNITS_S = 0.35  # for which positions of the conveyor unit are remembered [s]
MOTION_NS = 24_000_000  # over which the tcp's speed at an exposure is averaged [ns]
FIRST_READINGS = 4  # readings of the distance sensor that start the classifier
FIRST_SPREAD = 0.015  # largest range of these readings: none is an outlier [m]
# The offset of the compliance follows across; the screws turn the object by a milliradian at once.
_SLOWER = np.array((4.0, 4.0, 4.0, 0.0625, 0.0625, 0.0625))
_TRANSLATIONS = np.array((4.0, 4.0, 4.0, 0.0, 0.0, 0.0))
_ROTATIONS = np.array((0.0, 0.0, 0.0, 1.0, 1.0, 1.0))
# Variance of what a contact that can slide shows across the tool's axis and about it: nothing.
_SLIDES = np.array((1.0, 1.0, 0.0, 0.0, 0.0, 1.0))
# Times the sigma of a deflection that follows an oscillation which it drives.
DRIVEN_INFLATION = 6.0
WRENCH_S = 0.05  # a wrench may be so old; health excludes an older one [s]
SEATING_S = 0.012  # a clamp closes in 0.04 s; contact is detected 0.03 s after it or later [s]
NO_FORCE = (0.0, 0.0, 0.0)
UNHELD = (0.0, 0.0)  # bolts in their holes have shown nothing yet
HELD_GATE = 5.0  # of a place that bolts in their holes show [sigma]
CLEAR_WAY = 0.05  # way from the object at which a released tool has cleared it [m]
BLIND_S = 0.06  # without a distance for longer than this the object is not seen [s]


def estimate(
    tracker: Tracker, state: TrackerState, samples: StepSamples
) -> tuple[TrackerState, ConveyorEstimate | None, int, Wrench | None]:
    """Return the state one step later, the conveyor, the number of rejected poses, the wrench."""
    history = state.history
    if samples.tcp is not None:
        history = remember(history, samples.tcp_stamp_ns, samples.tcp, tracker.history_length)
    transverse = state.transverse
    if transverse is not None:
        seating = state.fixing is not None and Gate.SCREWS_FIXED not in state.passed
        transverse = tracker.transverse.predict(
            transverse,
            tracker.cycle_s,
            seating=seating,
            speed=state.speed,
            unit=state.unit,
            swayed=state.sway.way,
        )
    state = _announced(tracker, state, samples)
    raw = mean_wrench(samples.wrench)
    state = _accelerated(tracker, state, raw, samples)
    state = _weighed(tracker, state, raw)
    wrench = tare.tared(state.tare, raw, tracker.settings.tactile)
    pull, pull_power = _pulled(tracker, state, wrench)
    state = _with_sign(tracker, state, wrench)
    felt = wrench if is_force_used(tracker, state, wrench) else None
    felt = tare.bending(state.tare, felt, tracker.settings.tactile)
    first_poses = _pose_measurements(tracker, history, samples, felt, state.bolts)
    rows, distance_noise = _distance_rows(tracker, state, samples)
    oscillation = compliance.uncertainty(state.compliance, tracker.compliance)
    seen, waiting, rejected, pose_ns = _see(
        tracker, state, transverse, first_poses, rows, oscillation, samples.stamp_ns
    )
    leaning = _leaning(tracker, state, wrench)
    transverse = _correct_held(tracker, state, seen, history, samples, wrench, leaning, rows)
    engaged = _engaged(tracker, state, seen, history, samples, wrench)
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
        pose_ns=pose_ns,
        blind_s=0.0 if samples.distance else state.blind_s + tracker.cycle_s,
        speed=0.0 if view is None else view.speed,
        unit=None if view is None else view.unit,
        sway=sway,
        held=_held(tracker, state, seen, transverse),
        leaning=leaning,
        units=_with_unit(tracker, state, samples.stamp_ns, view),
        distance_noise=distance_noise,
    )
    return state, view, rejected, wrench


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
        if transverse is None:
            waiting = (*waiting, measured)[-tracker.settings.fusion.initial_images :]
            if len(waiting) == tracker.settings.fusion.initial_images:
                transverse = tracker.transverse.initial(list(waiting))
        else:
            is_camera = source is Source.CAMERA
            across = measured if is_camera else _yielding(tracker, state, measured, oscillation)
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
        row = _along_measurement(tracker, transverse, source, measured, gate)
        rows.append(row if source is Source.CAMERA else _felt_row(tracker, state, row, oscillation))
    return transverse, waiting, rejected, pose_ns


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


def _pulled(tracker: Tracker, state: TrackerState, wrench: Wrench | None) -> tuple[Vector3, float]:
    """Return the mean force [N] and its mean square [N^2] on a tool that may be clamped."""
    if not state.contact and state.releasing is None:
        return state.pull, state.pull_power
    pull = release.averaged(state.pull, wrench, tracker.cycle_s)
    return pull, release.averaged_square(state.pull_power, wrench, tracker.cycle_s)


def _announced(tracker: Tracker, state: TrackerState, samples: StepSamples) -> TrackerState:
    """Return the state with a stop that the line announces in this step."""
    settings = tracker.task.conveyor.stop_input
    if settings.bit is None or samples.tcp is None:
        return state
    age = stop_input.edge_age(
        settings, state.announced_s + tracker.cycle_s, state.digital_in, samples.digital_in
    )
    return replace(state, digital_in=samples.digital_in, announced_s=age)


def _weighed(tracker: Tracker, state: TrackerState, raw: Wrench | None) -> TrackerState:
    """Return the state with its tare: taken in the approach, kept in contact, then dropped.

    Args:
        raw: wrench of the sensor.
    """
    if Gate.WHEEL_RELEASED in state.passed:
        is_clear = state.distance < -CLEAR_WAY
        later = tare.released(state.tare, raw, tracker.cycle_s, is_clear=is_clear)
        return state if later is state.tare else replace(state, tare=later)
    if state.contact and _is_unloading(tracker, state):
        delay = tracker.compliance.delays[0] * tracker.cycle_s
        later = tare.unloaded(state.tare, tracker.settings.tactile, tracker.cycle_s, delay)
        return state if later is state.tare else replace(state, tare=later)
    near = tare.frozen_within(tracker.task.guard.clearance, tracker.settings.payload.bolts)
    is_free = state.started and not state.contact and -math.inf < state.distance < -near
    if raw is None or not is_free or state.withdrawn is not None or state.stood > 0.0:
        return state
    down, settings = gravity(tracker, state.poses[0]), tracker.settings
    # The force that brakes the tool on its way is no weight.
    inertia = tracker.vibration.mass * state.acceleration[2]
    still = replace(raw, force=raw.force + np.array((0.0, 0.0, inertia)))
    nominal = gravity(tracker, np.zeros(6))
    later = tare.updated(
        state.tare, still, down, nominal, settings.payload, settings.tactile, tracker.cycle_s
    )
    return replace(state, tare=later)


def gravity(tracker: Tracker, pose: Array) -> Vector3:
    """Return the unit vector of gravity in a tcp (6,) in c: it is along -z of base."""
    a, b, c, d, e, f, g, h, i = rotations.exp_rows(*pose[3:].tolist())
    x, y, z = tracker.reference.axes[2]
    return (-a * x - d * y - g * z, -b * x - e * y - h * z, -c * x - f * y - i * z)


def carried_weights(tracker: Tracker, state: TrackerState) -> tuple[Vector3, ...]:
    """Return the weights that the sensor may state without a contact, in the tcp [N].

    Before the tare it is not known whether it was zeroed with the payload on.
    """
    weight = tracker.settings.payload.mass * tare.GRAVITY
    known = tare.carried(state.tare, tracker.settings.tactile)
    if state.tare.wrench is not None or state.tare.empty is not None or weight == 0.0:
        return (known,)
    x, y, z = gravity(tracker, state.poses[0])
    return known, (weight * x, weight * y, weight * z)


def _is_unloading(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether the object takes weight over: a known one as soon as it is screwed on."""
    if state.tare.part is None:
        return release.is_held_by_hub(tracker.reference.gated, state.passed, state.time)
    is_fixed = Gate.SCREWS_FIXED in state.passed and state.fixing is not None
    return state.tare.unloading is not None or (is_fixed and not state.force_sign.is_suspect)


def _accelerated(
    tracker: Tracker, state: TrackerState, raw: Wrench | None, samples: StepSamples
) -> TrackerState:
    """Return the state with the samples of the wrench, and the tool's acceleration at its time.

    The wrench is older than the step: by its transfer, and by half a cycle of samples. A plan of
    the step itself would be ahead of the force that accelerates the tool.
    """
    count = math.ceil(WRENCH_S / tracker.cycle_s) + 1
    planned = (*state.accelerations, planned_acceleration(tracker, state.poses))[-count:]
    if raw is None:
        return replace(state, accelerations=planned, sampled=())
    late = (samples.stamp_ns - raw.stamp_ns) * 1e-9 / tracker.cycle_s
    mean = float(raw.force[2])
    sampled = tuple([each.force[2] - mean for each in samples.wrench])
    x, y, z = (at_delay(values, late) for values in zip(*planned, strict=True))
    return replace(state, accelerations=planned, acceleration=(x, y, z), sampled=sampled)


def at_delay(values: Sequence[float], late: float) -> float:
    """Return a value some steps ago, between two of them linearly.

    Args:
        values: one a step, newest last.
        late: steps; one beyond the oldest value gives the oldest.
    """
    late = min(max(late, 0.0), len(values) - 1.0)
    whole = int(late)
    newer, older = values[-1 - whole], values[max(-2 - whole, -len(values))]
    return newer + (late - whole) * (older - newer)


def planned_acceleration(tracker: Tracker, poses: Array) -> Vector3:
    """Return the acceleration in the tool's axes at the second of some poses [m/s^2]."""
    (a, b, c, *_), (x, y, z, *turned), (d, e, f, *_) = poses[:3].tolist()
    r, s, t, u, v, w, i, j, k = rotations.exp_rows(*turned)
    square = tracker.cycle_s**2
    dx, dy, dz = a - 2.0 * x + d, b - 2.0 * y + e, c - 2.0 * z + f
    return (
        (r * dx + u * dy + i * dz) / square,
        (s * dx + v * dy + j * dz) / square,
        (t * dx + w * dy + k * dz) / square,
    )


def elastic(state: TrackerState, pose: Array) -> Array:
    """Return the elastic tcp (6,) of a rigid one that hangs still."""
    sag = tare.mounted(state.tare)
    if sag is None:
        return pose
    x, y, z, *at = pose.tolist()
    dx, dy, dz, *bend = sag.tolist()
    a, b, c, d, e, f, g, h, i = rotations.exp_rows(*at)
    place = x + a * dx + b * dy + c * dz, y + d * dx + e * dy + f * dz, z + g * dx + h * dy + i * dz
    turned = rotations.multiply(rotations.exp_quaternion(*at), rotations.exp_quaternion(*bend))
    return np.array((*place, *rotations.log_quaternion(turned).tolist()))


def sagging(state: TrackerState, target: Array) -> Array:
    """Return the target (m, 6) of the rigid tcp for one of the elastic tcp.

    Args:
        target: (m, 6), stays as it is.
    """
    sag = tare.commanded(state.tare)
    if sag is None:
        return target
    back = -sag
    vectors, arms = rotations.turned_many(target[:, 3:], back[3:], back[:3])
    rigid = np.empty_like(target)
    np.add(target[:, :3], arms, out=rigid[:, :3])
    rigid[:, 3:] = vectors
    return rigid


def _felt_row(
    tracker: Tracker, state: TrackerState, row: PositionMeasurement, more: float
) -> PositionMeasurement:
    """Return a deflection along the conveyor with what is known of the object in contact.

    Args:
        more: variance that an oscillation adds [m^2].
    """
    complied = state.compliance
    return replace(
        row,
        variance=_inflation(state) * row.variance + more,
        is_firm=complied.is_firm,
        complied=complied.offset[ALONG],
        pushed=held_bolts.pushed(state.leaning, state.poses[0], ALONG)
        if any(state.leaning)
        else 0.0,
        ringing=compliance.ringing(complied, tracker.compliance),
    )


def _inflation(state: TrackerState) -> float:
    """Return the factor of a deflection's variance: large in a contact that drives its object."""
    return DRIVEN_INFLATION**2 if state.compliance.driven else 1.0


def _yielding(
    tracker: Tracker, state: TrackerState, measured: PoseMeasurement, oscillation: float
) -> PoseMeasurement:
    """Return a deflection as the filter across the conveyor takes it: slowly.

    A target that followed it at once would drive a body that gives way. What the offset of the
    compliance has taken up is no error of the estimate: else the target moved by it twice.

    Args:
        oscillation: variance that it adds to a deflection [m^2].
    """
    position = measured.position - np.array(state.compliance.offset)
    slides = 0.0 if tracker.settings.tactile.holds else _SLIDES
    if state.compliance.is_firm:
        return replace(measured, position=position, variance=measured.variance + slides)
    factor = tracker.settings.tactile.compliance**2
    slower = _inflation(state) * _SLOWER
    # The torque swings with the force: it would turn the target, which drove the swing.
    share = oscillation / float(measured.variance[:3].mean())
    turned = share * _ROTATIONS * measured.variance
    variance = factor * (slower * measured.variance + _TRANSLATIONS * oscillation + turned)
    return replace(measured, position=position, variance=variance + slides)


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


def distance_measurement(
    tracker: Tracker, now_ns: int, sample: DistanceSample, count: int = 1
) -> PositionMeasurement:
    """Return (10)'s row: the sensor reads the start position as the object is at its origin.

    Args:
        count: readings whose mean the sample is.
    """
    noise = tracker.settings.distance
    value = sample.position - tracker.task.conveyor.start_position + tracker.reference.origin[1]
    delay = (now_ns - sample.stamp_ns) * 1e-9 + noise.delay
    variance = noise.deviation**2 / count
    return PositionMeasurement(Source.DISTANCE, float(value), delay, variance, noise.gate)


def _distance_rows(
    tracker: Tracker, state: TrackerState, samples: StepSamples
) -> tuple[list[PositionMeasurement], MeasuredNoise]:
    """Return the distance sensor's rows with the variance that is believed, and their noise."""
    rows = [
        distance_measurement(tracker, samples.stamp_ns, *block)
        for block in mean_distances(samples.distance)
    ]
    noise = measured_noise.update(state.distance_noise, rows, tracker.cycle_s)
    if noise.inflation > 1.0:
        rows = [replace(row, variance=noise.inflation * row.variance) for row in rows]
    return rows, noise


def _shown(tracker: Tracker, rows: list[PositionMeasurement]) -> list[PositionMeasurement]:
    """Return what shows the object along the conveyor: no deflection of a contact that slides."""
    if tracker.settings.tactile.holds:
        return rows
    return [row for row in rows if row.source is not Source.TACTILE]


def _along_measurement(
    tracker: Tracker,
    transverse: TransverseState | None,
    source: Source,
    measured: PoseMeasurement,
    gate: float,
) -> PositionMeasurement:
    """Return a pose's component along the conveyor, without the swing."""
    if transverse is not None:
        measured = tracker.transverse.without_errors(transverse, measured)
    value, variance = float(measured.position[1]), float(measured.variance[1])
    if transverse is not None:
        if source is Source.CAMERA:
            variance *= transverse.inflation
        angles = tracker.transverse.swing_now(transverse, measured.delay)
        for mode, angle in zip(tracker.transverse.swing, angles, strict=True):
            value -= mode.levers[1] * angle
    return PositionMeasurement(source, value, measured.delay, variance, gate)


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
    is_closed = is_closed or state.touching < release.PULL_S
    return state.contact and (is_closed or is_pulling(tracker, state))


def is_pulling(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether the mean force on the tool is one that only a closed clamp gives."""
    pulling = release.PULLING * tracker.settings.tactile.contact_force
    return math.hypot(*state.pull) > pulling


def _with_sign(tracker: Tracker, state: TrackerState, wrench: Wrench | None) -> TrackerState:
    """Return the state with what a force on the clamped tool says of its sign."""
    if wrench is None or not is_seated(tracker, state) or state.history is None:
        return state
    axis = rotations.exp(state.history.poses[-1][3:])[:, 2]
    # The compliance begins where the tool touched: that is no advance of the target.
    begun = state.compliance.press is not None
    offset = float(axis @ state.compliance.offset) if begun else None
    before, force = state.force_sign, float(wrench.force[2])
    sign = force_sign.advanced(before, force, offset, tracker.settings.tactile.contact_force)
    if sign.is_suspect and state.releasing is None and state.touching > force_sign.SEATED_S:
        sign = force_sign.tested(sign, force, tracker.cycle_s)
    if sign == before:
        return state
    way = sign.way - before.way if sign.is_suspect else 0.0
    x, y, z = (way * axis).tolist()
    return replace(
        state, force_sign=sign, compliance=compliance.shifted(state.compliance, (x, y, z))
    )


def _is_overload(tracker: Tracker, wrench: Wrench | None) -> bool:
    """Return whether a force is beyond the tool's limit: then it does not measure the object.

    A wrong sensor would move the object by 10 mm for 500 N, and the clamped tool would follow.
    """
    limit = tracker.settings.tactile.overload_force
    return wrench is not None and math.hypot(*wrench.force.tolist()) > limit


def is_seated(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether a closing clamp has drawn the tool in.

    Before that the mount is bent by the tool's offset from the object: the force does not measure
    the object. Its change would be detected as a stop, a start or an impulse. A tool that touches
    blind waits a cycle less: only the force shows that the object stops.
    """
    sooner = tracker.cycle_s if state.blind_s > BLIND_S else 0.0
    return state.contact and state.touching >= SEATING_S - sooner


def _correct_held(
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
        rows.append(_along_measurement(tracker, transverse, Source.CAMERA, held, HELD_GATE))
    return transverse


def _bent(
    tracker: Tracker, state: TrackerState, history: History | None, wrench: Wrench | None
) -> tuple[Array, Array] | None:
    """Return the tcp (6,) at a wrench, and the force (3,) that bends its mount [N]; or None."""
    bending = tare.bending(state.tare, wrench, tracker.settings.tactile)
    if history is None or wrench is None or bending is None:
        return None
    tcp = pose_at(history, wrench.stamp_ns, 2.5 * tracker.cycle_s)
    return None if tcp is None else (tcp, bending.force)


def _engaged(
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
    return _along_measurement(tracker, transverse, Source.TACTILE, held, HELD_GATE)


def _held(
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


def _leaning(tracker: Tracker, state: TrackerState, wrench: Wrench | None) -> Vector3:
    """Return the mean force of bolts in their holes [N], nothing where there are none."""
    if state.contact:
        return state.leaning  # with which the tool touched
    if not held_bolts.is_entered(tracker.settings.payload, state.distance):
        return NO_FORCE
    if wrench is None:
        return state.leaning
    return held_bolts.averaged(state.leaning, wrench.force, tracker.cycle_s)


def _pose_measurements(
    tracker: Tracker,
    history: History | None,
    samples: StepSamples,
    wrench: Wrench | None,
    bolts: BoltSearch,
) -> list[tuple[Source, PoseMeasurement, float]]:
    """Return the pose measurements of the camera and of the force-torque sensor.

    Args:
        wrench: of the clamped tool; None if it does not measure the object.
        bolts: by which the tool is turned against the object.
    """
    measurements: list[tuple[Source, PoseMeasurement, float]] = []
    if history is None or not (samples.camera or wrench is not None):
        return measurements
    settings, rate = tracker.settings, rate_now(history)
    for sample in samples.camera:
        tcp = pose_at(history, sample.exposure_ns, tracker.cycle_s)
        delay = (samples.stamp_ns - sample.exposure_ns) * 1e-9
        if tcp is not None and delay <= settings.camera.longest_delay:
            motion = motion_at(history, sample.exposure_ns, MOTION_NS)
            measured = measure_camera(
                sample, tcp, tracker.camera, settings.camera, samples.stamp_ns, rate, motion
            )
            measurements.append((Source.CAMERA, measured, settings.camera.gate))
    if wrench is not None:
        tcp = pose_at(history, wrench.stamp_ns, 2.5 * tracker.cycle_s)
        if tcp is not None:
            off_s = date_error(history, tracker.cycle_s)
            measured = measure_touch(wrench, tcp, settings.tactile, samples.stamp_ns, rate, off_s)
            if bolts.tried:
                rotation = bolt_search.unturned(measured.rotation, bolts)
                measured = replace(measured, rotation=rotation)
            measurements.append((Source.TACTILE, measured, settings.tactile.gate))
    return measurements
