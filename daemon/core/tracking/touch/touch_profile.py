"""Distance profile of the last approach: fast to the clearance, then at the touch speed.

Bolts that stand out farther than the clearance meet the tool first. From before their tips on it
comes at a speed at which a bolt that does not enter its hole stops it without an overload.

Invariants:
    * Within the clearance the speed never exceeds the touch speed, nor what the mount withstands.
    * Within reach of the bolts' tips it never exceeds theirs.
    * The profile rests at both ends and never goes back.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.task import GuardedApproach, Phase, TaskFile, WaypointFrame
from linemate.daemon.core.tracking.touch.guard import GOES_ON_S

BRAKING_S = 0.16  # duration of the last part, from the touch speed to rest [s]
ACCELERATION = 0.85  # largest one of the first part, from which its shortest time follows [m/s^2]
PEAK = 5.78  # largest acceleration of a quintic from rest to rest over 1 m in 1 s [1/s^2]
HUB_ERROR = 0.011  # of an estimated object along the tool's axis, for a task that names none [m]
BORNE_SHARE = 0.5  # of the overload's force, which the mount gets before the tool reacts to a touch
TIPS_RESERVE = 0.005  # before the bolts' tips, for the error of the estimate [m]
LED_S = 0.2  # for which the motion goes on after the tips touch, until the tool withdraws [s]
TIPS_SHARE = 0.3  # of the overload's force that the mount gets in that time
TIPS_LIMIT = 0.5  # of the overload's force, at which the tool withdraws from the tips


@dataclass(frozen=True, slots=True)
class BoltTips:
    """Bolts that the tool meets before the object's face.

    Attributes:
        length: of the bolts from the face [m].
        speed: largest speed with which the tool comes to their tips [m/s].
    """

    length: float = 0.0
    speed: float = 0.0


NO_TIPS = BoltTips()


def slowed(task: TaskFile, stiffness: float, overload: float) -> TaskFile:
    """Return the task with a speed at every touch that the mount withstands.

    A task without a clearance of its own gets one: the estimate of an object is never exact.

    Args:
        stiffness: of the mount along the tool's axis [N/m].
        overload: force beyond which the tool is withdrawn [N].
    """
    guard = task.guard
    most = BORNE_SHARE * overload / (stiffness * GOES_ON_S)
    if guard.clearance > 0.0 and guard.touch_speed <= most:
        return task
    speed = min(guard.touch_speed, most) if guard.clearance > 0.0 else most
    clearance = guard.clearance or HUB_ERROR
    return replace(task, guard=replace(guard, clearance=clearance, touch_speed=speed))


def bolt_tips(length: float, stiffness: float, overload: float) -> BoltTips:
    """Return the bolts with the speed that keeps a tool on their tips below the overload.

    Args:
        length: from the face [m]; 0 for none.
        stiffness: of the mount along the tool's axis [N/m].
        overload: force beyond which the tool is withdrawn [N].
    """
    return BoltTips(length, TIPS_SHARE * overload / (stiffness * LED_S))


def bolts_reach(length: float) -> float:
    """Return the distance before the object from which on bolts' tips can be met slowly [m].

    Args:
        length: from the face [m]; 0 for none.
    """
    return length + 2.0 * TIPS_RESERVE if length > 0.0 else 0.0


def force_limit(length: float, distance: float, overload: float) -> float:
    """Return the force beyond which a tool that has not touched the face is withdrawn [N].

    Less than the overload where only the bolts' tips can stop it: it moves on for a while.

    Args:
        length: of the bolts from the face [m]; 0 for none.
        distance: programmed, from the tcp to the object along its z [m].
        overload: force beyond which the tool is withdrawn elsewhere [N].
    """
    is_near = length > 0.0 and -length - TIPS_RESERVE < distance < math.inf
    return TIPS_LIMIT * overload if is_near else overload


@dataclass(frozen=True, slots=True)
class TouchProfile:
    """Share of a straight stretch over time, in parts.

    Each part but the last ends at the speed at which the next begins. The last one ends at rest.

    Attributes:
        begin: task time at which the first part starts [s].
        times: durations of the parts [s].
        ways: their shares of the stretch; they add up to 1.
        speeds: at the ends of the parts, in shares of the stretch [1/s].
    """

    begin: float
    times: tuple[float, ...]
    ways: tuple[float, ...]
    speeds: tuple[float, ...]

    def share(self, times: Array) -> Array:
        """Return the share (m,) of the stretch at task times (m,) [s]."""
        t, before = times - self.begin, 0.0
        share = np.zeros_like(t)
        for lasting, way, speed in zip(self.times, self.ways, self.speeds, strict=True):
            if speed == before:
                share += speed * np.minimum(np.maximum(t, 0.0), lasting)
            else:
                share += _quintic(t / lasting, way, before * lasting, speed * lasting)
            t, before = t - lasting, speed
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
    """Lengths [m], durations [s] and last speeds [m/s] of the parts, the first part shortest."""

    ways: tuple[float, ...]
    times: tuple[float, ...]
    speeds: tuple[float, ...]


def contact_stretch(task: TaskFile) -> int | None:
    """Return the number of the stretch that ends at the waypoint of contact.

    None for a task without one, or whose stretch is not along the object.
    """
    for i, point in enumerate(task.waypoints):
        if point.phase in {Phase.CONTACT, Phase.SCREWS}:
            frames = {task.waypoints[max(i - 1, 0)].frame, point.frame}
            return i - 1 if i > 0 and frames == {WaypointFrame.OBJECT} else None
    return None


def _parts(task: TaskFile, stretch: int, tips: BoltTips) -> _Parts | None:
    """Return the parts of the stretch to contact; None if it needs no bound."""
    guard = _guard_from_tips(task.guard, tips)
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
    last = _Parts((second, third), (second / speed, BRAKING_S), (speed, 0.0))
    before = _tip_parts(guard, tips)
    to_tips = first - sum(before.ways)
    if before.ways and to_tips > 0.5 * tips.speed * BRAKING_S:
        first, speed = to_tips, tips.speed
        last = _Parts(
            before.ways + last.ways, before.times + last.times, before.speeds + last.speeds
        )
    shortest = max(math.sqrt(PEAK * first / ACCELERATION), BRAKING_S)
    return _Parts((first, *last.ways), (shortest, *last.times), (speed, *last.speeds))


def _guard_from_tips(guard: GuardedApproach, tips: BoltTips) -> GuardedApproach:
    """Return the guard of a mount that withstands less at the bolts' tips than at the touch."""
    reach = tips.length + TIPS_RESERVE
    if tips.length <= 0.0 or reach <= guard.clearance or tips.speed > guard.touch_speed:
        return guard
    return replace(guard, clearance=reach, touch_speed=tips.speed)


