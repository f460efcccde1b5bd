"""One line as the robot sees it: car after car, each a world of its own.

The robot goes on from where it stands as the next car enters, and so does the reading of the
distance sensor. The next car enters only while the robot stands still.

Invariants:
- Time only goes forward, and starts at 0.
- A car's world knows nothing of the others.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from linemate.simulators.devices.emulated_world import Floats, Pose, Six
from linemate.simulators.devices.line.cars import Car, CarFault, LinePlan
from linemate.simulators.devices.robot_plant import seven
from linemate.simulators.plants.scenario import Scenario
from linemate.simulators.plants.sensors import CameraEmission, DistanceEmission, WrenchEmission
from linemate.simulators.plants.world import World

AHEAD_S = 1.0  # of a car that is computed as it enters; the rest as it goes on [s]
COVERED_S = 12.0  # time that a covered camera stays covered [s]
SILENT_S = 6.0  # time that a silent force sensor stays silent [s]
NEVER = Car("", "", 0)


class CarLine:
    """Worlds of the cars, one after the other, with one clock, one robot and one reading.

    Attributes:
        car: that is in front of the robot.
        reading: what the distance sensor would read without error [m], less its mount.
    """

    def __init__(self, template: Scenario, plan: LinePlan) -> None:
        """Begin with an empty place.

        Args:
            template: what the cars have in common.
        """
        self._template = replace(template, lead_in_s=plan.entry_s, duration_s=AHEAD_S)
        self._hubs = plan.hubs
        self.car = NEVER
        self.entered_s = 0.0
        self._way = 0.0
        self._first_cycle = 0
        self.world = World(self._scenario(NEVER, template.robot.start))

    def _scenario(self, car: Car, start: tuple[float, ...]) -> Scenario:
        template = self._template
        conveyor = replace(template.conveyor, events=car.events)
        hub = self._hubs.get(car.variant, template.body.nominal)
        robot = replace(template.robot, start=seven(start))
        return replace(
            template,
            seed=car.seed,
            conveyor=conveyor,
            body=replace(template.body, nominal=hub),
            robot=robot,
        )

    def enter(self, car: Car, start: tuple[float, ...], cycle: int) -> None:
        """Let the next car enter.

        Args:
            start: setpoints of the robot, which stands, A1..A6 [rad], E1 [m].
            cycle: number of the controller's cycle that begins now.
        """
        before, now_s = self.world.unit_position() + self._way, self.time_s
        self.car, self.entered_s = car, now_s
        self.world = World(self._scenario(car, start))
        self._way = before - self.world.unit_position()
        self._first_cycle = cycle

    @property
    def car_time_s(self) -> float:
        """Time of the present car: 0 as it passes the start position [s]."""
        return self.world.time_s

    @property
    def is_faulty_now(self) -> bool:
        """The present car's fault has begun."""
        return self.car.fault is not None and self.car_time_s >= self.car.fault_s

    def is_silent(self, sensor: str, at_s: float) -> bool:
        """Return whether the fault of the car silences a sensor at a time of the car [s]."""
        car, since_s = self.car, at_s - self.car.fault_s
        if car is NEVER:
            return sensor == "camera"
        if sensor == "camera" and car.fault is CarFault.PART_MISSING:
            return True
        if sensor == "camera" and car.fault is CarFault.CAMERA_COVERED:
            return 0.0 <= since_s <= COVERED_S
        if sensor == "force_torque" and car.fault is CarFault.FORCE_SILENT:
            return 0.0 <= since_s <= SILENT_S
        return False

    # What a world of the devices must have.

    @property
    def seed(self) -> int:
        """Seed of the line."""
        return self._template.seed

    @property
    def lead_in_s(self) -> float:
        """The line begins at 0."""
        return 0.0

    @property
    def start(self) -> tuple[float, ...]:
        """Axes at the beginning, A1..A6 [rad], E1 [m]."""
        return self._template.robot.start

    @property
    def look_ahead_s(self) -> float:
        """No axis moves on a setpoint before this time has passed [s]."""
        return self.world.look_ahead_s

    @property
    def mount_stiffness(self) -> tuple[float, ...]:
        """Stiffness of the mount, along [N/m] and about [Nm/rad] the tcp's axes."""
        return self.world.mount_stiffness

    @property
    def _ahead_s(self) -> float:
        """What a time of the line is ahead of that of the car [s]."""
        return self.entered_s + self._template.lead_in_s

    @property
    def time_s(self) -> float:
        """Time reached [s]."""
        return self.world.time_s + self._ahead_s

    @property
    def reading(self) -> float:
        """True position of the line, over all cars [m]."""
        return self.world.unit_position() + self._way

    def cycle_start(self, cycle: int) -> float:
        """Time at which a controller cycle begins [s]."""
        return self.world.cycle_start(cycle - self._first_cycle) + self._ahead_s

    def advance(self, t: float) -> None:
        """Go on to a time [s]."""
        self.world.advance(t - self._ahead_s)

    def command(self, setpoints: tuple[float, ...], cycle: int | None = None) -> None:
        """Command the setpoints that the controller moves to during a cycle."""
        self.world.command(setpoints, None if cycle is None else cycle - self._first_cycle)

    def digital_out(self, bits: int) -> None:
        """Set the signals to the tool."""
        self.world.digital_out(bits)

    def digital_in(self) -> int:
        """Signals of the tool."""
        return self.world.digital_in()

    def encoders(self) -> tuple[float, ...]:
        """What the encoders say now."""
        return self.world.encoders()

    def take_distance(self) -> Sequence[DistanceEmission]:
        """Readings of the distance sensor that became due."""
        return [
            self._dated(each)._replace(position=each.position + self._way)
            for each in self.world.take_distance()
        ]

    def take_camera(self) -> Sequence[CameraEmission]:
        """Poses of the camera that became due, unless it is covered or there is no part."""
        return [
            self._dated(each)
            for each in self.world.take_camera()
            if not self.is_silent("camera", each.time_s)
        ]

    def take_wrench(self) -> Sequence[WrenchEmission]:
        """Readings of the force-torque sensor that became due, unless it is silent."""
        return [
            self._dated(each)
            for each in self.world.take_wrench()
            if not self.is_silent("force_torque", each.time_s)
        ]

    def _dated(self, emission: Any) -> Any:
        """Return an emission with the line's times."""
        ahead_s = self._ahead_s
        return emission._replace(
            time_s=emission.time_s + ahead_s, exposure_s=emission.exposure_s + ahead_s
        )

    def reported(self) -> Pose:
        """Tcp as the controller computes it."""
        return self.world.reported()

    def rigid(self) -> Pose:
        """True tcp without the mount's deflection."""
        return self.world.rigid()

    def hub(self) -> Pose:
        """True hub."""
        return self.world.hub()

    def deflection(self) -> Six:
        """Elastic tcp relative to the rigid one [m, rad]."""
        return self.world.deflection()

    def sag(self) -> Six:
        """Part of the deflection that is no contact [m, rad]."""
        return self.world.sag()

    def sway(self) -> Six:
        """Displacement of the hub by the carrier's modes [m, rad]."""
        return self.world.sway()

    def energy(self) -> float:
        """Work on the car in contact [J]."""
        return self.world.energy()

    def hub_pose(self, t: float | None = None) -> Floats:
        """True hub, 4x4."""
        return self.world.hub_pose(None if t is None else t - self._ahead_s)

    def tcp_pose(self) -> Floats:
        """True, elastic tcp, 4x4."""
        return self.world.tcp_pose()

    def unit_position(self) -> float:
        """True position of the line [m]."""
        return self.reading

    def unit_speed(self) -> float:
        """True speed of the line [m/s]."""
        return self.world.unit_speed()

    def unit_motion(self, times: Floats) -> tuple[Floats, Floats]:
        """True positions [m] and speeds [m/s] of the line at ascending times, (n,)."""
        positions, speeds = self.world.unit_motion(times - self._ahead_s)
        return positions + self._way, speeds

    @property
    def contact(self) -> str:
        """Free, clamped or released."""
        return self.world.contact

    @property
    def impact(self) -> Any:
        """First touch of tool and hub, in time of the car."""
        return self.world.impact

    @property
    def collision(self) -> Any:
        """First collision, in time of the car."""
        return self.world.collision

    @property
    def screws_fixed_s(self) -> float | None:
        """When the screws were tight, in time of the car [s]."""
        return self.world.screws_fixed_s

    @property
    def released_s(self) -> float | None:
        """When the tool let go of the wheel, in time of the car [s]."""
        return self.world.released_s
