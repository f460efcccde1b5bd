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
from linemate.simulators.devices.force_torque import ForceTorqueSensor
from linemate.simulators.plants.world import World

DEVICE = "bota"

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
        silenced: what a fault kept from leaving, by link.
    """

    def __init__(self, world: World, cycle: Cycle, faults: Faults, mount: float) -> None:
        """Plug everything in; the force-torque sensor has been talked to and streams.

        Args:
            world: whose sensors emit.
            cycle: that takes samples.
            faults: of the scenario.
            mount: what the distance sensor reads when the conveyor unit is at s = 0 [m].
        """
        self.refused: Counter[str] = Counter()
        self.silenced: Counter[str] = Counter()
        self._world, self._cycle, self._faults = world, cycle, faults
        self._begin_s = -world.scenario.lead_in_s
        self._junk = random.Random(world.scenario.seed)  # noqa: S311 -- noise, not a secret
        self._can = CanSensor(DistanceEncoder(), mount)
        self._can_decoder = DistanceDecoder()
        self._camera = CameraSender(clock_offset_ns=CAMERA_CLOCK_NS)
        self._camera_decoder = CameraDecoder()
        self._force_torque = ForceTorqueSensor(DEVICE)
        self._wrench_decoder = make_decoder(DEVICE)
        self._is_faulty = bool(world.scenario.faults)
        self._under_way: list[Arrival] = []
        self._count = 0
        _talk(self._force_torque)

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

    def _emit(self) -> None:
        """Encode what became due, at its own instant."""
        for distance in self._world.take_distance():
            if not self._is_silent("distance", distance.time_s):
                send = partial(self._distance, distance.position, distance.strength)
                self._put("distance", distance.time_s, send)
        for pose in self._world.take_camera():
            if not self._is_silent("camera", pose.time_s):
                data = self._camera.datagram(
                    pose.position,
                    pose.quaternion,
                    pose.covariance,
                    exposure_ns=self.stamp(pose.exposure_s),
                    sent_ns=self.stamp(pose.time_s),
                )
                self._put("camera", pose.time_s, partial(self._pose, data))
        for wrench in self._world.take_wrench():
            if not self._is_silent("force_torque", wrench.time_s):
                device_us = round((wrench.exposure_s - self._begin_s) * 1e6)
                data = self._force_torque.frame(wrench.force, wrench.torque, device_us)
                self._put("force_torque", wrench.time_s, partial(self._stream, data))

    def _is_silent(self, link: str, time_s: float) -> bool:
        """A link that is unplugged says as little as one that is silent."""
        if not self._is_faulty:
            return False
        silent = any(
            self._faults.in_force(link, kind, time_s) is not None for kind in ("silence", "unplug")
        )
        self.silenced[link] += silent
        return silent

    def _put(self, link: str, time_s: float, arrive: Callable[[int], None]) -> None:
        delay = self._faults.in_force(link, "delay", time_s) if self._is_faulty else None
        arrival_s = time_s if delay is None else time_s + delay.value
        self._count += 1
        heapq.heappush(self._under_way, (arrival_s, self._count, link, arrive))

    def _distance(self, position: float, strength: float, stamp_ns: int) -> None:
        frame = self._can.frame(position, strength)
        if frame is None:
            return
        found = self._can_decoder.decode(frame.can_id, frame.data, stamp_ns, frame.extended)
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
