"""The shipped cell for tests of the step and of the cycle, and inputs to drive them with."""

from collections.abc import Callable
from copy import copy
from functools import cache
from typing import Any

import numpy as np
from msgspec.structs import replace

from linemate.daemon.config import task_file
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.core import rotations
from linemate.daemon.core.control.settings import ControlSettings
from linemate.daemon.core.inputs import Inputs, MotionOrder
from linemate.daemon.core.parameters import Parameters, build
from linemate.daemon.core.step import initial, step
from linemate.daemon.core.step_state import Outputs, StepState
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.protocol.stamped_samples import (
    CameraSample,
    DistanceSample,
    RobotSample,
    WrenchSample,
)

EPOCH_NS = 7_000_000_000_000
TASK = task_file.load(DAEMON_DATA / "wheel.yaml")
REST = TASK.file.arm.rest_joints
AXIS = 0.0
SPEED = 0.106
LEAD_S = 1.5
"""The object passes the start position this long after the first step."""

MOUNT = TASK.file.conveyor.start_position
"""What the distance sensor reads as the object passes the start position [m]."""

SWING = 0.004
TURN = rotations.exp(np.array((0.05, -0.25, 0.2)))
OFF = np.array((0.03, -0.02, 0.04))
"""The object in c next to its nominal pose, and its turn."""


@cache
def parameters(cycle_s: float = 0.012) -> Parameters:
    """The shipped task with default settings, compiled once."""
    return build(TASK.file, TASK.urdf, TrackingSettings(), ControlSettings(), cycle_s)


def robot_sample(
    stamp_ns: int, command: tuple[float, ...] | None = None, digital_in: int = 0
) -> RobotSample:
    """What an ideal robot says: it is where it was commanded."""
    joints = (*REST, AXIS) if command is None else command
    arm: Any = joints[:6]
    return RobotSample(stamp_ns, 1, arm, joints[6:7], 0, digital_in)


def object_at(t: float) -> tuple[np.ndarray, np.ndarray]:
    """The object in c (position, rotation) at scenario time t [s]: off, turned and swinging."""
    phi = SWING * np.cos(2 * np.pi * 0.62 * t)
    nominal = rotations.matrix(TASK.file.object.nominal.quaternion).T @ np.array(
        TASK.file.object.nominal.position
    )
    place = nominal + OFF + np.array((-0.3 * phi, SPEED * t, -0.9 * phi))
    return place, rotations.exp(np.array((0.0, phi, 0.0))) @ TURN


