"""Sizes of what a real arm does between its encoders and its flange, and in its drives.

Invariants:
    Every effect is off by default; each has its own switch.
    Values are per axis, A1..A6 (then E1 where seven are given).
    Nothing here knows the daemon's settings.
"""

from dataclasses import dataclass, field

Six = tuple[float, float, float, float, float, float]
Seven = tuple[float, float, float, float, float, float, float]

_SIX: Six = (0.0,) * 6
_SEVEN: Seven = (0.0,) * 7


@dataclass(frozen=True, slots=True)
class WindupEffect:
    """Windup of the gears with the direction of motion: Dahl's hysteresis (Dahl 1968).

    ``dw/dq = (depth sgn(dq) - w) / travel``; the link lags by w behind the motor. Fitted to
    a recorded KUKA KR300 R2500: 0.00-0.09 mrad on A1-A3 if the 3 ms between the stamps of its
    encoders are fitted too, and 0.4-0.7 mrad if they are not. The second is the harsh case.

    Attributes:
        depth: windup after a long way in one direction [rad]; 0 switches it off.
        travel: way after a reversal in which 63 % of the change take place [rad].
    """

    depth: Six = _SIX
    travel: Six = (3e-3,) * 6


@dataclass(frozen=True, slots=True)
class Friction:
    """Friction in the drives, stated as the following error it causes.

    Coulomb and Stribeck friction with Dahl's presliding. The encoders see it. Large arms show
    0.1-0.3 mrad at a reversal; the integral action of the controller removes it.

    Attributes:
        coulomb: following error by sliding friction [rad]; 0 switches it off.
        breakaway: additional share of it near standstill (Stribeck), 0.2-0.5 of greased gears.
        stribeck_speed: speed at which that has faded to 37 % [rad/s].
        presliding: way in which the friction turns round [rad].
        recovery_s: time constant of the integral action [s]; 0 for none.
    """

    coulomb: Seven = _SEVEN
    breakaway: float = 0.3
    stribeck_speed: float = 5e-3
    presliding: float = 0.1e-3
    recovery_s: float = 0.3


@dataclass(frozen=True, slots=True)
class Elasticity:
    """Compliance of the gears under gravity and the arm's own acceleration.

    Stiffness of this size of arm: 4e6 Nm/rad for A1-A3, 5e5 for A4-A6 (Dumas, Caro, Garnier,
    Furet, "Joint stiffness identification of six-revolute industrial serial robots", 2011).

    Attributes:
        compliance: of each gear [rad/Nm], about 0.25e-6 and 2e-6; 0 switches it off.
        masses: of upper arm, forearm, and hand with tool and wheel [kg].
        balanced: share of the moment about A2 that a counterbalance takes.
        inertia: about each axis in a middling posture [kg m^2].
    """

    compliance: Six = _SIX
    masses: tuple[float, float, float] = (250.0, 180.0, 110.0)
    balanced: float = 0.7
    inertia: Six = (1000.0, 900.0, 350.0, 25.0, 20.0, 8.0)


@dataclass(frozen=True, slots=True)
class Geometry:
    """Errors of calibration, drawn once a run.

    ISO 9283 absolute accuracy of large uncalibrated arms is 0.3-1 mm.

    Attributes:
        zero_sigma: of each axis' zero [rad], 0.3e-3 uncalibrated; 0 switches it off.
        length_sigma: of each length of the table [m], about 0.2e-3.
        angle_sigma: of each twist of the table [rad], about 0.1e-3.
    """

    zero_sigma: float = 0.0
    length_sigma: float = 0.0
    angle_sigma: float = 0.0


@dataclass(frozen=True, slots=True)
class Posture:
    """Servos that depend on the posture, because the inertia does.

    The frequency goes with the square root of an inertia that grows with the reach. The dead
    time of a controller's interpolation drifts (FANUC: 84-180 ms reported).

    Attributes:
        frequency_share: change of a servo's frequency for each metre of reach; about 0.1 to 0.2,
            0 switches it off.
        reach: of the tcp from A1's axis at which the frequency is as set [m].
        dead_time_amplitude: of a slow sine of all dead times [s]; 0 switches it off.
        dead_time_period_s: of that sine [s].
    """

    frequency_share: float = 0.0
    reach: float = 1.8
    dead_time_amplitude: float = 0.0
    dead_time_period_s: float = 10.0


@dataclass(frozen=True, slots=True)
class WarmingController:
    """Dead time of all axes that grows with the controller's duty, and stays.

    FANUC Stream Motion: 84 ms rested, 180 ms after hours of duty, as users measured it.

    Attributes:
        growth_s: of the dead time [s], 0.096 for that range; 0 switches it off.
        begin_s: time at which it begins to grow [s].
        duration_s: in which it grows, evenly [s]; hours on a real controller.
    """

    growth_s: float = 0.0
    begin_s: float = 0.0
    duration_s: float = 20.0


@dataclass(frozen=True, slots=True)
class ArmEffects:
    """What a real arm does that the emulated one does not.

    Attributes:
        lost_motion: play of each gear, from one flank to the other [rad]; 0.1e-3 to 0.3e-3 of
            worn gears.
        quantisation: step of each encoder [rad], [m]; AIPos as text has 1e-4 degrees (1.7e-6).
    """

    windup: WindupEffect = field(default_factory=WindupEffect)
    lost_motion: Six = _SIX
    friction: Friction = field(default_factory=Friction)
    elasticity: Elasticity = field(default_factory=Elasticity)
    geometry: Geometry = field(default_factory=Geometry)
    posture: Posture = field(default_factory=Posture)
    warming: WarmingController = field(default_factory=WarmingController)
    quantisation: Seven = _SEVEN
