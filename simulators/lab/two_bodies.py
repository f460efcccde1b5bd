"""Two-body loop of a contact: the real step, a servo model, a mount, and a body that gives way.

Invariants:
    The body is three uncoupled oscillators in the conveyor frame; the mount is a spring without
        damping. Nothing here is shared with ``plants``.
    One approach to a rigid body is made per cell; each case goes on from its end. States of the
        step are values, so a case costs its contact alone.
"""

import math
from collections import deque
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.inputs import Inputs, MotionOrder
from linemate.daemon.core.parameters import Parameters, build
from linemate.daemon.core.step import initial, step
from linemate.daemon.core.step_state import Outputs, StepState
from linemate.daemon.core.tracking.task import Phase, TaskFile
from linemate.protocol.stamped_samples import (
    CameraSample,
    DistanceSample,
    RobotSample,
    WrenchSample,
)
from linemate.simulators.harness.setup import Setup, identified

EPOCH_NS = 7_000_000_000_000
LEAD_S = 1.5  # the object passes the start position this long after the first step [s]
SUBSTEP_S = 0.001
WRENCH_S = 0.004
CAMERA_S = 0.025
CAMERA_DELAY_S = 0.1
CAMERA_BLIND = 0.03  # distance below which the camera sees nothing [m]
HELD_S = 6.0  # the press lasts so much longer than in the task, beyond the end of a case [s]
TOOL_MASS = 25.0  # of tool and wheel, which move with the hub [kg]
OFF = np.array((0.03, -0.02, 0.04))  # of the object from its nominal place, in c [m]
GRAIN = 0.001  # quantisation of the distance sensor [m]


@dataclass(frozen=True, slots=True)
class TwoBodyCell:
    """What the daemon is built for.

    Attributes:
        mount: stiffness of the mount, the same in each direction [N/m].
        configured: stiffness in the daemon's settings, as a share of it.
        dead_time: of each servo [s].
        speed: of the conveyor [m/s].
    """

    cycle_s: float = 0.012
    mount: float = 50e3
    configured: float = 1.0
    dead_time: float = 0.036
    speed: float = 0.106


@dataclass(frozen=True, slots=True)
class CarMode:
    """The body that gives way.

    Attributes:
        mass: modal mass at the hub [kg].
        frequency_hz: of the body alone.
        damping: share of critical of the body alone.
    """

    mass: float
    frequency_hz: float
    damping: float


@dataclass(frozen=True, slots=True)
class ContactTrace:
    """One case around its kick, a row a cycle.

    Attributes:
        times: (n,) from the kick [s]; less than 0 before it.
        moved: (n, 3) of the hub from its undisturbed place, in c [m].
        forces: (n, 3) on the tool, in c [N].
        energies: (n,) that the tool has given to the body since it was freed, or kicked [J].
        events: what happened, with its time.
        calm: rows before the kick.
    """

    times: Array
    moved: Array
    forces: Array
    energies: Array
    events: tuple[tuple[float, str], ...]
    calm: int = 0


def _parameters(cell: TwoBodyCell, run_setup: Setup) -> Parameters:
    """Return the parameters of a cell: servos and mount as the daemon has them configured."""
    stiffness = (cell.configured * cell.mount,) * 3
    tracking = replace(
        run_setup.tracking, tactile=replace(run_setup.tracking.tactile, stiffness=stiffness)
    )
    servos = tuple(replace(servo, dead_time=cell.dead_time) for servo in run_setup.control.servos)
    filters = run_setup.control.filters
    ahead = max(filters.servo_future_s, cell.dead_time + 0.06)
    filters = replace(filters, servo_future_s=ahead)
    control = replace(run_setup.control, servos=servos, filters=filters)
    return build(_held(run_setup.task), run_setup.urdf, tracking, control, cell.cycle_s)


def _held(task: TaskFile) -> TaskFile:
    """Return a task that presses for longer, so that no motion of its own is in a case."""
    screws = next(point.time for point in task.waypoints if point.phase is Phase.SCREWS)
    waypoints = tuple(
        replace(point, time=point.time + HELD_S) if point.time > screws else point
        for point in task.waypoints
    )
    tool = replace(task.tool, release_wheel=task.tool.release_wheel + HELD_S)
    return replace(task, waypoints=waypoints, tool=tool)


class Servos:
    """Each axis: setpoints interpolated over a cycle, dead time, second-order response."""

    def __init__(self, parameters: Parameters, cell: TwoBodyCell, joints: Array) -> None:
        servos = parameters.settings.servos[: len(joints)]
        self._omega = np.array([math.tau * servo.frequency_hz for servo in servos])
        self._damping = np.array([servo.damping for servo in servos])
        self._substeps = round(cell.cycle_s / SUBSTEP_S)
        late = round(cell.dead_time / SUBSTEP_S)
        self.line: deque[Array] = deque([joints] * (late + 1), maxlen=late + 1)
        self.joints, self._speed, self._last = joints, np.zeros(len(joints)), joints

    def advance(self, command: Array) -> None:
        """Move through one cycle."""
        joints, speed, h = self.joints, self._speed, SUBSTEP_S
        for i in range(1, self._substeps + 1):
            self.line.append(self._last + (i / self._substeps) * (command - self._last))
            pull = self._omega**2 * (self.line[0] - joints)
            speed = speed + h * (pull - 2.0 * self._damping * self._omega * speed)
            joints = joints + h * speed
        self.joints, self._speed, self._last = joints, speed, command

    def fork(self) -> "Servos":
        """Return a copy that goes on by itself."""
        other = copy(self)
        other.line = self.line.copy()
        return other


