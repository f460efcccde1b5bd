"""One sampling step: ``step(state, inputs, parameters) -> (state, outputs)``.

    predict -> correct -> classify -> predict the part over the horizon -> approach -> x_t
    smooth -> damp -> inverse kinematics -> feed-forward -> limits -> q_c

Invariants:
- Pure: no I/O, clock or random number.
- The inputs hold what arrived before telegram k, the robot's state of k - 1 included, so that the
  reply is ready before its telegram. The commands are feed-forward: nothing is lost by it.
- Only ``finish`` reads the delivery status of the last command. ``plan`` stays valid if the
  telegram reports another one than was assumed.
"""

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core import followed_poses, lost_command, rotations, way_home, wrench_frame
from linemate.daemon.core.arm_pose import axis_of, joints_of, tcp_of, windup_after
from linemate.daemon.core.control import command_limiter
from linemate.daemon.core.control import controller as control
from linemate.daemon.core.control.windup import WindupState
from linemate.daemon.core.followed_poses import ChunkError, FollowedPoses
from linemate.daemon.core.horizon import Array, Horizon
from linemate.daemon.core.inputs import Inputs, MotionOrder
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.step_state import (
    FIX_SCREWS,
    RELEASE_WHEEL,
    Outputs,
    Pose,
    StepPlan,
    StepState,
)
from linemate.daemon.core.tracking import contact_decision, task_clock, tracker_state
from linemate.daemon.core.tracking import tracker as tracking
from linemate.daemon.core.tracking.estimation.mount_sag import elastic
from linemate.daemon.core.tracking.go_no_go import evidence
from linemate.daemon.core.tracking.goal import rest_state, retraction
from linemate.daemon.core.tracking.reference import Reference
from linemate.daemon.core.tracking.task import Phase
from linemate.protocol.stamped_samples import RobotSample

REST_DISTANCE = 0.02  # largest distance from the task's first pose to start [m]
REST_ANGLE = 0.05  # largest rotation from it [rad]
NEAR = 0.06  # a tool this near to the object is led like a clamped one [m]
REST_TOLERANCE = 0.05  # a robot that tracked comes to rest within this distance [m]


def _in_base(reference: Reference, pose: Array) -> Pose:
    """Return a pose (6,) in c as position and quaternion in base; plain floats for speed."""
    x, y, z, rx, ry, rz = pose.tolist()
    (a, b, c), (d, e, f), (g, h, i) = reference.axes
    position = (a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z)
    return (
        *position,
        *rotations.multiply(reference.quaternion, rotations.exp_quaternion(rx, ry, rz)),
    )


def initial(
    parameters: Parameters, robot: RobotSample, before: StepState | None = None
) -> StepState:
    """Return the state of a robot at rest where a telegram reports it.

    Args:
        before: of an earlier session, of which the drift of the dead times is kept.
    """
    joints = joints_of(parameters, robot)
    wound = windup_after(parameters, None, joints)
    pose = tcp_of(parameters, joints, wound)
    drift = None if before is None else before.control.drift
    return StepState(
        tracker=rest_state.at_rest(parameters.tracker, pose, axis_of(parameters, joints)),
        control=control.at_rest(parameters.controller, joints, pose, wound, drift),
        applied=joints,
        windup=wound,
    )


def resumed(parameters: Parameters, state: StepState, robot: RobotSample) -> StepState:
    """Return the state of a robot at rest where a telegram reports it, its tool on the object.

    The object's estimate and the progress of the task are kept.
    """
    joints = joints_of(parameters, robot)
    wound = windup_after(parameters, state.windup, joints)
    pose = tcp_of(parameters, joints, wound)
    tracker = rest_state.rest(parameters.tracker, state.tracker, pose, axis_of(parameters, joints))
    drift = state.control.drift
    rest = control.at_rest(parameters.controller, joints, pose, wound, drift)
    return StepState(tracker, rest, joints, windup=wound)


def is_engaged(state: StepState, parameters: Parameters, robot: RobotSample) -> bool:
    """Return whether a robot stands where its tool was left on the object.

    An operator may have jogged it away since.
    """
    if not state.tracker.contact:
        return False
    off = state.tracker.poses[0] - tcp_of(parameters, joints_of(parameters, robot))
    return float(np.linalg.norm(off[:3])) <= REST_TOLERANCE


def step(state: StepState, inputs: Inputs, parameters: Parameters) -> tuple[StepState, Outputs]:
    """Return the state and the outputs of one sampling step.

    Args:
        state: of the step before, or ``initial``.
        inputs: everything that entered since, and the order.
    """
    return finish(state, plan(state, inputs, parameters), inputs, parameters)


