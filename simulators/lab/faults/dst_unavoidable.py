"""The rule by which a collision of a fault run counts as unavoidable by its plan.

Invariants:
- The rule is pure. It reads the plant's truth and never what the daemon says of itself.
- It excuses only what happens while, or shortly after, something was taken away from the daemon.
- What is taken away must have begun at the hub, and the hub must have moved on without it.

The rule in words stands in docs/reliability.md, section "When a collision is unavoidable".
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

FORCE_LOSS_S, COLLISION_LOSS_S = 0.08, 0.12
"""A clamped robot that lost its commands for so long [s] and is sent back at once has 200 N, or
tears its mount, on a line at full speed: its servos have a dead time of 36 ms and 4 Hz."""
POSITION_LOSS_S = 0.5
"""So long without a true position sample a prediction may be wrong [s]."""
FORCE_TRAVEL_M, COLLISION_TRAVEL_M = 0.004, 0.008
"""A hub that moved less bends no mount to 200 N, and overloads none [m]."""
SMALLEST_SPEED_CHANGE = 0.01
"""A line whose speed changed by less is where a prediction says it is [m/s]."""
COMMAND_RECOVERY_S = 0.15
"""So long after its end a loss of commands acts: dead time and lag of the servos [s]."""
POSITION_RECOVERY_S = 0.5
"""The same for a loss of positions: a clamp needs 0.3 s to open [s]."""

Harm = Literal["force", "collision"]
Lost = Literal["commands", "position", "programme"]


@dataclass(frozen=True, slots=True)
class Loss:
    """One stretch of time in which something was missing that keeps a tool at a hub.

    Attributes:
        what: ``commands``: no reply moved the robot. ``position``: no true sample of distance or
            camera arrived. ``programme``: the drives were off, the controller's programme ended,
            or the daemon was gone, so that the robot may not move without an operator.
        end_s: scenario time, infinite while it goes on [s].
        at_hub: the tool was clamped, or within 20 mm of the hub plane, when it began.
        travel_m: how far the hub has moved since it began [m].
        speed_change: largest change of the line's speed since it began [m/s].
        was_moved: a reply moved the robot since it began.
    """

    what: Lost
    begin_s: float
    end_s: float
    at_hub: bool
    travel_m: float
    speed_change: float
    was_moved: bool = False


def excuse(harm: Harm, now_s: float, losses: Iterable[Loss]) -> Loss | None:
    """Return the loss that makes a harm at ``now_s`` [s] unavoidable, None without one.

    Args:
        harm: a force beyond the limit, or a collision of any kind.
        losses: what was missing, over by now or not.
    """
    return next((loss for loss in losses if _excuses(loss, harm, now_s)), None)


def _excuses(loss: Loss, harm: Harm, now_s: float) -> bool:
    if not loss.at_hub or now_s < loss.begin_s:
        return False
    lasted_s = min(loss.end_s, now_s) - loss.begin_s
    moved_on = loss.travel_m > (FORCE_TRAVEL_M if harm == "force" else COLLISION_TRAVEL_M)
    match loss.what:
        case "programme":
            return moved_on and not loss.was_moved and now_s <= loss.end_s
        case "commands":
            shortest_s = FORCE_LOSS_S if harm == "force" else COLLISION_LOSS_S
            over_s = loss.end_s + COMMAND_RECOVERY_S
            return moved_on and lasted_s > shortest_s and now_s <= over_s
    is_turned = loss.speed_change > SMALLEST_SPEED_CHANGE
    over_s = loss.end_s + POSITION_RECOVERY_S
    return is_turned and lasted_s > POSITION_LOSS_S and now_s <= over_s