class TwoBodies:
    """The loop, cycle by cycle."""

    def __init__(self, cell: TwoBodyCell) -> None:
        self.cell, self._parameters = cell, _parameters(cell, identified())
        self.noise = np.random.default_rng(0)
        self._arm = self._parameters.controller.arm
        self._nominal = self._parameters.tracker.reference.nominal
        joints = np.array((*self._parameters.tracker.task.arm.rest_joints, 0.0))
        self.servos, self._reported = Servos(self._parameters, cell, joints), joints
        self._state: StepState = initial(self._parameters, self._robot(EPOCH_NS, 0))
        self._period_ns = round(cell.cycle_s * 1e9)
        self._k, self._bits, self._camera_due, self._touched = 0, 0, 0.02, False
        self._wrenches: tuple[WrenchSample, ...] = ()
        self.seen: deque[CameraSample] = deque()
        self._tcp = self._arm.tcp_in(self._nominal, joints)
        self._before = self._tcp
        self._omega = math.tau * self._parameters.settings.effector[:3][2].frequency_hz
        self._moved: Array = np.zeros(3)
        self._velocity: Array = np.zeros(3)
        self._load: Array = np.zeros(3)
        self._energy = 0.0
        self.force: Array = np.zeros(3)
        self.outputs: Outputs | None = None
        self.mode: CarMode | None = None

    @property
    def time(self) -> float:
        """Time of the next step since the object passed the start position [s]."""
        return self._k * self.cell.cycle_s - LEAD_S

    @property
    def energy(self) -> float:
        """What the tool has given to the body since the kick [J]."""
        return self._energy

    @property
    def moved(self) -> Array:
        """The hub from its undisturbed place (3,) in c [m]."""
        return self._moved

    def fork(self) -> "TwoBodies":
        """Return a copy that goes on by itself."""
        other = copy(self)
        other.servos, other.seen = self.servos.fork(), self.seen.copy()
        other.noise = np.random.default_rng(1)
        return other

    def free(self, mode: CarMode) -> None:
        """Let the body give way from now on; it is at rest where the press holds it."""
        self.mode, self._energy = mode, 0.0
        self._load = self._pull(self._tcp)

    def kick(self, amplitude: float) -> None:
        """Move the body along the conveyor and into the tool, and count the energy from now on.

        Args:
            amplitude: of the motion on the mount [m].
        """
        mode = self.mode
        assert mode is not None  # noqa: S101 - the caller has freed it
        self._energy = 0.0
        mass = mode.mass + TOOL_MASS
        body = mode.mass * (math.tau * mode.frequency_hz) ** 2
        omega = math.sqrt((body + self.cell.mount) / mass)
        self._velocity = self._velocity + amplitude * omega * np.array((0.4, 1.0, 0.4))

    def _hub(self, time: float) -> Array:
        """Return the undisturbed hub (3,) in c."""
        way = np.array((0.0, self.cell.speed * time, 0.0))
        hub: Array = self._parameters.tracker.reference.origin + OFF + way
        return hub

    def _pull(self, tcp: Array) -> Array:
        """Return the force on the tool (3,) in c: what the mount's spring makes of the way."""
        return self.cell.mount * (self._hub(self.time) + self._moved - tcp[:3])

    def turn(self) -> Outputs:
        """Make one cycle."""
        stamp_ns = EPOCH_NS + self._k * self._period_ns
        seen = self._images(stamp_ns)
        robot = self._robot(stamp_ns - self._period_ns, self._bits)
        position = 1.0 + self.cell.speed * (self.time - 0.002)
        position = GRAIN * round((position + 0.00025 * self.noise.normal()) / GRAIN)
        inputs = Inputs(
            self._k,
            stamp_ns,
            robot,
            (DistanceSample(stamp_ns - 1_000_000, position),),
            seen,
            self._wrenches,
            MotionOrder.TRACK if self._k > 60 else MotionOrder.HOLD,
            start=self._k == 61,
        )
        self._state, outputs = step(self._state, inputs, self._parameters)
        self._bits = outputs.digital_out
        before, self._reported = self._tcp, self.servos.joints
        self.servos.advance(np.array(outputs.command))
        self._k += 1
        self._tcp = self._arm.tcp_in(self._nominal, self.servos.joints)
        self._move(before, stamp_ns)
        self.outputs = outputs
        return outputs

    def _robot(self, stamp_ns: int, bits: int) -> RobotSample:
        joints: Any = tuple(self._reported.tolist())
        return RobotSample(stamp_ns, 1, joints[:6], joints[6:], 0, bits)

    def _move(self, before: Array, begun_ns: int) -> None:
        """Move the body through a cycle, the tcp on a straight line, and measure the force."""
        cell, h = self.cell, SUBSTEP_S
        count, every = round(cell.cycle_s / h), round(WRENCH_S / h)
        R = rotations.exp(self._tcp[3:])
        turn = rotations.log(R.T) * 2000.0
        samples = []
        begun = self.time - cell.cycle_s
        bend = (self._tcp - 2.0 * before + self._before)[:3] / cell.cycle_s**2
        inertia = -cell.mount / self._omega**2 * bend  # of a tool that hangs free
        self._before = before
        depth = float((self._tcp[:3] - self._hub(self.time) - self._moved)[2])
        self._touched = self._touched or depth >= 0.0
        for i in range(1, count + 1):
            tcp = before[:3] + (i / count) * (self._tcp[:3] - before[:3])
            hub = self._hub(begun + i * h)
            force = cell.mount * (hub + self._moved - tcp) if self._touched else inertia
            self._energy -= h * float((force - self._load) @ self._velocity)
            if self.mode is not None:
                self._swing(force - self._load, h)
            if i % every == 0:
                noise = 0.05e-3 * cell.mount
                felt = R.T @ force + noise * self.noise.normal(size=3)
                torque = turn if self._touched else np.zeros(3)
                torque = torque + 0.4 * self.noise.normal(size=3)
                stamp = begun_ns + round(i * h * 1e9)
                samples.append(WrenchSample(stamp, tuple(felt.tolist()), tuple(torque.tolist())))
        self.force, self._wrenches = force, tuple(samples)

    def _swing(self, force: Array, h: float) -> None:
        """Move the body by one substep under the change of the force since the kick."""
        mode = self.mode
        assert mode is not None  # noqa: S101 - the caller has checked
        omega = math.tau * mode.frequency_hz
        pull = -force - mode.mass * omega * (
            omega * self._moved + 2.0 * mode.damping * self._velocity
        )
        self._velocity = self._velocity + (h / (mode.mass + TOOL_MASS)) * pull
        self._moved = self._moved + h * self._velocity

    def _images(self, stamp_ns: int) -> tuple[CameraSample, ...]:
        """Return the images that have arrived, and expose the next one."""
        elapsed = (stamp_ns - EPOCH_NS) * 1e-9
        tracker = self._parameters.tracker
        if elapsed >= self._camera_due:
            self._camera_due += CAMERA_S
            camera, R_camera = tracker.camera
            R_tcp = rotations.exp(self._tcp[3:])
            R = R_tcp @ R_camera
            hub = self._hub(self.time) + self._moved
            at = R.T @ (hub - self._tcp[:3] - R_tcp @ camera)
            far = float(np.linalg.norm(hub - self._tcp[:3]))
            if far > CAMERA_BLIND:
                sigma = 0.00025 + 0.0012 * far
                x, y, z = (at + sigma * self.noise.normal(size=3)).tolist()
                turned = rotations.exp(0.001 * self.noise.normal(size=3))
                due = stamp_ns + round(CAMERA_DELAY_S * 1e9)
                quaternion = rotations.quaternion(R.T @ turned)
                sample = CameraSample(
                    due, stamp_ns, "cam1", "camera", "hub", self._k, (x, y, z), quaternion
                )
                self.seen.append(sample)
        arrived = []
        while self.seen and self.seen[0].stamp_ns <= stamp_ns:
            arrived.append(self.seen.popleft())
        return tuple(arrived)


