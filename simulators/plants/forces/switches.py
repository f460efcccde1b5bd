"""Switches and sizes of what forces do to the car, the tool and the mount.

Invariants:
    Nested frozen dataclasses in SI (m, rad, s, N, Nm); frequencies in Hz.
    Every default is off: the world is then the study's.
    Each size has a source or is marked as an estimate.
"""

from dataclasses import dataclass

Vector3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class CarrierMode:
    """A mode of the car in its carrier: m (x'' + 2 zeta w x' + w^2 x) = F - m g a.

    x is a coordinate [m]; ``direction`` and ``turn`` give what the hub does per metre of it.
    a is the true acceleration of the conveyor, ripple included; F is the contact's generalised
    force at the hub. Amplitude after a ramp of acceleration a is about g a / w^2:
    0.13 m/s^2 at 1.2 Hz gives 2.3 mm.

    Sizes: a hanger of 0.5 to 2 m is a pendulum of 0.35 to 0.7 Hz (sqrt(9.81 / l) / 2 pi);
    a stiff hanger has 1 to 5 Hz (estimate); damping 0.5 to 5 % (welded and bolted steel
    structures: EN 1998-1, ISO 10137; a rolling hanger is at the upper end). A car of
    1000 to 2000 kg on one hanger has a modal mass of 100 to 2000 kg at the hub (estimate: a
    flexible door or axle carrier is at the lower end).

    Attributes:
        frequency_hz: natural frequency without damping.
        damping: damping ratio, share of critical.
        direction: displacement of the hub per metre of the coordinate, in c.
        turn: rotation of the hub per metre of the coordinate, in c [rad/m].
        drive: share g of the conveyor's acceleration that excites the mode; 1 for a pendulum
            with its mass at the hub, 0.1 to 0.3 for a mode across the line or of yaw (estimate).
        mass: modal mass at the coordinate [kg]; 0 for a mode that no contact force moves.
        frequency_spread: half range of the frequency over the cars, share of it.
        mass_spread: half range of the mass over the cars, share of it.
    """

    frequency_hz: float = 0.62
    damping: float = 0.01
    direction: Vector3 = (0.0, 1.0, 0.0)
    turn: Vector3 = (0.0, 0.0, 0.0)
    drive: float = 1.0
    mass: float = 0.0
    frequency_spread: float = 0.0
    mass_spread: float = 0.0


@dataclass(frozen=True, slots=True)
class Load:
    """Weight of the tool and the wheel on the elastic mount.

    The mount sags by m g / k along and by (c x m g) / k about the axes of the rigid tcp: 25 kg
    on 50 N/mm is 4.9 mm. ``Effector.frequency_hz`` belongs to the tool with its wheel; once the
    wheel is released the frequencies grow by sqrt((tool + wheel) / tool).

    Sizes: a car's wheel with its tyre weighs 20 to 28 kg (16 to 20 inch; manufacturers'
    catalogues); a clamp with nutrunners 25 to 60 kg (estimate).

    Attributes:
        tool_mass: of the tool without wheel [kg].
        tool_centre: its centre of gravity in the tcp [m].
        wheel_mass: of the wheel [kg]; it is gone when the wheel is released.
        wheel_centre: its centre of gravity in the tcp [m].
        wheel_mass_spread: half range of the wheel's mass over the cars, share of it.
    """

    tool_mass: float = 0.0
    tool_centre: Vector3 = (0.0, 0.0, -0.15)
    wheel_mass: float = 0.0
    wheel_centre: Vector3 = (0.0, 0.0, -0.05)
    wheel_mass_spread: float = 0.0


@dataclass(frozen=True, slots=True)
class ForceTorqueEffects:
    """Errors of a real force-torque sensor: bias after mounting and drift with temperature.

    The drift goes to its end as 1 - exp(-t / time), which is how a sensor warms up. Bias and end
    of the drift are drawn for each axis, uniform within +- their range.

    Sizes: 2 to 10 N and 0.2 to 1 Nm of bias after mounting; drift of 0.1 % of full scale a kelvin
    (makers' data of strain-gauge sensors), that is 1 to 5 N over a warm-up of 10 to 20 min. A run
    of 20 s sees 2 % of it, or all of it with a short time as after a cold start.

    Attributes:
        bias_force: half range of the bias of each force [N].
        bias_torque: half range of the bias of each torque [Nm].
        drift_force: half range of the end of each force's drift [N].
        drift_torque: half range of the end of each torque's drift [Nm].
        drift_time_s: time constant of the drift [s].
    """

    bias_force: float = 0.0
    bias_torque: float = 0.0
    drift_force: float = 0.0
    drift_torque: float = 0.0
    drift_time_s: float = 600.0


@dataclass(frozen=True, slots=True)
class Mating:
    """Mating by bolts, flange and friction; without bolts the clamp catches at once.

    The bolts' tips meet the wheel first. Where each bolt is within chamfer and clearance of its
    hole the wheel goes on and the chamfer draws it in; elsewhere the tips hold it off. Then the
    flange touches, at its rim first where the wheel is tilted, with friction until the clamp
    closes. Every contact is a spring with a damper.

    Sizes: five bolts M14 on a circle of 112 mm (common for cars); chamfer 1 to 2 mm; the bolts'
    angle within +-2 degrees of what the camera sees (0.035 rad, 2 mm on that circle); friction of
    steel on aluminium or steel 0.1 to 0.3 (engineers' handbooks); flange of 150 mm; stiffness of
    disc and hub 1 kN/mm and damping are estimates: the mount is twenty times as soft.

    Attributes:
        bolts: how many; 0 for a clamp that catches at once.
        bolt_circle: radius of their circle [m].
        bolt_length: their tips stand out this far from the flange [m].
        chamfer: a bolt this far from its hole is drawn in [m].
        clearance: of a bolt in its hole, each side [m].
        angle: of the bolts against the hub's orientation [rad]; None draws it.
        angle_range: half range of that angle over the cars [rad].
        flange: radius of the flange [m].
        friction: coefficient of friction of the contact.
        elasticity: stiffness of the contact as a whole [N/m].
        contact_damping: its damping ratio with the tool's mass, share of critical.
        seat: the clamp takes the hub when the flange is nearer than this [m].
        tear_off: contact force that tears the wheel off the clamp [N]; 0 for none.
    """

    bolts: int = 0
    bolt_circle: float = 0.056
    bolt_length: float = 0.025
    chamfer: float = 0.0015
    clearance: float = 0.0005
    angle: float | None = None
    angle_range: float = 0.0
    flange: float = 0.075
    friction: float = 0.2
    elasticity: float = 1e6
    contact_damping: float = 0.2
    seat: float = 1e-3
    tear_off: float = 0.0
