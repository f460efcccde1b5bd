"""Identification pipeline: recorded steps and texts in, report lines and an overlay out.

Invariants:
- No file is opened. All recordings must be of one cell.
- A refused parameter keeps its configured value and has a line in the report.
"""

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from linemate.daemon.config import documents, task_file
from linemate.daemon.config.documents import FileError, YamlDocument
from linemate.daemon.core import rotations, wrench_frame
from linemate.daemon.core.control import kinematics
from linemate.daemon.core.control.settings import AxisGeometry, ControlSettings
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.inputs import MotionOrder
from linemate.daemon.core.tracking.settings import SwingMode, TrackingSettings
from linemate.daemon.core.tracking.task import TaskFile
from linemate.daemon.identification import (
    conveyor_ramps,
    ring_down,
    scene_fit,
    sway,
    sway_across,
    swing,
)
from linemate.daemon.identification.arm_windup import ArmWindup, bent_trace, identify_arm_windup
from linemate.daemon.identification.hand_eye import CameraResult, corrections, identify_camera
from linemate.daemon.identification.noise import NoiseResult, identify_noise
from linemate.daemon.identification.offset import OffsetResult, identify_offset
from linemate.daemon.identification.outcome import Estimate, Refusal, ReportLine
from linemate.daemon.identification.ring_down import ModeResult, identify_modes
from linemate.daemon.identification.scene_fit import Views
from linemate.daemon.identification.servo_models import ServoResult, identify_servos
from linemate.daemon.identification.swing import SwingResult, identify_swings
from linemate.daemon.identification.trace import Trace, TraceStep, build_trace
from linemate.daemon.recording.step_codec import StepRecord
from linemate.protocol.stamped_samples import AXES

MOST_UNFIT = 20  # rounds in which values that do not fit are left out
SAME_CYCLE = 0.01  # largest difference of cycle times that count as the same