def approached(cell: TwoBodyCell, settled_s: float = 1.2, limit_s: float = 20.0) -> TwoBodies:
    """Return a loop whose tool has been in contact with a rigid body for a while.

    Raises:
        RuntimeError: no contact.
    """
    loop = TwoBodies(cell)
    while not loop.turn().contact:
        if loop.time > limit_s:
            raise RuntimeError("the tool found no contact")
    for _ in range(round(settled_s / cell.cycle_s)):
        loop.turn()
    return loop


def kicked(
    begun: TwoBodies, mode: CarMode, seconds: float, amplitude: float = 0.001, calm_s: float = 0.0
) -> ContactTrace:
    """Return what follows a kick of a body that gives way.

    Args:
        begun: by ``approached``; it is not changed.
        amplitude: of the kick's motion on the mount [m].
        calm_s: for which the body gives way before the kick, and nothing excites it [s].
    """
    loop = begun.fork()
    loop.free(mode)
    rows, events = [], []
    calm = round(calm_s / loop.cell.cycle_s)
    start = loop.time + calm * loop.cell.cycle_s
    for k in range(calm + round(seconds / loop.cell.cycle_s)):
        if k == calm:
            loop.kick(amplitude)
        outputs = loop.turn()
        at = loop.time - start
        rows.append((at, *loop.moved.tolist(), *loop.force.tolist(), loop.energy))
        events += [(at, " ".join(event)) for event in outputs.events]
        if math.hypot(*loop.force.tolist()) > 2000.0:
            break
    table = np.array(rows)
    return ContactTrace(table[:, 0], table[:, 1:4], table[:, 4:7], table[:, 7], tuple(events), calm)
