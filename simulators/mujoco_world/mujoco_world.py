"""One run of the MuJoCo station, behind the same devices as the other plant.

Invariants:
    Scenario time is an argument and only goes forward, in time steps of ``TIMESTEP_S``.
    The same commands at the same cycles give the same run.
    Nothing is shared with ``plants``: no formula, no size, no random stream.
"""

import math
from collections import deque
from typing import TypeVar

import numpy as np

from linemate.simulators.mujoco_world.cell_sensors import (
    ConveyorEncoder,
    HubCamera,
    MountSensor,
    MujocoDistance,
    MujocoPose,
    MujocoWrench,
)
from linemate.simulators.mujoco_world.frame_poses import Array, Pose, matrix_of, pose
from linemate.simulators.mujoco_world.line import profile
from linemate.simulators.mujoco_world.mating import (
    BoltMating,
    FirstTouch,
    MatingCollision,
    MatingPoses,
    Phase,
)
from linemate.simulators.mujoco_world.model import TIMESTEP_S, mount_stiffness
from linemate.simulators.mujoco_world.motor_drives import Drives
from linemate.simulators.mujoco_world.mujoco_cell import MujocoCell, RunOrder, known, sample
from linemate.simulators.mujoco_world.station import MujocoStation, Six

_TINY = 1e-9
_SPARE_S = 2.0
_Reading = TypeVar("_Reading", MujocoDistance, MujocoPose, MujocoWrench)


