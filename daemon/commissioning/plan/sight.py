"""Where the task needs the camera: does it see the object from there?

Invariants:
- Pure. The object is at its nominal place, the camera where the task file has it.
"""

import math
from collections.abc import Iterator

from linemate.daemon.config.reading.complaints import Complaint
from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.tracking.reference import Reference
from linemate.daemon.core.tracking.task import Gate

WIDEST_VIEW = math.radians(60.0)  # of a lens to each side of its axis; wider ones bend the image

_PLACE = ("arm", "camera_in_tcp")


def unseen(parameters: Parameters) -> Iterator[Complaint]:
    """Return the camera's mount or its blind zone, if it shows no object where one is needed."""
    tracker = parameters.tracker
    reference, blind = tracker.reference, tracker.settings.camera.blind_below
    for i, needs in _looks(reference):
        object_in_tcp = _object_in_tcp(reference, i)
        far = math.hypot(*object_in_tcp)
        if far < blind:
            what = (
                f"{needs} {1e3 * far:.0f} mm from the object, where the camera is blind: "
                f"tracking.camera.blind_below is {1e3 * blind:g} mm. Move the waypoint away, or "
                "correct blind_below."
            )
            yield Complaint(("waypoints", i), what)
        yield from _outside(parameters, i, object_in_tcp)


def _looks(reference: Reference) -> Iterator[tuple[int, str]]:
    """Return the waypoints at which the camera has to show the object, and what needs it."""
    for i, gate in enumerate(reference.gates):
        if gate is Gate.OBJECT_SEEN:
            yield i, "the gate object_seen is"
        elif reference.times[i] == reference.sight_time:
            yield i, "the last waypoint before contact is"


def _object_in_tcp(reference: Reference, i: int) -> Array:
    """Return the nominal object's place (3,) in the tcp at a waypoint [m]."""
    relative = reference.poses(reference.times[i : i + 1])[1][0]
    place: Array = -rotations.exp(relative[3:]).T @ relative[:3]
    return place


def _outside(parameters: Parameters, i: int, object_in_tcp: Array) -> Iterator[Complaint]:
    """Return a mount from which the object is out of the camera's view, or too far away."""
    settings, guard = parameters.tracker.settings.camera, parameters.tracker.task.guard
    position, rotation = parameters.tracker.camera
    seen = rotation.T @ (object_in_tcp - position)
    far = math.hypot(*seen)
    angle = math.atan2(math.hypot(*seen[:2]), seen[2])
    if angle > WIDEST_VIEW:
        what = (
            f"at waypoints[{i}] the object is {math.degrees(angle):.0f} degrees off the camera's "
            f"z axis, along which it looks; at most {math.degrees(WIDEST_VIEW):.0f}. Check "
            "position and quaternion, and the axes of the camera's frame."
        )
        yield Complaint(_PLACE, what)
    sigma, most = settings.lateral + settings.lateral_slope * far, guard.tolerance
    if sigma > most:
        what = (
            f"at waypoints[{i}] the camera is {far:.2f} m from the object: sigma of an image is "
            f"{1e3 * sigma:.1f} mm there, limit {1e3 * most:g} mm (guard.tolerance). Check the "
            "position's unit, and tracking.camera.lateral and lateral_slope."
        )
        yield Complaint(_PLACE, what)
