"""True parameters of a run: conveyor, body, robot and sensors.

Invariants:
    Nested frozen dataclasses in SI (m, rad, s, N, Nm); frequencies in Hz.
    ``sample`` draws a value that is None, with one named random stream a value.
    Defaults are the parameters of the study, see docs/method.md.
    Nothing here knows the daemon's settings.
"""

import math
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, Literal

from linemate.simulators.plants.bending.effects_arm import ArmEffects
from linemate.simulators.plants.effects.conveyor_effects import ConveyorEffects, Order, ShapedRamps
from linemate.simulators.plants.effects.sensor_errors import CameraEffects, DistanceEffects
from linemate.simulators.plants.forces.switches import CarrierMode, ForceTorqueEffects, Load, Mating
from linemate.simulators.plants.streams import stream

Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]
Vector7 = tuple[float, float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class ConveyorEvent:
    """An order to the conveyor's drive.

    Attributes:
        kind: what the conveyor does, "stop" or "start".
        onset_s: scenario time at which the speed begins to change [s].
        acceleration: magnitude of the deceleration or acceleration [m/s^2].
    """

    kind: Literal["stop", "start"]
    onset_s: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class Ripple:
    """Irregularity of the running conveyor; it fades with the speed.

    Attributes:
        speed_sigma: standard deviation of the Ornstein-Uhlenbeck speed [m/s].
        correlation_s: its correlation time [s].
        amplitude: amplitude of the periodic part [m].
        frequency_hz: frequency of the periodic part.
        phase: phase of the periodic part at t = 0 [rad]; None draws it.
    """

    speed_sigma: float = 0.3e-3
    correlation_s: float = 1.0
    amplitude: float = 0.1e-3
    frequency_hz: float = 1.2
    phase: float | None = None


@dataclass(frozen=True, slots=True)
class StopSignal:
    """The signal with which the line's controller announces a stop; it may lie.

    A controller of a cycle of 10 to 50 ms sends it; what drive and brake need comes on top.

    Attributes:
        bit: of the robot controller's inputs; None for a line without the signal.
        lead_s: time from the signal to the onset of the stop, negative for a late one [s].
        false_s: scenario times at which it rises without a stop, for 0.5 s [s].
        stuck: it is always set.
        silent: it does not announce the stops that take place.
    """

    bit: int | None = None
    lead_s: float = 0.0
    false_s: tuple[float, ...] = ()
    stuck: bool = False
    silent: bool = False


@dataclass(frozen=True, slots=True)
class Conveyor:
    """The conveyor unit: nominal speed [m/s], stops and starts, ripple, announced stops."""

    nominal_speed: float = 0.106
    events: tuple[ConveyorEvent, ...] = (
        ConveyorEvent("stop", 5.0, 0.104),
        ConveyorEvent("start", 9.0, 0.013),
    )
    ripple: Ripple = field(default_factory=Ripple)
    effects: ConveyorEffects = field(default_factory=ConveyorEffects)
    stop_signal: StopSignal = field(default_factory=StopSignal)


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
class AppliedEvent:
    """A stop or start that really changed the motion, for judging.

    Attributes:
        kind: what the conveyor does, "stop" or "start".
        onset_s: scenario time of the onset [s].
        speed: speed of the drive at the onset, without ripple [m/s].
        acceleration: signed acceleration of the conveyor [m/s^2].
        settled_s: when the new speed was (or would have been) reached [s].
    """

    kind: Literal["stop", "start"]
    onset_s: float
    speed: float
    acceleration: float
    settled_s: float


@dataclass(frozen=True, slots=True)
class Scenario:
    """One run: t = 0 is when the nominal conveyor unit passes s = 0.

    Attributes:
        name: name of the scenario in reports.
        seed: of all random streams.
        cycle_s: the controller's cycle [s].
        lead_in_s: the run starts this long before t = 0 [s].
        duration_s: scenario time at the latest end [s].
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

    @property
    def events(self) -> tuple[AppliedEvent, ...]:
        """Stops and starts that really took place, in order of time."""
        return applied_events(self.conveyor)


def applied_events(conveyor: Conveyor) -> tuple[AppliedEvent, ...]:
    """Walk through the orders: an order for what is already going on changes nothing.

    Args:
        conveyor: nominal speed and orders; the unit runs before the first order.

    Returns:
        What took place, in order of time, each with the speed at its onset.
    """
    if conveyor.effects.shapes_ramps:
        return shaped_ramps(conveyor)[1]
    running, speed, acceleration, since = True, conveyor.nominal_speed, 0.0, -math.inf
    applied: list[AppliedEvent] = []
    for event in sorted(conveyor.events, key=lambda e: e.onset_s):
        if (event.kind == "start") == running:
            continue
        if applied:
            speed = _clamped_speed(conveyor, speed, acceleration, event.onset_s - since)
        running, since = event.kind == "start", event.onset_s
        acceleration = event.acceleration if running else -event.acceleration
        goal = conveyor.nominal_speed if running else 0.0
        settled = since + (goal - speed) / acceleration
        applied.append(AppliedEvent(event.kind, since, speed, acceleration, settled))
    return tuple(applied)


def shaped_ramps(conveyor: Conveyor) -> tuple[ShapedRamps, tuple[AppliedEvent, ...]]:
    """Return the drive's motion of a conveyor whose ramps are shaped, and what took place."""
    orders: list[Order] = []
    running = True
    for event in sorted(conveyor.events, key=lambda e: e.onset_s):
        if (event.kind == "start") != running:
            running = not running
            orders.append(Order(running, event.onset_s, event.acceleration))
    ramps = ShapedRamps(conveyor.nominal_speed, orders, conveyor.effects)
    applied = tuple(
        AppliedEvent(
            "start" if order.starts else "stop",
            order.onset_s,
            speed,
            order.acceleration if order.starts else -order.acceleration,
            settled,
        )
        for order, speed, settled in zip(orders, ramps.speeds, ramps.settled, strict=True)
    )
    return ramps, applied


def _clamped_speed(conveyor: Conveyor, speed: float, acceleration: float, age: float) -> float:
    return min(max(speed + acceleration * age, 0.0), conveyor.nominal_speed)


def sample(seed: int, scenario: Scenario | None = None) -> Scenario:
    """Draw what the scenario leaves open (None), each value from its own stream.

    Args:
        seed: of the run; it replaces the scenario's.
        scenario: what is given; the default is the study's.

    Returns:
        A scenario without open values. Sampling it again with the same seed changes nothing.
    """
    scenario = replace(scenario or Scenario(), seed=seed)
    ripple = scenario.conveyor.ripple
    if ripple.phase is None:
        ripple = replace(ripple, phase=float(stream(seed, "ripple.phase").uniform(0, math.tau)))
    conveyor = replace(scenario.conveyor, ripple=ripple)
    effector = _sample_effector(seed, scenario.effector)
    body = _sample_body(seed, scenario.body)
    contact = _sample_contact(seed, scenario.contact)
    return replace(scenario, conveyor=conveyor, body=body, effector=effector, contact=contact)


def _sample_contact(seed: int, contact: Contact) -> Contact:
    mating = contact.mating
    if mating.angle is not None:
        return contact
    share = float(stream(seed, "mating.angle").uniform(-1, 1))
    return replace(contact, mating=replace(mating, angle=share * mating.angle_range))


def _sample_effector(seed: int, effector: Effector) -> Effector:
    load = effector.load
    mass = _spread(seed, "load.wheel_mass", load.wheel_mass, load.wheel_mass_spread)
    return replace(effector, load=replace(load, wheel_mass=mass, wheel_mass_spread=0.0))


def _sample_body(seed: int, body: Body) -> Body:
    if body.offset is None:
        x, y, z = stream(seed, "body.offset").uniform(-1, 1, 3).tolist()
        range_x, range_y, range_z = body.offset_range
        body = replace(body, offset=(x * range_x, y * range_y, z * range_z))
    if body.rotation is None:
        # Mostly a turn about z and y; about x it would be a body that hangs askew.
        axis = stream(seed, "body.rotation").standard_normal(3) * (0.3, 1.0, 1.0)
        x, y, z = (axis * (body.tilt / math.sqrt(float(axis @ axis)))).tolist()
        body = replace(body, rotation=(x, y, z))
    swings = tuple(_sample_swing(seed, i, swing) for i, swing in enumerate(body.swings))
    carrier = tuple(_sample_mode(seed, i, mode) for i, mode in enumerate(body.carrier))
    return replace(body, swings=swings, carrier=carrier)


def _sample_swing(seed: int, index: int, swing: Swing) -> Swing:
    if swing.amplitude is None:
        share = float(stream(seed, f"swing.{index}.amplitude").uniform(0.5, 1.0))
        swing = replace(swing, amplitude=share * swing.amplitude_max)
    if swing.phase is None:
        phase = float(stream(seed, f"swing.{index}.phase").uniform(0, math.tau))
        swing = replace(swing, phase=phase)
    return swing


def _sample_mode(seed: int, index: int, mode: CarrierMode) -> CarrierMode:
    return replace(
        mode,
        frequency_hz=_spread(
            seed, f"carrier.{index}.frequency", mode.frequency_hz, mode.frequency_spread
        ),
        mass=_spread(seed, f"carrier.{index}.mass", mode.mass, mode.mass_spread),
        frequency_spread=0.0,
        mass_spread=0.0,
    )


def _spread(seed: int, name: str, value: float, share: float) -> float:
    return value * (1.0 + share * float(stream(seed, name).uniform(-1, 1))) if share else value


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
