"""What the plan asks of a tool that holds the object: to travel with it until the clamp opens.

Invariants:
- Pure. A task without contact, or without a gate on the open clamp, is passed over.
"""

from collections.abc import Iterator

import numpy as np

from linemate.daemon.config.reading.complaints import Complaint
from linemate.daemon.core import rotations
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.tracking.task import Gate, Phase, WaypointFrame


def strained(parameters: Parameters) -> Iterator[Complaint]:
    """Return waypoints that pull at the held object: across, back, turned, or at rest."""
    task, reference = parameters.tracker.task, parameters.tracker.reference
    phases, gates = [point.phase for point in task.waypoints], list(reference.gates)
    if Phase.CONTACT not in phases or Gate.WHEEL_RELEASED not in gates:
        return
    contact, release = phases.index(Phase.CONTACT), gates.index(Gate.WHEEL_RELEASED)
    for i in range(contact, release + 1):
        if task.waypoints[i].frame is not WaypointFrame.OBJECT:
            what = (
                f"base: the object travels at {task.conveyor.nominal_speed:g} m/s, and the tool "
                f"holds it up to waypoints[{release}] (wheel_released). Set frame: object."
            )
            yield Complaint(("waypoints", i, "frame"), what)
        elif i > contact:
            yield from _bent(parameters, contact, i)


def _bent(parameters: Parameters, contact: int, i: int) -> Iterator[Complaint]:
    """Return a waypoint so far from the touch that the mount would be overloaded."""
    tracker = parameters.tracker
    tactile, points = tracker.settings.tactile, tracker.reference.points
    touched = points[contact].copy()
    touched[2] = min(touched[2], 0.0)  # what the tool presses in is let go without a pull
    turned = rotations.exp(touched[3:])
    moved = turned.T @ (points[i, :3] - touched[:3])
    moved[2] = min(moved[2], 0.0)  # deeper is a matter of the press
    force = float(np.linalg.norm(moved * np.array(tactile.stiffness)))
    if force > tactile.overload_force:
        what = (
            f"{1e3 * float(np.linalg.norm(moved)):g} mm from the touch pull with {force:.0f} N at "
            f"an object that is held, overload is {tactile.overload_force:g} N. Check the signs "
            "and the unit of the position, and the place of the gate wheel_released."
        )
        yield Complaint(("waypoints", i, "pose", "position"), what)
    most = tracker.task.guard.angle_tolerance
    angle = float(np.linalg.norm(rotations.log(turned.T @ rotations.exp(points[i, 3:]))))
    if angle > most:
        what = (
            f"turned by {1e3 * angle:.0f} mrad from the touch while the object is held, at most "
            f"{1e3 * most:g} mrad (guard.angle_tolerance). Give it the orientation of the touch."
        )
        yield Complaint(("waypoints", i, "pose", "quaternion"), what)
