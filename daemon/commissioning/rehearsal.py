"""Rehearsal: the nominal task through the kinematics, before any robot moves.

The object moves at its nominal speed and no gate waits. The result is what the task asks of the tcp
and of each axis, and why the robot cannot do it.

Invariants:
- At most ``MOST_STEPS`` poses are solved, well below a second.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from linemate.daemon.commissioning.plan.directions import misdirected
from linemate.daemon.commissioning.plan.held import strained
from linemate.daemon.commissioning.plan.phases import disordered
from linemate.daemon.commissioning.plan.sight import unseen
from linemate.daemon.config.reading.complaints import Complaint
from linemate.daemon.core import rotations, way_home
from linemate.daemon.core.control.kinematics import UnreachableError
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.parameters import Parameters, joints_at_rest
from linemate.daemon.core.step import REST_ANGLE, REST_DISTANCE
from linemate.daemon.core.tracking import linear_axis
from linemate.daemon.core.tracking.classifiers.distance import stop_delay
from linemate.daemon.core.tracking.reference import Reference
from linemate.daemon.core.tracking.task import Phase, WayHome
from linemate.daemon.core.tracking.touch.touch_profile import bolts_reach
from linemate.protocol.stamped_samples import AXES

STEP_S = 0.02
MOST_STEPS = 3000
TOLERANCE = 1e-6  # of a pose [m, rad]


@dataclass(frozen=True, slots=True)
class Peak:
    """The largest speed of the tcp or of an axis.

    Attributes:
        name: ``tcp``, or the axis.
        margin: to the nearest position limit [rad], [m]; infinity for the tcp.
    """

    name: str
    speed: float
    at_s: float
    limit: float
    margin: float

    def __str__(self) -> str:
        unit = "m" if self.name in {"tcp", "E1"} else "rad"
        text = f"{self.name}: at most {self.speed:.3f} {unit}/s at {self.at_s:.1f} s, "
        text += f"limit {self.limit:.3f}"
        return text if self.margin == math.inf else f"{text}; {self.margin:.3f} {unit} to its end"


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """What the task asks, and what is wrong with it.

    Attributes:
        peaks: of the tcp, then of each axis; empty if a pose is out of reach.
        complaints: with paths in the task file.
    """

    peaks: tuple[Peak, ...]
    complaints: tuple[Complaint, ...]


def rehearse(parameters: Parameters) -> Rehearsal:
    """Run the nominal task through the kinematics."""
    complaints = [
        *disordered(parameters.tracker.task),
        *unseen(parameters),
        *misdirected(parameters),
        *_pressed(parameters),
        *_touched_early(parameters),
        *_untouched(parameters),
        *strained(parameters),
        *_left_close(parameters),
        *_unseen_stops(parameters),
    ]
    start = _start(parameters)
    if isinstance(start, Complaint):
        return Rehearsal((), (start, *complaints))
    times = _times(parameters)
    solved = _solved(parameters, times, start)
    if isinstance(solved, Complaint):
        return Rehearsal((), (solved, *complaints))
    peaks = tuple(_peaks(parameters, times, solved))
    return Rehearsal(peaks, (*_excesses(parameters, peaks, times, solved), *complaints))


def _times(parameters: Parameters) -> Array:
    """Return the task times that are solved, evenly spaced from 0 to the end [s]."""
    end = float(parameters.tracker.reference.times[-1])
    count = min(max(2, math.ceil(end / STEP_S) + 1), MOST_STEPS)
    return np.linspace(0.0, end, count)


def _placed(parameters: Parameters, pose: Array) -> tuple[Array, Array]:
    """Return position (3,) and rotation (3, 3) in base of a pose (6,) in c."""
    nominal = parameters.tracker.reference.nominal
    return nominal @ pose[:3], nominal @ rotations.exp(pose[3:])


def _start(parameters: Parameters) -> Array | Complaint:
    """Return the joints at rest, the linear axis where it brings the tcp to the first pose."""
    tracker = parameters.tracker
    joints, way, angle = joints_at_rest(parameters.controller.arm, tracker.task, tracker.reference)
    if way <= REST_DISTANCE and angle <= REST_ANGLE:
        return _cleared(tracker.reference, tracker.task.home) or joints
    what = (
        f"with these joints the tcp is {1e3 * way:.0f} mm and {1e3 * angle:.0f} mrad away from "
        f"waypoints[0], at most {1e3 * REST_DISTANCE:.0f} mm and {1e3 * REST_ANGLE:.0f} mrad. "
        "Check rest_joints, tcp_in_flange, the URDF and the first waypoint."
    )
    return Complaint(("arm", "rest_joints"), what)


def _cleared(reference: Reference, settings: WayHome) -> Complaint | None:
    """Return that the way home would lead too near to the objects, None if it would not."""
    if not reference.travels.any():
        return None  # an exercise goes to no object
    refused = way_home.refusal(reference.rest, (float(reference.origin[way_home.AWAY]),), settings)
    if refused is None:
        return None
    return Complaint(("waypoints", 0), f"{refused}. Move the first pose, or set home.clearance.")


def _solved(parameters: Parameters, times: Array, start: Array) -> Array | Complaint:
    """Return the joints (m, axes) at task times, or the first pose that is out of reach."""
    arm = parameters.controller.arm
    poses, _ = parameters.tracker.reference.poses(times)
    rail = _rail(parameters, times, start)
    joints, rows = start.copy(), []
    for time, pose, place in zip(times.tolist(), poses, rail, strict=True):
        if arm.linear_axis:
            joints[6] = place
        position, rotation = _placed(parameters, pose)
        try:
            joints = arm.solve(joints, position, rotation, tolerance=TOLERANCE)
        except UnreachableError:
            there = ", ".join(f"{part:.3f}" for part in position)
            what = f"the arm does not reach the pose at {time:.2f} s: tcp at ({there}) m in base"
            return Complaint(("waypoints", _waypoint(parameters, time)), what)
        rows.append(joints)
    return np.array(rows)


def _rail(parameters: Parameters, times: Array, start: Array) -> Array:
    """Return the linear axis (m,) as it follows the nominal object [m]."""
    task = parameters.tracker.task
    if not parameters.controller.arm.linear_axis:
        return np.zeros(len(times))
    file, dt = task.linear_axis, float(times[1] - times[0])
    speed = parameters.tracker.axis_travel * task.conveyor.nominal_speed
    begin, ahead = float(start[6]), linear_axis.delay(file.ramp, dt)
    if not parameters.tracker.reference.travels.any():
        speed = 0.0  # an exercise: the conveyor stops soon after the start
    plan, places = linear_axis.at_rest(begin, 0), [begin]
    for time in times[1:].tolist():
        plan = linear_axis.advance(plan, begin + speed * (time + ahead), file.ramp, dt)
        places.append(float(plan.positions[-1]))
    return np.array(places)


def _waypoint(parameters: Parameters, time: float) -> int:
    """Return the number of the waypoint that the task heads for at a time."""
    times = parameters.tracker.reference.times
    return min(int(np.searchsorted(times, time)), len(times) - 1)


def _peaks(parameters: Parameters, times: Array, joints: Array) -> Iterator[Peak]:
    """Return the largest speed of the tcp and of each axis."""
    controller = parameters.controller
    arm, bounds = controller.arm, controller.limits
    dt = float(times[1] - times[0])
    places = np.array([arm.tcp_in_base(row)[0] for row in joints])
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / dt
    at = int(speeds.argmax())
    limit = controller.tcp_limit.commanded
    yield Peak("tcp", float(speeds[at]), float(times[at]), limit, math.inf)
    turning = np.abs(np.diff(joints, axis=0)) / dt
    margins = np.minimum(joints - bounds.lower, bounds.upper - joints).min(axis=0)
    for axis in range(arm.axes):
        at = int(turning[:, axis].argmax())
        yield Peak(
            AXES[axis],
            float(turning[at, axis]),
            float(times[at]),
            float(bounds.speed[axis]),
            float(margins[axis]),
        )


def _excesses(
    parameters: Parameters, peaks: tuple[Peak, ...], times: Array, joints: Array
) -> Iterator[Complaint]:
    """Return what the task asks beyond the limits."""
    bounds = parameters.controller.limits
    for peak in peaks:
        unit = "m" if peak.name in {"tcp", "E1"} else "rad"
        if peak.speed > peak.limit:
            what = (
                f"{peak.name} would move at {peak.speed:.3f} {unit}/s at {peak.at_s:.2f} s, limit "
                f"{peak.limit:.3f} {unit}/s. Check the units of times and positions."
            )
            yield Complaint(("waypoints", _waypoint(parameters, peak.at_s)), what)
        if peak.margin < 0.0:
            axis = AXES.index(peak.name)
            beyond = np.minimum(joints - bounds.lower, bounds.upper - joints)[:, axis]
            at = int(beyond.argmin())
            what = (
                f"{peak.name} would be at {joints[at, axis]:.3f} {unit} at {times[at]:.2f} s, "
                f"limits {bounds.lower[axis]:.3f} .. {bounds.upper[axis]:.3f} {unit}"
            )
            yield Complaint(("waypoints", _waypoint(parameters, float(times[at]))), what)


def _pressed(parameters: Parameters) -> Iterator[Complaint]:
    """Return a waypoint so far beyond the object's surface that the mount would be overloaded."""
    tactile = parameters.tracker.settings.tactile
    waypoints = parameters.tracker.task.waypoints
    stiffness, most = tactile.stiffness[2], tactile.overload_force
    if all(point.phase not in {Phase.CONTACT, Phase.SCREWS} for point in waypoints):
        return
    reference = parameters.tracker.reference
    for i in range(len(waypoints)):
        depth = float(reference.points[i, 2]) if reference.travels[i] else 0.0
        if depth * stiffness > most:
            what = (
                f"{1e3 * depth:g} mm beyond the object's surface press with "
                f"{depth * stiffness:.0f} N at {stiffness:g} N/m, overload is {most:g} N. Check "
                "the sign and the unit of position z, and tracking.tactile.stiffness."
            )
            yield Complaint(("waypoints", i, "pose", "position"), what)