class IdentifyError(ValueError):
    """Recordings that cannot be used; the message says which and why."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """One recording.

    Attributes:
        texts: of the cell: at least task and urdf.
    """

    name: str
    texts: Mapping[str, str]
    steps: Sequence[StepRecord]


@dataclass(frozen=True, slots=True)
class Identified:
    """Result of an identification.

    Attributes:
        findings: every line of the report, with refusals.
        overlay: identified parameters, as sections of a configuration.
        kept: paths in the overlay whose values stay as configured.
    """

    findings: tuple[ReportLine, ...]
    overlay: dict[str, Any]
    kept: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Cell:
    task: TaskFile
    urdf: str
    geometry: tuple[AxisGeometry, ...]
    tracking: TrackingSettings
    control: ControlSettings


def identify(recordings: Sequence[Recorded]) -> Identified:
    """Identify parameters from recordings.

    Raises:
        IdentifyError: a recording cannot be read, or they are not of one cell.
    """
    cell = _cell(recordings)
    arm = _arm(cell)
    traces = _traces(recordings, cell, arm)
    place = cell.task.arm.camera_in_tcp
    camera = (np.array(place.position), rotations.matrix(place.quaternion))

    def views_of(trace: Trace) -> list[Views]:
        return scene_fit.views(trace, camera, cell.tracking.camera, cell.tracking.distance.delay)

    # Without its windup an arm makes a scene of false swings and a false hand-eye pose.
    nominal = _nominal(cell)
    windup = identify_arm_windup(traces, views_of, camera, arm.tcp_in_base, nominal)
    traces = [bent_trace(trace, windup.axes, arm.tcp_in_base, nominal) for trace in traces]
    per_trace = [views_of(trace) for trace in traces]
    bodies = [i for i, views in enumerate(per_trace) for _ in views]
    seen = [view for views in per_trace for view in views]
    labels = [
        f"{recorded.name}{', later' if i else ''}"
        for recorded, views in zip(recordings, per_trace, strict=True)
        for i in range(len(views))
    ]
    fit = swing.find_swings(seen, camera)
    servos = identify_servos(traces, [recorded.name for recorded in recordings])
    modes = identify_modes(traces)
    swings = identify_swings(fit, seen)
    vision = identify_camera(fit, seen, [trace.images for trace in traces])
    noise = identify_noise(traces, fit, seen, camera)
    origin = rotations.matrix(cell.task.object.nominal.quaternion).T @ np.array(
        cell.task.object.nominal.position
    )
    start = cell.task.conveyor.start_position
    offset = identify_offset(fit, seen, bodies, start, float(origin[1]))
    delay = cell.tracking.distance.delay
    swayed = sway.identify_sway(
        fit, seen, bodies, traces, camera, delay, cell.tracking.sway.range_hz[0]
    )
    overlay, kept = _overlay(cell, servos, modes, swings, vision, noise)
    identified = [result.mode for result in swings if result.mode is not None]
    # A sway across the line that was identified before is replaced, not added to.
    free = tuple(mode for mode in identified or cell.tracking.swing if not mode.gain)
    known = replace(cell.tracking, swing=free)
    across = sway_across.identify_across(seen, bodies, traces, camera, known)
    _add_sections(overlay, swayed, (*free, *across) if across else (), servos, windup)
    findings = (
        *_servo_findings(servos),
        *_windup_findings(windup),
        *_mode_findings(modes),
        *_swing_findings(swings),
        *sway.findings(swayed),
        *sway_across.across_findings(across),
        *conveyor_ramps.findings(conveyor_ramps.identify_ramps(traces, delay)),
        *_camera_findings(vision),
        *_noise_findings(noise, cell.tracking),
        *_offset_findings(offset, labels),
    )
    overlay, unfit = fitting(overlay)
    findings = (*_without(findings, unfit), *unfit.values())
    return Identified(findings, overlay, (*kept, *unfit))


def _add_sections(
    overlay: dict[str, Any],
    swayed: sway.SwayResult,
    swinging: Sequence[SwingMode],
    servos: Sequence[ServoResult],
    windup: ArmWindup,
) -> None:
    """Add what is written as a whole section: sway, swings, friction and windup."""
    tracking: dict[str, Any] = {}
    control: dict[str, Any] = {}
    if swayed.settings:
        tracking["sway"] = {name: _digits(value) for name, value in swayed.settings.items()}
    if swinging:
        tracking["swing"] = [_plain(mode) for mode in swinging]
    if any(result.friction.level for result in servos):
        control["friction"] = [_plain(result.friction) for result in servos]
    if windup.axes:
        control["windup"] = [_plain(axis) for axis in windup.axes]
    for name, values in (("tracking", tracking), ("control", control)):
        if values:
            overlay.setdefault(name, {}).update(values)


def fitting(overlay: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, ReportLine]]:
    """Return an overlay without the values that a configuration refuses.

    Returns:
        The rest, and a refusal for each value left out, by its path.
    """
    kept = copy.deepcopy(dict(overlay))
    unfit: dict[str, ReportLine] = {}
    for section, kind in (("tracking", TrackingSettings), ("control", ControlSettings)):
        for _ in range(MOST_UNFIT):
            try:
                documents.fill(YamlDocument(section, kept.get(section, {})), kind)
                break
            except FileError as error:
                for line in error.lines:
                    path, _, what = line.split(": ", 1)[1].partition(": ")
                    name = f"{section}.{path}"
                    if not _remove(kept[section], path):
                        raise IdentifyError(f"{name}: {what}") from error
                    reason = f"{what}; it stays as configured"
                    unfit[name] = ReportLine(name, "", 1.0, Refusal(reason))
        if section in kept and not kept[section]:
            del kept[section]
    return kept, unfit


def _remove(tree: dict[str, Any], path: str) -> bool:
    """Remove the value at a path, the whole list if it is in one; return whether it was there."""
    parts = path.partition("[")[0].split(".")
    branches = [tree]
    for part in parts[:-1]:
        below = branches[-1].get(part)
        if not isinstance(below, dict):
            return False
        branches.append(below)
    if branches[-1].pop(parts[-1], None) is None:
        return False
    if len(branches) > 1 and not branches[-1]:
        branches[-2].pop(parts[-2])
    return True


def _without(
    findings: Sequence[ReportLine], unfit: Mapping[str, ReportLine]
) -> tuple[ReportLine, ...]:
    """Return report lines of which none claims to be in the overlay that is left out of it."""
    names = {_LINES.get(path, path) for path in unfit}
    return tuple(
        replace(line, in_overlay=False) if line.name in names else line for line in findings
    )


_LINES = {
    "tracking.distance.deviation": "distance noise",
    "tracking.camera.lateral": "camera noise at 0 m",
    "tracking.camera.lateral_slope": "camera noise slope",
    "tracking.camera.depth_factor": "camera depth factor",
    "tracking.camera.angle": "camera angle noise at 0 m",
    "tracking.camera.angle_slope": "camera angle noise slope",
    "tracking.tactile.deflection": "force noise",
    "tracking.tactile.angle": "torque noise",
}
"""Lines of the report by the path of their value."""


def _cell(recordings: Sequence[Recorded]) -> _Cell:
    if not recordings:
        raise IdentifyError("no recording")
    first = recordings[0]
    for other in recordings[1:]:
        if any(other.texts.get(text) != first.texts.get(text) for text in ("urdf", "geometry")):
            raise IdentifyError(f"{other.name}: another arm than in {first.name}")
    missing = [name for name in ("task", "urdf") if name not in first.texts]
    if missing:
        raise IdentifyError(f"{first.name}: the recording holds no {' and no '.join(missing)}")
    try:
        task = task_file.parse(first.texts["task"].encode(), f"{first.name}: task")
        geometry = task_file.geometry_of(first.texts, first.name)
        tracking, control = _settings(first)
    except FileError as error:
        raise IdentifyError(str(error)) from error
    for other in recordings[1:]:
        theirs = _arm_of(other)
        if theirs != task.arm:
            raise IdentifyError(f"{other.name}: another tool or camera than in {first.name}")
    for earlier, other in combinations(recordings, 2):
        if _is_same(earlier, other):
            raise IdentifyError(
                f"{other.name}: its steps are in {earlier.name} too. Leave one out."
            )
    return _Cell(task, first.texts["urdf"], geometry, tracking, control)


def _is_same(earlier: Recorded, other: Recorded) -> bool:
    """Return whether two recordings share their steps, whose noise would count as less."""
    theirs = {(step.inputs.k, step.inputs.stamp_ns): step.inputs for step in earlier.steps}
    ours = {(step.inputs.k, step.inputs.stamp_ns): step.inputs for step in other.steps}
    shared = theirs.keys() & ours.keys()
    return bool(shared) and all(theirs[step] == ours[step] for step in shared)


def _arm_of(recorded: Recorded) -> Any:
    try:
        return task_file.parse(recorded.texts["task"].encode(), f"{recorded.name}: task").arm
    except (KeyError, FileError) as error:
        raise IdentifyError(f"{recorded.name}: {error}") from error


def _settings(recorded: Recorded) -> tuple[TrackingSettings, ControlSettings]:
    """Return the settings of a recording, or defaults where it has none."""
    name = f"{recorded.name}: config"
    document = documents.read(recorded.texts.get("config", "").encode(), name)
    value = document.value if isinstance(document.value, dict) else {}
    return (
        documents.fill(YamlDocument(name, value.get("tracking") or {}), TrackingSettings),
        documents.fill(YamlDocument(name, value.get("control") or {}), ControlSettings),
    )


def _nominal(cell: _Cell) -> Array:
    return rotations.matrix(cell.task.object.nominal.quaternion)


def _arm(cell: _Cell) -> kinematics.Arm:
    tool = cell.task.arm.tcp_in_flange
    try:
        return kinematics.load(
            cell.urdf,
            cell.task.arm.flange,
            np.array(tool.position),
            rotations.matrix(tool.quaternion),
            linear_axis=cell.task.arm.linear_axis,
            geometry=cell.geometry,
        )
    except ValueError as error:
        raise IdentifyError(str(error)) from error


def _traces(recordings: Sequence[Recorded], cell: _Cell, arm: kinematics.Arm) -> list[Trace]:
    nominal, traces = _nominal(cell), []
    frame = wrench_frame.of_arm(cell.task.arm)
    for recorded in recordings:
        steps = [
            TraceStep(
                s.counter,
                s.inputs,
                tuple(s.outputs["command"]),
                bool(s.outputs["contact"]),
                s.inputs.order is not MotionOrder.HOLD and s.outputs["held"] is not None,
            )
            for s in recorded.steps
        ]
        try:
            traces.append(build_trace(steps, arm.tcp_in_base, nominal, frame))
        except ValueError as error:
            raise IdentifyError(f"{recorded.name}: {error}") from error
    cycles = [trace.cycle_s for trace in traces]
    if max(cycles) > (1.0 + SAME_CYCLE) * min(cycles):
        raise IdentifyError("the recordings were made at different cycle times")
    return traces


def _overlay(
    cell: _Cell,
    servos: Sequence[ServoResult],
    modes: Sequence[ModeResult],
    swings: Sequence[SwingResult],
    vision: CameraResult,
    noise: NoiseResult,
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return the sections of an overlay, and the paths that stay as configured."""
    kept: list[str] = []
    control: dict[str, Any] = {}
    if any(result.model for result in servos):
        models = list(cell.control.servos)
        for result in servos:
            if result.model is not None:
                models[result.axis] = result.model
            else:
                kept.append(f"control.servos.{result.axis}")
        control["servos"] = [_plain(model) for model in models]
    if any(result.mode for result in modes):
        effector = list(cell.control.effector)
        for mode in modes:
            if mode.mode is not None:
                effector[mode.axis] = mode.mode
            else:
                kept.append(f"control.effector.{mode.axis}")
        control["effector"] = [_plain(mode) for mode in effector]
    tracking = _noise_overlay(cell.tracking, noise)
    swing_modes = [result.mode for result in swings if result.mode is not None]
    if swing_modes:
        tracking["swing"] = [_plain(mode) for mode in swing_modes]
    overlay: dict[str, Any] = {}
    if tracking:
        overlay["tracking"] = tracking
    if control:
        overlay["control"] = control
    place = _hand_eye(cell, vision)
    if place is not None:
        overlay["task"] = {"arm": {"camera_in_tcp": place}}
    return overlay, tuple(kept)


