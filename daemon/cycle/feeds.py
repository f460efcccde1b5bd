"""What the sensors brought and no step has seen yet, and when each was heard last.

Law of this file: bounded, the oldest dropped and counted; stamps come with the samples. What a
step takes is what came before it and can be believed, and nothing waits for a second one.
"""

from collections import deque
from math import sqrt
from typing import Any, Generic, TypeVar

from msgspec import Struct

from linemate.daemon.cycle.sensor_health import CameraHealth, DistanceHealth, WrenchHealth
from linemate.protocol.samples import CameraSample, DistanceSample, WrenchSample
from linemate.protocol.sensors.even_clock import EvenClock
from linemate.protocol.sensors.wrench_clock import WrenchClock

Sample = TypeVar("Sample")

DISTANCES, POSES, WRENCHES = 32, 16, 64


class Inbox(Generic[Sample]):
    """Samples that wait for the next step: bounded, the oldest dropped and counted."""

    __slots__ = ("_samples", "dropped", "taken")

    def __init__(self, size: int) -> None:
        self._samples: deque[Sample] = deque(maxlen=size)
        self.taken = 0
        self.dropped = 0

    def put(self, sample: Sample) -> None:
        """Add the newest sample."""
        if len(self._samples) == self._samples.maxlen:
            self.dropped += 1
        self._samples.append(sample)

    def __bool__(self) -> bool:
        """Whether any wait."""
        return bool(self._samples)

    def take(self) -> tuple[Sample, ...]:
        """Return all that wait, oldest first."""
        if not self._samples:
            return ()
        samples = tuple(self._samples)
        self._samples.clear()
        self.taken += len(samples)
        return samples


class Taken(Struct, frozen=True):
    """The samples of one step, oldest first."""

    distance: tuple[DistanceSample, ...]
    camera: tuple[CameraSample, ...]
    wrench: tuple[WrenchSample, ...]


class SensorFact(Struct, frozen=True):
    """One sensor at one moment.

    Attributes:
        stamp_ns: of its newest accepted sample [ns], None before the first one.
        excluded: why its samples are refused, None if they are accepted.
    """

    stamp_ns: int | None = None
    excluded: str | None = None


_NOTHING = Taken((), (), ())


class Feeds:
    """The three sensors' inboxes.

    Attributes:
        distance, camera, wrench: what waits.
        distance_ns, camera_ns, wrench_ns: stamps of the newest samples that were taken [ns].
        overloaded: of the forces taken last two in a row were too great.
        overload_n: the last force that was too great, and the limit [N]; None before one.
        distance_health, camera_health, wrench_health: whether each can be believed.
    """

    __slots__ = (
        "_clock",
        "_even",
        "_was_much",
        "camera",
        "camera_health",
        "camera_ns",
        "distance",
        "distance_health",
        "distance_ns",
        "overload_n",
        "overloaded",
        "wrench",
        "wrench_health",
        "wrench_ns",
    )

    def __init__(self) -> None:
        self.distance: Inbox[DistanceSample] = Inbox(DISTANCES)
        self.camera: Inbox[CameraSample] = Inbox(POSES)
        self.wrench: Inbox[WrenchSample] = Inbox(WRENCHES)
        self.distance_ns: int | None = None
        self.camera_ns: int | None = None
        self.wrench_ns: int | None = None
        self.overloaded = False
        self.overload_n: tuple[float, float] | None = None
        self.distance_health = DistanceHealth()
        self.camera_health = CameraHealth()
        self.wrench_health = WrenchHealth()
        self._clock = WrenchClock()
        self._even = EvenClock()
        self._was_much = False

    def put_wrench(self, sample: WrenchSample) -> None:
        """Add a wrench, dated by the device's own clock."""
        self.wrench.put(self._clock.date(sample))

    def take(self, bearable: float, deviation: float, *, moving: bool) -> Taken:
        """Return what waits and can be believed; note when each sensor was heard.

        Args:
            bearable: the force that the tool bears [N].
            deviation: standard deviation of the distance sensor [m].
        """
        self.overloaded = False
        if not (self.distance or self.camera or self.wrench):
            return _NOTHING
        distances = self._even.date(self.distance.take())
        distance = tuple([s for s in distances if self.distance_health.believes(s, deviation)])
        camera = tuple(
            [s for s in self.camera.take() if self.camera_health.believes(s, moving=moving)]
        )
        wrench = tuple(
            [s for s in self.wrench.take() if self.wrench_health.believes(s, moving=moving)]
        )
        if distance:
            self.distance_ns = distance[-1].stamp_ns
        if camera:
            self.camera_ns = camera[-1].stamp_ns
        for sample in wrench:
            x, y, z = sample.force
            square = x * x + y * y + z * z
            much = square > bearable * bearable
            if much:
                self.overload_n = sqrt(square), bearable
            self.overloaded |= much and self._was_much
            self._was_much = much
            self.wrench_ns = sample.stamp_ns
        return Taken(distance, camera, wrench)

    def sensors(self) -> dict[str, SensorFact]:
        """Return when each sensor was heard last, and whether it is excluded."""
        return {
            "distance": SensorFact(self.distance_ns, self.distance_health.reason),
            "camera": SensorFact(self.camera_ns, self.camera_health.reason),
            "force_torque": SensorFact(self.wrench_ns, self.wrench_health.reason),
        }

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest position, distance or camera [ns]."""
        if self.distance_ns is None or self.camera_ns is None:
            return self.camera_ns if self.distance_ns is None else self.distance_ns
        return max(self.distance_ns, self.camera_ns)

    @property
    def slower_ns(self) -> int | None:
        """The same of the one of the two that was heard less lately [ns]."""
        if self.distance_ns is None or self.camera_ns is None:
            return self.newest_ns
        return min(self.distance_ns, self.camera_ns)

    def status(self, now_ns: int) -> dict[str, Any]:
        """Return what can be believed, what was dropped, and how old the newest is [s]."""
        heard = {
            "position": self.newest_ns,
            "distance": self.distance_ns,
            "camera": self.camera_ns,
            "wrench": self.wrench_ns,
        }
        return {
            "sensors": {
                "distance": self.distance_health.status(now_ns),
                "camera": {
                    **self.camera_health.status(now_ns),
                    "contradicts": self.camera_health.contradicts,
                },
                "wrench": self.wrench_health.status(now_ns),
            },
            "redated": {"distance": self._even.redated},
            "dropped": {
                "distance": self.distance.dropped,
                "camera": self.camera.dropped,
                "wrench": self.wrench.dropped,
            },
            "ages_s": {
                name: None if stamp_ns is None else (now_ns - stamp_ns) * 1e-9
                for name, stamp_ns in heard.items()
            },
        }
