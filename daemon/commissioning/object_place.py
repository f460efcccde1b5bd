"""Nominal pose of the object from images of several objects by a robot at rest.

    d = mean over objects of (x, z) of C^T (p - p_0),   C' = C exp((0, mean r_y, 0))

C is the configured nominal object with y along the conveyor, p_0 its position, p and r the seen
object's position and its rotation vector in C.

Invariants:
- Pure. Along the conveyor the configured place stays: it depends on where the object is seen.
- One object says where that one hung. A nominal pose is the mean of several.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linemate.daemon.commissioning.postures import StandingPosture
from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.task import PoseFile
from linemate.daemon.identification.outcome import Refusal

LEAST_OBJECTS = 3
LARGEST_SHIFT = 0.3  # of the mean object off the configured one, across the conveyor [m]
LARGEST_TURN = 0.2  # of the mean object off the configured one [rad]


@dataclass(frozen=True, slots=True, eq=False)
class ObjectPlace:
    """Where objects hang.

    Attributes:
        position: (3,) of the mean object in base [m], as configured along the conveyor.
        rotation: (3, 3) of the mean object in base, y along the conveyor.
        off: (5,) mean object in the configured one: x, z [m], rx, ry, rz [rad].
        spread: (5,) deviation of one object from the mean.
    """

    position: Array
    rotation: Array
    off: Array
    spread: Array
    objects: int

    @property
    def deviation(self) -> Array:
        """Deviation of the mean, (5,) as ``spread``."""
        deviation: Array = self.spread / np.sqrt(self.objects)
        return deviation


def find_place(
    recordings: Sequence[Sequence[StandingPosture]], camera: PoseFile, nominal: PoseFile
) -> ObjectPlace | Refusal:
    """Return where the objects of recordings hang, or why the recordings do not say it.

    Args:
        recordings: postures of each recording; a recording has one object.
    """
    C, origin = rotations.matrix(nominal.quaternion), np.array(nominal.position)
    rows = [_seen(each, camera, C, origin) for each in recordings]
    seen = np.array([row for row in rows if row is not None])
    if len(seen) < LEAST_OBJECTS:
        return Refusal(
            f"objects seen by a robot at rest: {len(seen)}, at least {LEAST_OBJECTS} are needed. "
            "Record each object by itself, and give all recordings"
        )
    off, spread = seen.mean(axis=0), seen.std(axis=0, ddof=1)
    shift, turn = float(np.hypot(*off[:2])), float(np.linalg.norm(off[2:]))
    if shift > LARGEST_SHIFT or turn > LARGEST_TURN:
        return Refusal(
            f"the objects hang {1e3 * shift:.0f} mm and {1e3 * turn:.0f} mrad off object.nominal, "
            f"at most {1e3 * LARGEST_SHIFT:.0f} mm and {1e3 * LARGEST_TURN:.0f} mrad. Check "
            "object.nominal and arm.camera_in_tcp"
        )
    place = origin + C @ np.array((off[0], 0.0, off[1]))
    return ObjectPlace(
        place, C @ rotations.exp(np.array((0.0, off[3], 0.0))), off, spread, len(seen)
    )


def _seen(
    postures: Sequence[StandingPosture], camera: PoseFile, C: Array, origin: Array
) -> Array | None:
    """Return the object of a recording in the nominal one (5,), None if it was not seen."""
    mount, place = rotations.matrix(camera.quaternion), np.array(camera.position)
    rows, images = [], []
    for posture in postures:
        if posture.seen is None:
            continue
        in_tcp = place + mount @ posture.seen.position
        p = C.T @ (posture.position + posture.rotation @ in_tcp - origin)
        r = rotations.log(C.T @ posture.rotation @ mount @ posture.seen.rotation)
        rows.append((p[0], p[2], *r))
        images.append(posture.seen.images)
    return np.average(np.array(rows), axis=0, weights=images) if rows else None
