"""Way home: from where a retreat ends back to the task's first pose, planned before it begins.

The tool first withdraws straight from the objects' plane until it is as far away as the first pose.
Then it travels in that plane, and the linear axis with it. Both stretches are quintics of time.

Invariants:
- Pure. The path is a function of its own clock, so that what is committed stays bit for bit.
- The distance to the objects' plane never falls below the smaller one of its two ends.
- The path begins only with a tool that has cleared the object.
"""

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.task import WayHome

AWAY = 2  # z of c points away from the robot: the tool withdraws along -z
PEAK_SPEED = 1.875  # of a quintic of length 1 that lasts 1 s
PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)
SETTLE_S = 0.3  # time that the axes lag behind the path at its end [s]


class HomePath(Struct, frozen=True, eq=False):
    """A planned path, and how far the robot is on it.

    Attributes:
        begin, corner, end: (6,) poses of the tcp in c; the corner ends the first stretch.
        rail: positions of the linear axis at begin and end [m].
        times: duration of the two stretches [s].
        steps: steps since it began.
    """

    begin: Array
    corner: Array
    end: Array
    rail: tuple[float, float]
    times: tuple[float, float]
    steps: int = 0


def plan_path(
    begin: Array, end: Array, rail: tuple[float, float], settings: WayHome, commit: int
) -> HomePath:
    """Return the path between two poses (6,) in c of a robot at rest.

    Args:
        rail: of the linear axis at both [m]; equal without one.
        commit: steps of the horizon that stand already: the path begins behind them.
    """
    corner = begin.copy()
    corner[AWAY] = min(float(begin[AWAY]), float(end[AWAY]))
    out = float(begin[AWAY] - corner[AWAY])
    way = float(np.linalg.norm(end[:3] - corner[:3]))
    between = rotations.exp(corner[3:]).T @ rotations.exp(end[3:])
    turn = float(np.linalg.norm(rotations.log(between)))
    along = abs(rail[1] - rail[0])
    speed, acceleration = settings.speed, settings.acceleration
    first = _duration(out, speed, acceleration)
    second = max(
        _duration(max(way, along), speed, acceleration),
        _duration(turn, settings.turn_speed, settings.turn_acceleration),
    )
    return HomePath(begin, corner, end, rail, (first, second), -commit)


def _duration(way: float, speed: float, acceleration: float) -> float:
    """Return how long a quintic over a way takes within speed and acceleration [s]."""
    return max(PEAK_SPEED * way / speed, math.sqrt(PEAK_ACCELERATION * way / acceleration))


def poses_ahead(path: HomePath, cycle_s: float, steps: int) -> Array:
    """Return the tcp (steps + 1, 6) in c from this step on."""
    times = np.arange(path.steps, path.steps + steps + 1) * cycle_s
    out, along = _shares(path, times)
    poses: Array = path.begin + out[:, None] * (path.corner - path.begin)
    return poses + along[:, None] * (path.end - path.corner)


def rail_ahead(path: HomePath, cycle_s: float, steps: int) -> Array:
    """Return the linear axis (steps + 1,) from this step on [m]."""
    times = np.arange(path.steps, path.steps + steps + 1) * cycle_s
    _, along = _shares(path, times)
    rail: Array = path.rail[0] + along * (path.rail[1] - path.rail[0])
    return rail


def is_over(path: HomePath, cycle_s: float) -> bool:
    """Return whether the path has ended and the axes have had time to settle."""
    return path.steps * cycle_s >= sum(path.times) + SETTLE_S


def refusal(tcp: Array, planes: Sequence[float], settings: WayHome) -> str | None:
    """Return why the tool is too near to the objects to go home, None if it is not.

    Args:
        tcp: pose (6,) in c; its axis points at the objects.
        planes: positions of the object along z of c [m]: nominal, and as estimated.
    """
    gap = min(planes) - float(tcp[AWAY])
    if gap >= settings.clearance:
        return None
    return (
        f"the tool is {1e3 * gap:.0f} mm before the object's plane, at least "
        f"{1e3 * settings.clearance:.0f} mm are needed to go home. Drive it away by hand"
    )


def _shares(path: HomePath, times: Array) -> tuple[Array, Array]:
    """Return the shares of both stretches (m,) at times of the path [s]."""
    first, second = path.times
    return _quintic(times, first), _quintic(times - first, second)


def _quintic(times: Array, duration: float) -> Array:
    """Return the share of a way (m,) at times since its begin [s]."""
    if duration <= 0.0:
        return np.ones(len(times))
    s = np.minimum(np.maximum(times / duration, 0.0), 1.0)
    share: Array = s * s * s * (10.0 + s * (6.0 * s - 15.0))
    return share
