"""Sensor links in virtual time: emissions carried to the daemon's cycle as bytes.

Invariants:
    Emulator's encoder on one side, daemon's decoder on the other.
    Faults of the scenario act on the bytes.
    Refused bytes are counted.
"""

import heapq
import math
import random
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Protocol

from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.cycle.sensing.samples import SensorQueues
from linemate.protocol.errors import ProtocolError
from linemate.protocol.sensors.camera_codec import CameraDecoder
from linemate.protocol.sensors.distance import DistanceDecoder, DistanceEncoder
from linemate.protocol.sensors.wrench import make_decoder, make_host
from linemate.simulators.devices.emulated_world import CameraReading, EmulatedWorld, WrenchReading
from linemate.simulators.devices.faults import GARBAGE_BYTES, Faults
from linemate.simulators.devices.faulty_link import FaultyLink
from linemate.simulators.devices.sensing.camera_sender import CameraSender
from linemate.simulators.devices.sensing.can_sensor import CanSensor
from linemate.simulators.devices.sensing.faulty_sensor import FaultySensor
from linemate.simulators.devices.sensing.force_torque import ForceTorqueSensor
from linemate.simulators.judge.rows import EPOCH_NS

DEVICE = "bota"
SENSORS = ("distance", "camera", "force_torque")

CAMERA_CLOCK_NS = 86_400_000_000_123
"""The camera's clock minus the host's: the daemon has to learn it."""

CAN_BYTES = 8
MOST_COMING = 256  # samples that are kept until a look at what has arrived
DIALOGUE_TURNS = 100
_TINY = 1e-9
_arrival = itemgetter(0)

Arrival = tuple[float, int, str, bytes]
"""When [s], a number that keeps the order, on which link, and what."""


class Hearing:
    """When a sensor's samples arrived, by what is true of them.

    A piece that a link damaged counts as heard where no check can refuse it: on a CAN bus and in
    a datagram. A wrench has a checksum.

    Attributes:
        heard_s: arrival of the newest sample that a decoder takes [s].
        true_s: arrival of the newest sample that is what the plant is [s].
        moved_s: arrival of the newest sample that is not a repetition of a frozen one [s].
        wrong_s: when a reading was wrong last [s].
        is_wrong: the reading that leaves is not what the plant is.
        is_frozen: it repeats an earlier one.
    """

    __slots__ = ("_coming", "heard_s", "is_frozen", "is_wrong", "moved_s", "true_s", "wrong_s")

    def __init__(self) -> None:
        self.heard_s = self.true_s = self.moved_s = self.wrong_s = float("-inf")
        self.is_wrong = self.is_frozen = False
        self._coming: list[tuple[float, bool, bool]] = []

    def sends(self, at_s: float, *, is_whole: bool) -> None:
        """Note a sample that arrives at a time [s], whole or damaged on its way."""
        self._coming.append((at_s, is_whole and not self.is_wrong, self.is_frozen))

    @property
    def is_long(self) -> bool:
        """Whether so many samples are on their way, or arrived, that a look at them is due."""
        return len(self._coming) >= MOST_COMING

    def arrive(self, now_s: float) -> None:
        """Note what has arrived by now [s]."""
        for at_s, is_true, is_frozen in self._coming:
            if at_s <= now_s:
                self.heard_s = max(self.heard_s, at_s)
                if is_true:
                    self.true_s = max(self.true_s, at_s)
                if not is_frozen:
                    self.moved_s = max(self.moved_s, at_s)
        self._coming = [arrival for arrival in self._coming if arrival[0] > now_s]


