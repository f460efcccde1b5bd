"""Distance profile of the last approach: fast to the clearance, then at the touch speed.

Invariants:
    * Within the clearance the speed never exceeds the touch speed.
    * The profile rests at both ends and never goes back.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.task import Phase, TaskFile, WaypointFrame

BRAKING_S = 0.16  # duration of the last part, from the touch speed to rest [s]
ACCELERATION = 0.85  # largest one of the first part, from which its shortest time follows [m/s^2]
PEAK = 5.78  # largest acceleration of a quintic from rest to rest over 1 m in 1 s [1/s^2]


@dataclass(frozen=True, slots=True)
class TouchProfile:
    """Share of a straight stretch over time, in three parts.

    Attributes:
        begin: task time at which the first part starts [s].
        times: durations of the three parts [s].
        ways: their shares of the stretch; they add up to 1.
        speed: touch speed, in shares of the stretch [1/s].
    """

    begin: float
    times: tuple[float, float, float]
    ways: tuple[float, float, float]
    speed: float

    def share(self, times: Array) -> Array:
        """Return the share (m,) of the stretch at task times (m,) [s]."""
        first, second, third = self.times
        t = times - self.begin
        share = _quintic(t / first, self.ways[0], 0.0, self.speed * first)
        share += self.speed * np.minimum(np.maximum(t - first, 0.0), second)
        s = (t - first - second) / third
        share += _quintic(s, self.ways[2], self.speed * third, 0.0)
        return share


def _quintic(s: Array, way: float, first: float, last: float) -> Array:
    """Return a quintic (m,) over s in [0, 1] with its slopes at both ends, and no curvature."""
    s = np.clip(s, 0.0, 1.0)
    cube = s * s * s
    share: Array = way * cube * (10.0 + s * (6.0 * s - 15.0))
    share += first * (s + cube * (-6.0 + s * (8.0 - 3.0 * s)))
    share += last * cube * (-4.0 + s * (7.0 - 3.0 * s))
    return share


@dataclass(frozen=True, slots=True)
class _Parts:
    """Lengths [m] and durations [s] of the parts, the first as short as it may be."""

    ways: tuple[float, float, float]
    times: tuple[float, float, float]


def contact_stretch(task: TaskFile) -> int | None:
    """Return the number of the stretch that ends at the waypoint of contact.

    None for a task without one, or whose stretch is not along the object.
    """
    for i, point in enumerate(task.waypoints):
        if point.phase in {Phase.CONTACT, Phase.SCREWS}:
            frames = {task.waypoints[max(i - 1, 0)].frame, point.frame}
            return i - 1 if i > 0 and frames == {WaypointFrame.OBJECT} else None
    return None


def _parts(task: TaskFile, stretch: int) -> _Parts | None:
    """Return the parts of the stretch to contact; None if it needs no bound."""
    guard = task.guard
    here, there = task.waypoints[stretch], task.waypoints[stretch + 1]
    near, far = there.pose.position[2], here.pose.position[2]
    speed, way = guard.touch_speed, near - far
    slow = min(way, near + guard.clearance)
    if guard.clearance <= 0.0 or slow <= 0.0:
        return None
    third = 0.5 * speed * BRAKING_S
    first = max(way - slow, third)
    second = way - first - third
    if second <= 0.0:
        return None
    shortest = max(math.sqrt(PEAK * first / ACCELERATION), BRAKING_S)
    return _Parts((first, second, third), (shortest, second / speed, BRAKING_S))


def sighted(task: TaskFile, distance: float) -> TaskFile:
    """Return the task whose last waypoint before contact is at least so far from the object [m].

    The tool waits there: the camera must see the object. A waypoint before it that is nearer still
    keeps it where it is.
    """
    stretch = contact_stretch(task)
    if stretch is None:
        return task
    here, before = task.waypoints[stretch], task.waypoints[max(stretch - 1, 0)]
    x, y, z = here.pose.position
    is_nearer = before.frame is WaypointFrame.OBJECT and before.pose.position[2] > -distance
    if z <= -distance or is_nearer:
        return task
    moved = replace(here, pose=replace(here.pose, position=(x, y, -distance)))
    points = (*task.waypoints[:stretch], moved, *task.waypoints[stretch + 1 :])
    return replace(task, waypoints=points)


def lengthened(task: TaskFile) -> TaskFile:
    """Return the task with enough time for the stretch to contact.

    All later times move by as much.
    """
    stretch = contact_stretch(task)
    parts = None if stretch is None else _parts(task, stretch)
    if stretch is None or parts is None:
        return task
    here, there = task.waypoints[stretch], task.waypoints[stretch + 1]
    lacking = sum(parts.times) - (there.time - here.time)
    if lacking <= 0.0:
        return task
    points = tuple(
        replace(point, time=point.time + lacking) if i > stretch else point
        for i, point in enumerate(task.waypoints)
    )
    tool = replace(
        task.tool,
        fix_screws=_moved(task.tool.fix_screws, here.time, lacking),
        release_wheel=_moved(task.tool.release_wheel, here.time, lacking),
    )
    return replace(task, waypoints=points, tool=tool)


def _moved(time: float, after: float, by: float) -> float:
    """Return a time that moves if it is after another [s]."""
    return time + by if time > after else time


def touch_profile(task: TaskFile) -> TouchProfile | None:
    """Return the profile of a lengthened task's stretch to contact; None if it needs no bound.

    The first part takes what time is left, but waits at the beginning rather than creep: slower
    than half the touch speed the quintic would go back.
    """
    stretch = contact_stretch(task)
    parts = None if stretch is None else _parts(task, stretch)
    if stretch is None or parts is None:
        return None
    here, there = task.waypoints[stretch], task.waypoints[stretch + 1]
    (first, second, third), speed = parts.ways, task.guard.touch_speed
    way = first + second + third
    left = there.time - here.time - parts.times[1] - parts.times[2]
    taken = min(left, max(2.0 * first / speed, parts.times[0]))
    return TouchProfile(
        begin=here.time + left - taken,
        times=(taken, parts.times[1], parts.times[2]),
        ways=(first / way, second / way, third / way),
        speed=speed / way,
    )
