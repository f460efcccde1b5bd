"""Trace of a recorded run: commands, answers and sensor readings as arrays with their times.

Invariants:
- Times are seconds since the first step. Poses are in c, whose y axis lies along the conveyor.
- A setpoint that did not reach the controller is replaced by the one that it held.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from linemate.daemon.core import rotations, wrench_frame
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.inputs import Inputs
from linemate.daemon.core.wrench_frame import WrenchFrame

Mask = NDArray[np.bool_]

# From joints (axes,) to position (3,) and rotation (3, 3) of the undeflected tcp in base.
Kinematics = Callable[[Array], tuple[Array, Array]]

LIMITED_S = 1.0  # answers after a limited setpoint that are left out [s]
RATE_S = 0.05  # from a time to either end of the span of its rate [s]
LONGEST_GAP = 2.5  # cycles between two robot poses that are interpolated


@dataclass(frozen=True, slots=True)
class TraceStep:
    """What a trace needs of a recorded step.

    Attributes:
        counter: counter of the answered telegram, None without one.
        command: setpoints (axes,) [rad, m].
        contact: the tool is clamped to the object.
        limited: the command limiter or the brake changed the setpoints.
    """

    counter: int | None
    inputs: Inputs
    command: tuple[float, ...]
    contact: bool
    limited: bool


@dataclass(frozen=True, slots=True, eq=False)
class Images:
    """Poses from the camera; ``exposures`` and ``arrivals`` are times (m,) [s].

    Attributes:
        positions: (m, 3) object in the camera [m].
        rotations: (m, 3, 3) object in the camera.
        deviations: (m, 6) as the camera states them, NaN where it does not.
    """

    exposures: Array
    arrivals: Array
    positions: Array
    rotations: Array
    deviations: Array


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """One recording.

    Attributes:
        commands: (n, axes) setpoint in force from each step on [rad, m].
        answers: (n, axes) measured at each step's telegram, NaN without one, and NaN for a while
            after setpoints at their limits: no servo follows those linearly [rad, m].
        robot_times: (m,) of the robot's telegrams [s].
        tcp: (m, 6) undeflected tcp in c, position [m] and rotation vector [rad].
        distances: (d, 2) arrival [s] and reading [m].
        wrenches: (w, 7) arrival [s], force [N], torque [Nm] of the tcp.
        contact: (c, 2) begin and end of each contact [s].
        motors: (m, axes) positions in the robot's telegrams [rad, m].
    """

    cycle_s: float
    commands: Array
    answers: Array
    robot_times: Array
    tcp: Array
    distances: Array
    images: Images
    wrenches: Array
    contact: Array
    motors: Array

    def in_contact(self, times: Array, margin: float = 0.0) -> Mask:
        """Return for each time (m,) whether the tool was clamped, ``margin`` s around included."""
        inside = np.zeros(len(times), dtype=bool)
        for begin, end in self.contact:
            inside |= (times >= begin - margin) & (times <= end + margin)
        return inside


def build_trace(
    steps: Iterable[TraceStep],
    kinematics: Kinematics,
    nominal: Array,
    frame: WrenchFrame | None = None,
) -> Trace:
    """Return the trace of recorded steps.

    Args:
        kinematics: of the arm with its tool.
        nominal: (3, 3) C, the nominal object's axes in base.
        frame: of the force-torque sensor in the tcp; None: it states the tcp's wrench.

    Raises:
        ValueError: the steps are too few, or without telegrams of a robot.
    """
    rows = list(steps)
    if len(rows) < 20:
        raise ValueError(f"a recording of {len(rows)} steps is too short")
    epoch = rows[0].inputs.stamp_ns
    robots = [step.inputs.robot for step in rows if step.inputs.robot is not None]
    if len(robots) < 20:
        raise ValueError("the recording has no telegrams of a robot")
    axes = len(rows[0].command)
    joints = np.array([(*robot.joints, *robot.external)[:axes] for robot in robots])
    if joints.shape[1] != axes:
        raise ValueError(f"the robot sent {joints.shape[1]} axes, {axes} were commanded")
    row_of = {step.counter: i for i, step in enumerate(rows) if step.counter is not None}
    answers = np.full((len(rows), axes), np.nan)
    for robot, measured in zip(robots, joints, strict=True):
        if robot.counter in row_of:
            answers[row_of[robot.counter]] = measured
    cycle_s = _cycle(rows)
    answers[_after_limited(rows, round(LIMITED_S / cycle_s))] = np.nan
    times = _seconds([robot.stamp_ns for robot in robots], epoch)
    return Trace(
        cycle_s=cycle_s,
        commands=_in_force(rows, joints[0]),
        answers=answers,
        robot_times=times,
        tcp=tcp_poses(joints, kinematics, nominal),
        distances=_distances(rows, epoch),
        images=_images(rows, epoch),
        wrenches=_wrenches(rows, epoch, frame),
        contact=_contacts(rows, epoch),
        motors=joints,
    )


def _cycle(rows: list[TraceStep]) -> float:
    """Return T0 [s]: missed steps count too."""
    first, last = rows[0].inputs, rows[-1].inputs
    return (last.stamp_ns - first.stamp_ns) * 1e-9 / (last.k - first.k)


def _after_limited(rows: list[TraceStep], steps: int) -> Mask:
    """Return which steps (n,) come within ``steps`` of a step with limited setpoints."""
    excluded, left = np.zeros(len(rows), dtype=bool), 0
    for i, step in enumerate(rows):
        left = steps if step.limited else max(left - 1, 0)
        excluded[i] = left > 0
    return excluded


def _seconds(stamps_ns: list[int], epoch_ns: int) -> Array:
    return np.array([stamp - epoch_ns for stamp in stamps_ns], dtype=float) * 1e-9


def _in_force(rows: list[TraceStep], at_first: Array) -> Array:
    """Return the setpoints (n, axes) that the controller had; it holds them if none comes."""
    held = tuple(at_first.tolist())
    commands = []
    for step in rows:
        if step.counter is not None:
            held = step.command
        commands.append(held)
    return np.array(commands)


def tcp_poses(joints: Array, kinematics: Kinematics, nominal: Array) -> Array:
    """Return the tcp (m, 6) in c for joints (m, axes); its rotation vector is continuous."""
    poses = np.empty((len(joints), 6))
    for row, q in zip(poses, joints, strict=True):
        position, rotation = kinematics(q)
        row[:3] = nominal.T @ position
        row[3:] = rotations.log(nominal.T @ rotation)
    return poses


def _distances(rows: list[TraceStep], epoch: int) -> Array:
    samples = [sample for step in rows for sample in step.inputs.distance]
    stamps = _seconds([sample.stamp_ns for sample in samples], epoch)
    readings = np.array([sample.position for sample in samples], dtype=float)
    return np.column_stack((stamps, readings)).reshape(-1, 2)


def _images(rows: list[TraceStep], epoch: int) -> Images:
    samples = [sample for step in rows for sample in step.inputs.camera]
    deviations = np.full((len(samples), 6), np.nan)
    for row, sample in zip(deviations, samples, strict=True):
        if sample.covariance is not None:
            diagonal = [sample.covariance[i] for i in (0, 6, 11, 15, 18, 20)]
            row[:] = np.sqrt(np.maximum(diagonal, 0.0))
    return Images(
        exposures=_seconds([sample.exposure_ns for sample in samples], epoch),
        arrivals=_seconds([sample.stamp_ns for sample in samples], epoch),
        positions=np.array([sample.position for sample in samples], dtype=float).reshape(-1, 3),
        rotations=np.array(
            [rotations.matrix(sample.quaternion) for sample in samples], dtype=float
        ).reshape(-1, 3, 3),
        deviations=deviations,
    )


def _wrenches(rows: list[TraceStep], epoch: int, frame: WrenchFrame | None) -> Array:
    stated = [sample for step in rows for sample in step.inputs.wrench]
    samples = wrench_frame.each_at_tcp(frame, stated)
    stamps = _seconds([sample.stamp_ns for sample in samples], epoch)
    wrenches = np.array([(*sample.force, *sample.torque) for sample in samples], dtype=float)
    return np.column_stack((stamps, wrenches.reshape(-1, 6))).reshape(-1, 7)


def _contacts(rows: list[TraceStep], epoch: int) -> Array:
    contacts: list[tuple[float, float]] = []
    begin: float | None = None
    for step in rows:
        now = (step.inputs.stamp_ns - epoch) * 1e-9
        if step.contact and begin is None:
            begin = now
        elif not step.contact and begin is not None:
            contacts.append((begin, now))
            begin = None
    if begin is not None:
        contacts.append((begin, (rows[-1].inputs.stamp_ns - epoch) * 1e-9))
    return np.array(contacts).reshape(-1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class TcpPath:
    """Path of the undeflected tcp, at any time.

    Attributes:
        spline: of position and rotation vector.
        times: (m,) times of its telegrams [s].
        gap: longest interpolated gap between two telegrams [s].
    """

    spline: CubicSpline
    times: Array
    gap: float

    def known(self, times: Array) -> Mask:
        """Return for each time (m,) whether it lies in no gap between telegrams."""
        after = np.clip(np.searchsorted(self.times, times), 1, len(self.times) - 1)
        inside = (times >= self.times[0]) & (times <= self.times[-1])
        close = self.times[after] - self.times[after - 1] <= self.gap
        known: Mask = inside & close
        return known

    def at(self, times: Array) -> tuple[Array, Array]:
        """Return positions (m, 3) and rotations (m, 3, 3) in c at times (m,)."""
        poses = self.spline(times)
        return poses[:, :3], rotations.exp_many(poses[:, 3:])

    def rates(self, times: Array) -> Array:
        """Return the speeds (m, 6) of position and rotation vector at times (m,).

        Differences over a span: the derivative of a noisy encoder is mostly noise.
        """
        before = np.maximum(times - RATE_S, self.times[0])
        after = np.minimum(times + RATE_S, self.times[-1])
        span = np.maximum(after - before, 1e-9)[:, None]
        rates: Array = (self.spline(after) - self.spline(before)) / span
        return rates


def tcp_path(trace: Trace) -> TcpPath:
    """Return the path of the tcp through a trace."""
    keep = np.concatenate(((True,), np.diff(trace.robot_times) > 0.0))
    times = trace.robot_times[keep]
    return TcpPath(CubicSpline(times, trace.tcp[keep]), times, LONGEST_GAP * trace.cycle_s)