def _noise_overlay(settings: TrackingSettings, noise: NoiseResult) -> dict[str, Any]:
    tracking: dict[str, Any] = {}
    if isinstance(noise.distance, Estimate):
        tracking["distance"] = {"deviation": _digits(noise.distance.value)}
    camera = {
        name: _digits(outcome.value)
        for name, outcome in (
            ("lateral", noise.lateral),
            ("lateral_slope", noise.lateral_slope),
            ("depth_factor", noise.depth_factor),
            ("angle", noise.angle),
            ("angle_slope", noise.angle_slope),
            ("lasting", noise.lasting),
            ("lasting_s", noise.lasting_s),
        )
        if isinstance(outcome, Estimate) and (outcome.value > 0.0 or name == "lasting")
    }
    if camera:
        tracking["camera"] = camera
    tactile = {}
    if isinstance(noise.force, Estimate):
        tactile["deflection"] = _digits(noise.force.value / _mean(settings.tactile.stiffness))
    if isinstance(noise.torque, Estimate):
        turn = noise.torque.value / _mean(settings.tactile.rotational_stiffness)
        tactile["angle"] = _digits(turn)
    if tactile:
        tracking["tactile"] = tactile
    return tracking


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def _hand_eye(cell: _Cell, vision: CameraResult) -> dict[str, Any] | None:
    """Return the corrected camera pose if an estimate is significantly off, else None."""
    place = cell.task.arm.camera_in_tcp
    shift, turn = corrections(vision.position), corrections(vision.rotation)
    if not (shift.any() or turn.any()):
        return None
    rotation = rotations.matrix(place.quaternion) @ rotations.exp(turn)
    return {
        "position": [_digits(v) for v in (np.array(place.position) + shift).tolist()],
        "quaternion": [round(v, 12) for v in rotations.quaternion(rotation)],
    }


