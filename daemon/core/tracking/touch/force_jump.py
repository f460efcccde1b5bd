"""Jumps of the measured force that no touch makes: the sensor's offset has changed.

The sensor measures how far the mount is bent. The bend changes at the speed of the tool against the
robot: that of the approach at a touch, and that of the tool's own vibration. A force that changes
by more between two samples has jumped. What it jumped by is an offset until it jumps back.

A touch after a jump is felt all the same: its force grows from there.
"""

import math
from collections.abc import Sequence

from msgspec import Struct

from linemate.daemon.core.tracking.touch.contact import ContactState, ToolVibration

SIGMAS = 5.0  # of the difference of two samples


class ForceOffset(Struct, frozen=True):
    """What jumps have added to the measured force.

    Attributes:
        size: of the offset [N].
        last: sample before, as measured [N]; None after a step without one.
    """

    size: float = 0.0
    last: float | None = None


NO_OFFSET = ForceOffset()


def largest_change(
    contact_state: ContactState, vibration: ToolVibration, speed: float, spacing: float
) -> float:
    """Return the largest change of the force between two samples [N].

    Args:
        speed: of the approach [m/s].
        spacing: between two samples, in steps.
    """
    newest = contact_state.forces[-vibration.period :]
    swing = 0.5 * (max(newest) - min(newest)) * math.pi / vibration.half
    pressed = vibration.stiffness * speed * vibration.cycle_s
    return (swing + pressed) * spacing + SIGMAS * math.sqrt(2.0) * vibration.noise


def without_jumps(
    state: ForceOffset, samples: Sequence[float], largest: float, free: float
) -> tuple[ForceOffset, list[float]]:
    """Return the offset after the samples of a step, and the samples without it [N].

    Args:
        samples: as measured, oldest first.
        largest: change between two of them that is no jump.
        free: force of the free tool. A jump that ends near it ends the offset.
    """
    size, last = state.size, state.last
    corrected = []
    for sample in samples:
        if last is not None and abs(sample - last) > largest:
            size = 0.0 if abs(sample - free) < largest else size + sample - last
        last = sample
        corrected.append(sample - size)
    return ForceOffset(size, last), corrected