def plan(state: StepState, inputs: Inputs, parameters: Parameters) -> StepPlan:
    """Return the part of a step (90 % of its time) that the last delivery does not change.

    Args:
        inputs: of which ``sent``, ``applied`` and ``pace`` are not read.
    """
    joints = None if inputs.robot is None else joints_of(parameters, inputs.robot)
    wound = windup_after(parameters, state.windup, joints)
    samples = _samples(inputs, parameters, joints, wound)
    retreat = inputs.order is MotionOrder.RETREAT
    if inputs.order is MotionOrder.HOLD or (retreat and _brakes(state)):
        observed = tracking.observe(parameters.tracker, state.tracker, samples)
        return StepPlan(*observed, windup=wound)
    if inputs.order is MotionOrder.HOME:
        return _plan_home(state, samples, parameters, wound)
    if inputs.order is MotionOrder.FOLLOW:
        return _plan_follow(state, inputs, samples, parameters, wound)
    tracker, horizon, report = tracking.track(
        parameters.tracker, state.tracker, samples, start=inputs.start, retreat=retreat
    )
    desired = control.desire_command(parameters.controller, state.control, horizon)
    return StepPlan(tracker, report, horizon, desired, wound)


def _plan_home(
    state: StepState,
    samples: tracker_state.StepSamples,
    parameters: Parameters,
    wound: WindupState | None,
) -> StepPlan:
    """Return the plan of a robot that goes home. The object is observed and not followed."""
    tracker, report = tracking.observe(parameters.tracker, state.tracker, samples)
    settings, cycle_s = parameters.tracker, parameters.cycle_s
    path = state.path
    if path is None:
        rail = (
            axis_of(parameters, state.control.limiter.position),
            axis_of(parameters, parameters.home),
        )
        commit = max(settings.commit, settings.axis_steps)
        path = way_home.plan_path(
            state.tracker.poses[0], settings.reference.rest, rail, settings.task.home, commit
        )
    path = replace(path, steps=path.steps + 1)
    poses = way_home.poses_ahead(path, cycle_s, settings.steps)
    rail_plan = way_home.rail_ahead(path, cycle_s, settings.axis_steps)
    tracker = replace(tracker, poses=poses)
    free = np.ones(len(poses))
    horizon = Horizon(poses, rail_plan, free, settings.reference.nominal, settings.commit)
    desired = control.desire_command(parameters.controller, state.control, horizon)
    return StepPlan(tracker, report, horizon, desired, wound, path)


def _plan_follow(
    state: StepState,
    inputs: Inputs,
    samples: tracker_state.StepSamples,
    parameters: Parameters,
    wound: WindupState | None,
) -> StepPlan:
    """Return the plan of a robot that follows poses handed in. The linear axis stands."""
    tracker, report = tracking.observe(parameters.tracker, state.tracker, samples)
    settings, cycle_s = parameters.tracker, parameters.cycle_s
    follow = followed(state)
    follow = replace(follow, steps=follow.steps + 1)
    for chunk in inputs.chunks:
        try:
            follow = extended(follow, chunk, inputs.stamp_ns, parameters)
        except ChunkError:
            follow = replace(follow, refused=follow.refused + 1)
    poses = followed_poses.poses_ahead(follow, state.tracker.poses, settings.commit, cycle_s)
    tracker = replace(tracker, poses=poses)
    free = np.ones(len(poses))
    rail = state.tracker.axis.positions
    horizon = Horizon(poses, rail, free, settings.reference.nominal, settings.commit)
    desired = control.desire_command(parameters.controller, state.control, horizon)
    return StepPlan(tracker, report, horizon, desired, wound, follow=follow)


def followed(state: StepState) -> FollowedPoses:
    """Return the curve that the robot follows, or that of a robot at rest."""
    return state.follow or followed_poses.begin(state.tracker.poses[0])


def extended(
    follow: FollowedPoses, chunk: followed_poses.Chunk, stamp_ns: int, parameters: Parameters
) -> FollowedPoses:
    """Return a curve with one more chunk of poses.

    Raises:
        ChunkError: why it is refused.
    """
    tracker = parameters.tracker
    return followed_poses.extend(
        follow,
        chunk,
        stamp_ns,
        nominal=tracker.reference.nominal,
        plane=float(tracker.reference.origin[way_home.AWAY]),
        limits=tracker.task.follow,
        cycle_s=parameters.cycle_s,
        commit=tracker.commit,
    )


