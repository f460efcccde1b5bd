"""Emulated distance sensor behind an slcan adapter, on a pty or a TCP port.

Invariants:
    Bytes pass unchanged.
"""

from pathlib import Path

from linemate.protocol.sensors.slcan import CanFrame
from linemate.simulators.devices.links.endpoint import Address
from linemate.simulators.devices.links.pty_port import PtyPort
from linemate.simulators.devices.links.tcp_port import TcpPort
from linemate.simulators.devices.sensing.can_sensor import CanSensor
from linemate.simulators.devices.sensing.slcan_adapter import SlcanAdapter


class SlcanPty:
    """A CAN adapter with one sensor on its bus.

    Attributes:
        port: the pty, or the TCP port.
    """

    def __init__(
        self, sensor: CanSensor, link: Path | None = None, bind: Address | None = None
    ) -> None:
        """Set it up; it is not plugged in yet.

        Args:
            link: symbolic link to make for the pty.
            bind: address and port of a TCP port instead of a pty.
        """
        self.sensor = sensor
        self.adapter = SlcanAdapter()
        self.port: PtyPort | TcpPort = (
            PtyPort(self._heard, link=link) if bind is None else TcpPort(self._heard, bind)
        )

    def open(self) -> None:
        """Plug the adapter in.

        Raises:
            OSError: if no port can be had.
        """
        self.adapter.reset()
        self.port.plug()

    def close(self) -> None:
        """Unplug the adapter."""
        self.port.unplug()

    def emit(self, position: float, strength: float | None = None) -> None:
        """The sensor puts one reading on the bus.

        Args:
            position: of the conveyor unit [m].
            strength: of the signal, where the message has one.
        """
        frame = self.sensor.frame(position, strength)
        if frame is not None:
            self.send_frame(frame)

    def send_frame(self, frame: CanFrame) -> None:
        """Send any frame on the bus."""
        self.port.write(self.adapter.forward(frame))

    def counters(self) -> dict[str, int]:
        """What happened, by name."""
        return {
            "sent": self.sensor.sent,
            "out_of_range": self.sensor.out_of_range,
            "forwarded": self.adapter.forwarded,
            "withheld": self.adapter.withheld,
            "refused": self.adapter.refused,
            "dropped_bytes": self.port.dropped_bytes,
        }

    def _heard(self, data: bytes) -> None:
        self.port.write(self.adapter.feed(data))
