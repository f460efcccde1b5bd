"""The distance sensor's offset x10 of each recording: what it reads against where the camera sees.

Law of this file: pure; it is the difference of the distance sensor's word and the object's place
along the conveyor, as the paper's (10). One recording cannot tell the sensor's own error from a
body that sits off its hanger; only over several bodies does a mean belong to the sensor.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal
from linemate.daemon.identification.scene import Scene, Views

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
    scene: Scene | None,
    seen: Sequence[Views],
    bodies: Sequence[int],
    start_position: float,
    origin: float,
) -> OffsetResult:
    """Return the offsets: reading less start position, less the object's place from its nominal.

    Args:
        seen: the images it rests on.
        bodies: which recording, hence which body, each of them is of.
        start_position: the reading at which the object is at its nominal place [m].
        origin: that place along the conveyor [m].
    """
    if scene is None:
        refusal = Refusal("not observable: no camera sees the object beside the distance sensor")
        return OffsetResult((refusal,), refusal)
    values = [origin - start_position - float(rest.position[1]) for rest in scene.rests]
    recordings = tuple(
        Estimate(value, deviation, f"{len(view.times)} images")
        for value, deviation, view in zip(values, scene.doubts[:, 1].tolist(), seen, strict=True)
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
                f" {LEAST_BODIES} bodies would tell"
            ),
        )
    spread = float(np.std(means, ddof=1))
    shared = Estimate(
        float(np.mean(means)),
        spread / len(means) ** 0.5,
        f"{len(means)} bodies, {spread:.3f} m apart",
    )
    return OffsetResult(recordings, shared)
