"""Sensor samples that wait for the next step: one queue a sensor, with its clock and its health.

Invariants:
- Bounded. The oldest sample is dropped and counted.
- A drained sample has its date, and its sensor is healthy.
- A step takes the samples that came before it, and waits for none.
"""

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Generic

from msgspec import Struct
from msgspec.structs import replace

from linemate.daemon.cycle.sensing.sensor_health import (
    CameraHealth,
    Conditions,
    DistanceHealth,
    Health,
    Sample,
    WrenchHealth,
)
from linemate.protocol.sensors.even_clock import EvenClock
from linemate.protocol.sensors.wrench_clock import WrenchClock
from linemate.protocol.stamped_samples import CameraSample, DistanceSample, Vector3, WrenchSample

DISTANCES, POSES, WRENCHES = 128, 16, 64  # samples that may wait; 1 kHz of distance for 0.1 s


class SensorFact(Struct, frozen=True):
    """One sensor at one moment.

    Attributes:
        stamp_ns: of its newest accepted sample [ns], None before the first one.
        excluded: why its samples are refused, None if they are accepted.
    """

    stamp_ns: int | None = None
    excluded: str | None = None


class SampleQueue(Generic[Sample]):
    """Samples of one sensor: dated, bounded, accepted by the sensor's health.

    Attributes:
        newest_ns: stamp of the newest accepted sample [ns].
        dropped: samples for which there was no space.
    """

    __slots__ = ("_date", "_date_batch", "_health", "_samples", "dropped", "newest_ns")

    def __init__(
        self,
        size: int,
        health: Health[Sample],
        *,
        date: Callable[[Sample], Sample] | None = None,
        date_batch: Callable[[Sequence[Sample]], Sequence[Sample]] | None = None,
    ) -> None:
        """Begin empty.

        Args:
            size: samples that may wait.
            date: dates each sample by the sensor's own clock.
            date_batch: dates what is drained, for sensors without a clock.
        """
        self._samples: deque[Sample] = deque(maxlen=size)
        self._health: Health[Sample] = health
        self._date: Callable[[Sample], Sample] | None = date
        self._date_batch: Callable[[Sequence[Sample]], Sequence[Sample]] | None = date_batch
        self.newest_ns: int | None = None
        self.dropped = 0

    def push(self, sample: Sample) -> None:
        """Add the newest sample."""
        if len(self._samples) == self._samples.maxlen:
            self.dropped += 1
        self._samples.append(sample if self._date is None else self._date(sample))

    def drain(self, conditions: Conditions) -> tuple[Sample, ...]:
        """Return the accepted samples since the last call, oldest first."""
        if not self._samples:
            return ()
        samples: Sequence[Sample] = tuple(self._samples)
        self._samples.clear()
        if self._date_batch is not None:
            samples = self._date_batch(samples)
        accepted = tuple([s for s in samples if self._health.accepts(s, conditions)])
        if accepted:
            self.newest_ns = accepted[-1].stamp_ns
        return accepted

    @property
    def fact(self) -> SensorFact:
        """When the sensor's newest sample came, and whether it is excluded."""
        return SensorFact(self.newest_ns, self._health.reason)


class DrainedSamples(Struct, frozen=True):
    """The samples of one step, oldest first."""

    distance: tuple[DistanceSample, ...]
    camera: tuple[CameraSample, ...]
    wrench: tuple[WrenchSample, ...]


NO_SAMPLES = DrainedSamples((), (), ())