class World:
    """Inputs for a robot that does what is desired, a steady object, and clean sensors.

    The robot is where the servos should bring it, q_d(0), and not where the setpoints lead them.
    """

    def __init__(self, parameters: Parameters, *, camera: bool = True, distance: bool = True):
        """Begin at rest."""
        self.parameters = parameters
        self.period_ns = round(parameters.cycle_s * 1e9)
        self.k = 0
        self.state: StepState = initial(parameters, robot_sample(EPOCH_NS))
        self.command: tuple[float, ...] = (*REST, AXIS)
        self.outputs: Outputs | None = None
        self.camera, self.distance = camera, distance
        self._camera_due = 0.02
        self._poses: list[tuple[int, np.ndarray, np.ndarray]] = []

    def fork(self) -> "World":
        """Another world with the same past: states are values, only the poses are a list."""
        other = copy(self)
        other._poses = list(self._poses)
        return other

    @property
    def stamp_ns(self) -> int:
        """Time of the next step [ns]."""
        return EPOCH_NS + self.k * self.period_ns

    @property
    def time(self) -> float:
        """Scenario time of the next step [s]."""
        return (self.stamp_ns - EPOCH_NS) * 1e-9 - LEAD_S

    def inputs(self, order: MotionOrder = MotionOrder.HOLD, **changes: Any) -> Inputs:
        """What the next step is given."""
        stamp_ns = self.stamp_ns
        robot = robot_sample(stamp_ns - self.period_ns, self.joints)
        distance: tuple[DistanceSample, ...] = ()
        if self.distance:
            seen_ns = stamp_ns - 1_000_000
            position = MOUNT + SPEED * (self.time - 0.002)
            distance = (DistanceSample(seen_ns, position, 1.0),)
        made = Inputs(self.k, stamp_ns, robot, distance, self._camera(), (self._wrench(),), order)
        return replace(made, **changes)

    @property
    def joints(self) -> tuple[float, ...]:
        """Where the robot is."""
        return tuple(self.state.control.joints[0].tolist())

    @property
    def clamped(self) -> bool:
        """The tool is where the task has it on the object."""
        time = self.outputs.task_time if self.outputs is not None else None
        return time is not None and 5.95 < time < 15.0

    def _wrench(self) -> WrenchSample:
        """The tool's own mass while free; clamped, what the mount's stiffness makes of the way."""
        stamp_ns = self.stamp_ns - self.period_ns
        if not self.clamped:
            return WrenchSample(stamp_ns, (0.1, 0.2, 0.1 + self._inertia()), (0.0, 0.01, 0.0))
        tcp, R = self._tcp(self.joints)
        place, turned = object_at((stamp_ns - EPOCH_NS) * 1e-9 - LEAD_S)
        tactile = TrackingSettings().tactile
        fx, fy, fz = (R.T @ (place - tcp) * np.array(tactile.stiffness)).tolist()
        turn = rotations.log(R.T @ turned)
        mx, my, mz = (turn * np.array(tactile.rotational_stiffness)).tolist()
        return WrenchSample(stamp_ns, (fx, fy, fz), (mx, my, mz))

    def _inertia(self) -> float:
        """Force along the tool's axis that accelerates the tool [N]."""
        (first, _), (middle, R), (last, _) = map(self._tcp, self.state.control.joints[:3])
        acceleration = (first - 2.0 * middle + last) / self.parameters.cycle_s**2
        return -self.parameters.tracker.vibration.mass * float(R[:, 2] @ acceleration)

    def _tcp(self, joints: Any) -> tuple[np.ndarray, np.ndarray]:
        """Where the robot has its tcp with some joints, in c."""
        C = self.parameters.tracker.reference.nominal
        position, rotation = self.parameters.controller.arm.tcp_in_base(np.array(joints))
        return C.T @ position, C.T @ rotation

    def _camera(self) -> tuple[CameraSample, ...]:
        """An image every 25 ms, a tenth of a second late, from where the robot then was."""
        self._poses.append((self.stamp_ns - self.period_ns, *self._tcp(self.joints)))
        elapsed = (self.stamp_ns - EPOCH_NS) * 1e-9
        if not self.camera or self.clamped or elapsed - 0.1 < self._camera_due:
            return ()
        exposure_ns, tcp, R_tcp = min(
            self._poses, key=lambda pose: abs(pose[0] - EPOCH_NS - self._camera_due * 1e9)
        )
        self._camera_due += 0.025
        del self._poses[:-60]
        camera, R_camera = self.parameters.tracker.camera
        place, turned = object_at((exposure_ns - EPOCH_NS) * 1e-9 - LEAD_S)
        R = R_tcp @ R_camera
        x, y, z = (R.T @ (place - tcp - R_tcp @ camera)).tolist()
        return (
            CameraSample(
                self.stamp_ns,
                exposure_ns,
                "cam1",
                "camera",
                "hub",
                self.k,
                (x, y, z),
                rotations.quaternion(R.T @ turned),
            ),
        )

    def step(self, order: MotionOrder = MotionOrder.HOLD, **changes: Any) -> Outputs:
        """Make the next step."""
        return self.take(self.inputs(order, **changes))

    def take(self, inputs: Inputs) -> Outputs:
        """Make a step with these inputs."""
        self.state, self.outputs = step(self.state, inputs, self.parameters)
        self.command = self.outputs.command
        self.k += 1
        return self.outputs

    def run(
        self,
        seconds: float,
        order: MotionOrder = MotionOrder.HOLD,
        each: Callable[[Outputs], None] | None = None,
        **changes: Any,
    ) -> Outputs:
        """Make steps for some time."""
        outputs = None
        for _ in range(round(seconds / self.parameters.cycle_s)):
            outputs = self.step(order, **changes)
            if each is not None:
                each(outputs)
        assert outputs is not None
        return outputs