def finish(
    state: StepState, planned: StepPlan, inputs: Inputs, parameters: Parameters
) -> tuple[StepState, Outputs]:
    """Return a step's state and outputs, with the delivery of the last command.

    Args:
        planned: by ``plan`` from the same state, inputs and parameters.
        inputs: ``sent``, ``applied`` and ``pace`` may differ from those of ``plan``.
    """
    delivered = _follow_drift(lost_command.apply_delivery(state, inputs), inputs, parameters)
    horizon, desired = planned.horizon, planned.desired
    if horizon is None or desired is None:
        delivered = replace(delivered, windup=planned.windup)
        state = _brake(delivered, planned.tracker, parameters)
        return state, _outputs(state, inputs, planned.report, None, "hold", parameters)
    tracker = planned.tracker
    if planned.path is None and planned.follow is None:
        is_lost = not inputs.sent and inputs.pace is None
        tracker = contact_decision.update_contact(
            parameters.tracker,
            state.tracker,
            planned.tracker,
            planned.report,
            held=is_lost,
            is_open=inputs.robot is None or bool(inputs.robot.digital_in & task_clock.CLAMP_OPEN),
        )
        if retraction.is_interrupted(parameters.tracker, tracker):
            state = lost_command.withdraw_again(delivered, tracker, planned.windup, parameters)
            return state, _outputs(state, inputs, planned.report, None, "no reply", parameters)
        leaves = inputs.order is not MotionOrder.RETREAT
        if leaves and retraction.may_have_opened(parameters.tracker, state.tracker, tracker):
            delivered, tracker, desired = lost_command.follow_silence(
                state, delivered, tracker, desired, parameters, is_lost=is_lost
            )
        elif leaves and (is_lost or tracker.slowed):
            tracker, is_paused = retraction.pause(
                parameters.tracker, state.tracker, tracker, is_lost=is_lost
            )
            if is_paused:
                delivered, desired = lost_command.pause(delivered, desired, is_lost=is_lost)
    # A clamp may have closed unfelt: it is pulled as one that was felt. The distance is infinite
    # before a task is tracked.
    clamped = state.tracker.contact or state.tracker.clamped or abs(state.tracker.distance) < NEAR
    after, held = control.limit_command(
        parameters.controller, desired, delivered.control.limiter, clamped=clamped
    )
    after = replace(after, drift=delivered.control.drift)
    state = StepState(
        tracker,
        after,
        delivered.applied,
        moving=True,
        windup=planned.windup,
        path=planned.path,
        follow=planned.follow,
    )
    outputs = _outputs(state, inputs, planned.report, tracker.poses, held, parameters)
    if planned.report.object_left or desired.command is None:
        outputs = replace(outputs, object_left=True)
    return state, outputs


def _follow_drift(state: StepState, inputs: Inputs, parameters: Parameters) -> StepState:
    """Return the state with the drift of the dead times after the last telegram."""
    if parameters.controller.drift is None:
        return state
    reported = None if inputs.robot is None else joints_of(parameters, inputs.robot)
    after = control.follow_drift(parameters.controller, state.control, state.applied, reported)
    return replace(state, control=after)


def _brake(
    state: StepState, tracker: tracker_state.TrackerState, parameters: Parameters
) -> StepState:
    """Return the state of a robot on hold: it brakes; at rest its plan is reset."""
    if not state.moving:
        return replace(state, tracker=tracker, path=None, follow=None)
    braked = control.stop(parameters.controller, state.control)
    is_standing = command_limiter.is_standing(braked.limiter)
    joints, wound = braked.limiter.position, state.windup
    pose = tcp_of(parameters, joints, wound)
    if is_standing:
        braked = control.at_rest(parameters.controller, joints, pose, wound, state.control.drift)
    tracker = rest_state.rest(parameters.tracker, tracker, pose, axis_of(parameters, joints))
    return StepState(tracker, braked, state.applied, moving=not is_standing, windup=wound)


def _brakes(state: StepState) -> bool:
    """Return whether a free tool brakes on hold: its retreat begins at rest.

    A plan at rest under a robot that moves turned it back and forth at its limits.
    """
    tracker = state.tracker
    is_engaged = tracker.contact or tracker.clamped or tracker.started
    return state.moving and not is_engaged and tracker.anchor is None