def _touched_early(parameters: Parameters) -> Iterator[Complaint]:
    """Return a waypoint before the last approach that is nearer than where it begins.

    Nothing is guarded there: speed, search and the checks of the object's place begin later. Nor
    may bolts reach the object there.
    """
    reference = parameters.tracker.reference
    if reference.contact_time == math.inf:
        return
    last = int(np.searchsorted(reference.times, reference.sight_time))
    gaps = [0.0 - float(row[2]) for row in reference.poses(reference.times[: last + 1])[1]]
    for i, gap in enumerate(gaps[:-1]):
        if gap < gaps[-1]:
            what = (
                f"{1e3 * gap:g} mm before the object's surface, nearer than waypoints[{last}] "
                f"({1e3 * gaps[-1]:g} mm), where the last approach begins. The touch is guarded "
                "behind that one alone: move it away from the object."
            )
            yield Complaint(("waypoints", i, "pose", "position"), what)
    bolts = parameters.tracker.settings.payload.bolts
    if gaps[-1] < bolts_reach(bolts) - TOLERANCE:
        what = (
            f"the last approach begins {1e3 * gaps[-1]:g} mm before the object's surface, where "
            f"bolts of {1e3 * bolts:g} mm (tracking.payload.bolts) reach it already. Move this "
            f"waypoint and those before it out to {1e3 * bolts_reach(bolts):g} mm."
        )
        yield Complaint(("waypoints", last, "pose", "position"), what)


