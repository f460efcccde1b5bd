"""Setpoints that a controller does not report as lost, seen by where it sends its servos.

Some controllers count no lost reply, but say where they send their servos. That position follows
the setpoints through a filter. Setpoints that move at a constant speed while it stands did not
arrive. They count as lost until it moves with them again.

Invariants:
- Pure, and its memory is bounded.
- Only a steady motion is judged: what a filter makes of any other is not known.
- A controller that does not say where it sends its servos loses nothing here.
"""

from collections import deque

from linemate.daemon.cycle.setpoint_reference import Axes

# The motion of the setpoints is judged over so long [s]. A filter may lag by 50 ms: a steady motion
# has lasted for twice this time, and most of its last half has come through.
WINDOW_S = 0.024
LEAST = 6e-4  # a shorter way in that time is not judged [rad, m]
STEADY = 0.3  # the ways of two such times differ by no more than this share
STANDS = 0.25  # an axis that covered a smaller share of the way did not get its setpoints
# An axis that covers such a share of the way to each setpoint gets them. One that covers more is
# sent to an older setpoint, which came late.
ARRIVED, OLDER = 0.1, 1.5
THERE = 1e-5  # servos that are sent so near to a setpoint have it [rad, m]
RESUMED_S = 0.012  # setpoints that arrive for so long are no longer lost [s]
TRUSTED_S = 0.1  # nor is the way to the controller doubtful after this time [s]


class DeliveryCheck:
    """Compares setpoints with where the controller sends its servos.

    Attributes:
        is_lost: the setpoints of the last replies did not arrive.
        is_doubtful: they did not a moment ago.
    """

    __slots__ = ("_arrived", "_given", "_length", "_resumed", "_sent_to", "_trusted", "is_lost")

    def __init__(self, cycle_s: float) -> None:
        """Begin without a setpoint."""
        self.is_lost = False
        self._resumed = max(1, round(RESUMED_S / cycle_s))
        self._arrived = self._trusted = max(1, round(TRUSTED_S / cycle_s))
        self._length = max(2, round(WINDOW_S / cycle_s))
        self._given: deque[Axes] = deque(maxlen=2 * self._length)
        self._sent_to: deque[Axes] = deque(maxlen=self._length)

    @property
    def is_doubtful(self) -> bool:
        """Whether setpoints did not arrive a moment ago."""
        return self._arrived < self._trusted

    def reset(self) -> None:
        """Forget the motion: a cycle passed without a setpoint or without a telegram."""
        self.is_lost, self._arrived = False, self._trusted
        self._given.clear()
        self._sent_to.clear()

    def add(self, given: Axes, sent_to: Axes) -> None:
        """Add a setpoint, and where the servos were sent a cycle later [rad, m]."""
        was_lost, self.is_lost = self.is_lost, self.would_be_lost(given, sent_to)
        if self.is_lost and not was_lost:
            self._arrived = 0
        elif self.is_doubtful:
            self._arrived = self._arrived + 1 if self._arrives(given, sent_to) else 0
        if was_lost and not self.is_lost:
            self._given.clear()
            self._sent_to.clear()
        self._given.append(given)
        self._sent_to.append(sent_to)

    def would_be_lost(self, given: Axes, sent_to: Axes) -> bool:
        """Return whether a setpoint counts as lost, by where the servos are sent [rad, m]."""
        if self.is_lost:
            return self._arrived + 1 < self._resumed or not self._arrives(given, sent_to)
        if len(self._given) < 2 * self._length:
            return False
        middle, first, before = self._given[self._length], self._given[0], self._sent_to[0]
        axes = zip(given, middle, first, sent_to, before, strict=True)
        return any(
            abs(new - mid) >= LEAST
            and abs(new - 2.0 * mid + old) <= STEADY * abs(new - mid)
            and (now - then) / (new - mid) < STANDS
            for new, mid, old, now, then in axes
        )

    def _arrives(self, given: Axes, sent_to: Axes) -> bool:
        """Return whether the servos are sent along the way to the last setpoint."""
        before = self._sent_to[-1]
        ways = [new - then for new, then in zip(given, before, strict=True)]
        axis = max(range(len(ways)), key=lambda n: abs(ways[n]))
        way = ways[axis]
        return abs(way) < THERE or ARRIVED <= (sent_to[axis] - before[axis]) / way <= OLDER