def _tip_parts(guard: GuardedApproach, tips: BoltTips) -> _Parts:
    """Return the parts from before the bolts' tips to the clearance; none without such bolts."""
    braking = 0.5 * (tips.speed + guard.touch_speed) * BRAKING_S
    steady = tips.length + TIPS_RESERVE - guard.clearance - braking
    if tips.length <= 0.0 or steady <= 0.0 or tips.speed <= guard.touch_speed:
        return _Parts((), (), ())
    times = steady / tips.speed, BRAKING_S
    return _Parts((steady, braking), times, (tips.speed, guard.touch_speed))


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


def lengthened(task: TaskFile, tips: BoltTips = NO_TIPS) -> TaskFile:
    """Return the task with enough time for the stretch to contact.

    All later times move by as much.
    """
    stretch = contact_stretch(task)
    parts = None if stretch is None else _parts(task, stretch, tips)
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


def touch_profile(task: TaskFile, tips: BoltTips = NO_TIPS) -> TouchProfile | None:
    """Return the profile of a lengthened task's stretch to contact; None if it needs no bound.

    The first part takes what time is left, but waits at the beginning rather than creep: slower
    than half its last speed the quintic would go back.
    """
    stretch = contact_stretch(task)
    parts = None if stretch is None else _parts(task, stretch, tips)
    if stretch is None or parts is None:
        return None
    here, there = task.waypoints[stretch], task.waypoints[stretch + 1]
    first, way = parts.ways[0], sum(parts.ways)
    left = there.time - here.time
    for lasting in parts.times[1:]:
        left -= lasting
    taken = min(left, max(2.0 * first / parts.speeds[0], parts.times[0]))
    return TouchProfile(
        begin=here.time + left - taken,
        times=(taken, *parts.times[1:]),
        ways=tuple(part / way for part in parts.ways),
        speeds=tuple(speed / way for speed in parts.speeds),
    )
