"""Which way the tool and the linear axis point: the tool at the object, the axis along the line.

Invariants:
- Pure. A task without contact may hold the tool in any direction.
"""

import math
from collections.abc import Iterator

from linemate.daemon.config.reading.complaints import Complaint
from linemate.daemon.core import rotations
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.tracking.task import Phase

LEAST_COSINE = math.sqrt(0.5)  # beyond 45 degrees more of a motion goes across than along


def misdirected(parameters: Parameters) -> Iterator[Complaint]:
    """Return a contact across or against the tool's z, and a linear axis across the conveyor."""
    tracker = parameters.tracker
    task, reference = tracker.task, tracker.reference
    phases = [point.phase for point in task.waypoints]
    if Phase.CONTACT in phases:
        i = phases.index(Phase.CONTACT)
        cosine = float(rotations.exp(reference.points[i, 3:])[2, 2])
        if reference.travels[i] and cosine < LEAST_COSINE:
            what = (
                f"the tool's z points {math.degrees(math.acos(max(cosine, -1.0))):.0f} degrees "
                "away from the object's z, at most 45: the tool presses along its z and retracts "
                "against it. Turn arm.tcp_in_flange, so that z points from the tool at the object."
            )
            yield Complaint(("waypoints", i, "pose", "quaternion"), what)
    travel = task.linear_axis.travel
    along = abs(tracker.axis_travel)
    if parameters.controller.arm.linear_axis and along < LEAST_COSINE * travel:
        what = (
            f"E1 of the URDF would move by {along:g} m along the conveyor for {travel:g} m of the "
            "axis. Check the <axis> of E1 and conveyor.axis, or set travel to 0."
        )
        yield Complaint(("linear_axis", "travel"), what)
