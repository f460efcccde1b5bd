"""From recordings to parameters: the straight line through the rooms of ``identification``.

Law of this file: recorded steps and texts in, findings and an overlay out; no file is opened here.
All recordings must be of one cell. What is refused keeps its configured value and is said to.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from linemate.daemon.config import documents, task_file
from linemate.daemon.config.documents import FileError, YamlDocument
from linemate.daemon.core import rotations
from linemate.daemon.core.control import kinematics
from linemate.daemon.core.control.settings import ControlSettings
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.inputs import Inputs, MotionOrder
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.daemon.core.tracking.task import TaskFile
from linemate.daemon.identification import ring_down, scene, swing
from linemate.daemon.identification.camera import CameraResult, identify_camera
from linemate.daemon.identification.noise import NoiseResult, identify_noise
from linemate.daemon.identification.offset import OffsetResult, identify_offset
from linemate.daemon.identification.outcome import Estimate, Finding, Outcome
from linemate.daemon.identification.ring_down import ModeResult, identify_modes
from linemate.daemon.identification.servo import ServoResult, identify_servos
from linemate.daemon.identification.swing import SwingResult, identify_swings
from linemate.daemon.identification.tape import Tape, make_tape
from linemate.daemon.recording.step_codec import StepRecord
from linemate.protocol.samples import AXES

SIGNIFICANT = 4.0  # deviations by which a hand-eye pose must be off to be corrected
CLOSE = 0.01  # of cycle times that count as the same


class IdentifyError(ValueError):
    """Recordings that cannot be used; the message says which and why."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """One recording, read.

    Attributes:
        texts: of the cell: at least task and urdf.
    """

    name: str
    texts: Mapping[str, str]
    steps: Sequence[StepRecord]


@dataclass(frozen=True, slots=True)
class Identified:
    """What recordings tell.

    Attributes:
        findings: every line of the report, refusals among them.
        overlay: parameters as a configuration's sections, those that were identified.
        kept: paths in the overlay whose values had to be kept as configured.
    """

    findings: tuple[Finding, ...]
    overlay: dict[str, Any]
    kept: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Cell:
    task: TaskFile
    urdf: str
    tracking: TrackingSettings
    control: ControlSettings


@dataclass(frozen=True, slots=True)
class _Step:
    """A recorded step as a tape wants it."""

    ipoc: int | None
    inputs: Inputs
    command: tuple[float, ...]
    contact: bool
    limited: bool


def identify(recordings: Sequence[Recorded]) -> Identified:
    """Return what recordings tell.

    Raises:
        IdentifyError: a recording cannot be read, or they are not of one cell.
    """
    cell = _cell(recordings)
    tapes = _tapes(recordings, cell)
    place = cell.task.arm.camera_in_tcp
    camera = (np.array(place.position), rotations.matrix(place.quaternion))
    delay = cell.tracking.distance.delay
    per_tape = [scene.views(tape, camera, cell.tracking.camera, delay) for tape in tapes]
    bodies = [i for i, views in enumerate(per_tape) for _ in views]
    seen = [view for views in per_tape for view in views]
    labels = [
        f"{recorded.name}{', later' if i else ''}"
        for recorded, views in zip(recordings, per_tape, strict=True)
        for i in range(len(views))
    ]
    found = swing.look(seen, camera)
    servos = identify_servos(tapes)
    modes = identify_modes(tapes)
    swings = identify_swings(found, seen)
    vision = identify_camera(found, seen, [tape.images for tape in tapes])
    noise = identify_noise(tapes, found, seen, camera)
    origin = rotations.matrix(cell.task.object.nominal.quaternion).T @ np.array(
        cell.task.object.nominal.position
    )
    start = cell.task.conveyor.start_position
    offset = identify_offset(found, seen, bodies, start, float(origin[1]))
    overlay, kept = _overlay(cell, servos, modes, swings, vision, noise)
    findings = (
        *_servo_findings(servos),
        *_mode_findings(modes),
        *_swing_findings(swings),
        *_camera_findings(vision),
        *_noise_findings(noise, cell.tracking),
        *_offset_findings(offset, labels),
    )
    return Identified(findings, overlay, kept)


def _cell(recordings: Sequence[Recorded]) -> _Cell:
    if not recordings:
        raise IdentifyError("no recording")
    first = recordings[0]
    for other in recordings[1:]:
        if other.texts.get("urdf") != first.texts.get("urdf"):
            raise IdentifyError(f"{other.name}: another arm than in {first.name}")
    missing = [name for name in ("task", "urdf") if name not in first.texts]
    if missing:
        raise IdentifyError(f"{first.name}: the recording holds no {' and no '.join(missing)}")
    try:
        task = task_file.parse(first.texts["task"].encode(), f"{first.name}: task")
        tracking, control = _settings(first)
    except FileError as error:
        raise IdentifyError(str(error)) from error
    for other in recordings[1:]:
        theirs = _arm_of(other)
        if theirs != task.arm:
            raise IdentifyError(f"{other.name}: another tool or camera than in {first.name}")
    return _Cell(task, first.texts["urdf"], tracking, control)


def _arm_of(recorded: Recorded) -> Any:
    try:
        return task_file.parse(recorded.texts["task"].encode(), f"{recorded.name}: task").arm
    except (KeyError, FileError) as error:
        raise IdentifyError(f"{recorded.name}: {error}") from error


def _settings(recorded: Recorded) -> tuple[TrackingSettings, ControlSettings]:
    """Return the settings that a recording was made with; the defaults where it is silent."""
    name = f"{recorded.name}: config"
    document = documents.read(recorded.texts.get("config", "").encode(), name)
    value = document.value if isinstance(document.value, dict) else {}
    return (
        documents.fill(YamlDocument(name, value.get("tracking") or {}), TrackingSettings),
        documents.fill(YamlDocument(name, value.get("control") or {}), ControlSettings),
    )


def _tapes(recordings: Sequence[Recorded], cell: _Cell) -> list[Tape]:
    tool = cell.task.arm.tcp_in_flange
    nominal = rotations.matrix(cell.task.object.nominal.quaternion)
    try:
        arm = kinematics.load(
            cell.urdf,
            cell.task.arm.flange,
            np.array(tool.position),
            rotations.matrix(tool.quaternion),
            linear_axis=cell.task.arm.linear_axis,
        )
    except ValueError as error:
        raise IdentifyError(str(error)) from error
    tapes = []
    for recorded in recordings:
        steps = [
            _Step(
                s.ipoc,
                s.inputs,
                tuple(s.outputs["command"]),
                bool(s.outputs["contact"]),
                s.inputs.order is not MotionOrder.HOLD and s.outputs["held"] is not None,
            )
            for s in recorded.steps
        ]
        try:
            tapes.append(make_tape(steps, arm.tcp_in_base, nominal))
        except ValueError as error:
            raise IdentifyError(f"{recorded.name}: {error}") from error
    cycles = [tape.cycle_s for tape in tapes]
    if max(cycles) > (1.0 + CLOSE) * min(cycles):
        raise IdentifyError("the recordings were made at different cycle times")
    return tapes


# --- the overlay --------------------------------------------------------------------------


def _overlay(
    cell: _Cell,
    servos: Sequence[ServoResult],
    modes: Sequence[ModeResult],
    swings: Sequence[SwingResult],
    vision: CameraResult,
    noise: NoiseResult,
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return the sections of an overlay, and the paths that had to be kept as configured."""
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
    told = [result.mode for result in swings if result.mode is not None]
    if told:
        tracking["swing"] = [_plain(mode) for mode in told]
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
        )
        if isinstance(outcome, Estimate) and outcome.value > 0.0
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
    """Return the corrected place of the camera if it is significantly off, in what is told."""
    place = cell.task.arm.camera_in_tcp
    shift, turn = _corrections(vision.position), _corrections(vision.rotation)
    if not (shift.any() or turn.any()):
        return None
    rotation = rotations.matrix(place.quaternion) @ rotations.exp(turn)
    return {
        "position": [_digits(v) for v in (np.array(place.position) + shift).tolist()],
        "quaternion": [round(v, 12) for v in rotations.quaternion(rotation)],
    }


