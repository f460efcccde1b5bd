"""Settings of control: servo and effector models, filters, limits.

Invariants:
- Frozen values in SI units with their ranges; nothing is computed.
"""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Gt, Le, Len, Lt

# Wider than any arm needs; values in degrees, millimetres or milliseconds are out of range.
Place = Annotated[float, Ge(-30.0), Le(30.0)]
Acceleration = Annotated[float, Ge(0.01), Le(100.0)]
Jerk = Annotated[float, Ge(0.1), Le(10_000.0)]
Span = Annotated[float, Ge(0.0), Le(1.0)]
# An arm that is further off is another one, or its axes are not mastered.
LARGEST_SHIFT = 3e-3  # [m]
LARGEST_TURN = 5e-3  # [rad]
Shift = Annotated[float, Ge(-LARGEST_SHIFT), Le(LARGEST_SHIFT)]
Turn = Annotated[float, Ge(-LARGEST_TURN), Le(LARGEST_TURN)]


@dataclass(frozen=True, slots=True)
class ServoModel:
    """Identified model of one axis with its position controller.

    Attributes:
        frequency_hz: natural frequency of the second-order response.
        damping: damping ratio, share of critical.
        dead_time: from the telegram that a setpoint answers to its first effect [s]; the
            controller is assumed to interpolate over the next cycle. ``linemate identify`` finds
            it.
    """

    # The inverse of a slower servo multiplies errors until the tool swings faster than 0.6 m/s.
    frequency_hz: Annotated[float, Ge(1.5), Le(100.0)]
    damping: Annotated[float, Gt(0.05), Lt(3.0)]
    dead_time: Annotated[float, Ge(0.0), Le(0.3)]


@dataclass(frozen=True, slots=True)
class DeadTimeDrift:
    """Drift of all dead times that is followed while the robot moves.

    The horizon is as long as the longest dead time needs.

    Attributes:
        shorter: how far dead times may fall below the identified ones [s].
        longer: how far they may rise above them [s]; both 0: they are fixed.
        rate: largest change of the dead time, seconds a second.
    """

    shorter: Annotated[float, Ge(0.0), Le(0.2)] = 0.0
    longer: Annotated[float, Ge(0.0), Le(0.2)] = 0.0
    rate: Annotated[float, Gt(0.0), Le(0.05)] = 0.01


@dataclass(frozen=True, slots=True)
class AxisWindup:
    """Identified windup of one axis: the link lags behind the motor by its direction of motion.

    Attributes:
        depth: after a long way in one direction [rad]; 0 for an axis that does not wind up.
        travel: way after a reversal in which 63 % of the change take place [rad].
    """

    depth: Annotated[float, Ge(0.0), Le(0.005)] = 0.0
    travel: Annotated[float, Ge(2e-5), Le(0.1)] = 0.003


@dataclass(frozen=True, slots=True)
class AxisFriction:
    """Friction in the drive of one axis, which its encoder sees as a following error.

    Attributes:
        level: following error by sliding friction before the integral action removes it [rad] or
            [m]; 0 for an axis that does not rub. ``linemate identify`` finds it.
        travel: way after a reversal in which 63 % of the change take place [rad] or [m].
        recovery_s: time constant of the controller's integral action [s].
    """

    level: Annotated[float, Ge(0.0), Le(0.005)] = 0.0
    travel: Annotated[float, Ge(1e-5), Le(0.01)] = 1e-4
    recovery_s: Annotated[float, Ge(0.02), Le(10.0)] = 0.3


@dataclass(frozen=True, slots=True)
class AxisLoad:
    """Weight that turns with an axis: a part of the arm, or the tool with what it carries.

    Attributes:
        axis: the last axis that turns it, 1 to 6.
        mass: of the part [kg].
        centre: of mass, in the URDF's frame of that axis [m].
    """

    axis: Annotated[int, Ge(1), Le(6)]
    mass: Annotated[float, Gt(0.0), Le(5000.0)]
    centre: tuple[Place, Place, Place] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class GravityBend:
    """Bend of the gears under the weight of arm, tool and load, which encoders do not see.

    Attributes:
        compliance: of the gears of A1..A6 [rad/Nm], by the tcp under a known weight. None: stiff.
        loads: weights of the arm, the tool and its load; none: the gears count as stiff.
        balanced: share of the moment about A2 that a counterbalance takes.
    """

    compliance: Annotated[tuple[Annotated[float, Ge(0.0), Le(1e-4)], ...], Len(0, 6)] = ()
    loads: Annotated[tuple[AxisLoad, ...], Len(0, 12)] = ()
    balanced: Annotated[float, Ge(0.0), Le(1.0)] = 0.0


