"""Plant of one run: conveyor, body, robot, tool, contact and sensors.

Invariants:
    Scenario time is an argument and only goes forward.
    The same commands at the same cycles give the same world to the byte.
    Substeps are at most 4 ms and divide the cycle.
    Sensors are evaluated at their exact instants.
"""

import math
from collections import deque
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from linemate.simulators.plants import rotation
from linemate.simulators.plants.arm import ArmPlant
from linemate.simulators.plants.bending.drives import drives
from linemate.simulators.plants.bending.link_side import link_side, true_links
from linemate.simulators.plants.body import BodyPlant
from linemate.simulators.plants.contact_plant import Collision, ContactPlant, Impact, Phase
from linemate.simulators.plants.conveyor_plant import ConveyorPlant
from linemate.simulators.plants.effector import ZERO, EffectorPlant, Six, deflected
from linemate.simulators.plants.forces.carried import CarriedBody
from linemate.simulators.plants.rotation import Pose
from linemate.simulators.plants.scenario import Scenario
from linemate.simulators.plants.scenario_draw import sample
from linemate.simulators.plants.sensors import (
    CameraEmission,
    CameraPlant,
    DistanceEmission,
    DistanceSensorPlant,
    ForceTorquePlant,
    WrenchEmission,
)
from linemate.simulators.plants.streams import Draws

SUBSTEP_S = 0.004
"""Longest substep of the integration [s]."""

_TINY = 1e-9
_TRACK_BLOCK = 128
_AHEAD = 64

Matrix = NDArray[np.float64]
_Emission = TypeVar("_Emission", DistanceEmission, CameraEmission, WrenchEmission)


