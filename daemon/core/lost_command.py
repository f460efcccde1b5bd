"""What follows a command that the robot did not get: its limiter, a pause, a clamp in silence."""

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core.arm_pose import axis_of, tcp_of
from linemate.daemon.core.control import command_limiter
from linemate.daemon.core.control import controller as control
from linemate.daemon.core.control.windup import WindupState
from linemate.daemon.core.inputs import Inputs
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.step_state import StepState
from linemate.daemon.core.tracking import tracker_state
from linemate.daemon.core.tracking.goal import retraction
from linemate.daemon.core.tracking.task import Gate


def apply_delivery(state: StepState, inputs: Inputs) -> StepState:
    """Return the state with its limiter at the command that the robot executes.

    Without a command it holds, unless ``Inputs.pace`` says that it goes on.
    """
    if inputs.sent:
        return replace(state, applied=state.control.limiter.position)
    applied = state.applied if inputs.applied is None else np.array(inputs.applied)
    gate, moving = command_limiter.held(state.control.limiter, applied), state.moving
    if inputs.pace is not None:
        # It moves even if the state was at rest: it has to brake first.
        gate, moving = command_limiter.moving(applied, *map(np.array, inputs.pace)), True
        if state.moving:
            # Else the way to the next desired setpoint would count as its speed, as in ``held``.
            led = state.control.limiter
            gate = replace(gate, desired=led.desired, desired_speed=led.desired_speed)
    return replace(
        state, applied=applied, control=replace(state.control, limiter=gate), moving=moving
    )


def follow_silence(
    before: StepState,
    state: StepState,
    tracker: tracker_state.TrackerState,
    desired: control.DesiredCommand,
    parameters: Parameters,
    *,
    is_lost: bool,
) -> tuple[StepState, tracker_state.TrackerState, control.DesiredCommand]:
    """Return state, tracker and desired command of a tool whose clamp may have opened in silence.

    Until that is known it goes on with its object, as far behind as it is. One that is free keeps
    what it is behind: a catch-up would swing it. One that is clamped catches up.

    Args:
        state: ``before``, with the limiter at the command that the robot executes.
    """
    planned, limiter = desired.command, state.control.limiter
    if planned is None:
        return state, tracker, desired
    going = desired.state.joints[0] - before.control.joints[0]
    behind = limiter.position + going - planned
    way = tcp_of(parameters, planned + behind) - tcp_of(parameters, planned)
    share = retraction.kept_share(way)
    if not retraction.is_reported(parameters.tracker, before.tracker, tracker, is_lost=is_lost):
        tracker = replace(tracker, stood=max(before.tracker.stood, tracker.stood))
        desired = control.DesiredCommand(desired.state, planned + share * behind)
    elif Gate.WHEEL_RELEASED in tracker.passed:
        way, behind = share * way, share * behind
        axis = axis_of(parameters, behind)
        tracker = retraction.stay_behind(parameters.tracker, tracker, way, axis)
        plan = control.displaced(desired.state, behind, way)
        desired = control.DesiredCommand(plan, planned + behind)
    if desired.command is not None:
        # The way to another plan would count as the speed of this one.
        last, speed = desired.command - going, going / parameters.cycle_s
        limiter = replace(limiter, desired=last, desired_speed=speed)
        state = replace(state, control=replace(state.control, limiter=limiter))
    return state, tracker, desired


def pause(
    state: StepState, desired: control.DesiredCommand, *, is_lost: bool
) -> tuple[StepState, control.DesiredCommand]:
    """Return the state and the desired command of a plan that pauses: the last one again.

    Args:
        state: with the limiter at the command that the robot executes.
        desired: command of the plan that follows.
        is_lost: the robot stands, for it did not get the last one; else it goes half the way.
    """
    limiter = state.control.limiter
    command = limiter.desired
    if is_lost:
        limiter = command_limiter.at_rest(state.applied)
    elif desired.command is not None:
        command = 0.5 * (command + desired.command)
    held = replace(state.control, limiter=limiter)
    return replace(state, control=held), control.DesiredCommand(held, command)


def withdraw_again(
    state: StepState,
    tracker: tracker_state.TrackerState,
    wound: WindupState | None,
    parameters: Parameters,
) -> StepState:
    """Return the state of a retraction that begins again where the last command leads the robot."""
    joints = state.applied
    pose, axis = tcp_of(parameters, joints, wound), axis_of(parameters, joints)
    tracker = retraction.withdraw_again(parameters.tracker, tracker, pose, axis)
    rest = control.at_rest(parameters.controller, joints, pose, wound, state.control.drift)
    return StepState(tracker, rest, joints, moving=True, windup=wound)
