"""Reference trajectory x_r along the task's clock, and the clock's gates.

Poses are (6,) or (m, 6) in c. A stretch between two waypoints is a quintic of time, each end moving
as its frame does. The stretch to contact has a profile with a bounded speed near the object. The
one that leaves it has a constant speed between two ramps.
"""

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace

import numpy as np

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.merge import ALONG
from linemate.daemon.core.tracking.task import Gate, Phase, TaskFile, WaypointFrame
from linemate.daemon.core.tracking.touch.touch_profile import (
    NO_TIPS,
    BoltTips,
    TouchProfile,
    contact_stretch,
    lengthened,
    touch_profile,
)
from linemate.daemon.core.tracking.touch.withdrawal import leaving_share
from linemate.protocol.stamped_samples import Quaternion

STANDING_ACCELERATION = 0.5  # at most, with the object and of its own, of a tool at a stand [m/s^2]
SHORTEST_STANDING_S = 0.2  # in which it comes to rest [s]


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Compiled trajectory of a task.

    Attributes:
        nominal: (3, 3) C, the nominal object's axes in base.
        origin: (3,) nominal object in c as the task's clock starts.
        speed: of the nominal object along y [m/s].
        times: (w,) of the waypoints.
        points: (w, 6) in c; of those that travel, relative to the nominal object.
        travels: (w,) 1.0 for waypoints in the object's frame.
        phases: of the stretch behind each waypoint.
        turned: some waypoint is turned against the object.
        contact_time: when the tool is programmed to reach the object [s]; infinity if never.
        rest: (6,) the first pose, where the robot waits, in c.
        starts: times of the waypoints but the last, as plain floats.
        gated: times of the waypoints with a gate, and the gates, in order.
        axes: C as plain floats.
        quaternion: C as a quaternion.
        profile: of the stretch to contact; None for a quintic there too.
        guarded: number of that stretch, -1 without a profile.
    """

    nominal: Array
    origin: Array
    speed: float
    times: Array
    points: Array
    travels: Array
    phases: tuple[Phase, ...]
    gates: tuple[Gate, ...]
    turned: bool
    contact_time: float
    rest: Array
    starts: tuple[float, ...]
    gated: tuple[tuple[float, Gate], ...]
    axes: tuple[tuple[float, ...], ...]
    quaternion: Quaternion
    profile: TouchProfile | None = None
    guarded: int = -1

    def time_of(self, *phases: Phase) -> float:
        """Return when the first of some phases begins [s]; infinity if the task has none."""
        for time, phase in zip(self.times, self.phases, strict=True):
            if phase in phases:
                return float(time)
        return float("inf")

    @property
    def sight_time(self) -> float:
        """When the tool leaves the last waypoint before contact [s]; -infinity without contact."""
        planned = self.time_of(Phase.CONTACT, Phase.SCREWS)
        if planned == math.inf:
            return -math.inf
        return self.starts[max(bisect_left(self.starts, planned) - 1, 0)]

    def time_before(self, distance: float) -> float:
        """Return when the tool on its last approach is this near [m] to the object [s].

        Infinity without a contact.
        """
        if self.contact_time == math.inf:
            return math.inf
        times = np.linspace(self.sight_time, self.contact_time, 2001)
        reached = np.flatnonzero(self.poses(times)[1][:, 2] >= -distance)
        return float(times[reached[0]]) if len(reached) else self.contact_time

    @property
    def press(self) -> float:
        """Programmed tcp in the object along its axis at the waypoint of contact [m]."""
        planned = self.time_of(Phase.CONTACT, Phase.SCREWS)
        if planned == math.inf:
            return 0.0
        return float(self.poses(np.array([planned]))[1][0, 2])

    def phase(self, time: float) -> Phase:
        """Return the phase at a task time."""
        if time >= self.times[-1]:
            return Phase.DONE
        return self.phases[self._segment(time)]

    def poses(self, times: Array) -> tuple[Array, Array]:
        """Return x_r and (x_o^nom)^-1 x_r at task times; constant before and after the task.

        Returns:
            The tcp (m, 6) in c and the tcp (m, 6) in the nominal object, which is not turned in
            c: position [m] and rotation vector [rad].
        """
        first, last = self._segment(float(times[0])), self._segment(float(times[-1]))
        if first == last:
            return self._within(first, times, self._progress(first, times))
        poses, relative = np.empty((2, len(times), 6))
        start = 0
        for segment in range(first, last + 1):
            end = len(times)
            if segment < last:
                end = int(np.searchsorted(times, self.times[segment + 1]))
            part = slice(start, end)
            if end > start:
                progress = self._progress(segment, times[part])
                poses[part], relative[part] = self._within(segment, times[part], progress)
            start = end
        return poses, relative

    def _segment(self, time: float) -> int:
        """Return the number of the stretch of a task time."""
        return min(max(bisect_right(self.starts, time) - 1, 0), len(self.starts) - 1)

    def way_on(self, time: float, stood: Array) -> Array:
        """Return how far the tool goes on (m, 6) while the clock stands [m, rad].

        It comes to rest with bounded accelerations, and its own motion not beyond the stretch's
        end. A programme that stood at once had a corner in its speed, and shook the tool with
        390 N at 106 mm/s.

        Args:
            time: at which the clock stands [s].
            stood: (m,) for how long [s].
        """
        i = self._segment(time)
        end = float(self.times[i + 1])
        soon = min(time + 1e-3, end)
        at = np.array((time, soon, end))
        progress = self._progress(i, at)
        travel = self.speed * float(self._travelling(i, progress)[0])
        points, _ = self._within(i, at, progress)
        points[:, ALONG] -= travel * (at - time)  # what is left is the tool's own motion
        own = (points[1] - points[0]) / max(soon - time, 1e-9)
        # numpy's norm costs five times as much.
        speed, left = (math.sqrt(float(d.dot(d))) for d in (own[:3], (points[2] - points[0])[:3]))
        lasts = min(1.875 * speed / STANDING_ACCELERATION, 2.0 * left / max(speed, 1e-9))
        way: Array = _run_out(lasts, stood)[:, None] * own
        if travel:
            way[:, ALONG] += travel * _run_out(1.875 * abs(travel) / STANDING_ACCELERATION, stood)
        return way

    def _progress(self, i: int, times: Array) -> Array:
        """Return how much (m,) of one stretch is done at some times, from 0 to 1."""
        if self.profile is not None and i == self.guarded:
            return self.profile.share(times)
        begin, end = self.times[i], self.times[i + 1]
        if self.gates[i] is Gate.WHEEL_RELEASED:
            way = float(np.linalg.norm(self.points[i + 1, :3] - self.points[i, :3]))
            leaving = leaving_share(times - begin, end - begin, way)
            if leaving is not None and self.travels[i] == self.travels[i + 1]:
                return leaving
        s = (np.minimum(np.maximum(times, begin), end) - begin) / (end - begin)
        quintic: Array = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        return quintic

    def _travelling(self, i: int, progress: Array) -> Array:
        """Return the share (m,) of the nominal object's motion that one stretch has."""
        share: Array = self.travels[i] + progress * (self.travels[i + 1] - self.travels[i])
        return share

    def _within(self, i: int, times: Array, progress: Array) -> tuple[Array, Array]:
        """Return x_r and (x_o^nom)^-1 x_r (m, 6) at times of one stretch.

        Args:
            progress: how much (m,) of it is done then.
        """
        here, there = self.points[i], self.points[i + 1]
        poses = here + progress[:, None] * (there - here)
        relative = poses.copy()
        share = self._travelling(i, progress)
        way = self.speed * times
        base = 1.0 - share
        relative[:, :3] -= base[:, None] * self.origin
        relative[:, 1] -= base * way
        poses[:, :3] += share[:, None] * self.origin
        poses[:, 1] += share * way
        return poses, relative


