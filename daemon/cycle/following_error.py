"""Following error, rest, and the distance that a stop would leave.

A robot lags behind its commands. So its position is compared with all commands of the last
moments, not with the newest one alone.

Invariants:
- Pure. It commands nothing, and its memory is bounded.
"""

from collections import deque

from linemate.daemon.core.step import Outputs, Pose
from linemate.daemon.cycle.session import Axes
from linemate.protocol.stamped_samples import AXES

REST_S = 0.12  # the robot rests if its telegrams of this time ...
STILL = 2e-4  # ... are this near to each other [rad, m]
OFF_START = 5e-4  # rest farther from the session's start is another place [rad, m]
BRAKING = 1.0  # least deceleration of a tool that stops [m/s^2]
LEADING_S = 0.12  # a stopping tool follows its plan for this time: commands lead, jerk is limited


class FollowingCheck:
    """Compares the robot's position with its commands.

    Attributes:
        error: the axis beyond the tolerance, in words; None if there is none.
    """

    __slots__ = ("_at_start", "_commands", "_rest", "error")

    def __init__(self, lag_s: float, cycle_s: float) -> None:
        """Begin with no command.

        Args:
            lag_s: longest lag of the robot behind its commands [s].
        """
        self.error: str | None = None
        self._at_start = 0
        self._rest: deque[Axes] = deque(maxlen=max(2, round(REST_S / cycle_s)))
        self._commands: deque[Axes] = deque(maxlen=max(2, round(lag_s / cycle_s)))

    @property
    def is_resting(self) -> bool:
        """Whether a robot without a command has stayed where its session began."""
        return self._at_start >= (self._rest.maxlen or 0)

    def reset(self, held: Axes) -> None:
        """Begin a session with a robot that holds at a position."""
        self._rest.clear()
        self._commands.clear()
        self._commands.append(held)
        self.error = None
        self._at_start = 0

    def add_command(self, command: Axes) -> None:
        """Add the newest command."""
        self._commands.append(command)

    def check_moving(self, axes: Axes, tolerance: float) -> None:
        """Compare the position of a robot that has got a command.

        Args:
            tolerance: beyond the range of the last commands [rad, m].
        """
        self._rest.clear()
        self.error = None
        newest = self._commands[-1]
        for n, q in enumerate(axes):
            if newest[n] - tolerance <= q <= newest[n] + tolerance:
                continue
            commands = [command[n] for command in self._commands]
            if not min(commands) - tolerance <= q <= max(commands) + tolerance:
                self.error = f"{AXES[n]} is at {q:.3f}, it was sent to {newest[n]:.3f} (rad, m)"
                return

    def check_resting(self, axes: Axes, start: Axes) -> bool:
        """Return whether a robot without a command has come to rest away from the start.

        Args:
            start: its position when the session began.
        """
        self.error = None
        self._rest.append(axes)
        for q, s in zip(axes, start, strict=True):
            if not abs(q - s) <= OFF_START:
                break
        else:
            self._at_start += 1
            return False
        self._at_start = 0
        ranges = zip(*self._rest, strict=True)
        return len(self._rest) == self._rest.maxlen and all(max(r) - min(r) < STILL for r in ranges)


def max_axis_speed(before: Outputs, now: Outputs, period: float) -> float:
    """Return the speed of the fastest axis from one step to the next [rad/s, m/s]."""
    moved = zip(before.command, now.command, strict=True)
    return max(abs(b - a) for a, b in moved) / period


def gap_after_stop(now: Outputs, period: float) -> float | None:
    """Return what a stop would leave between tool and object [m], None while it is not seen.

    Along the tool's axis alone: an object that goes on sideways passes the tool in all its width.
    Commands lead the tool. So it follows its plan for a while before it slows down.

    Args:
        now: outputs of the last step.
        period: of the steps [s].
    """
    if now.part is None or now.task_time is None:
        return None
    distance = _ahead(now.target, now.part)
    if now.horizon is None:
        return distance
    depth = now.horizon.item
    n = min(max(1, round(LEADING_S / period)), len(now.horizon) - 1)
    reached = depth(n, 2)
    speed = max(0.0, (reached - depth(n - 1, 2)) / period)
    return distance - (reached - depth(0, 2)) - speed * speed / (2.0 * BRAKING)


def _ahead(tool: Pose, part: Pose) -> float:
    """Return how far ahead of a tool a part is, along the tool's own z [m]."""
    px, py, pz, w, x, y, z = tool
    ax, ay, az = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
    return (part[0] - px) * ax + (part[1] - py) * ay + (part[2] - pz) * az
