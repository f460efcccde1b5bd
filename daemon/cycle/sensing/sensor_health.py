"""Health of the sensors: exclude a faulty sensor and readmit it, with the reason.

A check knows what no sensor can do: jump, freeze at full speed, repeat itself to the last bit. It
does not know where the object is. Samples that fit no estimate are refused by the tracker's gates.

Invariants:
- Pure and of bounded memory. Stamps come with the samples.
- A refused sample reaches no step and does not count as fresh.
"""

import math
from collections import deque
from typing import Any, Generic, TypeVar

from msgspec import Struct

from linemate.protocol.stamped_samples import CameraSample, DistanceSample, WrenchSample

BAD, OF = 3, 5  # exclude a sensor after 3 bad of its last 5 samples
BAD_S = 0.1  # or after bad samples only for this long
GOOD = 10  # good samples in a row that readmit it

# How far a distance may be from where it was heading: the greater of the first two ...
JUMP = 0.03  # [m]
DEVIATIONS = 6.0  # standard deviations of the sensor
ACCELERATION = 1.0  # ... and what this acceleration adds, that no conveyor exceeds [m/s^2] ...
UNKNOWN_SPEED = 1.0  # ... and what this speed adds, while the conveyor's is unknown [m/s]
# In the last approach the camera goes blind, and small jumps count too. There the jump is the
# greatest of these three.
SMALL_JUMP = 0.006  # [m]
MEASURED_DEVIATIONS = 6.0  # measured deviations, known after so many samples:
LEARNED = 20
VARIANCE_GAIN = 0.05  # of their mean square
UNITS = 2.0  # resolution steps
EXCLUDED_S = 0.05  # what acceleration adds grows no longer for an excluded sensor [s]
BACK = 0.5  # share of a jump that counts as the jump back
FORGOTTEN_NS = 2_000_000_000  # forget a heading that nothing has agreed with for so long [ns]
OUTVOTING = 3  # samples whose median is taken: one outlier has no effect

MOVING = 0.05  # a distance that changed at this speed cannot freeze at once [m/s]
FROZEN_S = 0.15  # without a change it is frozen after this time
QUANTA = 1.5  # ... or the time of so many of its resolution steps, if that is longer
HEADING_NS = 300_000_000  # the speed is the mean over so long [ns]

# Poses in a row that the tracker refused although its gate had widened. Noise alone is not it.
CONTRADICTIONS = 8

SAME_POSES = 4  # identical poses while something moves: frozen
SAME_WRENCHES = 25  # identical wrenches while the tool moves: frozen
REPEATED = 3  # identical wrenches from which the next ones are no measurement: noise changes each

MAX_FORCE = 1e5  # beyond this nothing is a measurement [N]
MAX_TORQUE = 1e5  # [Nm]

Sample = TypeVar("Sample", DistanceSample, CameraSample, WrenchSample)


class Conditions(Struct, frozen=True):
    """What a check knows of the step.

    Attributes:
        moving: the tool moves, so that two images or wrenches are not alike.
        deviation: standard deviation of the distance sensor [m].
        last_approach: the camera goes blind, and cannot correct a distance that jumped.
    """

    moving: bool
    deviation: float
    last_approach: bool = False


