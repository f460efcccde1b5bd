"""Whether a sensor can be believed: each is out and back in by rule, with its reason.

Law of this file: pure; samples in, verdicts out, stamps come with the samples, a bounded memory.
It knows what no sensor can do (jump, stand still at full speed, repeat itself to the last bit),
not where the object is: what fits no estimate is refused by the tracker's gates. A sample that is
refused here reaches no step and makes nothing fresh. Source: reference/reliability.md, S6 to S8.
"""

from collections import deque
from typing import Any

from linemate.protocol.samples import CameraSample, DistanceSample, WrenchSample

BAD, OF = 3, 5
"""A sensor is out when so many of its last so many samples were bad, or all of them for"""
BAD_S = 0.1
GOOD = 10
"""samples in a row let it back in."""

JUMP = 0.03
"""A distance is never further from where it was heading [m], but for"""
DEVIATIONS = 6.0
"""so many of its standard deviations,"""
ACCELERATION = 1.0
"""what no conveyor exceeds [m/s^2],"""
UNKNOWN_SPEED = 1.0
"""and while its speed is not known, so much [m/s]."""

FORGOTTEN_NS = 2_000_000_000
"""A heading that nothing has agreed with for so long [ns] may have been wrong itself."""

OUTVOTING = 3
"""So many samples are one, their median; an outlier that is no jump yet misleads nobody."""

MOVING = 0.05
"""A conveyor that was so quick [m/s] does not stand all at once: a distance that is the same for"""
STUCK_S = 0.15
HEADING_NS = 300_000_000
"""is stuck; its speed is that of so long before [s, ns]."""
QUANTA = 1.5
"""A coarse sensor is given the time of so many of its own units."""

CONTRADICTIONS = 8
"""Poses in a row that the tracker refused although its gate had widened: noise alone is not it."""

SAME_POSES = 4
SAME_WRENCHES = 25
"""So many alike to the last bit, while something moves, are one that is stuck."""

MOST_FORCE = 1e5
MOST_TORQUE = 1e5
"""Beyond these nothing is a measurement [N, Nm]."""


class Health:
    """What is common to all: out and back in.

    Attributes:
        reason: why the sensor is out, None if it is in.
        since_ns: when that began [ns], None before the first change.
        outs: how often it went out.
    """

    __slots__ = ("_bad_since_ns", "_good", "_lately", "outs", "reason", "refused", "since_ns")

    def __init__(self) -> None:
        """Believe the sensor."""
        self.reason: str | None = None
        self.since_ns: int | None = None
        self.refused = self.outs = 0
        self._lately: deque[bool] = deque(maxlen=OF)
        self._bad_since_ns: int | None = None
        self._good = 0

    def judge(self, stamp_ns: int, fault: str | None) -> bool:
        """Take one sample's verdict.

        Args:
            stamp_ns: of the sample [ns].
            fault: what is wrong with it, None if nothing is.

        Returns:
            Whether it may be used.
        """
        if fault is None:
            self._lately.append(False)
            self._bad_since_ns = None
            self._good += 1
            if self.reason is not None and self._good >= GOOD:
                self.reason, self.since_ns = None, stamp_ns
                self._lately.clear()
            is_used = self.reason is None
        else:
            self._lately.append(True)
            self._good = 0
            began_ns = self._bad_since_ns if self._bad_since_ns is not None else stamp_ns
            self._bad_since_ns = began_ns
            if sum(self._lately) >= BAD or stamp_ns - began_ns >= BAD_S * 1e9:
                self.exclude(stamp_ns, fault)
            is_used = False
        self.refused += not is_used
        return is_used

    def exclude(self, stamp_ns: int, reason: str) -> None:
        """The sensor is out, whatever its last samples were; it must prove itself."""
        self._good = 0
        if self.reason is None:
            self.reason, self.since_ns = reason, stamp_ns
            self.outs += 1

    def status(self, now_ns: int) -> dict[str, Any]:
        """Return which state it is in, why and for how long [s]."""
        since_s = None if self.since_ns is None else round((now_ns - self.since_ns) * 1e-9, 3)
        return {
            "out": self.reason,
            "since_s": since_s,
            "refused": self.refused,
            "outs": self.outs,
        }


Trusted = tuple[int, float]
"""Stamp [ns] and distance [m] of a sample that was believed."""


