"""Emulated force-torque sensor on a serial line: start-up dialogue and stream.

Invariants:
    Pure: host bytes in, device bytes out; no port, no clock.
    It streams only after the dialogue that the device requires.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from linemate.protocol.sensors.wrench import WrenchDevice, bota_frame, ft300_frame, make_device

Encode = Callable[[Sequence[float], Sequence[float], int], bytes]


_ENCODERS: dict[str, Encode] = {
    "bota": lambda force, torque, device_us: bota_frame(force, torque, device_us=device_us),
    "robotiq-ft300": lambda force, torque, _: ft300_frame(force, torque),  # it has no clock
}


@dataclass(slots=True)
class ForceTorqueSensor:
    """The device's end of the line.

    Attributes:
        withheld: readings taken while the device did not stream.
    """

    device: str = "bota"
    sent: int = 0
    withheld: int = 0
    _talk: WrenchDevice = field(init=False)
    _encode: Encode = field(init=False)

    def __post_init__(self) -> None:
        """Resolve the device's name.

        Raises:
            WrenchError: if there is no such device.
        """
        self._talk = make_device(self.device)
        self._encode = _ENCODERS[self.device]

    @property
    def streaming(self) -> bool:
        """The device sends frames."""
        return self._talk.streaming

    def boot(self) -> bytes:
        """Power on.

        Returns:
            What the device prints then.
        """
        return self._talk.boot()

    def feed(self, data: bytes) -> bytes:
        """Take the host's bytes, cut anywhere.

        Returns:
            The answers.
        """
        return self._talk.feed(data)

    def frame(self, force: Sequence[float], torque: Sequence[float], device_us: int) -> bytes:
        """The frame of one reading.

        Returns:
            Bytes for the host; none while the device does not stream.

        Raises:
            WrenchError: if the reading does not fit a frame.
        """
        if not self._talk.streaming:
            self.withheld += 1
            return b""
        self.sent += 1
        return self._encode(force, torque, device_us)