def _corrections(outcomes: Sequence[Outcome]) -> Array:
    """Return what is to be added: all that is told, if any of it is significant."""
    told = [outcome if isinstance(outcome, Estimate) else None for outcome in outcomes]
    if not any(e is not None and abs(e.value) > SIGNIFICANT * e.deviation for e in told):
        return np.zeros(3)
    return np.array([0.0 if e is None else e.value for e in told])


def _plain(value: Any) -> dict[str, Any]:
    """Return a settings dataclass as an overlay has it."""
    return {
        name: [_digits(v) for v in part] if isinstance(part, tuple) else _digits(part)
        for name, part in asdict(value).items()
    }


def _digits(value: Any) -> Any:
    """Return a number with as many digits as can matter."""
    return float(f"{value:.6g}") if isinstance(value, float) else value


# --- the report ---------------------------------------------------------------------------


def _servo_findings(servos: Sequence[ServoResult]) -> list[Finding]:
    lines = []
    for result in servos:
        name, told = f"servo {AXES[result.axis]}", result.model is not None
        lines += [Finding(f"{name} frequency", "Hz", 1.0, result.frequency_hz, told)]
        if told:
            lines += [
                Finding(f"{name} damping", "", 1.0, result.damping, told),
                Finding(f"{name} dead time", "ms", 1e3, result.dead_time, told),
            ]
    return lines


