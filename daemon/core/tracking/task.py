"""Task file as data: what is assembled where, in which phases, at which conveyor.

Invariants:
- Frozen values in SI units; nothing is computed.
- Ranges are on the fields (``annotated_types``), for the file's validator and for Python callers.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, Len, Lt

from linemate.protocol.stamped_samples import Quaternion, Vector3

# Wider than any station needs; millimetres, milliseconds or degrees are out of range.
Metre = Annotated[float, Ge(-30.0), Le(30.0)]
Place = tuple[Metre, Metre, Metre]
Time = Annotated[float, Ge(0.0), Le(3600.0)]
Duration = Annotated[float, Ge(0.001), Le(600.0)]
Angle = Annotated[float, Ge(-6.3), Le(6.3)]
IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)


class WaypointFrame(StrEnum):
    """The frame a waypoint is given in: the station, or the nominal object as it moves."""

    BASE = "base"
    OBJECT = "object"


class Phase(StrEnum):
    """Purpose of a stretch of the reference trajectory."""

    WAIT = "wait"
    APPROACH = "approach"
    CONTACT = "contact"
    SCREWS = "screws"
    RETREAT = "retreat"
    DONE = "done"


class Gate(StrEnum):
    """Condition for passing a waypoint."""

    NONE = "none"
    OBJECT_CLOSE = "object_close"
    OBJECT_SEEN = "object_seen"
    SCREWS_FIXED = "screws_fixed"
    WHEEL_RELEASED = "wheel_released"


@dataclass(frozen=True, slots=True)
class PoseFile:
    """A pose as a file gives it: position [m] and unit quaternion, w first."""

    position: Place
    quaternion: Quaternion = IDENTITY


@dataclass(frozen=True, slots=True)
class Waypoint:
    """One point of the reference trajectory x_r.

    Attributes:
        time: task time at which it is reached [s]; the task's clock starts as the object is close.
        pose: of the tcp in ``frame``.
        frame: ``base``, or ``object`` for a point that travels with the nominal object.
        phase: what the stretch *behind* this waypoint is for.
        gate: what must hold before the clock passes this waypoint.
    """

    time: Time
    pose: PoseFile
    frame: WaypointFrame = WaypointFrame.OBJECT
    phase: Phase = Phase.APPROACH
    gate: Gate = Gate.NONE


@dataclass(frozen=True, slots=True)
class StopInput:
    """Digital input on which the line's controller announces a stop of the conveyor.

    A rising edge makes a stop likelier that begins about then. It never confirms one: a bit that
    is stuck, late or false does no lasting harm. Edges less than 1 s apart count once.

    Attributes:
        bit: of the controller's signals; bits 0 and 1 are the tool's. None: nothing is announced.
        before: the stop begins this long before the edge at the earliest [s].
        after: the stop begins this long after the edge at the latest [s].
        weight: log odds that an edge gives a stop, in the prediction alone.
    """

    bit: Annotated[int, Ge(2), Le(15)] | None = None
    before: Annotated[float, Ge(0.0), Le(0.5)] = 0.05
    after: Annotated[float, Ge(0.0), Le(0.5)] = 0.05
    weight: Annotated[float, Ge(0.0), Le(10.0)] = 4.0


@dataclass(frozen=True, slots=True)
class ConveyorClasses:
    """Classes of the conveyor (Sect. III-B): speed, and accelerations of a stop and a start.

    Attributes:
        axis: direction of travel in base, a unit vector.
        nominal_speed: speed of a running conveyor [m/s].
        deceleration: nominal deceleration of a stop [m/s^2].
        acceleration: nominal acceleration of a start [m/s^2].
        start_position: reading of the distance sensor at which the task's clock starts [m].
        stop_input: where the line announces a stop.
    """

    axis: Vector3 = (0.0, 1.0, 0.0)
    nominal_speed: Annotated[float, Ge(0.005), Le(0.5)] = 0.106
    deceleration: Annotated[float, Ge(0.001), Le(2.0)] = 0.104
    acceleration: Annotated[float, Ge(0.0005), Le(2.0)] = 0.013
    start_position: Annotated[float, Ge(-100.0), Le(100.0)] = 0.0
    stop_input: StopInput = StopInput()


@dataclass(frozen=True, slots=True)
class ObjectFile:
    """The object's nominal pose x_o^nom in base at the start position of the conveyor.

    The pose's axes span the frame in which deviations are estimated: y along the conveyor.
    """

    nominal: PoseFile


@dataclass(frozen=True, slots=True)
class ToolTimes:
    """When the task asks for the tool's signals, in task time [s].

    Attributes:
        fix_screws: signal 0 is set.
        release_wheel: signal 1 is set.
        fixed_after: without signals, the screws count as fixed this long after [s]; None: wait.
        released_after: without signals, the wheel counts as released this long after [s].
        release_timeout: a clamp that is not open this long after its order is overdue [s]: the
            tool follows the object, and does not withdraw.
    """

    fix_screws: Time = 8.5
    release_wheel: Time = 14.5
    fixed_after: Duration | None = None
    released_after: Duration | None = None
    release_timeout: Annotated[float, Gt(0.0), Le(10.0)] = 2.0


@dataclass(frozen=True, slots=True)
class GuardedApproach:
    """The last approach: when it may begin, and the search for contact at its end.

    Within ``clearance`` of the estimated object the tool approaches at ``touch_speed`` at most. The
    stretch that ends at the waypoint of contact is lengthened if it leaves too little time for it.
    The search begins at the waypoint of contact if no contact was felt up to there.

    Attributes:
        touch_speed: largest speed along the tool's axis relative to the object [m/s]. It is
            reduced so that the mount gets half the overload until the tool reacts to a touch.
        clearance: distance before the estimated object from which that speed holds and a contact
            counts [m]. It must cover the error of the estimate. 0 is 11 mm, at the reduced speed.
        speed: along the tool's axis [m/s]. The motion goes on for about 0.15 s after the touch.
        overrun: largest distance beyond the waypoint [m]; without contact up to there the tool
            retreats. 0 does not search.
        sight: greatest age of the camera's last accepted pose with which the approach goes on,
            down to ``camera.blind_below`` [s]. An older one makes the tool wait.
        checked: for how long images must have checked past predictions before the approach goes
            on [s]. The checks begin after a first time as long as the last approach, 1.5 s at most.
            0 needs none.
        tolerance: largest error across the tool's axis that the touch tolerates [m]: about half of
            what the tool catches. A larger expected error makes the tool wait next to the object.
        angle_tolerance: the same of the orientation [rad].
        wait: longest time to wait next to the object in one assembly [s]; then the tool retreats.
    """

    touch_speed: Annotated[float, Ge(0.002), Le(0.1)] = 0.009
    clearance: Annotated[float, Ge(0.0), Le(0.05)] = 0.011
    speed: Annotated[float, Gt(0.0), Le(0.02)] = 0.005
    overrun: Annotated[float, Ge(0.0), Le(0.05)] = 0.012
    sight: Annotated[float, Gt(0.0), Le(5.0)] = 0.3
    checked: Annotated[float, Ge(0.0), Le(1.0)] = 0.5
    tolerance: Annotated[float, Gt(0.0), Le(1.0)] = 0.003
    angle_tolerance: Annotated[float, Gt(0.0), Le(6.3)] = 0.015
    wait: Annotated[float, Gt(0.0), Le(600.0)] = 10.0


@dataclass(frozen=True, slots=True)
class ArmFile:
    """The arm: where its kinematics are, and what it holds.

    Attributes:
        urdf: path of the URDF, relative to the task file; a bare name is looked up among the
            shipped ones too.
        flange: the URDF's flange frame.
        linear_axis: the URDF's first joint is the linear axis E1. Which way it counts is its own.
        tcp_in_flange: of the undeflected tool.
        camera_in_tcp: hand-eye calibration, of the undeflected tool: the camera is on the rigid
            side of the elastic mount. Where its images have no covariance, z is its line of sight.
        sensor_in_tcp: frame in which the force-torque sensor states its wrench, of the undeflected
            tool. A sensor on the flange has its place and turn here.
        sensor_sign: 1 for a sensor that states the force on the tool: its weight points down, and a
            tool that presses along z reads a negative z. -1 for the opposite.
        rest_joints: A1..A6 at rest [rad].
    """

    rest_joints: tuple[Angle, Angle, Angle, Angle, Angle, Angle]
    urdf: str = "arm.urdf"
    flange: str = "flange"
    linear_axis: bool = True
    tcp_in_flange: PoseFile = PoseFile((0.0, 0.0, 0.0))
    camera_in_tcp: PoseFile = PoseFile((0.0, 0.0, 0.0))
    sensor_in_tcp: PoseFile = PoseFile((0.0, 0.0, 0.0))
    sensor_sign: Literal[1, -1] = 1


@dataclass(frozen=True, slots=True)
class LinearAxisFile:
    """How the linear axis follows the object.

    Attributes:
        travel: way of the axis along the conveyor as a share of the object's.
        ramp: time in which the axis takes up or loses its speed [s].
    """

    travel: Annotated[float, Ge(0.0), Lt(1.5)] = 1.0
    ramp: Annotated[float, Ge(0.05), Le(30.0)] = 1.0


@dataclass(frozen=True, slots=True)
class WayHome:
    """How the robot goes home to the first pose after a task.

    Attributes:
        clearance: least distance of the tool before the object's plane to begin, and of the first
            pose [m]. It must cover what protrudes from the object.
        speed: largest speed of the tcp, and of the linear axis [m/s].
        acceleration: largest acceleration of both [m/s^2].
        turn_speed: largest angular speed of the tcp [rad/s].
        turn_acceleration: largest angular acceleration of the tcp [rad/s^2].
    """

    clearance: Annotated[float, Ge(0.02), Le(2.0)] = 0.08
    speed: Annotated[float, Ge(0.01), Le(1.0)] = 0.25
    acceleration: Annotated[float, Ge(0.01), Le(2.0)] = 0.5
    turn_speed: Annotated[float, Ge(0.01), Le(1.0)] = 0.2
    turn_acceleration: Annotated[float, Ge(0.01), Le(2.0)] = 0.4


@dataclass(frozen=True, slots=True)
class FollowLimits:
    """Limits of target poses that a client hands in to be followed.

    Attributes:
        clearance: least distance of the tcp before the object's plane [m]. It must cover what
            protrudes from the object.
        speed: largest speed of the tcp along the poses [m/s].
        acceleration: largest acceleration of the tcp along them [m/s^2].
        turn_speed: largest angular speed of the tcp [rad/s].
        turn_acceleration: largest angular acceleration of the tcp [rad/s^2].
    """

    clearance: Annotated[float, Ge(-1.0), Le(2.0)] = 0.08
    speed: Annotated[float, Ge(0.01), Le(1.0)] = 0.25
    acceleration: Annotated[float, Ge(0.01), Le(2.0)] = 0.5
    turn_speed: Annotated[float, Ge(0.01), Le(1.0)] = 0.2
    turn_acceleration: Annotated[float, Ge(0.01), Le(2.0)] = 0.4


@dataclass(frozen=True, slots=True)
class TaskFile:
    """One assembly task, whole."""

    name: str
    arm: ArmFile
    object: ObjectFile
    waypoints: Annotated[tuple[Waypoint, ...], Len(2, 100)]
    conveyor: ConveyorClasses = ConveyorClasses()
    tool: ToolTimes = ToolTimes()
    guard: GuardedApproach = GuardedApproach()
    linear_axis: LinearAxisFile = LinearAxisFile()
    home: WayHome = WayHome()
    follow: FollowLimits = FollowLimits()
    version: Annotated[int, Ge(1), Lt(2)] = 1
