"""Values of tracking: compiled parameters, state, samples of a step, report."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from msgspec import Struct

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking import linear_axis
from linemate.daemon.core.tracking.across.body_sway import NO_SWAY, BodySway
from linemate.daemon.core.tracking.across.transverse import Transverse
from linemate.daemon.core.tracking.across.transverse_state import TransverseState
from linemate.daemon.core.tracking.approach import is_quicker
from linemate.daemon.core.tracking.classifiers.distance.measured_noise import (
    AS_CONFIGURED,
    MeasuredNoise,
)
from linemate.daemon.core.tracking.conveyor import Classifier, Motion
from linemate.daemon.core.tracking.estimation.prediction_error import (
    NO_PREDICTIONS,
    PredictionMonitor,
)
from linemate.daemon.core.tracking.go_no_go.clock_ramp import RUNNING, ClockRamp
from linemate.daemon.core.tracking.go_no_go.decision import GO, GoState
from linemate.daemon.core.tracking.go_no_go.target_shift import NO_SHIFT, TargetShift
from linemate.daemon.core.tracking.merge import MergePlan
from linemate.daemon.core.tracking.observation import History, PoseMeasurement
from linemate.daemon.core.tracking.reference import Reference, ReferenceTable
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.daemon.core.tracking.task import Gate, Phase, TaskFile
from linemate.daemon.core.tracking.touch import contact, force_jump, guard, release
from linemate.daemon.core.tracking.touch.bolt_search import NO_BOLT_SEARCH, BoltSearch
from linemate.daemon.core.tracking.touch.compliance import (
    NO_COMPLIANCE,
    Compliance,
    ComplianceModel,
)
from linemate.daemon.core.tracking.touch.force_sign import TRUSTED, ForceSign
from linemate.daemon.core.tracking.touch.tare import NO_TARE, Tare
from linemate.daemon.core.tracking.touch.withdrawal import Withdrawal
from linemate.protocol.stamped_samples import CameraSample, DistanceSample, Vector3, WrenchSample

Foresight = Callable[[int, Array], tuple[Array, Array]]


@dataclass(frozen=True, slots=True, eq=False)
class Tracker:
    """Compiled parameters of tracking.

    Attributes:
        table: the reference at every step of the task's clock.
        camera: position (3,) and rotation (3, 3) of the camera in the tcp.
        steps: n, length of the horizon.
        merge_free: of a tool that hangs free.
        merge_clamped: of a tool in contact: it has no elastic mode to damp, and answers earlier.
        merge_retreating: of one that waits for its clamp: what made it retreat may be wrong.
        corner: (2 h + 1,) kernel that rounds corners of the conveyor's way.
        history_length: number of robot poses in the history.
        span: (n+1,) times of the horizon from now [s].
        axis_steps: length of the linear axis' plan, as far as control reads it.
        axis_range: positions that the linear axis can take [m]; unbounded without one.
        axis_travel: its way for each metre of the object's; negative if it counts against it.
        ahead: times from now at which the conveyor's position is predicted [s]: the span, the
            time of the linear axis' goal, and the leads whose predictions are checked.
        leads: how far ahead predictions are checked [s].
        free: (t,) share of the damping at every step of the task's clock.
        vibration: of the tool along its axis.
        across: the same along the two axes across.
        compliance: of a clamped tool.
        sight_time: when the tool leaves its last waypoint before contact [s].
        near_time: when the tool reaches the clearance before the object [s].
        final_time: until when the touch can be prevented [s]; -infinity without contact.
        search_time: when the tool should be in contact at the latest [s].
        press: programmed tcp in the object along its axis at that time [m].
        damped_until: last task time before contact at which the tool is damped in full [s].
        foresight: oracle for campaigns, in place of the estimate: from a stamp [ns] and times from
            it (m,) [s] to positions (m, 3) and rotation vectors (m, 3) of the object in c.
    """

    task: TaskFile
    settings: TrackingSettings
    reference: Reference
    classifier: Classifier
    transverse: Transverse
    table: ReferenceTable
    camera: tuple[Array, Array]
    cycle_s: float
    steps: int
    merge_free: MergePlan
    merge_clamped: MergePlan
    merge_retreating: MergePlan
    corner: Array
    history_length: int
    span: Array
    axis_steps: int
    axis_range: tuple[float, float]
    axis_travel: float
    ahead: Array
    leads: tuple[float, float]
    free: Array
    vibration: contact.ToolVibration
    across: tuple[contact.ToolVibration, contact.ToolVibration]
    compliance: ComplianceModel
    sight_time: float
    near_time: float
    final_time: float
    search_time: float
    press: float
    damped_until: float
    withdrawal: Withdrawal
    foresight: Foresight | None = None

    @property
    def commit(self) -> int:
        """The last step that no list changes."""
        return self.merge_free.commit

    def merge_plan(
        self, *, in_contact: bool, retreats: bool = False, lead: float = 0.0
    ) -> MergePlan:
        """Return the parameters of the merge.

        Servos that are quicker than their models amplify quick motion: by four if twice as quick.

        Args:
            lead: of the goal before the object [s].
        """
        if not in_contact:
            return self.merge_free
        is_slow = retreats or is_quicker(lead, self.task.conveyor.nominal_speed)
        return self.merge_retreating if is_slow else self.merge_clamped


@lru_cache(maxsize=4)
def with_distance_noise(tracker: Tracker, inflation: float) -> Tracker:
    """Return the parameters for a distance sensor whose variance is larger by a factor."""
    if inflation == 1.0:
        return tracker
    classifier: Any = tracker.classifier
    deviation = math.sqrt(inflation) * classifier.distance_deviation
    return replace(tracker, classifier=replace(classifier, distance_deviation=deviation))


class TrackerState(Struct, frozen=True, eq=False):
    """State of tracking.

    Attributes:
        history: poses of the undeflected tcp.
        conveyor: state of the classifier; None before the first distance readings.
        transverse: state of the filter across the conveyor; None before enough images.
        first_poses: images that wait to start that filter.
        poses: (n+1, 6) x_t of the last step.
        axis: plan of the linear axis.
        object_left: the object leaves the range of the linear axis, or is about to.
        departure: positions of the linear axis and of the conveyor unit at the start of the task's
            clock [m]; None before.
        time: task time of step k [s]; constant before the start.
        started: the start edge has come.
        passed: gates that are open.
        blended: time since the blend to the sensed motion began [s], None before.
        blend_s: how long that blend takes [s]; infinity before.
        contact_state: of the contact detection, until there is contact.
        force_offset: what jumps of the measured force have added to it before contact.
        contact: the tool is clamped to the object.
        assumed: contact is assumed: the cell has no force-torque sensor, or a tool that may be
            clamped came to rest.
        touching: time since the contact began [s].
        touched: where the programme was as the contact began.
        fixing: time since the tool was ordered to fix [s]; None before.
        releasing: time since the tool was ordered to release [s]; None before.
        unloading_s: time from that order until the press is gone [s].
        withdrawn: time since an emergency retraction began [s]; None without.
        clamped: a retreat waits for the clamp, which is closed on the object or may be.
        keeps: a retreat began from free space: the clamp stays closed, and holds what it carries.
        anchor: (6,) of a robot at rest from which an emergency retraction began: its pose, or its
            offset from the object while the task is started; None if it tracked.
        gone: way of an emergency retraction before it began again at rest [m].
        further: its way behind the least one [m].
        leaving: speed at which the programme left the object as a retraction began [m/s].
        distance: programmed, from the tcp to the object along its z [m].
        readings: of the distance sensor, before the classifier starts [m].
        pull: mean force on the tool in contact, or since its clamp was ordered to open [N].
        pull_power: mean square of that force [N^2].
        search: for an object that is farther away than estimated.
        pose_ns: exposure of the camera's last accepted pose [ns], None before.
        placed: the camera has seen the object where the distance sensor leads it to.
        blind_s: time since the last reading of the distance sensor [s].
        stood: time without a command, in which the robot stood still [s].
        slowed: steps left of a plan that goes on at half its speed after such a time; below 0 while
            one catches up.
        clock_stood: time for which the task's clock has stood at its gate [s].
        carried: way of the programmed tool along the conveyor while the clock stood before [m].
        speed: of the conveyor, as it was last estimated [m/s].
        unit: position of the conveyor unit then [m], None before.
        sway: of the object along the conveyor, in contact.
        held: by what bolts in their holes have moved the estimate of x and z [m].
        leaning: mean force of bolts in their holes [N].
        go: decision of go or no-go before contact.
        units: past positions of the conveyor unit, as the distance sensor sees it, with their times
            [ns, m].
        monitor: past predictions of the object and their errors.
        motion: class of the conveyor in the last step.
        steady_s: time since it changed [s]; less than 0 after a change that was taken back.
        looked_s: for how long the camera has seen the object since then [s]; infinity if it never
            changed.
        look_ns: exposure of the last image that counts in it [ns].
        look_seen: acceleration of the strongest change whose effect on the object the camera has
            seen for long enough [m/s^2].
        following: mean of the tcp off its plan, in the tool's axes [m].
        lead: of the goal before the object, for a robot that lags more than its servo models [s].
        shift: of the target after a jump of the estimate.
        compliance: of a clamped tool: the offset by force from the feed-forward target.
        tare: wrench of the free tool, and the mount's sag under it.
        digital_in: of the last telegram; before it all set, so that a bit that is set from the
            beginning has no edge.
        announced_s: time since the line announced a stop [s].
        calming: steps in which the plan is still merged without swinging, after a corner.
        oscillated: for how long the wheel's release has waited for a calm contact [s]; None if it
            does not wait.
        accelerations: planned, in the tool's axes, one a step, newest last [m/s^2].
        acceleration: of them as the last wrench was measured [m/s^2].
        sampled: forces of its samples along the tool's axis, off their mean [N].
        ramp: how the task's clock goes on before contact.
        force_sign: whether the force on the clamped tool measures the object.
        bolts: search for the angle of bolts that do not enter.
        beyond_s: for which a touch has given more force than an object does [s].
        distance_noise: of the distance sensor, as its readings show it.
    """

    history: History | None
    conveyor: Any
    transverse: TransverseState | None
    first_poses: tuple[PoseMeasurement, ...]
    poses: Array
    axis: linear_axis.AxisPlan
    departure: tuple[float, float] | None = None
    object_left: bool = False
    time: float = 0.0
    started: bool = False
    passed: frozenset[Gate] = frozenset()
    blended: float | None = None
    blend_s: float = math.inf
    contact_state: contact.ContactState = contact.NO_CONTACT
    force_offset: force_jump.ForceOffset = force_jump.NO_OFFSET
    contact: bool = False
    assumed: bool = False
    touching: float = 0.0
    touched: guard.TouchedProgramme = guard.UNTOUCHED
    fixing: float | None = None
    releasing: float | None = None
    unloading_s: float = release.UNLOADING_S
    withdrawn: float | None = None
    clamped: bool = False
    keeps: bool = False
    anchor: Array | None = None
    gone: float = 0.0
    further: float = 0.0
    leaving: float = 0.0
    distance: float = math.inf
    readings: tuple[float, ...] = ()
    pull: Vector3 = (0.0, 0.0, 0.0)
    pull_power: float = 0.0
    search: guard.ContactSearch = guard.NO_SEARCH
    pose_ns: int | None = None
    placed: bool = False
    blind_s: float = 0.0
    stood: float = 0.0
    slowed: int = 0
    clock_stood: float = 0.0
    carried: float = 0.0
    speed: float = 0.0
    unit: float | None = None
    sway: BodySway = NO_SWAY
    held: tuple[float, float] = (0.0, 0.0)
    leaning: Vector3 = (0.0, 0.0, 0.0)
    go: GoState = GO
    units: tuple[tuple[int, float], ...] = ()
    monitor: PredictionMonitor = NO_PREDICTIONS
    motion: Motion = Motion.RUNNING
    steady_s: float = 0.0
    looked_s: float = math.inf
    look_ns: int | None = None
    look_seen: float = 0.0
    following: Vector3 = (0.0, 0.0, 0.0)
    lead: float = 0.0
    shift: TargetShift = NO_SHIFT
    compliance: Compliance = NO_COMPLIANCE
    tare: Tare = NO_TARE
    digital_in: int = -1
    announced_s: float = math.inf
    oscillated: float | None = None
    accelerations: tuple[Vector3, ...] = ()
    acceleration: Vector3 = (0.0, 0.0, 0.0)
    sampled: tuple[float, ...] = ()
    ramp: ClockRamp = RUNNING
    calming: int = 0
    force_sign: ForceSign = TRUSTED
    bolts: BoltSearch = NO_BOLT_SEARCH
    beyond_s: float = 0.0
    distance_noise: MeasuredNoise = AS_CONFIGURED


class Report(Struct, frozen=True, eq=False):
    """Results of one step of tracking, without the horizon.

    Attributes:
        sensed: x_f(k, 0) (6,) in c, or None.
        part: the object now (6,) in c, or None.
        speed: of the conveyor [m/s], or None.
        motion, tentative, confidence, events: what the classifier decided in this step.
        force: mean force [N], or None without a sample.
        overload: the force exceeds the tool's limit.
        object_left: the object leaves the range of the linear axis, or is about to.
        rejected: number of pose measurements that the gate rejected in this step.
    """

    sensed: Array | None
    part: Array | None
    speed: float | None
    motion: Motion
    tentative: bool
    confidence: float
    events: tuple[tuple[str, str], ...]
    phase: Phase
    force: Array | None
    overload: bool
    object_left: bool
    rejected: int


class StepSamples(Struct, frozen=True, eq=False):
    """Samples of one step, and the pose of the robot."""

    stamp_ns: int
    tcp: Array | None
    tcp_stamp_ns: int
    distance: Sequence[DistanceSample]
    camera: Sequence[CameraSample]
    wrench: tuple[WrenchSample, ...]
    digital_in: int
