"""Offset x10 of the distance sensor in each recording, equation (10) of the paper.

It is the difference between the distance reading and the object's position by the camera. One
recording cannot separate the sensor's error from a body off its hanger; the mean of several can.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal
from linemate.daemon.identification.scene_fit import SceneFit, Views

LEAST_BODIES = 5


@dataclass(frozen=True, slots=True)
class OffsetResult:
    """The offsets.

    Attributes:
        recordings: x10 of each recording [m].
        sensor: the part that all recordings share [m].
    """

    recordings: tuple[Outcome, ...]
    sensor: Outcome


def identify_offset(
    scene: SceneFit | None,
    seen: Sequence[Views],
    bodies: Sequence[int],
    start_position: float,
    origin: float,
) -> OffsetResult:
    """Return the offsets: reading less start position, less the object's place from its nominal.

    Args:
        seen: the images it rests on.
        bodies: index of the recording, so of the body, of each.
        start_position: the reading at which the object is at its nominal place [m].
        origin: that place along the conveyor [m].
    """
    if scene is None:
        refusal = Refusal("not observable: no camera sees the object")
        return OffsetResult((refusal,), refusal)
    values = [origin - start_position - float(rest.position[1]) for rest in scene.rests]
    along = scene.rest_deviations[:, 1]
    recordings = tuple(
        Estimate(value, deviation, f"{len(view.times)} images")
        for value, deviation, view in zip(values, along.tolist(), seen, strict=True)
    )
    means = [
        float(np.mean([v for v, b in zip(values, bodies, strict=True) if b == body]))
        for body in dict.fromkeys(bodies)
    ]
    if len(means) < LEAST_BODIES:
        return OffsetResult(
            recordings,
            Refusal(
                f"not observable in {len(means)} recordings: a body off its hanger looks the same;"
                f" {LEAST_BODIES} bodies would show it"
            ),
        )
    spread = float(np.std(means, ddof=1))
    shared = Estimate(
        float(np.mean(means)),
        spread / len(means) ** 0.5,
        f"{len(means)} bodies, {spread:.3f} m apart",
    )
    return OffsetResult(recordings, shared)