def _run_out(lasts: float, stood: Array) -> Array:
    """Return what a speed of 1 adds up to (m,) while it falls to 0 without a corner [s].

    Args:
        lasts: in which it falls, if that is not too short [s].
        stood: (m,) for how long it falls already [s].
    """
    lasts = max(lasts, SHORTEST_STANDING_S)
    u = np.minimum(stood / lasts, 1.0)
    way: Array = lasts * (u - u**4 * (2.5 + u * (u - 3.0)))
    return way


def compile_reference(task: TaskFile, tips: BoltTips = NO_TIPS) -> Reference:
    """Return a task's reference, of the task ``lengthened``.

    Args:
        tips: bolts that the tool meets before the object's face.

    Raises:
        ValueError: waypoint times that do not rise, or a nominal pose whose y axis is not the
            conveyor's.
    """
    C = rotations.matrix(task.object.nominal.quaternion)
    axis = np.array(task.conveyor.axis)
    if float(C[:, 1] @ axis) < 1.0 - 1e-6:
        raise ValueError("object.nominal: its y axis must lie along conveyor.axis")
    times = np.array([point.time for point in task.waypoints])
    if bool((np.diff(times) <= 0.0).any()):
        raise ValueError("waypoints: their times must rise")
    task = lengthened(task, tips)
    times = np.array([point.time for point in task.waypoints])
    profile = touch_profile(task, tips)
    points = np.zeros((len(times), 6))
    for row, point in zip(points, task.waypoints, strict=True):
        R = rotations.matrix(point.pose.quaternion)
        if point.frame is WaypointFrame.BASE:
            row[:3], R = C.T @ np.array(point.pose.position), C.T @ R
        else:
            row[:3] = point.pose.position
        row[3:] = rotations.log(R)
    origin = C.T @ np.array(task.object.nominal.position)
    travels = np.array([float(point.frame is WaypointFrame.OBJECT) for point in task.waypoints])
    reference = Reference(
        nominal=C,
        origin=origin,
        speed=task.conveyor.nominal_speed,
        times=times,
        points=points,
        travels=travels,
        phases=tuple(point.phase for point in task.waypoints),
        gates=tuple(point.gate for point in task.waypoints),
        turned=bool(np.abs(points[:, 3:]).max() > 1e-12),
        starts=tuple(times[:-1].tolist()),
        gated=tuple((p.time, p.gate) for p in task.waypoints if p.gate is not Gate.NONE),
        axes=tuple(tuple(row) for row in C.tolist()),
        quaternion=rotations.quaternion(C),
        rest=points[0] + travels[0] * np.concatenate((origin, np.zeros(3))),
        contact_time=math.inf,
        profile=profile,
        guarded=-1 if profile is None else contact_stretch(task) or 0,
    )
    return replace(reference, contact_time=_touching(reference))


