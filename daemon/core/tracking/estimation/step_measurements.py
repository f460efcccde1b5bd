"""Measurements of one step: poses by camera and force, distances, and parts along the conveyor."""

from msgspec.structs import replace

from linemate.daemon.core.tracking.across.transverse_state import TransverseState
from linemate.daemon.core.tracking.classifiers.distance import measured_noise
from linemate.daemon.core.tracking.classifiers.distance.measured_noise import MeasuredNoise
from linemate.daemon.core.tracking.conveyor import PositionMeasurement, Source
from linemate.daemon.core.tracking.observation import (
    History,
    PoseMeasurement,
    Wrench,
    date_error,
    mean_distances,
    measure_camera,
    measure_touch,
    motion_at,
    pose_at,
    rate_now,
)
from linemate.daemon.core.tracking.touch import bolt_search
from linemate.daemon.core.tracking.touch.bolt_search import BoltSearch
from linemate.daemon.core.tracking.tracker_state import StepSamples, Tracker, TrackerState
from linemate.protocol.stamped_samples import DistanceSample

MOTION_NS = 24_000_000  # over which the tcp's speed at an exposure is averaged [ns]


def pose_measurements(
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


def distance_rows(
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


def distance_measurement(
    tracker: Tracker, now_ns: int, sample: DistanceSample, count: int = 1
) -> PositionMeasurement:
    """Return (10)'s row: the sensor reads the start position as the object is at its origin.

    Args:
        count: readings whose mean the sample is.
    """
    noise = tracker.settings.distance
    way = noise.scale * (sample.position - tracker.task.conveyor.start_position)
    value = way + tracker.reference.origin[1]
    delay = (now_ns - sample.stamp_ns) * 1e-9 + noise.delay + noise.late
    variance = noise.deviation**2 / count
    return PositionMeasurement(Source.DISTANCE, float(value), delay, variance, noise.gate)


def along_measurement(
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
