"""Where the task needs the camera: can it see the object from there?

Invariants:
- Pure. The object is at its nominal place.
- The axes of the camera's frame are its maker's: where it looks is not known.
"""

from collections.abc import Iterator

import numpy as np

from linemate.daemon.config.reading.complaints import Complaint
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.tracking.reference import Reference
from linemate.daemon.core.tracking.task import Gate

FARTHEST_MOUNT = 1.2  # of a camera that rides on the arm, from the tcp [m]


def unseen(parameters: Parameters) -> Iterator[Complaint]:
    """Return the camera's mount or its blind zone, if it shows no object where one is needed."""
    tracker = parameters.tracker
    reference, blind = tracker.reference, tracker.settings.camera.blind_below
    for i, needs in _looks(reference):
        far = float(np.linalg.norm(reference.poses(reference.times[i : i + 1])[1][0, :3]))
        if far < blind:
            what = (
                f"{needs} {1e3 * far:.0f} mm from the object, where the camera is blind: "
                f"tracking.camera.blind_below is {1e3 * blind:g} mm. Move the waypoint away, or "
                "correct blind_below."
            )
            yield Complaint(("waypoints", i), what)
    lever = float(np.linalg.norm(tracker.camera[0]))
    if lever > FARTHEST_MOUNT:
        what = (
            f"the camera would be {lever:.2f} m from the tcp, at most {FARTHEST_MOUNT:g} m. Check "
            "the unit: its place is seen from the tcp."
        )
        yield Complaint(("arm", "camera_in_tcp", "position"), what)


def _looks(reference: Reference) -> Iterator[tuple[int, str]]:
    """Return the waypoints at which the camera has to show the object, and what needs it."""
    for i, gate in enumerate(reference.gates):
        if gate is Gate.OBJECT_SEEN:
            yield i, "the gate object_seen is"
        elif reference.times[i] == reference.sight_time:
            yield i, "the last waypoint before contact is"