def _mode_findings(modes: Sequence[ModeResult]) -> list[Finding]:
    lines = []
    for result in modes:
        name, told = f"effector {ring_down.AXES[result.axis]}", result.mode is not None
        lines += [Finding(f"{name} frequency", "Hz", 1.0, result.frequency_hz, told)]
        if told:
            lines += [Finding(f"{name} damping", "", 1.0, result.damping, told)]
    return lines


def _swing_findings(swings: Sequence[SwingResult]) -> list[Finding]:
    lines = []
    for i, result in enumerate(swings):
        name, told = f"swing {i + 1}", result.mode is not None
        lines += [Finding(f"{name} frequency", "Hz", 1.0, result.frequency_hz, told)]
        if isinstance(result.frequency_hz, Estimate):
            axis = "" if result.mode is None else f" off {'xyz'[result.mode.axis]}"
            lines += [
                Finding(f"{name} damping", "", 1.0, result.damping, told),
                Finding(f"{name} axis{axis}", "deg", math.degrees(1.0), result.oblique, told),
            ]
            lines += [
                Finding(f"{name} lever {axis_}", "m/rad", 1.0, lever, told)
                for axis_, lever in zip("xyz", result.levers, strict=True)
            ]
    return lines


def _camera_findings(vision: CameraResult) -> list[Finding]:
    return [
        *(
            Finding(f"hand-eye {axis}", "mm", 1e3, outcome)
            for axis, outcome in zip("xyz", vision.position, strict=True)
        ),
        *(
            Finding(f"hand-eye r{axis}", "mrad", 1e3, outcome)
            for axis, outcome in zip("xyz", vision.rotation, strict=True)
        ),
        Finding("camera stamp error", "ms", 1e3, vision.stamp_error),
        Finding("camera latency (spread)", "ms", 1e3, vision.latency),
        Finding("camera period (spread)", "ms", 1e3, vision.period),
    ]


def _noise_findings(noise: NoiseResult, settings: TrackingSettings) -> list[Finding]:
    soft = 1e3 / _mean(settings.tactile.stiffness)
    turn = 1e3 / _mean(settings.tactile.rotational_stiffness)
    return [
        Finding("distance noise", "mm", 1e3, noise.distance, told=True),
        Finding("distance resolution", "mm", 1e3, noise.resolution),
        Finding("distance outliers", "%", 1e2, noise.distance_outliers),
        Finding("camera noise at 0 m", "mm", 1e3, noise.lateral, told=True),
        Finding("camera noise slope", "mm/m", 1e3, noise.lateral_slope, told=True),
        Finding("camera depth factor", "", 1.0, noise.depth_factor, told=True),
        Finding("camera angle noise at 0 m", "mrad", 1e3, noise.angle, told=True),
        Finding("camera angle noise slope", "mrad/m", 1e3, noise.angle_slope, told=True),
        Finding("camera error over stated", "", 1.0, noise.honesty),
        Finding("camera outliers", "%", 1e2, noise.camera_outliers),
        Finding("force noise", "mm", soft, noise.force, told=True),
        Finding("torque noise", "mrad", turn, noise.torque, told=True),
    ]


def _offset_findings(offset: OffsetResult, labels: Sequence[str]) -> list[Finding]:
    lines = [
        Finding(f"distance offset x10, {label}", "mm", 1e3, outcome)
        for label, outcome in zip(labels or ("all",), offset.recordings, strict=True)
    ]
    return [*lines, Finding("distance offset of the sensor", "mm", 1e3, offset.sensor)]
