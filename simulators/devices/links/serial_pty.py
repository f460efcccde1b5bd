"""Emulated force-torque sensor on a pty or behind a TCP port.

Invariants:
    Bytes pass unchanged.
    The sensor powers on when the port opens, as with a USB converter.
"""

from collections.abc import Sequence
from pathlib import Path

from linemate.simulators.devices.links.endpoint import Address
from linemate.simulators.devices.links.pty_port import PtyPort
from linemate.simulators.devices.links.tcp_port import TcpPort
from linemate.simulators.devices.sensing.force_torque import ForceTorqueSensor


class SerialPty:
    """A serial line with one sensor on it.

    Attributes:
        port: the pty, or the TCP port.
    """

    def __init__(
        self, sensor: ForceTorqueSensor, link: Path | None = None, bind: Address | None = None
    ) -> None:
        """Set it up; it is not plugged in yet.

        Args:
            link: symbolic link to make for the pty.
            bind: address and port of a TCP port instead of a pty.
        """
        self.sensor = sensor
        self.port: PtyPort | TcpPort = (
            PtyPort(self._heard, link=link) if bind is None else TcpPort(self._heard, bind)
        )

    def open(self) -> None:
        """Plug the sensor in; it powers on.

        Raises:
            OSError: if no port can be had.
        """
        self.port.plug()
        self.port.write(self.sensor.boot())

    def close(self) -> None:
        """Unplug the sensor."""
        self.port.unplug()

    def emit(self, force: Sequence[float], torque: Sequence[float], device_us: int) -> None:
        """The sensor measures."""
        self.port.write(self.sensor.frame(force, torque, device_us))

    def counters(self) -> dict[str, int]:
        """What happened, by name."""
        return {
            "sent": self.sensor.sent,
            "withheld": self.sensor.withheld,
            "dropped_bytes": self.port.dropped_bytes,
        }

    def _heard(self, data: bytes) -> None:
        self.port.write(self.sensor.feed(data))