class Emitters:
    """The three sensors, encoded, on the way through their links.

    Attributes:
        links: the ways to the daemon, with what their faults did.
        sensors: the sensors behind them, with what their faults did.
        force_torque: the device that has to be talked to before it streams.
        frame: identifier of the distance sensor's frames, and whether it is a long one.
        has_wrench: there is a force-torque sensor.
        wrench_n: force of the last sample [N].
    """

    def __init__(
        self,
        world: EmulatedWorld,
        faults: Faults,
        mount: float,
        stamp: Callable[[float], int],
        distance: DistanceEncoder | None = None,
        device: str | None = DEVICE,
        camera: CameraSender | None = None,
    ) -> None:
        """Switch everything on.

        Args:
            mount: what the distance sensor reads when the conveyor unit is at s = 0 [m].
            stamp: the monotonic stamp of a scenario time [ns].
            distance: the distance sensor's message; None: CIA 406.
            device: the force-torque sensor; None: there is none.
            camera: names and clock of the camera; None: the shipped ones.
        """
        seed = world.seed
        self.links = {
            name: FaultyLink(name, faults, seed, ordered=name != "camera") for name in SENSORS
        }
        self.sensors = {name: FaultySensor(name, faults, seed) for name in SENSORS}
        self.force_torque = ForceTorqueSensor(device or DEVICE)
        encoder = distance or DistanceEncoder()
        self.frame = encoder.can_id, encoder.extended
        self._world, self._faults, self._stamp = world, faults, stamp
        self._begin_s = -world.lead_in_s
        self._junk = random.Random(seed)  # noqa: S311 -- noise, not a secret
        self._can = CanSensor(encoder, mount)
        self._camera = camera or CameraSender(clock_offset_ns=CAMERA_CLOCK_NS)
        self._hearing = {name: Hearing() for name in SENSORS}
        self.has_wrench = device is not None
        self.wrench_n = 0.0

    def heard_s(self, name: str) -> float:
        """When a sensor's newest sample arrived [s], true or not."""
        return self._arrived(name).heard_s

    def true_s(self, name: str) -> float:
        """When a sensor's newest true sample arrived [s]."""
        return self._arrived(name).true_s

    def moved_s(self, name: str) -> float:
        """When a sensor's newest sample arrived that was not frozen [s]."""
        return self._arrived(name).moved_s

    def wrong_s(self, name: str) -> float:
        """When a sensor's reading was wrong last [s]."""
        return self._hearing[name].wrong_s

    def _arrived(self, name: str) -> Hearing:
        hearing = self._hearing[name]
        hearing.arrive(self._world.time_s)
        return hearing

    def collect(self) -> list[tuple[float, str, bytes]]:
        """What has left since the last call.

        Returns:
            When it arrives [s], on which link, and the bytes; ``garbage`` of the scenario among
            them, on the robot's link too.
        """
        left: list[tuple[float, str, bytes]] = []
        for distance in self._world.take_distance():
            position, sensor = distance.position, self.sensors["distance"]
            if not sensor.is_sound:
                (position,) = sensor.reading((position,), distance.time_s)
                self._note("distance", distance.time_s, is_wrong=position != distance.position)
            frame = self._can.frame(position, distance.strength)
            if frame is not None:
                self._carry("distance", frame.data, distance.time_s, left)
        for pose in self._world.take_camera():
            self._carry("camera", self._datagram(pose), pose.time_s, left)
        for wrench in self._world.take_wrench() if self.has_wrench else ():
            self._carry("force_torque", self._streamed(wrench), wrench.time_s, left)
        now_s = self._world.time_s
        for fault in self._faults.strike(now_s):
            if fault.kind == "garbage":
                for _ in range(fault.count):
                    junk = self._junk.randbytes(int(fault.value) or GARBAGE_BYTES)
                    cut = CAN_BYTES if fault.link == "distance" else len(junk)
                    left.append((now_s, fault.link, junk[:cut]))
        return left

    def _carry(
        self, name: str, data: bytes, time_s: float, left: list[tuple[float, str, bytes]]
    ) -> None:
        link, hearing = self.links[name], self._hearing[name]
        if hearing.is_long:  # in a shift no one asks what has arrived
            hearing.arrive(time_s)
        if link.is_sound:
            left.append((time_s, name, data))
            hearing.sends(time_s, is_whole=True)
            return
        for arrival_s, piece in link.carry(data, time_s):
            left.append((arrival_s, name, piece))
            if piece == data or name != "force_torque":
                hearing.sends(arrival_s, is_whole=piece == data)

    def _note(self, name: str, time_s: float, *, is_wrong: bool) -> None:
        """Note what is true of the reading that leaves next."""
        hearing = self._hearing[name]
        hearing.is_wrong = is_wrong
        hearing.is_frozen = self._faults.in_force(name, "stuck", time_s) is not None
        if is_wrong:
            hearing.wrong_s = time_s

    def _datagram(self, pose: CameraReading) -> bytes:
        sensor = self.sensors["camera"]
        reading = (*pose.position, *pose.quaternion)
        values = sensor.reading(reading, pose.exposure_s, additive=3)
        shown_s = sensor.clock(pose.exposure_s)
        if not sensor.is_sound:
            is_wrong = values != reading or shown_s != pose.exposure_s
            self._note("camera", pose.time_s, is_wrong=is_wrong)
        return self._camera.datagram(
            values[:3],
            values[3:],
            pose.covariance,
            exposure_ns=self._stamp(shown_s),
            sent_ns=self._stamp(sensor.clock(pose.time_s)),
        )

    def _streamed(self, wrench: WrenchReading) -> bytes:
        sensor, taken_s = self.sensors["force_torque"], wrench.exposure_s
        force, torque = wrench.force, wrench.torque
        if not sensor.is_sound:
            a, b, c, d, e, f = sensor.reading((*force, *torque), taken_s)
            is_wrong = (a, b, c, d, e, f) != (*force, *torque)
            self._note("force_torque", wrench.time_s, is_wrong=is_wrong)
            force, torque, taken_s = (a, b, c), (d, e, f), sensor.clock(taken_s)
        self.wrench_n = math.hypot(*force)
        return self.force_torque.frame(force, torque, round((taken_s - self._begin_s) * 1e6))


