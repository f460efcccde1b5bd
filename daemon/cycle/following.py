"""Whether the robot goes where it is sent, where it rests, and what a stop would leave.

Law of this file: axes and poses in, verdicts out; a bounded memory of the last moments. It
commands nothing. A robot is always behind its commands, so it is asked only whether it is where
they led it at some time lately.
"""

from collections import deque

from linemate.daemon.core.step import Outputs, Pose
from linemate.daemon.cycle.session import Axes

AXES = ("A1", "A2", "A3", "A4", "A5", "A6", "E1")
RESTING_S = 0.12  # from the telegrams of so long is told that a robot rests
STILL = 2e-4  # and how far apart they are [rad, m]
BESIDE = 5e-4  # from where it was when the session began [rad, m]
BRAKING = 1.0  # a tool that is told to hold slows down by so much at least [m/s^2]
LEADING = 0.12  # after it went on as planned for so long: commands lead, jerk is limited [s]


class Following:
    """The commands of the last moments, and where the robot was meanwhile.

    Attributes:
        astray: which axis is not where it was sent, in words; None if all are.
    """

    __slots__ = ("_lately", "_rest", "_stayed", "astray")

    def __init__(self, behind_s: float, cycle_s: float) -> None:
        """Know nothing; a robot is at most ``behind_s`` behind, in cycles of ``cycle_s``."""
        self.astray: str | None = None
        self._stayed = 0
        self._rest: deque[Axes] = deque(maxlen=max(2, round(RESTING_S / cycle_s)))
        self._lately: deque[Axes] = deque(maxlen=max(2, round(behind_s / cycle_s)))

    @property
    def rests(self) -> bool:
        """Whether a robot that was not sent anywhere yet has stayed where its session began."""
        return self._stayed >= (self._rest.maxlen or 0)

    def begin(self, held: Axes) -> None:
        """Forget; the robot holds there."""
        self._rest.clear()
        self._lately.clear()
        self._lately.append(held)
        self.astray = None
        self._stayed = 0

    def sent(self, command: Axes) -> None:
        """The robot is sent there."""
        self._lately.append(command)

    def moving(self, axes: Axes, far: float) -> None:
        """Look where a robot is that was sent somewhere.

        Args:
            far: it may be so far beside where the last commands led it [rad, m].
        """
        self._rest.clear()
        self.astray = None
        newest = self._lately[-1]
        for n, q in enumerate(axes):
            if newest[n] - far <= q <= newest[n] + far:
                continue
            sent = [command[n] for command in self._lately]
            if not min(sent) - far <= q <= max(sent) + far:
                self.astray = f"{AXES[n]} is at {q:.3f}, it was sent to {newest[n]:.3f} (rad, m)"
                return

    def resting(self, axes: Axes, start: Axes) -> bool:
        """Look where a robot is that was not sent anywhere yet.

        Args:
            start: where it was when its session began.

        Returns:
            Whether it has come to rest somewhere else.
        """
        self.astray = None
        self._rest.append(axes)
        if all(abs(q - s) <= BESIDE for q, s in zip(axes, start, strict=True)):
            self._stayed += 1
            return False
        self._stayed = 0
        ways = zip(*self._rest, strict=True)
        return len(self._rest) == self._rest.maxlen and all(max(w) - min(w) < STILL for w in ways)


def pace(before: Outputs, now: Outputs, period: float) -> float:
    """Return the speed of the quickest axis from one step to the next [rad/s, m/s]."""
    moved = zip(before.command, now.command, strict=True)
    return max(abs(b - a) for a, b in moved) / period


def gap(now: Outputs, period: float) -> float | None:
    """Return what a stop would leave between tool and object [m], None while it is not seen.

    Along the tool's axis alone: an object that goes on sideways passes the tool in all its width.
    Commands lead the tool, so that it goes on for a while as it was planned before it slows down.

    Args:
        now: of the last step.
        period: of the steps [s].
    """
    if now.part is None or now.task_time is None:
        return None
    distance = _ahead(now.target, now.part)
    if now.horizon is None:
        return distance
    depth = now.horizon.item
    n = min(max(1, round(LEADING / period)), len(now.horizon) - 1)
    reached = depth(n, 2)
    speed = max(0.0, (reached - depth(n - 1, 2)) / period)
    return distance - (reached - depth(0, 2)) - speed * speed / (2.0 * BRAKING)


def _ahead(tool: Pose, part: Pose) -> float:
    """Return how far ahead of a tool a part is, along the tool's own z [m]."""
    px, py, pz, w, x, y, z = tool
    ax, ay, az = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
    return (part[0] - px) * ax + (part[1] - py) * ay + (part[2] - pz) * az
