"""State, plan and outputs of a sampling step."""

from msgspec import Struct

from linemate.daemon.core.control import controller as control
from linemate.daemon.core.control.windup import WindupState
from linemate.daemon.core.followed_poses import FollowedPoses
from linemate.daemon.core.horizon import Array, Horizon
from linemate.daemon.core.tracking import tracker_state
from linemate.daemon.core.tracking.task import Phase
from linemate.daemon.core.way_home import HomePath

# Position [m] and unit quaternion, w first, in base.
Pose = tuple[float, float, float, float, float, float, float]

FIX_SCREWS = 1
RELEASE_WHEEL = 2


class StepState(Struct, frozen=True, eq=False):
    """State of the step.

    Attributes:
        applied: (axes,) the last command that was sent.
        moving: the robot has not come to rest since it last tracked.
        windup: of the measured axes, None for an arm without.
        path: the way home, None if the robot is not on it.
        follow: poses handed in, None if the robot does not follow them.
    """

    tracker: tracker_state.TrackerState
    control: control.ControlState
    applied: Array
    moving: bool = False
    windup: WindupState | None = None
    path: HomePath | None = None
    follow: FollowedPoses | None = None


class StepPlan(Struct, frozen=True, eq=False):
    """Part of a step that does not depend on the delivery of the last command.

    Attributes:
        tracker: one step later; contact is still that of the step before.
        horizon: x_t, None where the robot is to stand.
        desired: command, None where the robot is to stand.
        windup: of the measured axes.
        path: the way home, None if the robot is not on it.
        follow: poses handed in, None if the robot does not follow them.
    """

    tracker: tracker_state.TrackerState
    report: tracker_state.Report
    horizon: Horizon | None = None
    desired: control.DesiredCommand | None = None
    windup: WindupState | None = None
    path: HomePath | None = None
    follow: FollowedPoses | None = None


class Outputs(Struct, frozen=True, eq=False):
    """Result of one step.

    Attributes:
        k: number of the step.
        command: absolute setpoints q_c, A1..A6 [rad] and E1 [m], within the limits.
        digital_out: the tool's signals, bit 0 fix the screws, bit 1 release the wheel.
        task_time: time of the task's clock [s], None before the start.
        scenario: the class in force.
        confidence: log odds of the change that was last evaluated.
        events: of the classifier in this step.
        target: x_c(k) = x_t(k, 0), the committed tcp in base.
        sensed: x_f(k, 0) in base, None before the object was seen.
        part: the object's estimated pose in base, None before it was seen.
        speed: of the conveyor [m/s].
        horizon: (n+1, 6) x_t in the nominal frame, None while the robot does not track.
        contact: the tool is clamped to the object.
        clamped: a retreat waits for the clamp, which is closed on the object or may be.
        overdue: the clamp was not reported open in time, or no contact was found.
        overload: the force exceeds the tool's limit.
        finished: the task is over, or the retraction or the way home is.
        held: why the command is not the desired one, None if it is.
        ready: why the task cannot start, None if it can.
        refused: number of pose measurements that the gate rejected.
        object_left: the object is tracked and out of reach, or about to be.
        waiting: why the tool waits before contact, None if it does not.
        waited_s: how long it has waited before contact, in all [s]; None if it has not.
        swinging_n: rms force of an oscillation in contact that softening does not make smaller [N];
            None if there is none.
        unanswered_n: mean force of a contact that is suspect and has answered none of its tests
            [N]; None if there is none.
    """

    k: int
    stamp_ns: int
    command: tuple[float, ...]
    digital_out: int
    phase: Phase
    task_time: float | None
    scenario: str
    scenario_state: str
    confidence: float
    events: tuple[tuple[str, str], ...]
    target: Pose
    sensed: Pose | None
    part: Pose | None
    speed: float | None
    horizon: Array | None
    contact: bool
    clamped: bool
    overdue: bool
    overload: bool
    finished: bool
    held: str | None
    ready: str | None
    refused: int
    object_left: bool = False
    waiting: str | None = None
    waited_s: float | None = None
    swinging_n: float | None = None
    unanswered_n: float | None = None
