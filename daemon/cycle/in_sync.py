"""In sync: the tool follows the part within a tolerance."""

import math
from typing import Final

from linemate.daemon.core.step_state import Outputs
from linemate.daemon.cycle.states import State

_FOLLOWING: Final = frozenset({State.TRACK.value, State.CONTACT.value})


def is_in_sync(state: str, outputs: Outputs, tolerance: float) -> bool:
    """Return whether the tool follows the part.

    The error is the distance of the committed tcp, x_t(k, 0), from the sensed one, x_f(k, 0). It
    has no errors of sensors and of the arm: the daemon does not know them.

    Args:
        state: operating state of the step.
        tolerance: largest error that counts as in sync [m].
    """
    if state not in _FOLLOWING or outputs.held is not None or outputs.sensed is None:
        return False
    return math.dist(outputs.target[:3], outputs.sensed[:3]) <= tolerance