@dataclass(frozen=True, slots=True)
class AxisGeometry:
    """Measured frame of one axis, seen from its frame in the URDF with the axis at 0.

    ``linemate identify-arm`` finds it from measured poses.

    Attributes:
        shift: place of the frame: errors of lengths [m].
        turn: rotation vector of the frame: about the axis the error of its zero, about the others
            twists [rad].
    """

    shift: tuple[Shift, Shift, Shift] = (0.0, 0.0, 0.0)
    turn: tuple[Turn, Turn, Turn] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class EffectorMode:
    """One elastic mode of the tool's suspension along or about a tcp axis.

    Attributes:
        frequency_hz: natural frequency of the mode [Hz].
        damping: damping ratio, share of critical.
    """

    frequency_hz: Annotated[float, Ge(2.0), Le(200.0)]  # a slower one was commanded to 0.9 m/s
    damping: Annotated[float, Ge(0.0), Lt(1.0)] = 0.02


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """Limits of an axis for the finite differences of its setpoints.

    Attributes:
        lower: least position [rad] or [m].
        upper: largest position [rad] or [m].
        speed: largest speed [rad/s] or [m/s].
        acceleration: largest acceleration [rad/s^2] or [m/s^2].
        jerk: largest jerk [rad/s^3] or [m/s^3].
    """

    lower: Place
    upper: Place
    speed: Annotated[float, Gt(0.0), Le(20.0)]
    acceleration: Annotated[float, Gt(0.0), Le(500.0)]
    jerk: Annotated[float, Gt(0.0), Le(100_000.0)]


@dataclass(frozen=True, slots=True)
class BrakeSettings:
    """Deceleration of a robot on hold; a gentle stop excites the tool's mount less.

    Attributes:
        acceleration: largest deceleration of A1..A6 [rad/s^2].
        jerk: largest jerk of A1..A6 [rad/s^3].
        axis_acceleration: largest deceleration of E1 [m/s^2].
        axis_jerk: largest jerk of E1 [m/s^3].
    """

    acceleration: Acceleration = 1.0
    jerk: Jerk = 25.0
    axis_acceleration: Acceleration = 2.0
    axis_jerk: Jerk = 50.0


@dataclass(frozen=True, slots=True)
class SmoothingSettings:
    """The impedance law of (13)-(15). ``mass`` 0 switches it off.

    Attributes:
        mass: desired mass M_d of the law [s^2].
        damper: desired damper D_d of the law [s].
        steps_s: preview of the smoothing, n_imp * T0 [s].
    """

    mass: Span = 0.0
    damper: Span = 0.0
    steps_s: Annotated[float, Gt(0.0), Le(1.0)] = 0.24


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """Reach and training of the inverse filters.

    Attributes:
        servo_past_s: reach of (12) into the past [s].
        servo_future_s: reach of (12) into the future [s].
        effector_past_s: reach of (11) into the past [s].
        effector_future_s: reach of (11) into the future [s].
        band_hz: band of the training signal.
        wide_hz: band in which the training signal has a tenth of its amplitude.
        ridge: weight of the squared taps in the fit.
        contact_blend: time in which (11) is blended out at contact [s].
    """

    servo_past_s: Span = 0.036
    servo_future_s: Annotated[float, Gt(0.0), Le(1.0)] = 0.096
    effector_past_s: Span = 0.036
    effector_future_s: Span = 0.012
    band_hz: Annotated[float, Ge(0.05), Le(50.0)] = 2.0
    wide_hz: Annotated[float, Ge(0.05), Le(100.0)] = 8.0
    ridge: Annotated[float, Gt(0.0), Le(1.0)] = 1e-6
    contact_blend: Annotated[float, Ge(0.001), Le(2.0)] = 0.06


_SERVOS = (
    ServoModel(4.0, 0.75, 0.036),
    ServoModel(4.0, 0.80, 0.036),
    ServoModel(4.5, 0.80, 0.030),
    ServoModel(5.5, 0.85, 0.024),
    ServoModel(6.0, 0.80, 0.024),
    ServoModel(6.5, 0.75, 0.020),
    ServoModel(4.0, 0.80, 0.036),
)
_MODES = tuple(EffectorMode(f) for f in (5.0, 4.5, 7.0, 5.5, 6.0, 6.5))


@dataclass(frozen=True, slots=True)
class ControlSettings:
    """All that can be set of control. Axes are A1..A6, then E1.

    Attributes:
        drift: of the dead times; left out: they are fixed.
        windup: of each axis; left out: the links are where the motors are.
        bend: of the gears under weight.
        geometry: of A1..A6 as measured; left out: that of the URDF.
        friction: of each axis; left out: no drive rubs.
        limits: of each axis, within those of the URDF; left out: those of the URDF.
        tcp_speed: limit of the tcp's speed relative to the object; the conveyor's nominal speed
            comes on top of it [m/s].
        horizon_s: length of the horizon that control reads [s].
        feed_forward: invert the servos' responses; False commands the desired joints.
        damping: invert the tool's elastic modes; False does not damp them.
    """

    servos: Annotated[tuple[ServoModel, ...], Len(6, 7)] = _SERVOS
    effector: Annotated[tuple[EffectorMode, ...], Len(6, 6)] = _MODES
    drift: DeadTimeDrift = DeadTimeDrift()
    windup: Annotated[tuple[AxisWindup, ...], Len(0, 7)] = ()
    bend: GravityBend = GravityBend()
    geometry: Annotated[tuple[AxisGeometry, ...], Len(0, 6)] = ()
    friction: Annotated[tuple[AxisFriction, ...], Len(0, 7)] = ()
    limits: Annotated[tuple[AxisLimits, ...], Len(0, 7)] = ()
    smoothing: SmoothingSettings = SmoothingSettings()
    brake: BrakeSettings = BrakeSettings()
    filters: FilterSettings = FilterSettings()
    tcp_speed: Annotated[float, Ge(0.01), Le(2.0)] = 0.5
    horizon_s: Annotated[float, Gt(0.1), Le(2.0)] = 0.492
    feed_forward: bool = True
    damping: bool = True
