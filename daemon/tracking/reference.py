"""The reference: x_r along the task's clock, and the clock with its gates.

Law of this file: what is programmed, before any sensor. Poses are (6,) or (m, 6) in c; a stretch
between two waypoints is run through by a quintic of time, each end moving as its frame does.
"""

from dataclasses import dataclass

import numpy as np

from linemate.daemon import rotations
from linemate.daemon.horizon import Array
from linemate.daemon.tracking.task import Frame, Gate, Phase, TaskFile
from linemate.protocol.samples import Quaternion


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """A task's trajectory, compiled.

    Attributes:
        nominal: (3, 3) C, the nominal object's axes in base.
        origin: (3,) nominal object in c as the task's clock starts.
        speed: of the nominal object along y [m/s].
        times: (w,) of the waypoints.
        points: (w, 6) in c; of those that travel, relative to the nominal object.
        travels: (w,) 1.0 for waypoints in the object's frame.
        phases: of the stretch behind each waypoint.
        gates: of each waypoint.
        turned: some waypoint is turned against the object.
        contact_time: when contact is planned [s]; infinity if it is not.
        rest: (6,) the first pose, where the robot waits, in c.
        axes: C as plain floats.
        quaternion: C as a quaternion.
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
    axes: tuple[tuple[float, ...], ...]
    quaternion: Quaternion

    def time_of(self, *phases: Phase) -> float:
        """Return when the first of some phases begins [s]; infinity if the task has none."""
        for time, phase in zip(self.times, self.phases, strict=True):
            if phase in phases:
                return float(time)
        return float("inf")

    def phase(self, time: float) -> Phase:
        """Return the phase at a task time."""
        if time >= self.times[-1]:
            return Phase.DONE
        return self.phases[max(int(np.searchsorted(self.times, time, side="right")) - 1, 0)]

    def poses(self, times: Array) -> tuple[Array, Array]:
        """Return x_r and (x_o^nom)^-1 x_r at task times; past its ends it stays with them.

        Args:
            times: (m,) [s].

        Returns:
            The tcp (m, 6) in c and the tcp (m, 6) in the nominal object, which is not turned in
            c: position [m] and rotation vector [rad].
        """
        t = np.minimum(np.maximum(times, self.times[0]), self.times[-1])
        i = np.searchsorted(self.times[1:-1], t, side="right")
        s = (t - self.times[i]) / (self.times[i + 1] - self.times[i])
        s = (s * s * s * (10.0 + s * (6.0 * s - 15.0)))[:, None]
        here, there = self.points[i], self.points[i + 1]
        travels = self.travels[i]
        poses = here + s * (there - here)
        share = travels + s[:, 0] * (self.travels[i + 1] - travels)
        relative = poses.copy()
        relative[:, 1] -= (1.0 - share) * self.speed * times
        relative[:, :3] -= (1.0 - share)[:, None] * self.origin
        poses[:, 1] += share * self.speed * times
        poses[:, :3] += share[:, None] * self.origin
        return poses, relative


def compile_reference(task: TaskFile) -> Reference:
    """Return a task's reference.

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
    points = np.zeros((len(times), 6))
    for row, point in zip(points, task.waypoints, strict=True):
        R = rotations.matrix(point.pose.quaternion)
        if point.frame is Frame.BASE:
            row[:3], R = C.T @ np.array(point.pose.position), C.T @ R
        else:
            row[:3] = point.pose.position
        row[3:] = rotations.log(R)
    origin = C.T @ np.array(task.object.nominal.position)
    travels = np.array([float(point.frame is Frame.OBJECT) for point in task.waypoints])
    contact = [
        point.time for point in task.waypoints if point.phase in {Phase.CONTACT, Phase.SCREWS}
    ]
    return Reference(
        nominal=C,
        origin=origin,
        speed=task.conveyor.nominal_speed,
        times=times,
        points=points,
        travels=travels,
        phases=tuple(point.phase for point in task.waypoints),
        gates=tuple(point.gate for point in task.waypoints),
        turned=bool(np.abs(points[:, 3:]).max() > 1e-12),
        axes=tuple(tuple(row) for row in C.tolist()),
        quaternion=rotations.quaternion(C),
        rest=points[0] + travels[0] * np.concatenate((origin, np.zeros(3))),
        contact_time=min(contact, default=float("inf")),
    )


def barrier(reference: Reference, time: float, passed: frozenset[Gate]) -> float:
    """Return the task time that may not be passed yet: the next gate that is not open."""
    for at, gate in zip(reference.times, reference.gates, strict=True):
        if at >= time - 1e-9 and gate is not Gate.NONE and gate not in passed:
            return float(at)
    return float("inf")
