"""Joints, windup and undeflected tcp of the arm that a telegram reports."""

import numpy as np

from linemate.daemon.core.control import controller as control
from linemate.daemon.core.control import windup
from linemate.daemon.core.control.windup import WindupState
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.parameters import Parameters
from linemate.protocol.stamped_samples import RobotSample


def joints_of(parameters: Parameters, robot: RobotSample) -> Array:
    """Return a telegram's joints in the controller's order (axes,)."""
    if parameters.controller.arm.linear_axis:
        return np.array(robot.joints + robot.external[:1])
    return np.array(robot.joints)


def windup_after(
    parameters: Parameters, wound: WindupState | None, joints: Array | None
) -> WindupState | None:
    """Return the windup after what a telegram reports."""
    if parameters.controller.windup is None or joints is None:
        return wound
    if wound is None:
        return windup.begin(parameters.controller.windup, joints)
    return windup.follow(parameters.controller.windup, wound, joints)


def tcp_of(parameters: Parameters, joints: Array, wound: WindupState | None = None) -> Array:
    """Return the undeflected tcp (6,) in c for the motors' positions and their windup."""
    placed = control.links_of(parameters.controller, joints, wound)
    return parameters.controller.arm.tcp_in(parameters.tracker.reference.nominal, placed)


def axis_of(parameters: Parameters, joints: Array) -> float:
    """Return the linear axis' position [m], 0 without one."""
    return float(joints[6]) if parameters.controller.arm.linear_axis else 0.0
