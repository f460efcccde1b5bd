"""Sizes of the MuJoCo station, and the draw of what differs from run to run.

Invariants:
    Nested frozen dataclasses in SI (m, rad, s, N, kg); frequencies in Hz.
    A value that is None is drawn by ``sample``, each from a stream of its own.
    The sizes and their sources are listed in docs/mujoco.md. They were written down before a run.
"""

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

SHORTEST_RUN_S = 36.0
"""The bolts are met at 10 mm/s, and a start in that time makes the tool look once more."""

Three = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]
Seven = tuple[float, float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Car:
    """The car body, hung from a carrier on the conveyor.

    Attributes:
        mass: of the body [kg].
        inertia: about its centre of gravity: pitch, roll, yaw [kg m^2].
        hanger: suspension above the centre of gravity [m].
        hub_in_centre: hub seen from the centre of gravity: towards the robot, along the
            conveyor, up [m].
        fore_aft_hz: frequency of the pendulum along the conveyor.
        lateral_hz: frequency of the pendulum across the conveyor.
        yaw_hz: frequency of the turn about the vertical.
        fore_aft_damping: damping ratio of that mode; None draws it, as those of the others.
        lateral_damping: of the pendulum across the conveyor.
        yaw_damping: of the turn about the vertical.
        excitation: acceleration amplitude that each mode starts the run with, at the hub [m/s^2].
        offset: hub off its nominal place in base [m].
        tilt: hub off its nominal orientation, rotation vector in base [rad].
    """

    mass: float = 900.0
    inertia: Three = (1100.0, 350.0, 1300.0)
    hanger: float = 1.2
    hub_in_centre: Three = (-0.80, 0.20, -0.30)
    fore_aft_hz: float | None = None
    lateral_hz: float | None = None
    yaw_hz: float | None = None
    fore_aft_damping: float | None = None
    lateral_damping: float | None = None
    yaw_damping: float | None = None
    excitation: float | None = None
    offset: Three | None = None
    tilt: Three | None = None


@dataclass(frozen=True, slots=True)
class Line:
    """The conveyor.

    Attributes:
        moving_mass: of chain and carriers that move together [kg].
        drive_hz: stiffness of the drive, as the frequency of that mass on it.
        speed_share: true speed over the one ordered.
        ramp_share: true acceleration over the one ordered.
        rounding_s: time over which an acceleration builds up (S-shape) [s].
        askew: direction of travel turned about the vertical [rad].
        chain_amplitude: speed variation of the chain's polygon [m/s].
        chain_hz: its frequency at nominal speed.
        wander: slow variation of the speed [m/s].
    """

    moving_mass: float = 20e3
    drive_hz: float = 8.0
    speed_share: float | None = None
    ramp_share: float | None = None
    rounding_s: float | None = None
    askew: float | None = None
    chain_amplitude: float = 0.6e-3
    chain_hz: float = 1.06
    wander: float = 0.3e-3


@dataclass(frozen=True, slots=True)
class ArmDrives:
    """Drives and joints of A1..A6, and of E1 (last of seven).

    Attributes:
        stiffness: of the gear of A1..A6 [Nm/rad].
        gear_damping: damping ratio of the motor on its gear.
        motor_inertia: seen from the joint, A1..A6 [kg m^2].
        link_friction: dry friction behind the gear [Nm].
        motor_friction: dry friction before the gear [Nm], E1 [N].
        smoothing_s: two moving averages of the setpoints of A1..A6, one after the other [s].
        linear_smoothing_s: the same of E1 [s].
        position_gain: of the position loop [1/s].
        velocity_gain: bandwidth of the velocity loop [rad/s].
        integral_s: reset time of the velocity loop [s].
        dead_time_s: setpoint received until it acts [s], the same for all axes.
        counterbalance: share of the arm's weight that a gas spring carries.
        gravity_error: share by which the controller's load data are wrong.
        friction_share: friction of this arm over the values above.
        encoder_step: resolution at the joint [rad], E1 [m].
    """

    stiffness: Six = (2.5e6, 3.0e6, 2.0e6, 4.0e5, 4.0e5, 2.5e5)
    gear_damping: float = 0.05
    motor_inertia: Six = (160.0, 200.0, 150.0, 25.0, 25.0, 15.0)
    link_friction: Six = (500.0, 600.0, 400.0, 60.0, 60.0, 40.0)
    motor_friction: Seven = (150.0, 150.0, 120.0, 30.0, 30.0, 20.0, 300.0)
    smoothing_s: tuple[float, float] = (0.072, 0.048)
    linear_smoothing_s: tuple[float, float] = (0.096, 0.060)
    position_gain: Seven = (50.0, 50.0, 50.0, 50.0, 50.0, 50.0, 40.0)
    velocity_gain: Seven = (250.0, 250.0, 250.0, 250.0, 250.0, 250.0, 200.0)
    integral_s: float = 0.10
    dead_time_s: float | None = None
    counterbalance: float = 0.7
    gravity_error: float | None = None
    friction_share: float | None = None
    encoder_step: float = 5e-6


@dataclass(frozen=True, slots=True)
class Tool:
    """Elastic mount, tool and wheel.

    Attributes:
        tool_mass: without the wheel [kg].
        wheel_mass: mass that the gripper carries [kg].
        tool_centre: centre of gravity of the tool in the tcp frame [m].
        wheel_centre: centre of gravity of the wheel in the tcp frame [m].
        stiffness: of the mount by its data sheet: along [N/m] and about [Nm/rad].
        stiffness_share: true stiffness over that of the data sheet.
        damping: damping ratio of the mount.
        hole_clearance: radius of a bolt hole over the bolt's [m].
        chamfer: widening of a hole at its mouth [m].
        friction: in the contact of wheel and hub.
        bolt_angle: bolt circle turned about the hub's axis [rad].
        screws_s: time to fix the screws [s].
        release_s: order to release until the gripper is open [s].
        mount_limit: force on the mount at which its break-away opens [N].
        mount_torque_limit: torque at which it opens [Nm].
        contact_limit: force between wheel and hub that is a collision [N].
    """

    tool_mass: float = 10.0
    wheel_mass: float | None = None
    tool_centre: Three = (0.01, 0.0, -0.12)
    wheel_centre: Three = (0.0, 0.0, -0.05)
    stiffness: Six = (50e3, 50e3, 50e3, 2000.0, 2000.0, 2000.0)
    stiffness_share: float | None = None
    damping: float = 0.02
    hole_clearance: float = 0.3e-3
    chamfer: float = 2.0e-3
    friction: float | None = None
    bolt_angle: float | None = None
    screws_s: float = 1.2
    release_s: float | None = None
    mount_limit: float = 400.0
    mount_torque_limit: float = 80.0
    contact_limit: float = 2500.0


@dataclass(frozen=True, slots=True)
class Sensors:
    """Errors and instants of the three sensors.

    Attributes:
        camera_period_s: between two images [s].
        camera_delay_s: exposure to emission [s].
        camera_jitter_s: half width of that delay's spread [s].
        camera_stamp_s: how much too late an exposure is dated [s].
        camera_sigma: white noise of a position near the hub [m].
        camera_sigma_per_metre: its growth with the distance [m/m].
        camera_angle: white noise of an angle [rad].
        camera_wander: standard deviation of the correlated noise [m].
        camera_wander_s: its correlation time [s].
        camera_range_bias: depth error over the distance [m/m].
        camera_blind: no pose nearer than this [m].
        camera_dropout: share of images without a pose.
        hand_eye: residual error of its calibration, in the camera's frame [m].
        hand_eye_angle: the same as a rotation vector [rad].
        distance_period_s: between two readings [s].
        distance_delay_s: age of a reading when it arrives; its date does not say so [s].
        distance_sigma: noise of a reading [m].
        distance_step: smallest difference of two readings [m].
        distance_scale: scale error of the measuring wheel.
        force_period_s: between two readings [s].
        force_sigma: noise of a force [N].
        torque_sigma: noise of a torque [Nm].
        force_drift: drift of each force [N/s].
    """

    camera_period_s: float = 0.033
    camera_delay_s: float = 0.080
    camera_jitter_s: float = 0.010
    camera_stamp_s: float | None = None
    camera_sigma: float = 0.20e-3
    camera_sigma_per_metre: float = 1.0e-3
    camera_angle: float = 0.8e-3
    camera_wander: float = 0.15e-3
    camera_wander_s: float = 0.4
    camera_range_bias: float | None = None
    camera_blind: float = 0.030
    camera_dropout: float = 0.03
    hand_eye: Three | None = None
    hand_eye_angle: Three | None = None
    distance_period_s: float = 0.004
    distance_delay_s: float = 0.003
    distance_sigma: float = 0.20e-3
    distance_step: float = 0.5e-3
    distance_scale: float | None = None
    force_period_s: float = 0.004
    force_sigma: float = 1.5
    torque_sigma: float = 0.15
    force_drift: float | None = None


@dataclass(frozen=True, slots=True)
class MujocoCell:
    """The station: everything that MuJoCo and the sensors are made of."""

    car: Car = field(default_factory=Car)
    line: Line = field(default_factory=Line)
    arm: ArmDrives = field(default_factory=ArmDrives)
    tool: Tool = field(default_factory=Tool)
    sensors: Sensors = field(default_factory=Sensors)


@dataclass(frozen=True, slots=True)
class DrivenRamp:
    """An order to the conveyor: towards rest or towards nominal speed."""

    onset_s: float
    starts: bool
    acceleration: float


@dataclass(frozen=True, slots=True)
class RunOrder:
    """What is asked of a run, whatever station it is on.

    Attributes:
        start: axes at the beginning, A1..A6 [rad], E1 [m].
        nominal_speed: of the conveyor [m/s].
        hub: nominal place of the hub at conveyor reading 0, in base [m].
        cell_seed: of what stays from car to car: all but the body; None: the seed.
    """

    seed: int
    cycle_s: float
    lead_in_s: float
    duration_s: float
    start: tuple[float, ...]
    nominal_speed: float
    ramps: tuple[DrivenRamp, ...]
    hub: Three
    cell_seed: int | None = None


_Part = TypeVar("_Part", Car, Line, ArmDrives, Tool, Sensors)


_Value = TypeVar("_Value")


def known(value: _Value | None) -> _Value:
    """Return a value that was drawn.

    Raises:
        ValueError: it is open: the cell is to be sampled first.
    """
    if value is None:
        raise ValueError("a value of the cell is open: sample the cell first")
    return value


class _Draw:
    """Random values by name: a new value leaves those of the other names as they were."""

    def __init__(self, seed: int) -> None:
        self._seed = seed

    def _stream(self, name: str) -> np.random.Generator:
        return np.random.default_rng((self._seed, zlib.crc32(b"mujoco." + name.encode())))

    def uniform(self, name: str, low: float, high: float) -> float:
        return float(self._stream(name).uniform(low, high))

    def logarithmic(self, name: str, low: float, high: float) -> float:
        return math.exp(self.uniform(name, math.log(low), math.log(high)))

    def box(self, name: str, half: Sequence[float]) -> Three:
        x, y, z = (self._stream(name).uniform(-1.0, 1.0, 3) * half).tolist()
        return (x, y, z)

    def normal(self, name: str, sigma: float) -> Three:
        x, y, z = (sigma * self._stream(name).standard_normal(3)).tolist()
        return (x, y, z)


def sample(seed: int, cell: MujocoCell, cell_seed: int | None = None) -> MujocoCell:
    """Draw what the station leaves open.

    Args:
        cell_seed: of all but the body; None: the seed.

    Returns:
        A station without open values.
    """
    draw = _Draw(seed if cell_seed is None else cell_seed)
    return replace(
        cell,
        car=_drawn(cell.car, _car(_Draw(seed))),
        line=_drawn(cell.line, _line(draw)),
        arm=_drawn(cell.arm, _arm(draw)),
        tool=_drawn(cell.tool, _tool(draw)),
        sensors=_drawn(cell.sensors, _sensors(draw)),
    )


def _drawn(part: _Part, values: dict[str, Any]) -> _Part:
    return replace(part, **{k: v for k, v in values.items() if getattr(part, k) is None})


def _car(draw: _Draw) -> dict[str, Any]:
    return {
        "fore_aft_hz": draw.logarithmic("car.fore_aft_hz", 0.45, 5.0),
        "lateral_hz": draw.logarithmic("car.lateral_hz", 0.45, 2.0),
        "yaw_hz": draw.logarithmic("car.yaw_hz", 0.8, 4.0),
        "fore_aft_damping": draw.uniform("car.fore_aft_damping", 0.01, 0.05),
        "lateral_damping": draw.uniform("car.lateral_damping", 0.01, 0.05),
        "yaw_damping": draw.uniform("car.yaw_damping", 0.01, 0.05),
        "excitation": draw.uniform("car.excitation", 0.01, 0.05),
        "offset": draw.box("car.offset", (0.040, 0.050, 0.030)),
        "tilt": draw.box("car.tilt", (0.08, 0.08, 0.08)),
    }


def _line(draw: _Draw) -> dict[str, Any]:
    return {
        "speed_share": draw.uniform("line.speed", 0.98, 1.02),
        "ramp_share": draw.uniform("line.ramp", 0.9, 1.1),
        "rounding_s": draw.uniform("line.rounding", 0.05, 0.25),
        "askew": draw.uniform("line.askew", -3e-3, 3e-3),
    }


def _arm(draw: _Draw) -> dict[str, Any]:
    return {
        "dead_time_s": draw.uniform("arm.dead_time", 0.026, 0.034),
        "gravity_error": draw.uniform("arm.gravity", -0.05, 0.05),
        "friction_share": draw.uniform("arm.friction", 0.3, 1.0),
    }


def _tool(draw: _Draw) -> dict[str, Any]:
    return {
        "wheel_mass": draw.uniform("tool.wheel", 20.0, 25.0),
        "stiffness_share": draw.uniform("tool.stiffness", 0.9, 1.1),
        "friction": draw.uniform("tool.friction", 0.1, 0.3),
        "bolt_angle": draw.uniform("tool.bolts", -0.005, 0.005),
        "release_s": draw.uniform("tool.release", 0.1, 0.6),
    }


def _sensors(draw: _Draw) -> dict[str, Any]:
    return {
        "camera_stamp_s": draw.uniform("camera.stamp", -0.003, 0.003),
        "camera_range_bias": draw.uniform("camera.bias", -2e-3, 2e-3),
        "hand_eye": draw.normal("camera.hand_eye", 0.2e-3),
        "hand_eye_angle": draw.normal("camera.hand_eye_angle", 0.3e-3),
        "distance_scale": draw.uniform("distance.scale", -1e-3, 1e-3),
        "force_drift": draw.uniform("force.drift", -0.05, 0.05),
    }
