"""What a good assembly has shown of the sensors that see the object."""

from collections.abc import Iterator
from typing import Any

from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.daemon.cycle.learning import distances, touches


def learned(
    distance: distances.DistanceLearner | None,
    touch: touches.TouchLearner | None,
    present: TrackingSettings,
) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield who has learned, from what, and the parameters that it changes, by name.

    Args:
        distance, touch: None where they are not configured.
        present: with the values in force in that assembly.
    """
    if distance is not None and distance.shown is not None:
        yield distances.WHO, "what the object's motion has shown", distance.keep(present.distance)
        if distance.spoils_touch and touch is not None:
            # A touch that a wrong distance has moved shows no camera.
            touch.touch = None
    if touch is not None and touch.touch is not None:
        yield touches.WHO, "what the touch has shown", touch.keep(present.camera)
