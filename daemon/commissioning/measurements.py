"""Measurements of the steps: recordings in, figures and an overlay out.

Invariants:
- Pure. A refused figure has its reason, and nothing of it is in the overlay.
- Angles and lengths are in the overlay as the task file has them.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from linemate.daemon.commissioning import camera_mount, dry_run, sensor_mount
from linemate.daemon.commissioning.camera_mount import CameraMount
from linemate.daemon.commissioning.conveyor_frame import SCALE_ERROR, ConveyorFrame, find_frame
from linemate.daemon.commissioning.link_figures import find_links
from linemate.daemon.commissioning.motion.axis_signs import find_signs
from linemate.daemon.commissioning.object_place import ObjectPlace, find_place
from linemate.daemon.commissioning.postures import StandingPosture, distinct, find_postures
from linemate.daemon.commissioning.recorded_cell import CellError, RecordedCell, read_cell
from linemate.daemon.commissioning.sensor_mount import SensorMount
from linemate.daemon.commissioning.walk import StepName
from linemate.daemon.config import documents
from linemate.daemon.config.documents import FileError, YamlDocument
from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.inputs import Inputs
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.daemon.core.tracking.task import PoseFile
from linemate.daemon.identification import conveyor_ramps, pipeline
from linemate.daemon.identification.noise import distance_noise
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal, ReportLine
from linemate.daemon.identification.pipeline import IdentifyError, Recorded
from linemate.daemon.identification.trace import Trace, TraceStep, build_trace
from linemate.protocol.stamped_samples import Vector3

LEAST_STOPS = 3
SERVO_LINES = ("servo ", "windup ", "effector ", "force noise", "torque noise")
OBJECT_LINES = ("swing ", "sway", "camera noise", "camera angle", "camera depth", "camera outliers")


@dataclass(frozen=True, slots=True)
class Measurement:
    """Result of a step.

    Attributes:
        overlay: sections of a configuration.
        refused: why the step has no result, None if it has one.
    """

    lines: tuple[ReportLine, ...]
    overlay: Mapping[str, Any] = field(default_factory=dict)
    refused: str | None = None


@dataclass(frozen=True, slots=True)
class StatedFacts:
    """What the engineer states.

    Attributes:
        sensor_place: of the force-torque sensor in the tcp [m]; None: as configured.
        sensors: configured sensors, None: all.
    """

    sensor_place: Vector3 | None = None
    sensors: tuple[str, ...] = ("distance", "camera", "force_torque")


@dataclass(frozen=True, slots=True, eq=False)
class _Data:
    recordings: Sequence[Recorded]
    cell: RecordedCell
    tracking: TrackingSettings
    watch: WatchSettings

    def inputs(self, recorded: Recorded) -> list[Inputs]:
        return [step.inputs for step in recorded.steps]

    def postures(self, recorded: Recorded) -> list[StandingPosture]:
        arm = self.cell.arm
        return find_postures(self.inputs(recorded), arm.tcp_in_base, arm.axes)

    def all_postures(self) -> list[StandingPosture]:
        return distinct([p for recorded in self.recordings for p in self.postures(recorded)])


def measure(
    name: StepName, recordings: Sequence[Recorded], options: StatedFacts = StatedFacts()
) -> Measurement:
    """Return what recordings say for a step.

    Raises:
        CellError: the recordings do not describe their cell, or not the same one.
    """
    return _MEASURES[name](_read(recordings), options)


def _read(recordings: Sequence[Recorded]) -> _Data:
    if not recordings:
        raise CellError("no recording")
    first = recordings[0]
    for other in recordings[1:]:
        for text in ("task", "urdf"):
            if other.texts.get(text) != first.texts.get(text):
                raise CellError(f"{other.name}: another {text} than in {first.name}")
    cell = read_cell(first.texts, first.name)
    try:
        document = documents.read(first.texts.get("config", "").encode(), f"{first.name}: config")
        value = document.value if isinstance(document.value, dict) else {}
        tracking = documents.fill(
            YamlDocument(document.name, value.get("tracking") or {}), TrackingSettings
        )
        watch = documents.fill(YamlDocument(document.name, value.get("watch") or {}), WatchSettings)
    except FileError as error:
        raise CellError(str(error)) from error
    return _Data(recordings, cell, tracking, watch)


def _links(data: _Data, options: StatedFacts) -> Measurement:
    lines = [
        line
        for recorded in data.recordings
        for line in find_links(data.inputs(recorded), data.watch, options.sensors)
    ]
    refused = [f"{x.name}: {x.outcome.reason}" for x in lines if isinstance(x.outcome, Refusal)]
    return Measurement(tuple(lines), {}, "; ".join(refused) or None)


def _signs(data: _Data, _: StatedFacts) -> Measurement:
    steps = [step for recorded in data.recordings for step in recorded.steps]
    lines = find_signs(steps)
    refused = [x.outcome.reason for x in lines if isinstance(x.outcome, Refusal)]
    return Measurement(tuple(lines), {}, "; ".join(refused) or None)


def _camera(data: _Data, _: StatedFacts) -> Measurement:
    arm = data.cell.arm
    mount = camera_mount.find_mount(data.all_postures(), arm.tcp_in_base)
    if isinstance(mount, Refusal):
        line = ReportLine("camera in the tcp", "mm", 1e3, mount)
        return Measurement((line, *_frames(data)), {}, mount.reason)
    delay = camera_mount.stamp_error(
        [data.inputs(recorded) for recorded in data.recordings], mount, arm.tcp_in_base, arm.axes
    )
    lines = [*_mount_lines(mount, data.cell.task.arm.camera_in_tcp), *_frames(data)]
    lines.append(ReportLine("camera stamp error", "ms", 1e3, delay))
    place = _pose(mount.position, mount.rotation)
    return Measurement(tuple(lines), {"task": {"arm": {"camera_in_tcp": place}}})


def _mount_lines(mount: CameraMount, configured: PoseFile) -> list[ReportLine]:
    basis = f"{mount.used} of {mount.given} postures, second axis {mount.turn:.2f} rad"
    lines = [
        ReportLine(f"camera {axis}", "mm", 1e3, Estimate(float(value), float(sigma), basis), True)
        for axis, value, sigma in zip("xyz", mount.position, mount.deviations[:3], strict=True)
    ]
    off = rotations.log(rotations.matrix(configured.quaternion).T @ mount.rotation)
    shift = mount.position - np.array(configured.position)
    vector = rotations.log(mount.rotation)
    lines += [
        ReportLine(
            f"camera r{axis}", "mrad", 1e3, Estimate(float(value), float(sigma), basis), True
        )
        for axis, value, sigma in zip("xyz", vector, mount.deviations[3:], strict=True)
    ]
    where, angle = mount.misfit
    worst = np.abs(mount.residuals).max(axis=0)
    basis = (
        f"largest {1e3 * float(worst[:3].max()):.2f} mm, {1e3 * float(worst[3:].max()):.2f} mrad"
    )
    lines += [
        ReportLine("camera off its configured place", "mm", 1e3, _norm(shift)),
        ReportLine("camera off its configured turn", "deg", math.degrees(1.0), _norm(off)),
        ReportLine("postures residual", "mm", 1e3, Estimate(where, 0.0, basis)),
        ReportLine("postures residual turn", "mrad", 1e3, Estimate(angle, 0.0, basis)),
    ]
    return lines


def _norm(vector: Array) -> Outcome:
    return Estimate(float(np.linalg.norm(vector)), 0.0, "length of the difference")


def _frames(data: _Data) -> list[ReportLine]:
    """Return the names that the camera states, one line each."""
    names: dict[tuple[str, str, str], int] = {}
    for recorded in data.recordings:
        for each in data.inputs(recorded):
            for image in each.camera:
                key = (image.source, image.frame, image.object_id)
                names[key] = names.get(key, 0) + 1
    return [
        ReportLine(
            f"camera source {source}, frame {frame}, object {seen}",
            "images",
            1.0,
            Estimate(float(count), 0.0, "as the sender names them"),
        )
        for (source, frame, seen), count in names.items()
    ]


def _force(data: _Data, options: StatedFacts) -> Measurement:
    mount = sensor_mount.find_sensor(data.all_postures())
    if isinstance(mount, Refusal):
        return Measurement((ReportLine("sensor in the tcp", "mrad", 1e3, mount),), {}, mount.reason)
    configured = data.cell.task.arm.sensor_in_tcp
    place = configured.position if options.sensor_place is None else options.sensor_place
    arm: dict[str, Any] = {"sensor_in_tcp": _pose(np.array(place), mount.rotation)}
    arm["sensor_sign"] = mount.sign
    lines = _sensor_lines(mount, np.array(place), stated=options.sensor_place is not None)
    off = rotations.log(rotations.matrix(configured.quaternion).T @ mount.rotation)
    lines.append(ReportLine("sensor off its configured turn", "deg", math.degrees(1.0), _norm(off)))
    centre = np.array(place) + mount.rotation @ mount.centre
    payload = {
        "mass": float(f"{mount.mass:.6g}"),
        "centre": [float(f"{value:.6g}") for value in centre.tolist()],
    }
    overlay = {"tracking": {"payload": payload}, "task": {"arm": arm}}
    return Measurement(tuple(lines), overlay)


def _sensor_lines(mount: SensorMount, place: Array, *, stated: bool) -> list[ReportLine]:
    basis = f"{mount.postures} postures, residual {mount.misfit[0]:.2f} N, {mount.misfit[1]:.3f} Nm"
    d = mount.deviations.tolist()
    turn = rotations.log(mount.rotation)
    in_tcp = place + mount.rotation @ mount.centre
    values: list[tuple[str, str, float, Sequence[float], Sequence[float], bool]] = [
        ("sensor r", "mrad", 1e3, turn.tolist(), d[:3], True),
        ("centre of gravity in the sensor ", "mm", 1e3, mount.centre.tolist(), d[4:7], False),
        ("centre of gravity in the tcp ", "mm", 1e3, in_tcp.tolist(), d[4:7], True),
        ("force bias ", "N", 1.0, mount.force_bias.tolist(), d[7:10], False),
        ("torque bias ", "Nm", 1.0, mount.torque_bias.tolist(), d[10:], False),
    ]
    lines = [
        ReportLine(f"{name}{axis}", unit, scale, Estimate(value, sigma, basis), kept)
        for name, unit, scale, vector, sigmas, kept in values
        for axis, value, sigma in zip("xyz", vector, sigmas, strict=True)
    ]
    lines.insert(3, ReportLine("sensor sign", "", 1.0, Estimate(mount.sign, 0.0, basis), True))
    lines.insert(4, ReportLine("payload mass", "kg", 1.0, Estimate(mount.mass, d[3], basis), True))
    origin = "as stated" if stated else "as configured: postures do not show it"
    where = Estimate(float(np.linalg.norm(place)), 0.0, origin)
    return [*lines, ReportLine("sensor distance from the tcp", "mm", 1e3, where, True)]


def _conveyor(data: _Data, _stated: StatedFacts) -> Measurement:
    task, delay = data.cell.task, data.tracking.distance.delay
    outcomes = [
        find_frame(
            data.inputs(recorded),
            data.postures(recorded),
            task.arm.camera_in_tcp,
            task.conveyor.axis,
            delay,
        )
        for recorded in data.recordings
    ]
    frames = [outcome for outcome in outcomes if isinstance(outcome, ConveyorFrame)]
    reasons = [outcome.reason for outcome in outcomes if isinstance(outcome, Refusal)]
    ramps = _ramps(data, delay)
    if not frames:
        line = ReportLine("conveyor direction", "mrad", 1e3, Refusal(reasons[0]))
        return Measurement((line, *ramps), {}, reasons[0])
    frame = min(frames, key=lambda each: each.deviation)
    settings: dict[str, Any] = {"axis": [round(part, 9) for part in frame.axis.tolist()]}
    lines = [*_conveyor_lines(frame, np.array(task.conveyor.axis)), *ramps]
    wrong = abs(frame.scale - 1.0) > max(SCALE_ERROR, 4.0 * frame.scale_deviation)
    refused = None
    if wrong:
        refused = (
            f"the object travels {frame.scale:.4f} m for 1 m of the distance sensor, limit "
            f"+-{SCALE_ERROR:.3f}. Multiply distance.step_m by {frame.scale:.4f} and record again"
        )
    elif frame.speed > 0.001:
        settings["nominal_speed"] = round(frame.speed, 5)
    for line in ramps:
        key = {"conveyor stop deceleration": "deceleration",
               "conveyor start acceleration": "acceleration"}.get(line.name)  # fmt: skip
        if key is not None and line.in_overlay and isinstance(line.outcome, Estimate):
            settings[key] = round(line.outcome.value, 5)
    overlay: dict[str, Any] = {} if refused else {"task": {"conveyor": settings}}
    noise, _, _ = distance_noise([_trace(data, each).distances for each in data.recordings])
    lines.append(ReportLine("distance noise", "mm", 1e3, noise, in_overlay=True))
    if overlay and isinstance(noise, Estimate):
        overlay["tracking"] = {"distance": {"deviation": float(f"{noise.value:.6g}")}}
    return Measurement(tuple(lines), overlay, refused)


def _conveyor_lines(frame: ConveyorFrame, configured: Array) -> list[ReportLine]:
    basis = f"{frame.images} images over {frame.way:.2f} m, {1e3 * frame.residual:.1f} mm off it"
    turn = float(np.arccos(min(float(frame.axis @ configured), 1.0)))
    lines = [
        ReportLine(
            f"conveyor direction {axis}", "", 1.0, Estimate(value, frame.deviation, basis), True
        )
        for axis, value in zip("xyz", frame.axis.tolist(), strict=True)
    ]
    return [
        *lines,
        ReportLine(
            "conveyor off its configured direction",
            "mrad",
            1e3,
            Estimate(turn, frame.deviation, basis),
        ),
        ReportLine(
            "distance sensor scale", "", 1.0, Estimate(frame.scale, frame.scale_deviation, basis)
        ),
        ReportLine(
            "conveyor speed", "m/s", 1.0, Estimate(frame.speed, 0.0, "the running conveyor"), True
        ),
        ReportLine(
            "conveyor ripple",
            "mm/s",
            1e3,
            Estimate(frame.ripple, 0.0, "at most: the sensor's noise is in it"),
        ),
    ]


def _ramps(data: _Data, delay: float) -> list[ReportLine]:
    """Return the lines of stops and starts; those of enough stops are for the overlay."""
    traces = [_trace(data, recorded) for recorded in data.recordings]
    stops = starts = 0
    for trace in traces:
        moved = conveyor_ramps.motion(trace, delay)
        for ramp in () if moved is None else conveyor_ramps.find_ramps(moved):
            starts += ramp.starts
            stops += not ramp.starts
    if stops < LEAST_STOPS:
        reason = f"{stops} stops recorded, at least {LEAST_STOPS} are needed for the ramps"
        return [ReportLine("conveyor stop deceleration", "m/s^2", 1.0, Refusal(reason))]
    findings = conveyor_ramps.findings(conveyor_ramps.identify_ramps(traces, delay))
    names = [line.name for line in findings]
    return [
        ReportLine(line.name, line.unit, line.scale, line.outcome, names.count(line.name) == 1)
        if line.name.endswith("eleration")
        else line
        for line in findings
    ]


def _trace(data: _Data, recorded: Recorded) -> Trace:
    steps = [
        TraceStep(
            step.counter,
            step.inputs,
            tuple(step.outputs["command"]),
            bool(step.outputs["contact"]),
            limited=False,
        )
        for step in recorded.steps
    ]
    nominal = rotations.matrix(data.cell.task.object.nominal.quaternion)
    try:
        return build_trace(steps, data.cell.arm.tcp_in_base, nominal)
    except ValueError as error:
        raise CellError(f"{recorded.name}: {error}") from error


def _servos(data: _Data, _: StatedFacts) -> Measurement:
    return _identified(data, SERVO_LINES, _servo_overlay)


def _servo_overlay(overlay: Mapping[str, Any]) -> dict[str, Any]:
    tracking = overlay.get("tracking", {})
    return {
        **({"tracking": _only(tracking, "tactile")} if "tactile" in tracking else {}),
        **_only(overlay, "control"),
    }


def _object(data: _Data, _: StatedFacts) -> Measurement:
    """Return what swings, and where the objects hang; a step without the one has the other."""
    task = data.cell.task
    postures = [data.postures(recorded) for recorded in data.recordings]
    place = find_place(postures, task.arm.camera_in_tcp, task.object.nominal)
    identified = _identified(data, OBJECT_LINES, _object_overlay)
    lines = (*identified.lines, *_place_lines(place))
    if isinstance(place, Refusal):
        return Measurement(lines, identified.overlay, identified.refused)
    nominal = {"object": {"nominal": _pose(place.position, place.rotation)}}
    return Measurement(lines, {**identified.overlay, "task": nominal})


def _place_lines(place: ObjectPlace | Refusal) -> list[ReportLine]:
    if isinstance(place, Refusal):
        return [ReportLine("object off its nominal place", "mm", 1e3, place)]
    basis = f"mean of {place.objects} objects, one deviates by"
    rows = zip(("x", "z", "rx", "ry", "rz"), place.off, place.deviation, place.spread, strict=True)
    return [
        ReportLine(
            f"object off its nominal {axis}",
            "mrad" if axis.startswith("r") else "mm",
            1e3,
            Estimate(float(value), float(sigma), f"{basis} {1e3 * float(spread):.2f}"),
            axis in ("x", "z", "ry"),
        )
        for axis, value, sigma, spread in rows
    ]


def _object_overlay(overlay: Mapping[str, Any]) -> dict[str, Any]:
    tracking = overlay.get("tracking", {})
    sections = {name: tracking[name] for name in ("swing", "sway", "camera") if name in tracking}
    return {"tracking": sections} if sections else {}


def _only(overlay: Mapping[str, Any], section: str) -> dict[str, Any]:
    return {section: overlay[section]} if section in overlay else {}


def _identified(
    data: _Data, names: tuple[str, ...], kept: Callable[[Mapping[str, Any]], dict[str, Any]]
) -> Measurement:
    """Return the part of ``linemate identify`` that a step asks for."""
    try:
        identified = pipeline.identify(data.recordings)
    except IdentifyError as error:
        raise CellError(str(error)) from error
    lines = tuple(line for line in identified.findings if line.name.startswith(names))
    if any(isinstance(line.outcome, Estimate) for line in lines):
        return Measurement(lines, kept(identified.overlay))
    reason = "no value could be identified"
    refusals = [line.outcome.reason for line in lines if isinstance(line.outcome, Refusal)]
    return Measurement(lines, {}, f"{reason}: {refusals[0]}" if refusals else reason)


def _dry_run(data: _Data, _: StatedFacts) -> Measurement:
    lines = dry_run.find_errors([recorded.steps for recorded in data.recordings], data.cell)
    refused = [x.outcome.reason for x in lines if isinstance(x.outcome, Refusal)]
    return Measurement(tuple(lines), {}, refused[0] if refused else None)


def _pose(position: Array, rotation: Array) -> dict[str, Any]:
    """Return a pose as the task file has it."""
    return {
        "position": [float(f"{value:.6g}") for value in position.tolist()],
        "quaternion": [round(value, 12) for value in rotations.quaternion(rotation)],
    }


_MEASURES: dict[StepName, Callable[[_Data, StatedFacts], Measurement]] = {
    StepName.LINKS: _links,
    StepName.SIGNS: _signs,
    StepName.FORCE: _force,
    StepName.CAMERA: _camera,
    StepName.CONVEYOR: _conveyor,
    StepName.SERVOS: _servos,
    StepName.OBJECT: _object,
    StepName.DRY_RUN: _dry_run,
}
"""Steps that rest on recordings."""