class World:
    """One run of the plant, from t = -lead_in_s on."""

    def __init__(self, scenario: Scenario) -> None:
        scenario = sample(scenario.seed, scenario)
        self.scenario = scenario
        seed, start = scenario.seed, -scenario.lead_in_s
        self._start = start
        self._substeps = max(1, math.ceil(scenario.cycle_s / SUBSTEP_S - _TINY))
        self._h = scenario.cycle_s / self._substeps
        self._conveyor = ConveyorPlant(scenario.conveyor, seed, start)
        self._body = BodyPlant(scenario.body)
        self._arm = ArmPlant(scenario.robot)
        cell = seed if scenario.cell_seed is None else scenario.cell_seed
        self._real_arm = ArmPlant(replace(scenario.robot, links=true_links(scenario.robot, cell)))
        self._servos = drives(scenario.robot, scenario.cycle_s, self._substeps)
        self._links = link_side(scenario.robot, cell)
        self._effector = EffectorPlant(scenario.effector, self._h)
        self._contact = ContactPlant(scenario.contact, scenario.effector)
        self._carried = self._new_carried(scenario)
        self._distance = DistanceSensorPlant(scenario.distance, seed, start, scenario.cycle_s)
        self._camera = CameraPlant(scenario.camera, seed, start)
        self._force_torque = ForceTorquePlant(scenario.force_torque, scenario.effector, seed, start)
        self._encoder_sigmas = tuple(axis.encoder_sigma for axis in scenario.robot.axes)
        self._encoder_draws = Draws.normal(seed, "robot.encoders")
        self._encoder_noise: tuple[float, ...] = (0.0,) * 7
        self._is_noisy = any(self._encoder_sigmas)
        self._encoder_steps = scenario.robot.effects.quantisation
        self._is_quantised = any(self._encoder_steps)
        self._track: list[Pose] = []
        # What depends on time alone is computed a block ahead, the last one first.
        self._units_measured: list[float] = []
        self._hubs_seen: list[Pose] = []
        self._next_exposure = start
        self._index = 0
        self._grid = start
        self._now = start
        start_joints = scenario.robot.start
        self._rigid = self._real_arm.tcp(
            start_joints if self._links is None else self._links.at(start_joints)
        )
        self._effector.rest(self._rigid)
        self._look_ahead(math.ceil((scenario.duration_s + scenario.lead_in_s) / self._h) + 1)
        self._hub = self._track[0]
        self._begin_cycle()

    @property
    def seed(self) -> int:
        """Seed of the run."""
        return self.scenario.seed

    @property
    def lead_in_s(self) -> float:
        """The run starts this long before t = 0 [s]."""
        return self.scenario.lead_in_s

    @property
    def start(self) -> tuple[float, ...]:
        """Axes at the beginning, A1..A6 [rad], E1 [m]."""
        return self.scenario.robot.start

    @property
    def look_ahead_s(self) -> float:
        """No axis moves on a setpoint before this time has passed [s]."""
        return min(axis.dead_time_s for axis in self.scenario.robot.axes)

    @property
    def mount_stiffness(self) -> tuple[float, ...]:
        """Stiffness of the mount, along [N/m] and about [Nm/rad] the tcp's axes."""
        return self.scenario.effector.stiffness

    @property
    def time_s(self) -> float:
        """Scenario time reached [s]."""
        return self._now

    @property
    def cycle(self) -> int:
        """Number of the present controller cycle, 0 at the start of the run."""
        return self._index // self._substeps

    def cycle_start(self, cycle: int) -> float:
        """Scenario time at which a controller cycle begins [s]."""
        return self._start + cycle * self._substeps * self._h

    def advance(self, t: float) -> None:
        """Integrate to scenario time t.

        Args:
            t: not before the time reached [s].

        Raises:
            ValueError: when t is in the past.
        """
        if t < self._now - _TINY:
            raise ValueError(f"time runs forward: at {self._now} s, asked for {t} s")
        following = self._start + (self._index + 1) * self._h
        while following <= t + _TINY:
            self._expose(following - _TINY)
            self._step(following)
            following = self._start + (self._index + 1) * self._h
        self._expose(t + _TINY)
        self._now = max(t, self._grid)

    def command(self, setpoints: tuple[float, ...], cycle: int | None = None) -> None:
        """Command the setpoints that the controller moves to during a cycle.

        A reply that arrives late may still be given while no axis has moved on it, that is
        within the shortest dead time after the cycle's start, even in the next cycle.

        Args:
            setpoints: A1..A6 [rad], E1 [m], reached at the end of the cycle.
            cycle: the present one, which None means as well, or the one before it.

        Raises:
            ValueError: wrong number, not finite, too late, or another cycle.
        """
        values = tuple(map(float, setpoints))
        if len(values) != 7 or not math.isfinite(sum(values)):
            raise ValueError(f"seven finite setpoints wanted, got {setpoints}")
        if cycle is None:
            cycle = self.cycle
        self._servos.command(cycle, self._now - self.cycle_start(cycle), values)

    def digital_out(self, bits: int) -> None:
        """Set the signals to the tool: bit 0 fix the screws, bit 1 release the wheel."""
        self._contact.order(bits)

    def digital_in(self) -> int:
        """Signals: bit 0 screws fixed, bit 1 wheel released, and the line's if it has one."""
        return self._contact.signals | self._conveyor.signals(self._now)

    def encoders(self) -> tuple[float, ...]:
        """What the encoders say now: A1..A6 [rad], E1 [m]."""
        read = self._motors_at(self._now)
        if self._is_noisy:
            read = tuple(q + n for q, n in zip(read, self._encoder_noise, strict=True))
        if self._is_quantised:
            read = tuple(
                step * round(q / step) if step else q
                for q, step in zip(read, self._encoder_steps, strict=True)
            )
        return read

    @property
    def velocities(self) -> tuple[float, ...]:
        """A1..A6 [rad/s], E1 [m/s] at the last substep."""
        return self._servos.velocities

    def rigid(self) -> Pose:
        """Rigid tcp in base, now."""
        return self._rigid_at(self._now)

    def reported(self) -> Pose:
        """Tcp in base as the controller computes it from its encoders, now."""
        return self._arm.tcp(self._motors_at(self._now))

    def hub(self) -> Pose:
        """True hub in base, now."""
        return self._hub if self._on_grid(self._now) else self._hub_at(self._now)

    def take_distance(self) -> list[DistanceEmission]:
        """Readings of the distance sensor that became due since the last call."""
        return self._pop_due(self._distance.due)

    def take_camera(self) -> list[CameraEmission]:
        """Poses of the camera that became due since the last call."""
        return self._pop_due(self._camera.due)

    def take_wrench(self) -> list[WrenchEmission]:
        """Readings of the force-torque sensor that became due since the last call."""
        return self._pop_due(self._force_torque.due)

    def hub_pose(self, t: float | None = None) -> Matrix:
        """True hub in base, 4x4, at t (default now).

        The future knows no step of the screws that is not ordered, and no force of contact.
        """
        return rotation.matrix(self.hub() if t is None else self._hub_at(t))

    def tcp_rigid_pose(self) -> Matrix:
        """Rigid tcp in base, 4x4, now."""
        return rotation.matrix(self._rigid_at(self._now))

    def tcp_pose(self) -> Matrix:
        """True, elastic tcp in base, 4x4, now."""
        return rotation.matrix(deflected(self._rigid_at(self._now), self.deflection()))

    def deflection(self) -> Six:
        """Elastic tcp relative to the rigid one, in the rigid tcp frame [m, rad], now."""
        return self._deflection_at(self._now)

    def sag(self) -> Six:
        """Part of the deflection that the weight of tool and wheel makes, now."""
        return self._effector.sag(self._rigid_at(self._now))

    def sway(self) -> Six:
        """Displacement [m] and rotation [rad] of the hub by the carrier's modes in c, now."""
        if self._carried is None:
            return ZERO
        x, y, z, a, b, c = self._carried.sway.tolist()
        return (x, y, z, a, b, c)

    def energy(self) -> float:
        """Work that the robot has done on the car in contact, relative to the conveyor [J]."""
        return 0.0 if self._carried is None else self._carried.energy

    def unit_position(self, t: float | None = None) -> float:
        """True position of the conveyor unit [m]."""
        return self._conveyor.at(self._now if t is None else t)[0]

    def unit_speed(self, t: float | None = None) -> float:
        """True speed of the conveyor unit [m/s]."""
        return self._conveyor.at(self._now if t is None else t)[1]

    def unit_motion(self, times: Matrix) -> tuple[Matrix, Matrix]:
        """True positions [m] and speeds [m/s] of the conveyor unit at ascending times, (n,)."""
        return self._conveyor.motion(times)

    @property
    def contact(self) -> Phase:
        """Free, clamped or released."""
        return self._contact.phase

    @property
    def impact(self) -> Impact | None:
        """The instant at which the tool reached the hub plane."""
        return self._contact.impact

    @property
    def collision(self) -> Collision | None:
        """The first collision, if any."""
        return self._contact.collision

    @property
    def screws_fixed_s(self) -> float | None:
        """When the screws were tight [s]."""
        return self._contact.fixed_s

    @property
    def released_s(self) -> float | None:
        """When the tool let go of the wheel [s]."""
        return self._contact.released_s

    def _new_carried(self, scenario: Scenario) -> CarriedBody | None:
        if not scenario.body.carrier:
            return None
        parts = self._start, self._h, self._contact, self._effector
        return CarriedBody(scenario, lambda times: self.unit_motion(times)[1], *parts)

    def _begin_cycle(self) -> None:
        self._servos.begin_cycle(self.cycle)
        if self._is_noisy:
            noise = self._encoder_draws.next_numbers(7)
            self._encoder_noise = tuple(
                s * n for s, n in zip(self._encoder_sigmas, noise, strict=True)
            )

    def _step(self, following: float) -> None:
        self._servos.advance(self._index)
        joints, links = self._servos.positions, self._links
        if links is not None:
            joints = links.advance(joints, self._servos.velocities, self._h)
        rigid = self._real_arm.tcp(joints)
        self._index = index = self._index + 1
        if index >= len(self._track):
            self._look_ahead(_TRACK_BLOCK)
        contact = self._contact
        hub = unmoved = self._track[index]
        carried = self._carried
        if carried is not None:
            hub = carried.hub(following, rigid, unmoved)
        hub = contact.turned(hub, following)
        contact.advance(following, self._h, self._effector, self._rigid, rigid, hub)
        if carried is not None:
            hub = carried.settle(following, rigid, hub, unmoved)
        self._grid, self._rigid, self._hub = following, rigid, hub
        if index % self._substeps == 0:
            self._begin_cycle()

    def _look_ahead(self, count: int) -> None:
        """Compute the hub at the next `count` grid points: it depends on time alone."""
        begin = len(self._track)
        times = self._start + self._h * np.arange(begin, begin + count, dtype=np.float64)
        self._track += self._hubs(times)

    def _expose(self, limit: float) -> None:
        """Let every sensor measure at its instants before `limit`."""
        if self._next_exposure >= limit:
            return
        touch, reach, sight = self._force_torque.clock, self._distance.clock, self._camera.clock
        while touch.next_s < limit:
            self._force_torque.measure(self._deflection_at(touch.next_s))
        while reach.next_s < limit:
            if not self._units_measured:
                ahead = self._conveyor.positions(reach.upcoming(_AHEAD))
                self._units_measured = ahead[::-1].tolist()
            self._distance.measure(self._units_measured.pop())
        while sight.next_s < limit:
            t = sight.next_s
            if not self._hubs_seen:
                upcoming = sight.upcoming(_AHEAD)
                self._hubs_seen = self._hubs(upcoming)[::-1]
                if self._carried is not None:
                    self._carried.foresee(upcoming)
            rigid, hub = self._rigid_at(t), self._hubs_seen.pop()
            if self._carried is not None:
                hub = self._carried.hub_within(t, rigid, hub)
            self._camera.measure(rigid, self._contact.turned(hub, t))
        self._next_exposure = min(touch.next_s, reach.next_s, sight.next_s)

    def _hubs(self, times: Matrix) -> list[Pose]:
        positions = self._conveyor.positions(times)
        hubs = self._body.hubs(positions, times)
        if not self._conveyor.leaves_line:
            return hubs
        return [
            (rotation.add(place, shift), turn)
            for (place, turn), shift in zip(
                hubs, self._conveyor.off_line(positions).tolist(), strict=True
            )
        ]

    def _on_grid(self, t: float) -> bool:
        return abs(t - self._grid) < _TINY

    def _hub_at(self, t: float) -> Pose:
        if self._conveyor.leaves_line:
            hub = self._hubs(np.array([t]))[0]
        else:
            hub = self._body.hub(self._conveyor.at(t)[0], t)
        if self._carried is not None:
            if self._grid <= t < self._grid + self._h:
                hub = self._carried.hub_within(t, self._rigid_at(t), hub)
            else:
                hub = self._carried.hub_at(t, hub)
        return self._contact.turned(hub, t)

    def _motors_at(self, t: float) -> tuple[float, ...]:
        if self._on_grid(t):
            return self._servos.positions
        return self._servos.peek(self._index, t - self._grid)

    def _rigid_at(self, t: float) -> Pose:
        if self._on_grid(t):
            return self._rigid
        joints = self._motors_at(t)
        return self._real_arm.tcp(joints if self._links is None else self._links.at(joints))

    def _deflection_at(self, t: float) -> Six:
        if self._on_grid(t):
            return self._effector.deflection
        rigid = self._rigid_at(t)
        if self._contact.phase == "clamped":
            return self._contact.held_deflection(t, rigid, self._hub_at(t))
        return self._effector.peek(self._rigid, rigid, t - self._grid)

    def _pop_due(self, due: "deque[_Emission]") -> "list[_Emission]":
        taken: list[_Emission] = []
        while due and due[0].time_s <= self._now + _TINY:
            taken.append(due.popleft())
        return taken
