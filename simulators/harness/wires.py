"""What sensors emit, carried to the daemon's cycle as bytes, in virtual time.

Law of this file: the emulator's encoder on one side, the daemon's decoder on the other, nothing
but bytes and a stamp in between; a scenario's faults act there. What a decoder refuses is counted.
"""

import heapq
import random
from collections import Counter
from collections.abc import Callable
from functools import partial

from linemate.daemon.service.cycle import Cycle
from linemate.protocol.camera import CameraDecoder
from linemate.protocol.distance import DistanceDecoder, DistanceEncoder
from linemate.protocol.errors import ProtocolError
from linemate.protocol.wrench import make_decoder, make_host
from linemate.simulators.devices.camera_sender import CameraSender
from linemate.simulators.devices.can_sensor import CanSensor
from linemate.simulators.devices.faults import GARBAGE_BYTES, Faults
from linemate.simulators.devices.faulty_link import FaultyLink
from linemate.simulators.devices.faulty_sensor import FaultySensor
from linemate.simulators.devices.force_torque import ForceTorqueSensor
from linemate.simulators.plants.world import World

DEVICE = "bota"
SENSORS = ("distance", "camera", "force_torque")

EPOCH_NS = 1_000_000_000_000
"""The monotonic stamp at which a run begins; any other would do."""

CAMERA_CLOCK_NS = 86_400_000_000_123
"""The camera's clock minus the host's: the daemon has to learn it."""

SHORT_FRAME = 3
DIALOGUE_TURNS = 100
_TINY = 1e-9

Arrival = tuple[float, int, str, Callable[[int], None]]
"""When [s], a number that keeps the order, on which link, and what to do with its stamp."""


class Wires:
    """The three sensors' links, and junk on any of the four.

    Attributes:
        refused: what a decoder did not accept, by link.
        links: the ways to the daemon, with what their faults did.
        sensors: the sensors behind them, with what their faults did.
    """

    def __init__(self, world: World, cycle: Cycle, faults: Faults, mount: float) -> None:
        """Plug everything in; the force-torque sensor has been talked to and streams.

        Args:
            world: whose sensors emit.
            cycle: that takes samples.
            faults: of the scenario.
            mount: what the distance sensor reads when the conveyor unit is at s = 0 [m].
        """
        seed = world.scenario.seed
        self.refused: Counter[str] = Counter()
        self.links = {
            name: FaultyLink(name, faults, seed, ordered=name != "camera") for name in SENSORS
        }
        self.sensors = {name: FaultySensor(name, faults, seed) for name in SENSORS}
        self._world, self._faults = world, faults
        self._begin_s = -world.scenario.lead_in_s
        self._junk = random.Random(seed)  # noqa: S311 -- noise, not a secret
        self._can = CanSensor(DistanceEncoder(), mount)
        self._camera = CameraSender(clock_offset_ns=CAMERA_CLOCK_NS)
        self._force_torque = ForceTorqueSensor(DEVICE)
        self._under_way: list[Arrival] = []
        self._count = 0
        _talk(self._force_torque)
        self.connect(cycle)

    def connect(self, cycle: Cycle) -> None:
        """Lead all links to a daemon that knows nothing yet.

        Args:
            cycle: of the daemon.
        """
        self._cycle = cycle
        self._can_decoder = DistanceDecoder()
        self._camera_decoder = CameraDecoder()
        self._wrench_decoder = make_decoder(DEVICE)

    def stamp(self, t: float) -> int:
        """The monotonic stamp of a scenario time [ns]."""
        return EPOCH_NS + round((t - self._begin_s) * 1e9)

    def carry(self) -> None:
        """Bring over everything that has arrived by now."""
        self._emit()
        now_s = self._world.time_s
        for fault in self._faults.strike(now_s):
            if fault.kind == "garbage":
                for _ in range(fault.count):
                    junk = self._junk.randbytes(int(fault.value) or GARBAGE_BYTES)
                    self._put(fault.link, now_s, partial(self._garbage, fault.link, junk))
        while self._under_way and self._under_way[0][0] <= now_s + _TINY:
            time_s, _, link, arrive = heapq.heappop(self._under_way)
            try:
                arrive(self.stamp(time_s))
            except ProtocolError:
                self.refused[link] += 1

    def discard(self) -> None:
        """Bring over nothing: what arrives by now finds nobody."""
        self._emit()
        now_s = self._world.time_s
        while self._under_way and self._under_way[0][0] <= now_s + _TINY:
            heapq.heappop(self._under_way)

    def _emit(self) -> None:
        """Encode what became due, at its own instant."""
        for distance in self._world.take_distance():
            (position,) = self.sensors["distance"].reading((distance.position,), distance.time_s)
            frame = self._can.frame(position, distance.strength)
            if frame is not None:
                head = frame.can_id, frame.extended
                self._send("distance", frame.data, distance.time_s, partial(self._distance, *head))
        for pose in self._world.take_camera():
            sensor = self.sensors["camera"]
            reading = (*pose.position, *pose.quaternion)
            values = sensor.reading(reading, pose.exposure_s, additive=3)
            data = self._camera.datagram(
                values[:3],
                values[3:],
                pose.covariance,
                exposure_ns=self.stamp(sensor.clock(pose.exposure_s)),
                sent_ns=self.stamp(sensor.clock(pose.time_s)),
            )
            self._send("camera", data, pose.time_s, self._pose)
        for wrench in self._world.take_wrench():
            sensor = self.sensors["force_torque"]
            values = sensor.reading((*wrench.force, *wrench.torque), wrench.exposure_s)
            shown_s = sensor.clock(wrench.exposure_s)
            device_us = round((shown_s - self._begin_s) * 1e6)
            data = self._force_torque.frame(values[:3], values[3:], device_us)
            self._send("force_torque", data, wrench.time_s, self._stream)

    def _send(
        self, link: str, data: bytes, time_s: float, receive: Callable[[bytes, int], None]
    ) -> None:
        for arrival_s, piece in self.links[link].carry(data, time_s):
            self._put(link, arrival_s, partial(receive, piece))

    def _put(self, link: str, arrival_s: float, arrive: Callable[[int], None]) -> None:
        self._count += 1
        heapq.heappush(self._under_way, (arrival_s, self._count, link, arrive))

    def _distance(self, can_id: int, extended: bool, data: bytes, stamp_ns: int) -> None:
        found = self._can_decoder.decode(can_id, data, stamp_ns, extended)
        if found is not None:
            self._cycle.feed_distance(found)

    def _pose(self, data: bytes, stamp_ns: int) -> None:
        self._cycle.feed_camera(self._camera_decoder.feed(data, stamp_ns))

    def _stream(self, data: bytes, stamp_ns: int) -> None:
        for found in self._wrench_decoder.feed(data, stamp_ns):
            self._cycle.feed_wrench(found)

    def _garbage(self, link: str, junk: bytes, stamp_ns: int) -> None:
        match link:
            case "robot":
                self._cycle.on_telegram(junk, stamp_ns)
            case "camera":
                self._pose(junk, stamp_ns)
            case "distance":
                # An adapter drops junk on its line; what can reach a decoder is a bad frame.
                decoder = self._can_decoder
                decoder.decode(decoder.can_id, junk[:SHORT_FRAME], stamp_ns, decoder.extended)
            case _:
                self._stream(junk, stamp_ns)


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