@dataclass(slots=True)
class SensorEnds:
    """Both ends of the sensors' links.

    Attributes:
        encoder, decoder: of the distance sensor's frames.
        sender, poses: camera and its decoder.
        device: the force-torque sensor, None for none.
        watch: time-outs of the daemon, None for the defaults.
    """

    encoder: DistanceEncoder = field(default_factory=DistanceEncoder)
    decoder: DistanceDecoder = field(default_factory=DistanceDecoder)
    sender: CameraSender = field(
        default_factory=lambda: CameraSender(clock_offset_ns=CAMERA_CLOCK_NS)
    )
    poses: CameraDecoder = field(default_factory=CameraDecoder)
    device: str | None = DEVICE
    watch: WatchSettings | None = None


class Receiver(Protocol):
    """Who takes what arrives: the daemon's cycle, or what stands for it."""

    @property
    def samples(self) -> SensorQueues:
        """Queues of the three sensors."""

    def on_telegram(self, data: bytes, stamp_ns: int) -> object:
        """Take a datagram on the robot's link."""


class SensorLinks:
    """The three sensors' links to a cycle, and junk on any of the four.

    Attributes:
        refused: what a decoder did not accept, by link.
    """

    def __init__(
        self,
        world: EmulatedWorld,
        cycle: Receiver,
        faults: Faults,
        mount: float,
        cell: "SensorEnds | None" = None,
    ) -> None:
        """Connect all sensors; the force-torque sensor has had its dialogue and streams.

        Args:
            mount: what the distance sensor reads when the conveyor unit is at s = 0 [m].
            cell: both ends of the links; None: those of the shipped cell.
        """
        cell = cell or SensorEnds()
        self.refused: Counter[str] = Counter()
        self.emitters = Emitters(
            world, faults, mount, self.stamp, cell.encoder, cell.device, cell.sender
        )
        self._world, self._cycle = world, cycle
        self._begin_s = -world.lead_in_s
        self._can_decoder = cell.decoder
        self._camera_decoder = cell.poses
        self._wrench_decoder = make_decoder(cell.device or DEVICE)
        self._receivers: dict[str, Callable[[bytes, int], object]] = {
            "distance": self._distance,
            "camera": self._pose,
            "force_torque": self._stream,
            "robot": cycle.on_telegram,
        }
        self._in_transit: list[Arrival] = []
        self._count = 0
        if cell.device is not None:
            _talk(self.emitters.force_torque)

    def stamp(self, t: float) -> int:
        """The monotonic stamp of a scenario time [ns]."""
        return EPOCH_NS + round((t - self._begin_s) * 1e9)

    def carry(self) -> None:
        """Bring over everything that has arrived by now."""
        left = self.emitters.collect()
        now_s = self._world.time_s + _TINY
        if not self._in_transit and all(arrival_s <= now_s for arrival_s, _, _ in left):
            left.sort(key=_arrival)  # those of one instant in the order of leaving
            for time_s, link, data in left:
                self._bring(time_s, link, data)
            return
        for arrival_s, link, data in left:
            self._count += 1
            heapq.heappush(self._in_transit, (arrival_s, self._count, link, data))
        while self._in_transit and self._in_transit[0][0] <= now_s:
            time_s, _, link, data = heapq.heappop(self._in_transit)
            self._bring(time_s, link, data)

    def _bring(self, time_s: float, link: str, data: bytes) -> None:
        try:
            self._receivers[link](data, self.stamp(time_s))
        except ProtocolError:
            self.refused[link] += 1

    def _distance(self, data: bytes, stamp_ns: int) -> None:
        # An adapter drops junk on its line; what reaches a decoder is a frame, good or bad.
        can_id, extended = self.emitters.frame
        sample = self._can_decoder.decode(can_id, data, stamp_ns, extended)
        if sample is not None:
            self._cycle.samples.distance.push(sample)

    def _pose(self, data: bytes, stamp_ns: int) -> None:
        self._cycle.samples.camera.push(self._camera_decoder.feed(data, stamp_ns))

    def _stream(self, data: bytes, stamp_ns: int) -> None:
        for sample in self._wrench_decoder.feed(data, stamp_ns):
            self._cycle.samples.wrench.push(sample)


def _talk(sensor: ForceTorqueSensor) -> None:
    """Hold the sensor's start-up dialogue before the run.

    Raises:
        RuntimeError: it never began to stream.
    """
    host, now_ns = make_host(sensor.device), 0
    sensor.boot()
    sent = host.begin(now_ns).send
    for _ in range(DIALOGUE_TURNS):
        if host.running:
            return
        now_ns += 10_000_000
        sent = host.feed(sensor.feed(sent), now_ns).send or host.on_time(now_ns).send
    raise RuntimeError(f"the {sensor.device} never began to stream: {host.failure}")