def _plain(value: Any) -> dict[str, Any]:
    """Return a settings dataclass as plain values of an overlay."""
    return {
        name: [_digits(v) for v in part] if isinstance(part, tuple) else _digits(part)
        for name, part in asdict(value).items()
    }


def _digits(value: Any) -> Any:
    """Return a number rounded to six digits."""
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _servo_findings(servos: Sequence[ServoResult]) -> list[ReportLine]:
    lines = []
    for result in servos:
        name, in_overlay = f"servo {AXES[result.axis]}", result.model is not None
        lines += [ReportLine(f"{name} frequency", "Hz", 1.0, result.frequency_hz, in_overlay)]
        if in_overlay:
            lines += [
                ReportLine(f"{name} damping", "", 1.0, result.damping, in_overlay),
                ReportLine(f"{name} dead time", "ms", 1e3, result.dead_time, in_overlay),
            ]
        rubs = result.friction.level > 0.0
        unit = "mm" if result.axis == 6 else "mrad"
        lines += [ReportLine(f"friction {AXES[result.axis]}", unit, 1e3, result.level, rubs)]
    return lines


def _windup_findings(windup: ArmWindup) -> list[ReportLine]:
    return [
        ReportLine(
            f"windup {AXES[axis]}",
            "mrad",
            1e3,
            outcome,
            axis < len(windup.axes) and windup.axes[axis].depth > 0.0,
        )
        for axis, outcome in enumerate(windup.depths)
    ]


