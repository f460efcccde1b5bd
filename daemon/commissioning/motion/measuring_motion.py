"""Motions for commissioning, made from the arm, its limits and the task's first pose.

The *exercise* goes briskly along and about every axis of the tcp and stands after each move. The
*axis moves* turn one axis after another by 0.2 degrees and back, at creeping speed. They begin
with the linear axis 30 mm away: the way home to their first pose moves it, and it alone. Both are
tasks that a daemon runs as any other: armed and started by an operator, through its one command
limiter.

Invariants:
- Pure. No move comes nearer to a limit of an axis than ``MARGIN``, and none is faster than
  ``SHARE`` of an axis' speed, acceleration and of the tcp's speed.
- A move that the arm does not reach is made smaller, and left out in the end.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from linemate.daemon.core import rotations
from linemate.daemon.core.control.kinematics import UnreachableError
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.parameters import Parameters

LINEAR = 6  # index of the linear axis, behind the six that turn
SHARE = 0.5  # of limits that a move may use
MARGIN = 0.05  # to the position limits [rad, m]
BRISK_S = 0.4  # shortest move
STAND_S = 1.3  # after a move: the tool rings down
AXIS_ANGLE = math.radians(0.2)  # of an axis move [rad]
CREEP_S = 2.0  # duration of an axis move
CREEP_STAND_S = 1.2
RAIL_MOVE = 0.03  # of the linear axis, more than a start allows without the way home [m]
RAIL_SPEED = 0.02  # on that way [m/s]
PEAK_SPEED = 1.875  # of a quintic of length 1 that lasts 1 s
PEAK_ACCELERATION = 5.774
NEVER_S = 3000.0  # the tool's signals are not ordered

SMALL, LARGE, TURN, TILT = 0.015, 0.1, 0.03, 0.3  # [m], [m], [rad], [rad]

_SMALL_MOVES = tuple(
    tuple(sign * size if i == axis else 0.0 for i in range(6))
    for axis, size in enumerate((SMALL, SMALL, 2.0 * SMALL, TURN, TURN, TURN))
    for sign in (1.0, -1.0)
)
_LARGE_MOVES = (
    (0.0, LARGE, 0.0, 0.0, -0.5 * TILT, 0.0),
    (0.8 * LARGE, LARGE, LARGE, 0.6 * TILT, 0.5 * TILT, 0.3 * TILT),
    (-0.8 * LARGE, -LARGE, LARGE, -0.7 * TILT, 0.5 * TILT, -0.6 * TILT),
    (0.5 * LARGE, 0.0, 0.0, 0.4 * TILT, -0.8 * TILT, 0.4 * TILT),
)


@dataclass(frozen=True, slots=True, eq=False)
class _Stop:
    """A pose at which the tool stands, and how long the way to it takes [s]."""

    position: Array
    rotation: Array
    way_s: float


def exercise_task(compiled: Parameters, task: Mapping[str, Any]) -> dict[str, Any]:
    """Return the exercise as plain values of a task file.

    Args:
        compiled: of the cell's task.
        task: plain values of that task.
    """
    return _task("exercise", task, [*_exercise(compiled)], STAND_S)


def axis_task(compiled: Parameters, task: Mapping[str, Any]) -> dict[str, Any]:
    """Return the moves of single axes as plain values of a task file.

    The linear axis moves on the way home to the first pose, and stands in the task.

    Args:
        compiled: of the cell's task.
        task: plain values of that task.
    """
    home = _moved_along_rail(compiled)
    motion = _task("axes", task, [*_axis_moves(compiled, home)], CREEP_STAND_S)
    motion["linear_axis"] = {"travel": 0.0}
    motion["home"] = {**(task.get("home") or {}), "speed": RAIL_SPEED}
    return motion


def _moved_along_rail(compiled: Parameters) -> Array:
    """Return the joints at rest with the linear axis moved, if its range allows."""
    home = compiled.home
    for way in (RAIL_MOVE, -RAIL_MOVE) if compiled.controller.arm.linear_axis else ():
        joints = home.copy()
        joints[LINEAR] += way
        if _is_inside(compiled, joints):
            return joints
    return home


def _exercise(compiled: Parameters) -> Iterator[_Stop]:
    arm, home = compiled.controller.arm, compiled.home
    origin, turned = arm.tcp_in_base(home)
    before = home
    for move in (*_SMALL_MOVES, *_LARGE_MOVES, (0.0,) * 6):
        for scale in (1.0, 0.5, 0.25):
            offset = scale * np.array(move)
            position = origin + turned @ offset[:3]
            rotation = turned @ rotations.exp(offset[3:])
            try:
                joints = arm.solve(home, position, rotation, tolerance=1e-6)
            except UnreachableError:
                continue
            if _is_inside(compiled, joints):
                yield _Stop(position, rotation, _duration(compiled, before, joints))
                before = joints
                break


def _axis_moves(compiled: Parameters, home: Array) -> Iterator[_Stop]:
    """Yield the poses with one of the six axes turned, and home (axes,) after each."""
    arm = compiled.controller.arm
    there = arm.tcp_in_base(home)
    for axis in range(LINEAR):
        joints = home.copy()
        joints[axis] += AXIS_ANGLE
        if not _is_inside(compiled, joints):
            joints[axis] -= 2.0 * AXIS_ANGLE
        position, rotation = arm.tcp_in_base(joints)
        yield _Stop(position, rotation, CREEP_S)
        yield _Stop(*there, CREEP_S)


def _is_inside(compiled: Parameters, joints: Array) -> bool:
    bounds = compiled.controller.limits
    above, below = joints - bounds.lower, bounds.upper - joints
    return bool(min(above.min(), below.min()) >= MARGIN)


def _duration(compiled: Parameters, before: Array, after: Array) -> float:
    """Return how long a quintic takes within the shares of the limits [s]."""
    controller = compiled.controller
    bounds, change = controller.limits, np.abs(after - before)
    from_, to = (controller.arm.tcp_in_base(joints)[0] for joints in (before, after))
    way = float(np.linalg.norm(to - from_))
    times = [
        BRISK_S,
        PEAK_SPEED * way / (SHARE * controller.tcp_limit.commanded),
        float((PEAK_SPEED * change / (SHARE * bounds.speed)).max()),
        math.sqrt(float((PEAK_ACCELERATION * change / (SHARE * bounds.acceleration)).max())),
    ]
    return max(times)


def _task(name: str, task: Mapping[str, Any], stops: list[_Stop], stand_s: float) -> dict[str, Any]:
    """Return a task of stops; nothing is touched and no signal ordered."""
    first = stops[-1]  # the motion ends where it begins
    waypoints = [_waypoint(0.0, first, "approach"), _waypoint(stand_s, first, "approach")]
    time = stand_s
    for stop in stops:
        time += stop.way_s
        waypoints.append(_waypoint(time, stop, "approach"))
        time += stand_s
        waypoints.append(_waypoint(time, stop, "approach"))
    waypoints.append(_waypoint(time + 1.0, first, "done"))
    kept = {key: task[key] for key in ("version", "object", "conveyor") if key in task}
    arm = {**task["arm"], "urdf": "arm.urdf"}
    tool = {"fix_screws": NEVER_S, "release_wheel": NEVER_S}
    return {"name": name, "arm": arm, **kept, "tool": tool, "waypoints": waypoints}


def _waypoint(time: float, stop: _Stop, phase: str) -> dict[str, Any]:
    pose = {
        "position": [round(value, 9) for value in stop.position.tolist()],
        "quaternion": [round(value, 12) for value in rotations.quaternion(stop.rotation)],
    }
    return {"time": round(time, 3), "frame": "base", "phase": phase, "pose": pose}