def _untouched(parameters: Parameters) -> Iterator[Complaint]:
    """Return the waypoint of contact if neither it nor the search behind it presses enough."""
    task, reference = parameters.tracker.task, parameters.tracker.reference
    phases = [point.phase for point in task.waypoints]
    if Phase.CONTACT not in phases:
        return
    i, search = phases.index(Phase.CONTACT), task.guard.overrun
    gap, mount = -float(reference.points[i, 2]), parameters.tracker.settings.tactile
    pressed = max(search - gap, 0.0) * mount.stiffness[2]
    is_felt = pressed >= mount.contact_force or gap <= search == 0.0
    if reference.travels[i] and not is_felt:
        what = (
            f"{1e3 * gap:g} mm before the object's surface, and the search goes on for "
            f"{1e3 * search:g} mm (guard.overrun): the tool presses with {pressed:.0f} N, a touch "
            f"is felt from {mount.contact_force:g} N on. Set the position of its surface."
        )
        yield Complaint(("waypoints", i, "pose", "position"), what)


def _left_close(parameters: Parameters) -> Iterator[Complaint]:
    """Return the last waypoint of a task with contact if no way home begins there."""
    tracker = parameters.tracker
    reference, least = tracker.reference, tracker.task.home.clearance
    gap = 0.0 - float(reference.poses(reference.times[-1:])[1][0, 2])
    if reference.contact_time < math.inf and gap < least:
        what = (
            f"the task ends {1e3 * gap:g} mm before the object's plane, at least {1e3 * least:g} "
            "mm are needed to go home (home.clearance). Let a retreat lead away from the object."
        )
        yield Complaint(("waypoints", len(reference.times) - 1, "pose", "position"), what)


def _unseen_stops(parameters: Parameters) -> Iterator[Complaint]:
    """Return a touch that a stop of the conveyor would spoil before the distance sensor shows it.

    A camera that sees the object up to the touch shows it too, and a line may announce its stops.
    """
    tracker = parameters.tracker
    settings, conveyor = tracker.settings, tracker.task.conveyor
    is_shown = settings.camera.blind_below <= 0.0 or conveyor.stop_input.bit is not None
    if is_shown or tracker.sight_time == -math.inf:
        return
    deviation, cycle_s = settings.distance.deviation, parameters.cycle_s
    # No rate of the sensor is configured: one reading a cycle is the most that counts.
    seen_s = stop_delay.seen_after(
        conveyor.deceleration, deviation, cycle_s, settings.bank.perceived
    )
    moved, most = 0.5 * conveyor.deceleration * seen_s**2, tracker.task.guard.tolerance
    if moved > most:
        what = (
            f"a stop of {conveyor.deceleration:g} m/s^2 is seen after {seen_s:.2f} s by a distance "
            f"sensor of {1e3 * deviation:g} mm (tracking.distance.deviation): the object is "
            f"{1e3 * moved:.1f} mm off then, limit {1e3 * most:.1f} mm (guard.tolerance). Use a "
            "finer distance sensor, or let the line announce its stops (conveyor.stop_input)."
        )
        yield Complaint(("conveyor", "stop_input"), what)
