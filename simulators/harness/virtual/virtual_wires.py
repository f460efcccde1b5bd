"""Wires between the emulated devices and the daemon's ports, in virtual time.

Invariants:
    Bytes arrive in the order of their instants, then in the order in which they were sent.
    A port that is not open drops what arrives.
"""

from functools import partial

from linemate.drivers.datagrams import Address
from linemate.simulators.harness.sensor_links import Emitters
from linemate.simulators.harness.virtual.virtual_time import VirtualTime

RSI_PORT, CAMERA_PORT = 49152, 49153
CAMERA: Address = ("127.0.0.1", 50_002)
TRANSIT_NS = 60_000  # one way on the wire of the robot
TALKING_NS = 1_000_000  # from the host's bytes to the answer of a serial device


class VirtualWires:
    """Sensor links and the robot's wire to the daemon."""

    def __init__(self, time: VirtualTime, emitters: Emitters) -> None:
        """Connect the force-torque sensor to the daemon's serial line."""
        self._time, self._emitters = time, emitters
        time.on_line = self._answer

    def send(self, at_ns: int, data: bytes, source: Address, port: int) -> None:
        """Let a datagram arrive at a port of the daemon at an instant [ns]."""
        self._time.at(at_ns, partial(self._arrive, data, source, port))

    def send_sensor(self, at_ns: int, link: str, data: bytes) -> None:
        """Let a sensor's bytes arrive at an instant [ns].

        Args:
            link: ``camera``, ``distance`` or ``force_torque``.
        """
        if link == "camera":
            self.send(at_ns, data, CAMERA, CAMERA_PORT)
        else:
            bring = self._frame if link == "distance" else self._bytes
            self._time.at(at_ns, partial(bring, data))

    def _arrive(self, data: bytes, source: Address, port: int) -> None:
        socket = self._time.sockets.get(port)
        if socket is not None:
            socket.deliver(data, source)

    def _frame(self, data: bytes) -> None:
        can_id, extended = self._emitters.frame
        for bus in self._time.buses:
            bus.deliver(can_id, data, extended=extended)

    def _bytes(self, data: bytes) -> None:
        for line in self._time.lines:
            line.deliver(data)

    def _answer(self, data: bytes | None) -> None:
        """Answer as the force-torque sensor: the host has written, or opened its port."""
        device = self._emitters.force_torque
        answer = device.boot() if data is None else device.feed(data)
        if answer:
            self._time.at(self._time.now_ns + TALKING_NS, partial(self._bytes, answer))