class Health(Generic[Sample]):
    """Exclusion and readmission of a sensor.

    Attributes:
        reason: why the sensor is excluded, None if it is not.
        since_ns: when that began [ns], None before the first change.
    """

    __slots__ = ("_bad_since_ns", "_good", "_lately", "outs", "reason", "refused", "since_ns")

    def __init__(self) -> None:
        self.reason: str | None = None
        self.since_ns: int | None = None
        self.refused = self.outs = 0
        self._lately: deque[bool] = deque(maxlen=OF)
        self._bad_since_ns: int | None = None
        self._good = 0

    def accepts(self, sample: Sample, conditions: Conditions) -> bool:
        """Return whether the newest sample may be used."""
        raise NotImplementedError

    def judge(self, stamp_ns: int, fault: str | None) -> bool:
        """Count a good or bad sample, and return whether it may be used.

        Args:
            fault: what is wrong with it, None if nothing is.
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
        """Exclude the sensor, whatever its last samples were."""
        self._good = 0
        if self.reason is None:
            self.reason, self.since_ns = reason, stamp_ns
            self.outs += 1

    def status(self, now_ns: int) -> dict[str, Any]:
        """Return which state it is in, why and for how long [s]."""
        since_s = None if self.since_ns is None else round((now_ns - self.since_ns) * 1e-9, 3)
        return {"out": self.reason, "since_s": since_s, "refused": self.refused, "outs": self.outs}


Trusted = tuple[int, float]
"""Stamp [ns] and distance [m] of an accepted sample."""

OffTrack = tuple[int, float, float]
"""Stamp [ns] and distance [m] of a refused sample, and how far the sensor has jumped [m]."""


class DistanceHealth(Health[DistanceSample]):
    """Check of the distance sensor: no jump, no stop without slowing down, no way backwards."""

    __slots__ = (
        "_changed_ns",
        "_learned",
        "_off_track",
        "_quick",
        "_square",
        "_trusted",
        "_unit",
        "_value",
    )

    def __init__(self) -> None:
        super().__init__()
        self._off_track: OffTrack | None = None
        self._trusted: deque[Trusted] = deque(maxlen=256)
        self._value: float | None = None
        self._changed_ns = 0
        self._quick: float | None = None  # how quick it was at its last change
        self._unit = 0.0
        self._learned = 0  # samples that the deviation was measured with
        self._square = 0.0  # mean square of their way from the heading [m^2]

    def accepts(self, sample: DistanceSample, conditions: Conditions) -> bool:
        """Return whether the newest sample may be used."""
        trusted, stamp_ns, position = self._trusted, sample.stamp_ns, sample.position
        if trusted and stamp_ns - trusted[-1][0] > FORGOTTEN_NS:
            trusted.clear()
            self._off_track = None
        lately = None
        if len(trusted) >= OUTVOTING:
            lately = _middle(trusted[-3], trusted[-2], trusted[-1])
        speed = self._speed(lately)
        if position != self._value:
            if self._value is not None:
                step = abs(position - self._value)
                self._unit = min(step, self._unit) if self._unit else step
            self._value, self._changed_ns, self._quick = position, stamp_ns, speed
        fault = None
        if lately is not None:
            passed = (stamp_ns - lately[0]) * 1e-9
            off = position - lately[1] - (speed or 0.0) * passed
            jumped = self._jumped(sample, speed or 0.0)
            if abs(off) > self._largest_jump(passed, speed, conditions):
                fault, jumped = f"it jumped by {off:.3f} m", max(off, jumped, key=abs)
            elif jumped and conditions.last_approach:
                fault = f"it jumped by {jumped:.3f} m"
            self._off_track = (stamp_ns, position, jumped) if fault else None
            if fault is None and speed is not None:
                self._learn(off)
        if conditions.moving and speed is not None and speed < -MOVING:
            what = f"it runs backwards at {speed:.3f} m/s; check the sign of the DBC's factor"
            fault = fault or what
        fault = fault or self._frozen(stamp_ns)
        if fault is None:
            trusted.append((stamp_ns, position))
            while stamp_ns - trusted[0][0] > HEADING_NS:
                trusted.popleft()
        return self.judge(stamp_ns, fault)

    def _learn(self, off: float) -> None:
        """Update the variance of accepted samples about their heading by one way [m]."""
        self._learned = min(self._learned + 1, LEARNED)
        self._square += max(VARIANCE_GAIN, 1.0 / self._learned) * (off * off - self._square)

    def _jumped(self, sample: DistanceSample, speed: float) -> float:
        """Return how far the sensor has jumped and not back again [m], 0 if it has not.

        A conveyor that brakes brings a wrong distance to where the right one was heading.

        Args:
            speed: at which the distance was heading on [m/s].
        """
        if self._off_track is None:
            return 0.0
        stamp_ns, position, jumped = self._off_track
        step = sample.position - position - speed * (sample.stamp_ns - stamp_ns) * 1e-9
        return jumped if step * jumped > -BACK * jumped * jumped else 0.0

    def _largest_jump(self, passed: float, speed: float | None, conditions: Conditions) -> float:
        """Return how far a sample may be from where the distance was heading [m].

        Args:
            passed: since the samples that it was heading from [s].
            speed: at which it was heading on [m/s], None if that is not known.
        """
        jump = JUMP
        if conditions.last_approach and self._learned >= LEARNED:
            jump = max(
                SMALL_JUMP, MEASURED_DEVIATIONS * math.sqrt(self._square), UNITS * self._unit
            )
            if self.reason is not None:
                # A distance that jumped by 30 mm would be accepted again after 0.22 s.
                passed = min(passed, EXCLUDED_S)
        jump = max(jump, DEVIATIONS * conditions.deviation)
        jump += 0.5 * ACCELERATION * passed * passed
        return jump if speed is not None else jump + UNKNOWN_SPEED * passed

    def _frozen(self, stamp_ns: int) -> str | None:
        stood = (stamp_ns - self._changed_ns) * 1e-9
        if stood < FROZEN_S or self._quick is None or abs(self._quick) < MOVING:
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


def _middle(first: Trusted, second: Trusted, third: Trusted) -> Trusted:
    """Return stamp [ns] and median [m] of three in a row."""
    return second[0], sorted((first[1], second[1], third[1]))[1]


class CameraHealth(Health[CameraSample]):
    """Check of the camera: no identical poses in motion, none that contradict the estimate."""

    __slots__ = ("_contradictions", "_pose", "_same")

    def __init__(self) -> None:
        super().__init__()
        self._contradictions = 0
        self._pose: tuple[float, ...] = ()
        self._same = 0

    def accepts(self, sample: CameraSample, conditions: Conditions) -> bool:
        """Return whether the newest sample may be used."""
        pose = (*sample.position, *sample.quaternion)
        self._same = self._same + 1 if conditions.moving and pose == self._pose else 1
        self._pose = pose
        is_frozen = self._same >= SAME_POSES
        fault = f"{self._same} poses alike" if is_frozen else None
        if fault is not None:
            self.exclude(sample.stamp_ns, fault)
        return self.judge(sample.stamp_ns, fault)

    @property
    def contradicts(self) -> bool:
        """Accepted poses do not fit the estimate of the object."""
        return self._contradictions >= CONTRADICTIONS

    def add_result(self, given: int, refused: int) -> None:
        """Count how many poses the tracker was given in a step, and refused."""
        if given:
            self._contradictions = self._contradictions + given if refused >= given else 0


class WrenchHealth(Health[WrenchSample]):
    """Check of the force-torque sensor: no identical wrenches in motion, none beyond measure."""

    __slots__ = ("_same", "_wrench")

    def __init__(self) -> None:
        super().__init__()
        self._wrench: tuple[float, ...] = ()
        self._same = 0

    def accepts(self, sample: WrenchSample, conditions: Conditions) -> bool:
        """Return whether the newest sample may be used."""
        wrench = (*sample.force, *sample.torque)
        self._same = self._same + 1 if conditions.moving and wrench == self._wrench else 1
        self._wrench = wrench
        fault = None
        if max(map(abs, sample.force)) > MAX_FORCE or max(map(abs, sample.torque)) > MAX_TORQUE:
            fault = "it is beyond all measure"
        elif self._same >= SAME_WRENCHES:
            fault = f"{self._same} wrenches alike"
            self.exclude(sample.stamp_ns, fault)
        elif self._same > REPEATED:
            self.refused += 1
            return False
        return self.judge(sample.stamp_ns, fault)