class SensorQueues:
    """The queues of the three sensors.

    The camera's decoder maps the camera's clock, so that its poses come dated.

    Attributes:
        overloaded: of the forces drained last, two in a row were beyond the limit.
        distance_offset: added to each reading of the distance sensor, so that it counts for the
            present object [m].
        reading: newest accepted reading of the distance sensor as it came [m], None before one.
        overload_n: the last force beyond the limit, without the weight, and the limit [N]; None
            before one.
    """

    __slots__ = (
        "_distance_clock",
        "_was_beyond",
        "camera",
        "camera_health",
        "distance",
        "distance_health",
        "distance_offset",
        "overload_n",
        "overloaded",
        "reading",
        "wrench",
        "wrench_health",
    )

    def __init__(self) -> None:
        self.distance_health = DistanceHealth()
        self.camera_health = CameraHealth()
        self.wrench_health = WrenchHealth()
        self._distance_clock = EvenClock()
        self.distance = SampleQueue(
            DISTANCES, self.distance_health, date_batch=self._distance_clock.date
        )
        self.camera = SampleQueue(POSES, self.camera_health)
        self.wrench = SampleQueue(WRENCHES, self.wrench_health, date=WrenchClock().date)
        self.distance_offset = 0.0
        self.reading: float | None = None
        self.overloaded = False
        self.overload_n: tuple[float, float] | None = None
        self._was_beyond = False

    def drain(
        self,
        conditions: Conditions,
        force_limit: float,
        weights: tuple[Vector3, ...] = ((0.0, 0.0, 0.0),),
    ) -> DrainedSamples:
        """Return the samples of a step.

        Args:
            force_limit: that the tool withstands in addition to the weight [N].
            weights: that the mount may carry, in the sensor's axes [N]. A force is an overload
                only if it is beyond the limit with each of them.
        """
        distance = self._count_from_object(self.distance.drain(conditions))
        camera = self.camera.drain(conditions)
        wrench = self.wrench.drain(conditions)
        self.overloaded = False
        for sample in wrench:
            self._check_overload(sample, force_limit, weights)
        return DrainedSamples(distance, camera, wrench)

    def _count_from_object(
        self, distance: tuple[DistanceSample, ...]
    ) -> tuple[DistanceSample, ...]:
        """Return readings as they count for the present object."""
        if distance:
            self.reading = distance[-1].position
        offset = self.distance_offset
        if not offset:
            return distance
        return tuple([replace(sample, position=sample.position + offset) for sample in distance])

    def _check_overload(
        self, sample: WrenchSample, limit: float, weights: tuple[Vector3, ...]
    ) -> None:
        force = min(math.dist(sample.force, weight) for weight in weights)
        is_beyond = force > limit
        if is_beyond:
            self.overload_n = force, limit
        self.overloaded |= is_beyond and self._was_beyond
        self._was_beyond = is_beyond

    def facts(self) -> dict[str, SensorFact]:
        """Return when each sensor's newest sample came, and whether it is excluded."""
        return {
            "distance": self.distance.fact,
            "camera": self.camera.fact,
            "force_torque": self.wrench.fact,
        }

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest position, distance or camera [ns]."""
        distance_ns, camera_ns = self.distance.newest_ns, self.camera.newest_ns
        if distance_ns is None or camera_ns is None:
            return camera_ns if distance_ns is None else distance_ns
        return max(distance_ns, camera_ns)

    @property
    def slower_ns(self) -> int | None:
        """Stamp of the newest sample of that of the two whose newest is older [ns]."""
        distance_ns, camera_ns = self.distance.newest_ns, self.camera.newest_ns
        if distance_ns is None or camera_ns is None:
            return camera_ns if distance_ns is None else distance_ns
        return min(distance_ns, camera_ns)

    def status(self, now_ns: int) -> dict[str, Any]:
        """Return each sensor's health, drops, and the age of its newest sample [s]."""
        newest = {
            "position": self.newest_ns,
            "distance": self.distance.newest_ns,
            "camera": self.camera.newest_ns,
            "wrench": self.wrench.newest_ns,
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
            "redated": {"distance": self._distance_clock.redated},
            "dropped": {
                "distance": self.distance.dropped + self._distance_clock.undated,
                "camera": self.camera.dropped,
                "wrench": self.wrench.dropped,
            },
            "ages_s": {
                name: None if stamp_ns is None else (now_ns - stamp_ns) * 1e-9
                for name, stamp_ns in newest.items()
            },
        }