def _samples(
    inputs: Inputs, parameters: Parameters, joints: Array | None, wound: WindupState | None
) -> tracker_state.StepSamples:
    tcp = None if joints is None else tcp_of(parameters, joints, wound)
    return tracker_state.StepSamples(
        stamp_ns=inputs.stamp_ns,
        tcp=tcp,
        tcp_stamp_ns=0 if inputs.robot is None else inputs.robot.stamp_ns,
        distance=inputs.distance,
        camera=inputs.camera,
        wrench=wrench_frame.each_at_tcp(parameters.wrench_frame, inputs.wrench),
        digital_in=0 if inputs.robot is None else inputs.robot.digital_in,
    )


def _ready(state: StepState, parameters: Parameters) -> str | None:
    """Return why the task cannot start, None if it can."""
    if state.tracker.conveyor is None:
        return "no distance has been measured yet"
    if not is_home(state, parameters):
        off = _off_rest(state, parameters)
        return (
            f"the tcp is {1e3 * float(np.linalg.norm(off[:3])):.0f} mm and "
            f"{1e3 * float(np.linalg.norm(off[3:])):.0f} mrad away from the task's first pose. "
            "Order home"
        )
    return None


def _off_rest(state: StepState, parameters: Parameters) -> Array:
    """Return how far the tcp is off the task's first pose (6,) in c."""
    off: Array = state.tracker.poses[0] - parameters.tracker.reference.rest
    return off


def is_home(state: StepState, parameters: Parameters) -> bool:
    """Return whether a robot that stands is at the task's first pose."""
    off = _off_rest(state, parameters)
    is_near = float(np.abs(off[:3]).max()) <= REST_DISTANCE
    return not state.moving and is_near and float(np.abs(off[3:]).max()) <= REST_ANGLE


def home_refusal(state: StepState, outputs: Outputs, parameters: Parameters) -> str | None:
    """Return why the robot cannot go home from where it is, None if it can."""
    tracker, reference = state.tracker, parameters.tracker.reference
    if state.moving:
        return "the robot still moves"
    if tracker.contact or tracker.clamped:
        return "the tool is on the object. Order retreat"
    planes = [float(reference.origin[way_home.AWAY])]
    if outputs.part is not None:
        planes.append(float(reference.nominal[:, way_home.AWAY] @ np.array(outputs.part[:3])))
    return way_home.refusal(tracker.poses[0], planes, parameters.tracker.task.home)


def _outputs(
    state: StepState,
    inputs: Inputs,
    report: tracker_state.Report,
    poses: Array | None,
    held: str | None,
    parameters: Parameters,
) -> Outputs:
    tracker, reference = state.tracker, parameters.tracker.reference
    signals = 0
    if tracker.fixing is not None and inputs.order is not MotionOrder.RETREAT:
        signals |= FIX_SCREWS
    if tracker.releasing is not None and not tracker.keeps:
        signals |= RELEASE_WHEEL
    return Outputs(
        k=inputs.k,
        stamp_ns=inputs.stamp_ns,
        command=tuple(state.control.limiter.position.tolist()),
        digital_out=signals,
        phase=report.phase if tracker.withdrawn is None else Phase.RETREAT,
        task_time=tracker.time if tracker.started else None,
        scenario=report.motion.value,
        scenario_state="tentative" if report.tentative else "confirmed",
        confidence=report.confidence,
        events=report.events,
        target=_in_base(reference, elastic(tracker, tracker.poses[0])),
        sensed=None if report.sensed is None else _in_base(reference, report.sensed),
        part=None if report.part is None else _in_base(reference, report.part),
        speed=report.speed,
        horizon=poses,
        contact=tracker.contact,
        clamped=tracker.clamped,
        overdue=task_clock.is_overdue(parameters.tracker, tracker),
        overload=report.overload,
        finished=_is_finished(state, report, parameters),
        held=held,
        ready="under way" if state.moving else _ready(state, parameters),
        refused=report.rejected,
        waiting=evidence.waiting(parameters.tracker, tracker),
        waited_s=tracker.go.waited_s or None,
        swinging_n=tracking.swinging(parameters.tracker, tracker),
        unanswered_n=tracking.unanswered(parameters.tracker, tracker),
    )


def _is_finished(state: StepState, report: tracker_state.Report, parameters: Parameters) -> bool:
    """Return whether the task, the retraction or the way home is over."""
    if state.path is not None:
        return way_home.is_over(state.path, parameters.cycle_s)
    if state.follow is not None:
        return followed_poses.is_over(state.follow, parameters.cycle_s)
    withdrawn = state.tracker.withdrawn
    if report.phase is Phase.DONE or withdrawn is None:
        return report.phase is Phase.DONE
    way = parameters.tracker.withdrawal
    return withdrawn > max(1.2 * way.duration, way.lasting(state.tracker.further))
