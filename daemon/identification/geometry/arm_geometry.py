"""Geometry of the arm from measured poses of the tcp: where its axes are, against the URDF.

Maximum a posteriori least squares of small twists, six an axis, about the frames of the URDF:

    tcp = B M_1 D_1 R_1(q_1) ... M_6 D_6 R_6(q_6) T E,    q = motor - c g(motor)

M: placements of the URDF, D: ``control.geometry``, T: ``tcp_in_flange``, B: error of the measuring
system's frame against base, E: error of the target's mount against the tcp. What a turn or a slide
of one axis explains is left to that axis: the next frame has no turn and no shift in its direction
(the next of two parallel axes no shift across both). Weak priors separate the rest.

Invariants:
- The bend under weight (``control.bend``) is taken off first.
- Rows of one pose, approached from several sides, count as their mean, which has no windup.
- B and E are estimated within what a survey leaves of them. They are reported and not written.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from linemate.daemon.core import rotations
from linemate.daemon.core.control import gravity_bend, kinematics
from linemate.daemon.core.control.settings import (
    LARGEST_SHIFT,
    LARGEST_TURN,
    AxisGeometry,
    ControlSettings,
)
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.task import TaskFile
from linemate.daemon.identification.geometry.measured_poses import MeasuredPoses
from linemate.daemon.identification.outcome import Estimate, ReportLine

AXES = 6
LEAST_POSES = 20
LEAST_RANGE = 0.1  # that the poses turn each axis [rad]
SAME_POSE = 1e-3  # largest difference of joints of rows that are one pose [rad], [m]
LARGEST_RESIDUAL = 0.5e-3  # of the positions after the fit, rms [m]
OUTLIER = 5.0  # largest residual, as a multiple of the usual one
LEAST_OUTLIER = 0.1e-3  # smaller residuals are none [m], [rad]
PARALLEL = 0.1  # smallest angle of consecutive axes that are not parallel [rad]
LEAST_LEVER = 0.01  # smallest distance of parallel axes that are not one line [m]
STAYS = 1e-7  # deviation of values that stay 0 [m], [rad]
ZERO, TWIST, LENGTH = 0.5e-3, 0.3e-3, 0.5e-3  # priors [rad], [rad], [m]
FRAME = (0.05e-3, 0.02e-3)  # of the measuring system's frame in base [m], [rad]
TARGET = (0.05e-3, 0.1e-3)  # of the target's mount on the tool [m], [rad]
OFF_PRIOR = 4.0  # largest value of these two, as a multiple of what both are known to
UNKNOWN = 20.0  # times their priors: nothing is known of them
NOISE = (0.3e-3, 0.3e-3)  # first guess of the residuals [m], [rad]
LEAST_NOISE = (0.01e-3, 0.02e-3)
DECIMALS = 9  # of the overlay's values
STEP = 1e-5  # of the numeric derivatives [m], [rad]
PRIOR_SHARE = 0.9  # of a prior's deviation that is left of a value that no pose shows
ROUNDS = 4
FOLDS = 5
BEFORE, AFTER = "tcp error, URDF", "tcp error, poses held back"


class GeometryError(ValueError):
    """Poses that do not give the geometry of the arm; the message says why."""


@dataclass(frozen=True, slots=True)
class MeasuredArm:
    """The arm whose poses were measured.

    Attributes:
        control: for the bend under weight.
    """

    task: TaskFile
    urdf: str
    control: ControlSettings

    def load(self, geometry: Sequence[AxisGeometry] = ()) -> kinematics.Arm:
        """Return the arm with a geometry.

        Raises:
            ValueError: the URDF does not describe the task's arm.
        """
        tool = self.task.arm.tcp_in_flange
        return kinematics.load(
            self.urdf,
            self.task.arm.flange,
            np.array(tool.position),
            rotations.matrix(tool.quaternion),
            linear_axis=self.task.arm.linear_axis,
            loads=self.control.bend.loads,
            geometry=geometry,
        )


@dataclass(frozen=True, slots=True)
class ArmGeometry:
    """Result of an identification.

    Attributes:
        axes: measured frames of A1..A6.
        findings: lines of the report.
    """

    axes: tuple[AxisGeometry, ...]
    findings: tuple[ReportLine, ...]

    @property
    def overlay(self) -> dict[str, Any]:
        """The geometry as an overlay of a configuration."""
        rows = [
            {
                name: [round(part, DECIMALS) for part in value]
                for name, value in asdict(axis).items()
            }
            for axis in self.axes
        ]
        return {"control": {"geometry": rows}}


@dataclass(frozen=True, slots=True, eq=False)
class _GeometryFit:
    """Values (48,) with their deviations, and the residuals (n, 3 or 6) that they leave."""

    values: Array
    deviations: Array
    residuals: Array


def identify_geometry(measured: MeasuredArm, poses: MeasuredPoses) -> ArmGeometry:
    """Return the geometry of an arm from measured poses.

    Raises:
        GeometryError: the poses are too few, do not turn an axis, contradict each other, or show
            no geometry that is nearer to them than the URDF.
        ValueError: the URDF does not describe the task's arm.
    """
    rows = len(poses.lines)
    poses, lines = _merged(poses)
    _check_poses(poses)
    problem = _Problem(measured, poses)
    count = problem.count
    _check_mounting(problem)
    whole = problem.fit(range(count))
    _check_residuals(whole.residuals, lines)
    _check_arm(whole.values)
    held = np.empty_like(whole.residuals)
    for fold in range(FOLDS):
        others = problem.fit([i for i in range(count) if i % FOLDS != fold])
        held[fold::FOLDS] = problem.residuals(others.values)[fold::FOLDS]
    before = problem.residuals(np.zeros(problem.unknowns))
    if _rms(held) >= _rms(before):
        raise GeometryError(
            f"no geometry is nearer to the poses than the URDF's: {1e3 * _rms(held):.2f} mm on "
            f"poses held back, {1e3 * _rms(before):.2f} mm without a correction. "
            "Measure more poses, or none at all."
        )
    basis = f"{rows} rows of {count} poses"
    errors = (_error_line(BEFORE, before), _error_line(AFTER, held))
    return ArmGeometry(_axes(whole.values), (*errors, *_findings(problem, whole, basis)))


def _merged(poses: MeasuredPoses) -> tuple[MeasuredPoses, list[str]]:
    """Return the mean of rows in a row that are one pose, and the lines of each pose."""
    groups: list[list[int]] = []
    for i, joints in enumerate(poses.joints):
        if groups and np.abs(joints - poses.joints[groups[-1][0]]).max() < SAME_POSE:
            groups[-1].append(i)
        else:
            groups.append([i])
    turns = None if poses.turns is None else np.array([_mean(poses.turns[g]) for g in groups])
    merged = MeasuredPoses(
        tuple(poses.lines[group[0]] for group in groups),
        np.array([poses.joints[group].mean(axis=0) for group in groups]).reshape(
            -1, poses.joints.shape[1]
        ),
        np.array([poses.positions[group].mean(axis=0) for group in groups]).reshape(-1, 3),
        turns,
    )
    return merged, [" and ".join(str(poses.lines[i]) for i in group) for group in groups]


def _mean(turns: Array) -> Array:
    """Return the mean of neighbouring rotations (m, 3, 3)."""
    first = turns[0]
    off = np.mean([rotations.log(first.T @ turn) for turn in turns], axis=0)
    return np.asarray(first @ rotations.exp(off))


def _check_poses(poses: MeasuredPoses) -> None:
    count = len(poses.lines)
    if count < LEAST_POSES:
        raise GeometryError(f"{count} poses, at least {LEAST_POSES} are needed; 30 to 60 are good")
    ranges = np.ptp(poses.joints[:, :AXES], axis=0).tolist()
    still = [
        f"A{i} turns by {1e3 * turned:.0f} mrad"
        for i, turned in enumerate(ranges, start=1)
        if turned < LEAST_RANGE
    ]
    if still:
        raise GeometryError(
            f"{', '.join(still)}, at least {1e3 * LEAST_RANGE:.0f} mrad are needed. "
            "Measure poses that turn every axis."
        )


def _check_residuals(residuals: Array, lines: Sequence[str]) -> None:
    """Refuse rows that do not fit to the others, and poses that no arm fits to.

    Raises:
        GeometryError: the lines of such rows, or the residual.
    """
    wrong = []
    for part, unit in ((residuals[:, :3], "mm"), (residuals[:, 3:], "mrad")):
        if not part.size:
            continue
        sizes = np.linalg.norm(part, axis=1)
        limit = max(OUTLIER * float(np.median(sizes)), LEAST_OUTLIER)
        for i in np.flatnonzero(sizes > limit).tolist():
            off, most = 1e3 * sizes[i], 1e3 * limit
            wrong.append(f"line {lines[i]}: {off:.2f} {unit} off the others, limit {most:.2f}")
    if wrong:
        raise GeometryError("\n".join((*wrong[:10], "Measure these poses again or delete them.")))
    left = _rms(residuals)
    if left > LARGEST_RESIDUAL:
        raise GeometryError(
            f"the poses differ by {1e3 * left:.2f} mm from the nearest arm, limit "
            f"{1e3 * LARGEST_RESIDUAL:.2f}. Check URDF, tcp_in_flange and the measuring system's "
            "frame; approach each pose from both sides."
        )


class _Problem:
    """Least squares of an arm's measured poses, linearised about the URDF."""

    def __init__(self, measured: MeasuredArm, poses: MeasuredPoses) -> None:
        self._measured, self._poses = measured, poses
        self._nominal = measured.load()
        self.count = len(poses.lines)
        self._parts = 3 if poses.turns is None else 6
        self.unknowns = 6 * (AXES + 2)
        self.priors, self._fixed = self._priors(), self._redundant()
        zero = self.residuals(np.zeros(self.unknowns))
        columns = [(self.residuals(row) - zero) / STEP for row in STEP * np.eye(self.unknowns)]
        self._slopes = np.moveaxis(np.array(columns), 0, -1)  # (n, parts, unknowns)

    def _priors(self) -> Array:
        """Return the prior deviations (unknowns,) of shift and turn of each frame."""
        rows = []
        for _, _, axis in self._nominal.axis_frames():
            along = np.abs(axis) > 0.5
            rows.append((LENGTH,) * 3 + tuple(np.where(along, ZERO, TWIST).tolist()))
        for place, turn in (FRAME, TARGET):
            rows.append((place,) * 3 + (turn,) * 3)
        return np.concatenate([np.array(row) for row in rows])

    def _redundant(self) -> Array:
        """Return directions (10, unknowns) of values that stay 0, each of length 1."""
        frames, rows = self._nominal.axis_frames(), np.zeros((2 * (AXES - 1), self.unknowns))
        for i in range(1, AXES):
            place, turn, axis = frames[i]
            before = turn.T @ frames[i - 1][2]
            across = before - (before @ axis) * axis
            shift, turned = rows[2 * i - 2, 6 * i : 6 * i + 3], rows[2 * i - 1, 6 * i : 6 * i + 6]
            shift[:] = before
            lever = np.cross(before, turn.T @ place)
            if np.linalg.norm(across) > PARALLEL:
                turned[3:] = across / np.linalg.norm(across)
            elif np.linalg.norm(lever) > LEAST_LEVER:
                turned[:3] = lever / np.linalg.norm(lever)
            else:
                turned[3:] = axis
        return rows

    def residuals(self, values: Array) -> Array:
        """Return measured against modelled poses (n, 3 or 6) [m], [rad]."""
        arm = self._measured.load(_axes(values)) if values.any() else self._nominal
        bent = gravity_bend.compile_bend(self._measured.control.bend, arm)
        frame, target = values[6 * AXES :].reshape(2, 6)
        turned, mounted = rotations.exp(frame[3:]), rotations.exp(target[3:])
        poses = self._poses
        rows = np.empty((len(poses.joints), self._parts))
        for i, motors in enumerate(poses.joints):
            links = motors if bent is None else gravity_bend.links(bent, motors)
            position, turn = arm.tcp_in_base(links)
            rows[i, :3] = poses.positions[i] - frame[:3] - turned @ (position + turn @ target[:3])
            if poses.turns is not None:
                rows[i, 3:] = rotations.log((turned @ turn @ mounted).T @ poses.turns[i])
        return rows

    def fit(self, poses: Sequence[int], looser: float = 1.0) -> _GeometryFit:
        """Return the values that fit to some of the poses; their noise is that of the residuals.

        Args:
            looser: factor of the priors of frame and target.
        """
        chosen, priors = list(poses), self.priors.copy()
        priors[6 * AXES :] *= looser
        slopes = self._slopes[chosen]
        noise, values = np.array(NOISE[: self._parts // 3]), np.zeros(self.unknowns)
        covariance = np.diag(priors**2)
        fixed = self._fixed * priors / STAYS
        for _ in range(ROUNDS):
            residuals = self.residuals(values)[chosen]
            weights = np.repeat(1.0 / noise, 3)
            J = (slopes * weights[:, None]).reshape(-1, self.unknowns) * priors
            e = (residuals * weights).ravel()
            # In units of the priors: the normal equations are at least the identity.
            information = J.T @ J + np.eye(self.unknowns) + fixed.T @ fixed
            covariance = np.linalg.inv(information)
            at = values / priors
            values = values - priors * (covariance @ (J.T @ e + at + fixed.T @ (fixed @ at)))
            # Of the values, that many are determined by the poses and not by their priors.
            free = residuals.size - (self.unknowns - float(np.trace(covariance)))
            left = self.residuals(values)[chosen]
            share = left.size / max(free, 1.0)
            squares = np.square(left).reshape(len(left), -1, 3).mean(axis=(0, 2))
            noise = np.maximum(np.sqrt(share * squares), LEAST_NOISE[: self._parts // 3])
        deviations = priors * np.sqrt(covariance.diagonal())
        return _GeometryFit(values, deviations, left)


def _axes(values: Array) -> tuple[AxisGeometry, ...]:
    """Return the frames of A1..A6."""
    rows = values[: 6 * AXES].reshape(AXES, 6).tolist()
    return tuple(AxisGeometry((a, b, c), (d, e, f)) for a, b, c, d, e, f in rows)


def _check_arm(values: Array) -> None:
    """Refuse an arm that is too far off the URDF.

    Raises:
        GeometryError: the values that are out of range.
    """
    limits = np.tile(np.repeat((LARGEST_SHIFT, LARGEST_TURN), 3), AXES)
    wrong = _beyond(values[: 6 * AXES], limits, 0)
    if wrong:
        raise GeometryError("\n".join((*wrong, "Master the axes, and check the URDF.")))


def _check_mounting(problem: "_Problem") -> None:
    """Refuse poses that show another frame of the measuring system, or another target, than stated.

    The fit for it does not know either. Only what the poses show counts: an arm that stands
    elsewhere looks like a frame that is shifted.

    Raises:
        GeometryError: the values that contradict what is stated.
    """
    arm = 6 * AXES
    fit = problem.fit(range(problem.count), UNKNOWN)
    limits = OFF_PRIOR * np.hypot(problem.priors[arm:], fit.deviations[arm:])
    wrong = _beyond(fit.values[arm:], limits, arm)
    if wrong:
        advice = "Register the measuring system again; measure the target, or tcp_in_flange, again."
        raise GeometryError("\n".join((*wrong, advice)))


def _beyond(values: Array, limits: Array, first: int) -> list[str]:
    """Return a line for each value that is out of range.

    Args:
        first: index of the first value among all.
    """
    rows = zip(_names()[first : first + len(values)], values, limits, strict=True)
    return [
        f"{name}: {1e3 * value:.3g} {'mm' if i % 6 < 3 else 'mrad'}, limit {1e3 * limit:.3g}"
        for i, (name, value, limit) in enumerate(rows)
        if abs(value) > limit
    ]


def _names() -> list[str]:
    """Return the names of all values, with their frames."""
    frames = (*(f"A{i}" for i in range(1, AXES + 1)), "measuring system", "target on the tool")
    parts = [f"{kind} {along}" for kind in ("shift", "turn") for along in "xyz"]
    return [f"{frame} {part}" for frame in frames for part in parts]


def _findings(problem: _Problem, fit: _GeometryFit, basis: str) -> list[ReportLine]:
    """Return a line for each value."""
    lines = []
    for i, name in enumerate(_names()):
        value, deviation = float(fit.values[i]), float(fit.deviations[i])
        if deviation < 2.0 * STAYS:
            continue
        known = basis if deviation < PRIOR_SHARE * problem.priors[i] else "its prior"
        unit = "mm" if i % 6 < 3 else "mrad"
        outcome = Estimate(value, deviation, known)
        lines.append(ReportLine(name, unit, 1e3, outcome, in_overlay=i < 6 * AXES))
    return lines


def _rms(residuals: Array) -> float:
    """Return the root mean square of the distances [m]."""
    return math.sqrt(float(np.mean(np.sum(residuals[:, :3] ** 2, axis=1))))


def _error_line(name: str, residuals: Array) -> ReportLine:
    """Return the line of positions' errors: rms, and the largest."""
    largest = 1e3 * float(np.linalg.norm(residuals[:, :3], axis=1).max())
    outcome = Estimate(round(_rms(residuals), 6), 0.0, f"rms; largest {largest:.3f} mm")
    return ReportLine(name, "mm", 1e3, outcome)