class DistanceHealth(Health):
    """A distance goes on where it was heading, and stands only after it has slowed down."""

    __slots__ = ("_changed_ns", "_quick", "_trusted", "_unit", "_value")

    def __init__(self) -> None:
        """Know nothing of where it is heading."""
        super().__init__()
        self._trusted: deque[Trusted] = deque(maxlen=256)
        self._value: float | None = None
        self._changed_ns = 0
        self._quick: float | None = None  # how quick it was at its last change
        self._unit = 0.0

    def believes(self, sample: DistanceSample, deviation: float) -> bool:
        """Return whether a sample may be used.

        Args:
            deviation: standard deviation of the sensor [m].
        """
        trusted, stamp_ns, position = self._trusted, sample.stamp_ns, sample.position
        if trusted and stamp_ns - trusted[-1][0] > FORGOTTEN_NS:
            trusted.clear()
        lately = None
        if len(trusted) >= OUTVOTING:
            lately = _middle(trusted[-3], trusted[-2], trusted[-1])
        speed = self._speed(lately)
        if position != self._value:
            if self._value is not None:
                step = abs(position - self._value)
                self._unit = min(step, self._unit) if self._unit else step
            self._value, self._changed_ns, self._quick = position, stamp_ns, speed
        fault = _jumped(sample, lately, speed, deviation) or self._stuck(stamp_ns)
        if fault is None:
            trusted.append((stamp_ns, position))
            while stamp_ns - trusted[0][0] > HEADING_NS:
                trusted.popleft()
        return self.judge(stamp_ns, fault)

    def _stuck(self, stamp_ns: int) -> str | None:
        stood = (stamp_ns - self._changed_ns) * 1e-9
        if stood < STUCK_S or self._quick is None or abs(self._quick) < MOVING:
            return None
        if stood * abs(self._quick) < QUANTA * self._unit:
            return None
        return f"it stands still all at once, from {self._quick:.3f} m/s"

    def _speed(self, lately: Trusted | None) -> float | None:
        """Return the mean speed lately [m/s], None if too little is known."""
        trusted = self._trusted
        if lately is None or len(trusted) < 2 * OUTVOTING:
            return None
        (first_ns, first), (last_ns, last) = _middle(trusted[0], trusted[1], trusted[2]), lately
        if last_ns - first_ns < HEADING_NS // 2:
            return None
        return (last - first) / ((last_ns - first_ns) * 1e-9)


def _middle(one: Trusted, two: Trusted, three: Trusted) -> Trusted:
    """Return stamp [ns] and median [m] of three in a row: an outlier has no say."""
    return two[0], sorted((one[1], two[1], three[1]))[1]


def _jumped(
    sample: DistanceSample, lately: Trusted | None, speed: float | None, deviation: float
) -> str | None:
    """Return why a sample is not where a distance was heading, None if it may be there.

    Args:
        lately: stamp and median of the last ones, None while there are too few.
        speed: at which it was heading on [m/s], None if that is not known.
        deviation: standard deviation of the sensor [m].
    """
    if lately is None:
        return None
    last_ns, last = lately
    passed = (sample.stamp_ns - last_ns) * 1e-9
    borne = max(JUMP, DEVIATIONS * deviation) + 0.5 * ACCELERATION * passed * passed
    borne += UNKNOWN_SPEED * passed if speed is None else 0.0
    off = sample.position - last - (speed or 0.0) * passed
    return None if abs(off) <= borne else f"it jumped by {off:.3f} m"


class CameraHealth(Health):
    """No two images give the same pose to the last bit, and poses agree with what is known."""

    __slots__ = ("_contradictions", "_pose", "_same")

    def __init__(self) -> None:
        """Have seen nothing."""
        super().__init__()
        self._contradictions = 0
        self._pose: tuple[float, ...] = ()
        self._same = 0

    def believes(self, sample: CameraSample, *, moving: bool) -> bool:
        """Return whether a sample may be used.

        Args:
            moving: something moves, so that no two poses are alike.
        """
        pose = (*sample.position, *sample.quaternion)
        self._same = self._same + 1 if moving and pose == self._pose else 1
        self._pose = pose
        is_stuck = self._same >= SAME_POSES
        fault = f"{self._same} poses alike" if is_stuck else None
        if fault is not None:
            self.exclude(sample.stamp_ns, fault)
        return self.judge(sample.stamp_ns, fault)

    @property
    def contradicts(self) -> bool:
        """Poses that were believed here fit nothing that was known of the object."""
        return self._contradictions >= CONTRADICTIONS

    def answered(self, given: int, refused: int) -> None:
        """Note what became of poses that were believed here.

        Args:
            given: to the tracker, in one step.
        """
        if given:
            self._contradictions = self._contradictions + given if refused >= given else 0


class WrenchHealth(Health):
    """No two wrenches are alike for long on a tool that moves, and none is beyond all measure."""

    __slots__ = ("_same", "_wrench")

    def __init__(self) -> None:
        """Have felt nothing."""
        super().__init__()
        self._wrench: tuple[float, ...] = ()
        self._same = 0

    def believes(self, sample: WrenchSample, *, moving: bool) -> bool:
        """Return whether a sample may be used.

        Args:
            moving: the tool moves, so that no two are alike for long.
        """
        wrench = (*sample.force, *sample.torque)
        self._same = self._same + 1 if moving and wrench == self._wrench else 1
        self._wrench = wrench
        fault = None
        if max(map(abs, sample.force)) > MOST_FORCE or max(map(abs, sample.torque)) > MOST_TORQUE:
            fault = "it is beyond all measure"
        elif self._same >= SAME_WRENCHES:
            fault = f"{self._same} wrenches alike"
            self.exclude(sample.stamp_ns, fault)
        return self.judge(sample.stamp_ns, fault)