def _touching(reference: Reference) -> float:
    """Return when the programmed distance has closed [s]; infinity without a contact.

    The waypoint of contact lies beyond the object's surface, by what the mount is pressed in: the
    tool is held from the instant that the distance along its axis crosses 0, 0.18 s earlier in
    the shipped task. Without a crossing it is the waypoint's time.
    """
    planned = reference.time_of(Phase.CONTACT, Phase.SCREWS)
    if planned == math.inf:
        return planned
    times = np.linspace(reference.sight_time, planned, 4001)
    _, relative = reference.poses(times)
    reached = np.flatnonzero(relative[:, 2] >= 0.0)
    return float(times[reached[0]]) if len(reached) else planned


def barrier(reference: Reference, time: float, passed: frozenset[Gate]) -> float:
    """Return the task time of the next gate that is not open."""
    for at, gate in reference.gated:
        if at >= time - 1e-9 and gate not in passed:
            return at
    return math.inf


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceTable:
    """The reference at every step of the task's clock: a horizon is a slice of it.

    Attributes:
        reference: of which it was made.
        poses, relative: (t, 6) of ``Reference.poses`` at 0, T0, 2 T0, ...
    """

    reference: Reference
    cycle_s: float
    poses: Array
    relative: Array

    def ahead(self, time: float, limit: float, steps: int) -> tuple[Array, Array]:
        """Return x_r and (x_o^nom)^-1 x_r (steps + 1, 6) from ``time`` on; not to be written to.

        Args:
            time: of the task's clock, a multiple of T0 [s].
            limit: at which the clock stands, likewise; infinity if at none [s].
        """
        first = round(time / self.cycle_s)
        last = first + steps
        if limit < last * self.cycle_s:
            held = np.minimum(np.arange(first, last + 1), round(limit / self.cycle_s))
            if held[-1] < len(self.poses):
                return self.poses[held], self.relative[held]
        elif last < len(self.poses):
            window = slice(first, last + 1)
            return self.poses[window], self.relative[window]
        times = np.arange(first, last + 1) * self.cycle_s
        return self.reference.poses(np.minimum(times, limit))

    def between(self, times: Array) -> tuple[Array, Array]:
        """Return x_r and (x_o^nom)^-1 x_r (m, 6) at times (m,) of the task's clock [steps].

        Between two steps they are interpolated linearly.
        """
        inside = np.clip(times, 0.0, len(self.poses) - 1.0)
        first = np.minimum(inside.astype(int), len(self.poses) - 2)
        share = (inside - first)[:, None]
        poses = self.poses[first] + share * (self.poses[first + 1] - self.poses[first])
        relative = self.relative[first]
        return poses, relative + share * (self.relative[first + 1] - relative)


def tabulated(reference: Reference, cycle_s: float, steps: int) -> ReferenceTable:
    """Return a reference's table, long enough for horizons of some steps up to the task's end."""
    count = math.ceil(float(reference.times[-1]) / cycle_s) + steps + 2
    poses, relative = reference.poses(np.arange(count) * cycle_s)
    poses.setflags(write=False)
    relative.setflags(write=False)
    return ReferenceTable(reference, cycle_s, poses, relative)


def last_step(time: float, cycle_s: float) -> float:
    """Return the last multiple of T0 up to a time [s]; infinity is kept.

    The task's clock counts whole steps and stops at the last one before a gate.
    """
    return math.floor(time / cycle_s + 1e-6) * cycle_s if time < math.inf else math.inf
