"""True parameters of a run: conveyor, body, robot and sensors.

Invariants:
    Nested frozen dataclasses in SI (m, rad, s, N, Nm); frequencies in Hz.
    A value that is None is drawn by ``scenario_draw.sample``.
    Defaults are the parameters of the study, see docs/method.md.
    Nothing here knows the daemon's settings.
"""

import math
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, Literal

from linemate.simulators.plants.bending.effects_arm import ArmEffects
from linemate.simulators.plants.conveyor_plan import AppliedEvent, Conveyor, applied_events
from linemate.simulators.plants.effects.sensor_errors import CameraEffects, DistanceEffects
from linemate.simulators.plants.forces.switches import CarrierMode, ForceTorqueEffects, Load, Mating

Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]
Vector7 = tuple[float, float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Swing:
    """A damped oscillation of the body about an axis through its suspension.

    Attributes:
        axis: direction in the conveyor frame c (normalised when used).
        amplitude: angle at t = 0 [rad]; None draws it from 0.5..1 times `amplitude_max`.
        amplitude_max: largest amplitude of the swing [rad].
        frequency_hz: frequency of the oscillation.
        damping: damping ratio, share of critical.
        phase: [rad]; None draws it.
    """

    axis: Vector3 = (0.0, 1.0, 0.0)
    amplitude: float | None = None
    amplitude_max: float = 8e-3
    frequency_hz: float = 0.62
    damping: float = 0.002
    phase: float | None = None


@dataclass(frozen=True, slots=True)
class Jerk:
    """A push of the body: a damped sine that starts at `onset_s`.

    Attributes:
        onset_s: scenario time of the onset [s].
        displacement: direction and amplitude in c [m].
        frequency_hz: frequency of the sine.
        damping: damping ratio, share of critical.
    """

    onset_s: float
    displacement: Vector3
    frequency_hz: float = 1.5
    damping: float = 0.15


@dataclass(frozen=True, slots=True)
class Body:
    """The car body on its hanger.

    Attributes:
        nominal: hub at conveyor reading 0 [m], in base; its orientation is that of c.
        offset: hub off nominal, in c [m]; None draws it within +-`offset_range`.
        offset_range: half range of the offset a run [m].
        rotation: hub off nominal as rotation vector in c [rad]; None draws an axis for `tilt`.
        tilt: angle of the drawn rotation [rad].
        suspension_to_hub: vector in c [m].
        swings: oscillations, applied one after another, outermost first.
        carrier: modes that the conveyor's acceleration and the contact force excite.
    """

    nominal: Vector3 = (2.20, 0.0, 1.10)
    offset: Vector3 | None = None
    offset_range: Vector3 = (0.060, 0.080, 0.050)
    rotation: Vector3 | None = None
    tilt: float = math.radians(23.0)
    suspension_to_hub: Vector3 = (0.9, 0.0, -0.3)
    swings: tuple[Swing, ...] = (Swing(),)
    jerks: tuple[Jerk, ...] = ()
    carrier: tuple[CarrierMode, ...] = ()


@dataclass(frozen=True, slots=True)
class DistanceSensor:
    """The distance sensor: it sees the conveyor unit, not the body.

    Attributes:
        period_s: [s]; None takes the controller's cycle.
        phase: instant of measuring within the period, 0..1.
        delay_s: measuring to emission [s].
        jitter_s: half width of the delay's uniform spread [s].
        sigma: noise before quantisation [m].
        quantisation: step of the reading [m], 0 for none.
        outlier_rate: probability of an outlier.
        outlier_range: outliers are uniform in +- this [m].
        dropout_rate: probability that a reading is missing.
        offset: constant error of the reading [m].
    """

    period_s: float | None = None
    phase: float = 0.5
    delay_s: float = 0.001
    jitter_s: float = 0.0
    sigma: float = 0.25e-3
    quantisation: float = 1.0e-3
    outlier_rate: float = 0.003
    outlier_range: float = 0.100
    dropout_rate: float = 0.0
    offset: float = 0.0
    effects: DistanceEffects = field(default_factory=DistanceEffects)


@dataclass(frozen=True, slots=True)
class Camera:
    """The camera in the tool: poses of the hub in the camera's frame, late and noisy.

    Attributes:
        period_s: time between two samples [s].
        phase: instant of exposure within the period, 0..1.
        delay_s: exposure to emission [s].
        jitter_s: half width of the delay's uniform spread [s]; order is kept.
        dropout_rate: probability that an image gives no pose.
        outlier_rate: probability of an outlier.
        outlier_range: outliers are uniform in +- this on each coordinate [m].
        sigma: position noise at distance 0 [m].
        sigma_per_metre: its growth with the distance tool - hub [m/m].
        depth_factor: how much noisier the depth (z) is.
        sigma_rotation: orientation noise at distance 0, each axis [rad].
        sigma_rotation_per_metre: growth of the rotation noise with distance [rad/m].
        blind_below: no pose when the hub is nearer to the tcp than this [m].
        blind_beyond: no pose when it is farther than this [m].
        covariance: whether a covariance is sent.
        covariance_honesty: reported over true standard deviation.
        position_in_tcp: camera in the rigid tcp frame [m].
        rotation_in_tcp: camera in the rigid tcp frame, rotation vector [rad].
    """

    period_s: float = 0.025
    phase: float = 0.3
    delay_s: float = 0.100
    jitter_s: float = 0.015
    dropout_rate: float = 0.03
    outlier_rate: float = 0.02
    outlier_range: float = 0.030
    sigma: float = 0.25e-3
    sigma_per_metre: float = 1.2e-3
    depth_factor: float = 2.0
    sigma_rotation: float = 0.6e-3
    sigma_rotation_per_metre: float = 4.0e-3
    blind_below: float = 0.030
    blind_beyond: float = 1.2
    covariance: bool = True
    covariance_honesty: float = 1.0
    position_in_tcp: Vector3 = (-0.10, 0.0, -0.15)
    rotation_in_tcp: Vector3 = (0.0, 0.0, 0.0)
    effects: CameraEffects = field(default_factory=CameraEffects)


@dataclass(frozen=True, slots=True)
class ForceTorque:
    """The force-torque sensor in the elastic mount; its noise is stated as deflection.

    Attributes:
        period_s: time between two samples [s].
        phase: instant of measuring within the period, 0..1.
        delay_s: measuring to emission [s].
        jitter_s: half width of the delay's uniform spread [s].
        sigma_translation: noise of each force, as deflection [m].
        sigma_rotation: noise of each torque, as deflection [rad].
        bias: constant error, as deflection [m, rad].
        dropout_rate: probability that a reading is missing.
        effects: bias after mounting and drift.
        position_in_tcp: sensor in the rigid tcp frame [m].
        rotation_in_tcp: sensor in the rigid tcp frame, rotation vector [rad].
        sign: -1 for a sensor that states the opposite wrench.
    """

    period_s: float = 0.004
    phase: float = 0.0
    delay_s: float = 0.001
    jitter_s: float = 0.0
    sigma_translation: float = 0.05e-3
    sigma_rotation: float = 0.2e-3
    bias: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    dropout_rate: float = 0.0
    effects: ForceTorqueEffects = field(default_factory=ForceTorqueEffects)
    position_in_tcp: Vector3 = (0.0, 0.0, 0.0)
    rotation_in_tcp: Vector3 = (0.0, 0.0, 0.0)
    sign: Literal[1, -1] = 1


@dataclass(frozen=True, slots=True)
class Axis:
    """One servo axis: dead time and a second order lag with limited acceleration.

    Attributes:
        frequency_hz: natural frequency of the servo [Hz].
        damping: damping ratio, share of critical.
        dead_time_s: dead time of the servo [s].
        acceleration_limit: of the actual motion [rad/s^2] or [m/s^2].
        encoder_sigma: noise of the reading [rad] or [m].
    """

    frequency_hz: float
    damping: float
    dead_time_s: float
    acceleration_limit: float
    encoder_sigma: float = 0.0


@dataclass(frozen=True, slots=True)
class DenavitHartenbergLink:
    """A row of Denavit-Hartenberg's table in Craig's form: Rx(alpha) Tx(a) Rz(theta) Tz(d).

    Attributes:
        alpha: twist before the joint [rad].
        a: length before the joint [m].
        d: offset along the joint's axis [m].
        theta: added to the joint's angle [rad].
    """

    alpha: float
    a: float
    d: float
    theta: float = 0.0


_QUARTER = math.pi / 2

ARM: tuple[DenavitHartenbergLink, ...] = (
    DenavitHartenbergLink(math.pi, 0.0, -0.675),
    DenavitHartenbergLink(_QUARTER, 0.350, 0.0),
    DenavitHartenbergLink(0.0, 1.150, 0.0, _QUARTER),
    DenavitHartenbergLink(-_QUARTER, 0.041, -1.200),
    DenavitHartenbergLink(_QUARTER, 0.0, 0.0),
    DenavitHartenbergLink(-_QUARTER, 0.0, -0.215),
)
"""The arm of the team's geometry: axes A1..A6 turn in KUKA's sense."""


@dataclass(frozen=True, slots=True)
class Robot:
    """Six axes on a linear axis.

    Attributes:
        axes: servos in the order A1..A6, E1.
        start: setpoints and positions at the start, A1..A6 [rad], E1 [m].
        root_position: first frame of the table in base, with E1 at 0 [m].
        root_rotation: the same, rotation vector [rad].
        links: Denavit-Hartenberg table; a half turn about x follows the last row (flange).
        tcp_position: tcp in the flange [m].
        tcp_rotation: tcp in the flange, rotation vector [rad].
        effects: errors of a real arm and its drives, off by default.
    """

    axes: tuple[Axis, Axis, Axis, Axis, Axis, Axis, Axis] = (
        Axis(4.0, 0.75, 0.036, 4.0),
        Axis(4.0, 0.80, 0.036, 5.0),
        Axis(4.5, 0.80, 0.030, 6.0),
        Axis(5.5, 0.85, 0.024, 10.0),
        Axis(6.0, 0.80, 0.024, 12.0),
        Axis(6.5, 0.75, 0.020, 15.0),
        Axis(4.0, 0.80, 0.036, 2.0),
    )
    start: Vector7 = (0.0, -_QUARTER, _QUARTER, 0.0, _QUARTER, 0.0, 0.0)
    root_position: Vector3 = (0.0, 0.0, 0.0)
    root_rotation: Vector3 = (0.0, 0.0, 0.0)
    links: tuple[DenavitHartenbergLink, ...] = ARM
    tcp_position: Vector3 = (-0.35, 0.0, 0.20)
    tcp_rotation: Vector3 = (0.0, -_QUARTER, 0.0)
    effects: ArmEffects = field(default_factory=ArmEffects)


@dataclass(frozen=True, slots=True)
class Effector:
    """The elastic suspension of the tool, one mode an axis of the tool frame.

    Attributes:
        frequency_hz: x y z, rotations about x y z.
        damping: damping ratio of each axis, share of critical.
        stiffness: stiffness along and about each axis [N/m], [Nm/rad].
        load: weight of tool and wheel.
    """

    frequency_hz: Vector6 = (5.0, 4.5, 7.0, 5.5, 6.0, 6.5)
    damping: Vector6 = (0.02, 0.02, 0.02, 0.02, 0.02, 0.02)
    stiffness: Vector6 = (50e3, 50e3, 50e3, 2000.0, 2000.0, 2000.0)
    load: Load = field(default_factory=Load)


@dataclass(frozen=True, slots=True)
class Contact:
    """Mating of tool and hub.

    Attributes:
        capture_lateral: largest lateral error at which the tool catches [m].
        capture_angle: largest error of orientation [rad].
        deflection_limit: beyond it the mount breaks away: a collision [m].
        deflection_angle_limit: the same for rotations [rad].
        hub_radius: a tool that passes the hub plane within it and does not catch has hit [m].
        close_s: the clamp centres and closes within this time [s].
        nutrunner_s: time to fix the screws [s].
        step: rotation of the hub when they are tight, about its own axes [rad].
        step_s: duration of that step [s].
        release_s: order to release until the clamp is open [s].
        clearance: the released tool is free of the hub after this distance [m].
        drag_limit: lateral motion that the released, not yet cleared tool survives [m].
        mating: bolts, flange and friction before the clamp closes.
    """

    capture_lateral: float = 0.006
    capture_angle: float = 0.030
    deflection_limit: float = 0.008
    deflection_angle_limit: float = 0.040
    hub_radius: float = 0.5
    close_s: float = 0.040
    nutrunner_s: float = 1.0
    step: Vector3 = (1.2e-3, -1.5e-3, 0.0)
    step_s: float = 0.050
    release_s: float = 0.3
    clearance: float = 0.010
    drag_limit: float = 0.012
    mating: Mating = field(default_factory=Mating)


@dataclass(frozen=True, slots=True)
class Fault:
    """A timed fault of a link; plants carry it, devices apply it.

    Attributes:
        at_s: scenario time of the begin [s].
        link: "robot", "distance", "camera", "force_torque".
        kind: what happens, in the device's words.
        duration_s: duration of the fault [s].
        value: size, in the kind's unit.
        count: number of times that the fault occurs.
    """

    at_s: float
    link: str
    kind: str
    duration_s: float = 0.0
    value: float = 0.0
    count: int = 1


@dataclass(frozen=True, slots=True)
class Scenario:
    """One run: t = 0 is when the nominal conveyor unit passes s = 0.

    Attributes:
        name: name of the scenario in reports.
        seed: of all random streams.
        cycle_s: the controller's cycle [s].
        lead_in_s: the run starts this long before t = 0 [s].
        duration_s: scenario time at the latest end [s].
        cell_seed: of what stays from car to car: the arm's zeros and links, and the MuJoCo
            station but for its body; None: the seed.
    """

    name: str = "wheel"
    seed: int = 0
    cycle_s: float = 0.012
    lead_in_s: float = 2.0
    duration_s: float = 20.0
    conveyor: Conveyor = field(default_factory=Conveyor)
    body: Body = field(default_factory=Body)
    distance: DistanceSensor = field(default_factory=DistanceSensor)
    camera: Camera = field(default_factory=Camera)
    force_torque: ForceTorque = field(default_factory=ForceTorque)
    robot: Robot = field(default_factory=Robot)
    effector: Effector = field(default_factory=Effector)
    contact: Contact = field(default_factory=Contact)
    faults: tuple[Fault, ...] = ()
    cell_seed: int | None = None

    @property
    def events(self) -> tuple[AppliedEvent, ...]:
        """Stops and starts that really took place, in order of time."""
        return applied_events(self.conveyor)


def to_dict(value: Any) -> Any:
    """Turn a scenario, or a part of it, into dicts and lists of plain values.

    Args:
        value: a dataclass of this file, a tuple or a plain value.

    Returns:
        The same as dicts, lists and plain values.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: to_dict(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, tuple):
        return [to_dict(item) for item in value]
    return value