class MujocoWorld:
    """One run, from t = -lead_in_s on.

    Attributes:
        cell: sizes of this run, all drawn.
        order: what was asked of the run.
    """

    def __init__(self, cell: MujocoCell, order: RunOrder) -> None:
        """Set everything up at rest, the conveyor at its speed."""
        self.cell = cell = sample(order.seed, cell, order.cell_seed)
        self.order = order
        self._station = MujocoStation(cell, order)
        self._drives = Drives(cell.arm, order.start, order.cycle_s, TIMESTEP_S)
        self._mating = BoltMating(cell.tool)
        self._steps_a_cycle = round(order.cycle_s / TIMESTEP_S)
        count = math.ceil((order.lead_in_s + order.duration_s + _SPARE_S) / TIMESTEP_S)
        self._profile = profile(cell.line, order, TIMESTEP_S, count)
        self._travelled = np.zeros((count, 2))
        self._step = 0
        self._energy = 0.0
        self._station.stand(self._profile)
        self._drives.fit(self._station.moved_inertia())
        self._travelled[0] = self._station.unit()
        self._gravity = self._weighed()
        self._begin_sensors()

    # Time and commands

    @property
    def seed(self) -> int:
        """Seed of the run."""
        return self.order.seed

    @property
    def lead_in_s(self) -> float:
        """The run starts this long before scenario time 0 [s]."""
        return self.order.lead_in_s

    @property
    def start(self) -> tuple[float, ...]:
        """Axes at the beginning, A1..A6 [rad], E1 [m]."""
        return self.order.start

    @property
    def look_ahead_s(self) -> float:
        """No axis moves on a setpoint before this time has passed [s]."""
        return self._drives.dead_time_s

    @property
    def mount_stiffness(self) -> tuple[float, ...]:
        """Stiffness of the mount, along [N/m] and about [Nm/rad] the tcp's axes."""
        return mount_stiffness(self.cell)

    @property
    def time_s(self) -> float:
        """Scenario time reached [s]."""
        return self._time_of(self._step)

    @property
    def cycle(self) -> int:
        """Number of the present controller cycle."""
        return self._step // self._steps_a_cycle

    def cycle_start(self, cycle: int) -> float:
        """Scenario time at which a controller cycle begins [s]."""
        return self._time_of(cycle * self._steps_a_cycle)

    def advance(self, t: float) -> None:
        """Simulate up to scenario time t.

        Raises:
            ValueError: t is in the past by a time step or more.
        """
        goal = math.floor((t + self.lead_in_s) / TIMESTEP_S + 1e-6)
        if goal < self._step:
            raise ValueError(f"time runs forward: at {self.time_s} s, asked for {t} s")
        while self._step < goal:
            self._advance_step()

    def command(self, setpoints: tuple[float, ...], cycle: int | None = None) -> None:
        """Command the setpoints that the controller moves to during a cycle.

        Args:
            setpoints: A1..A6 [rad], E1 [m].
            cycle: the present one, which None means as well, or the one before it.

        Raises:
            ValueError: not seven finite values, or too late.
        """
        number = self.cycle if cycle is None else cycle
        self._drives.command(number, self.time_s - self.cycle_start(number), setpoints)

    def digital_out(self, bits: int) -> None:
        """Set the signals to the tool: bit 0 fix the screws, bit 1 release the wheel."""
        self._mating.order(bits)

    def digital_in(self) -> int:
        """Signals of the tool: bit 0 screws fixed, bit 1 wheel released."""
        return self._mating.signals

    # What the controller knows

    def encoders(self) -> tuple[float, ...]:
        """What the motors' encoders say now: A1..A6 [rad], E1 [m]."""
        step = self.cell.arm.encoder_step
        read: list[float] = (np.round(self._station.motors()[0] / step) * step).tolist()
        return tuple(read)

    def reported(self) -> Pose:
        """Tcp in base as the controller computes it from its encoders."""
        return self._station.computed_tcp(self._station.motors()[0])

    # Truth

    def rigid(self) -> Pose:
        """True tcp without the mount's deflection, in base."""
        return pose(*self._station.place(self._station.rigid))

    def hub(self) -> Pose:
        """True hub in base."""
        return pose(*self._station.place(self._station.hub))

    def deflection(self) -> Six:
        """Elastic tcp relative to the rigid one, in the rigid tcp's frame [m, rad].

        It is 0 where the mount carries the weight that it carried when the tcp was measured.
        """
        return self._station.six(self._station.rigid, self._station.tool)

    def sag(self) -> Six:
        """Part of the deflection that is no contact: none, it is zeroed with the weight."""
        return (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def sway(self) -> Six:
        """Displacement [m] and rotation [rad] of the hub by the hanger's modes, in c."""
        return self._station.sway()

    def energy(self) -> float:
        """Work of the mount's force on the car in contact, relative to the conveyor [J]."""
        return self._energy

    def hub_pose(self, t: float | None = None) -> Array:
        """True hub in base now, 4x4.

        Raises:
            ValueError: another time: no one knows the future of this world.
        """
        if t is not None and abs(t - self.time_s) > TIMESTEP_S:
            raise ValueError("the MuJoCo world knows only where the hub is now")
        return matrix_of(*self._station.place(self._station.hub))

    def tcp_pose(self) -> Array:
        """True, elastic tcp in base, 4x4."""
        return matrix_of(*self._station.place(self._station.tool))

    def tcp_rigid_pose(self) -> Array:
        """True tcp without the mount's deflection in base, 4x4."""
        return matrix_of(*self._station.place(self._station.rigid))

    def unit_position(self) -> float:
        """True position of the conveyor [m]."""
        return self._station.unit()[0]

    def unit_speed(self) -> float:
        """True speed of the conveyor [m/s]."""
        return self._station.unit()[1]

    def unit_motion(self, times: Array) -> tuple[Array, Array]:
        """True positions [m] and speeds [m/s] of the conveyor at times that have passed, (n,)."""
        steps = (times + self.lead_in_s) / TIMESTEP_S
        known = np.arange(self._step + 1)
        position, speed = self._travelled[: self._step + 1].T
        return np.interp(steps, known, position), np.interp(steps, known, speed)

    @property
    def contact(self) -> Phase:
        """Free, clamped (touching or screwed) or released."""
        return self._mating.phase

    @property
    def impact(self) -> FirstTouch | None:
        """First touch of wheel and hub."""
        return self._mating.impact

    @property
    def collision(self) -> MatingCollision | None:
        """First collision, if any."""
        return self._mating.collision

    @property
    def screws_fixed_s(self) -> float | None:
        """When the screws were tight [s]."""
        return self._mating.fixed_s

    @property
    def released_s(self) -> float | None:
        """When the gripper let go of the wheel [s]."""
        return self._mating.released_s

    # Sensors

    def take_distance(self) -> list[MujocoDistance]:
        """Readings of the distance sensor that became due since the last call."""
        return self._pop_due(self._distance.due)

    def take_camera(self) -> list[MujocoPose]:
        """Poses of the camera that became due since the last call."""
        return self._pop_due(self._camera.due)

    def take_wrench(self) -> list[MujocoWrench]:
        """Readings of the force-torque sensor that became due since the last call."""
        return self._pop_due(self._force_torque.due)

    def _pop_due(self, due: "deque[_Reading]") -> "list[_Reading]":
        taken: list[_Reading] = []
        while due and due[0].time_s <= self.time_s + _TINY:
            taken.append(due.popleft())
        return taken

    # Going on

    def _begin_sensors(self) -> None:
        sensors, seed = self.cell.sensors, self.order.seed
        self._distance = ConveyorEncoder(self.cell, seed)
        self._camera = HubCamera(self.cell, seed)
        self._force_torque = MountSensor(self.cell, seed)
        self._periods = tuple(
            max(1, round(period / TIMESTEP_S))
            for period in (
                sensors.distance_period_s,
                sensors.camera_period_s,
                sensors.force_period_s,
            )
        )

    def _time_of(self, step: int) -> float:
        return round(step * TIMESTEP_S - self.lead_in_s, 9)

    def _advance_step(self) -> None:
        self._expose()
        station, step = self._station, self._step
        if step % self._steps_a_cycle == 0:
            self._gravity = self._weighed()
        reference = self._drives.reference(step * TIMESTEP_S)
        torques = self._drives.torques(reference, *station.motors(), self._gravity)
        station.drive(torques, self._pull(step))
        touch_n = station.touch_n()
        station.settle()
        self._step = step = step + 1
        self._travelled[step] = station.unit()
        if self._mating.phase == "clamped":
            self._energy += station.power() * TIMESTEP_S
        self._mating.advance(self.time_s, TIMESTEP_S, self._situation(touch_n))
        station.hold(by_gripper=self._mating.is_gripped, by_screws=self._mating.are_screws_in)

    def _weighed(self) -> Array:
        """Return the gravity that the controller feeds forward, by its own load data."""
        loads = self._station.axis_loads(is_gripped=self._mating.is_gripped)
        loads[6] = 0.0
        return (1.0 + known(self.cell.arm.gravity_error)) * loads

    def _pull(self, step: int) -> float:
        """Return the force of the conveyor's drive [N]."""
        line, (position, speed) = self._profile, self._station.unit()
        omega = math.tau * self.cell.line.drive_hz
        behind, slower = line.position[step] - position, line.speed[step] - speed
        wanted = line.acceleration[step] + omega**2 * behind + 1.4 * omega * slower
        return float((self.cell.line.moving_mass + self.cell.car.mass) * wanted)

    def _expose(self) -> None:
        """Let every sensor measure whose instant it is."""
        reach, sight, touch = self._periods
        station, t = self._station, self.time_s
        if self._step % reach == 0:
            self._distance.measure(t, self.unit_position())
        if self._step % sight == 0:
            self._camera.measure(t, station.place(station.rigid), station.place(station.hub))
        if self._step % touch == 0:
            self._force_torque.measure(t, station.wrench())

    def _situation(self, touch_n: float) -> MatingPoses:
        station, wrench = self._station, self._station.wrench()
        return MatingPoses(
            station.six(station.hub, station.tool),
            station.position(station.hub, station.wheel),
            station.position(station.wheel, station.tool),
            touch_n,
            float(np.linalg.norm(wrench[:3])),
            float(np.linalg.norm(wrench[3:])),
        )