def _mode_findings(modes: Sequence[ModeResult]) -> list[ReportLine]:
    lines = []
    for result in modes:
        name, in_overlay = f"effector {ring_down.AXES[result.axis]}", result.mode is not None
        lines += [ReportLine(f"{name} frequency", "Hz", 1.0, result.frequency_hz, in_overlay)]
        if in_overlay:
            lines += [ReportLine(f"{name} damping", "", 1.0, result.damping, in_overlay)]
    return lines


def _swing_findings(swings: Sequence[SwingResult]) -> list[ReportLine]:
    lines = []
    for i, result in enumerate(swings):
        name, in_overlay = f"swing {i + 1}", result.mode is not None
        lines += [ReportLine(f"{name} frequency", "Hz", 1.0, result.frequency_hz, in_overlay)]
        if isinstance(result.frequency_hz, Estimate):
            axis = "" if result.mode is None else f" off {'xyz'[result.mode.axis]}"
            lines += [
                ReportLine(f"{name} damping", "", 1.0, result.damping, in_overlay),
                ReportLine(
                    f"{name} axis{axis}", "deg", math.degrees(1.0), result.oblique, in_overlay
                ),
            ]
            lines += [
                ReportLine(f"{name} lever {axis_}", "m/rad", 1.0, lever, in_overlay)
                for axis_, lever in zip("xyz", result.levers, strict=True)
            ]
    return lines


def _camera_findings(vision: CameraResult) -> list[ReportLine]:
    return [
        *(
            ReportLine(f"hand-eye {axis}", "mm", 1e3, outcome)
            for axis, outcome in zip("xyz", vision.position, strict=True)
        ),
        *(
            ReportLine(f"hand-eye r{axis}", "mrad", 1e3, outcome)
            for axis, outcome in zip("xyz", vision.rotation, strict=True)
        ),
        ReportLine("camera stamp error", "ms", 1e3, vision.stamp_error),
        ReportLine("camera latency (spread)", "ms", 1e3, vision.latency),
        ReportLine("camera period (spread)", "ms", 1e3, vision.period),
    ]


def _noise_findings(noise: NoiseResult, settings: TrackingSettings) -> list[ReportLine]:
    soft = 1e3 / _mean(settings.tactile.stiffness)
    turn = 1e3 / _mean(settings.tactile.rotational_stiffness)
    return [
        ReportLine("distance noise", "mm", 1e3, noise.distance, in_overlay=True),
        ReportLine("distance resolution", "mm", 1e3, noise.resolution),
        ReportLine("distance outliers", "%", 1e2, noise.distance_outliers),
        ReportLine("camera noise at 0 m", "mm", 1e3, noise.lateral, in_overlay=True),
        ReportLine("camera noise slope", "mm/m", 1e3, noise.lateral_slope, in_overlay=True),
        ReportLine("camera depth factor", "", 1.0, noise.depth_factor, in_overlay=True),
        ReportLine("camera angle noise at 0 m", "mrad", 1e3, noise.angle, in_overlay=True),
        ReportLine("camera angle noise slope", "mrad/m", 1e3, noise.angle_slope, in_overlay=True),
        ReportLine("camera noise that lasts", "", 1.0, noise.lasting, in_overlay=True),
        ReportLine("time that it lasts", "s", 1.0, noise.lasting_s, in_overlay=True),
        ReportLine("camera error over stated", "", 1.0, noise.honesty),
        ReportLine("camera outliers", "%", 1e2, noise.camera_outliers),
        ReportLine("force noise", "mm", soft, noise.force, in_overlay=True),
        ReportLine("torque noise", "mrad", turn, noise.torque, in_overlay=True),
    ]


def _offset_findings(offset: OffsetResult, labels: Sequence[str]) -> list[ReportLine]:
    lines = [
        ReportLine(f"distance offset x10, {label}", "mm", 1e3, outcome)
        for label, outcome in zip(labels or ("all",), offset.recordings, strict=True)
    ]
    return [*lines, ReportLine("distance offset of the sensor", "mm", 1e3, offset.sensor)]
