"""The force-torque sensor: the door to its devices.

Law of this file: names and a table, no logic. A configuration names a device; here that name
becomes a decoder, the host's end of its start-up dialogue and, for an emulator, the device's.
A further device is one file beside ``bota`` and one line in each table.
"""

from typing import Protocol

from linemate.protocol.sensors.bota import (
    BotaDecoder,
    BotaDevice,
    BotaHost,
    BotaSettings,
    bota_frame,
)
from linemate.protocol.sensors.ft300 import (
    Ft300Device,
    Ft300Host,
    Robotiq300Decoder,
    ft300_frame,
)
from linemate.protocol.sensors.wrench_stream import HostOutput, WrenchDecoder, WrenchError

__all__ = [
    "BAUD_RATES",
    "DEVICES",
    "BotaDecoder",
    "BotaDevice",
    "BotaHost",
    "BotaSettings",
    "Ft300Device",
    "Ft300Host",
    "HostOutput",
    "Robotiq300Decoder",
    "WrenchDecoder",
    "WrenchDevice",
    "WrenchError",
    "WrenchHost",
    "bota_frame",
    "ft300_frame",
    "make_decoder",
    "make_device",
    "make_host",
]


class WrenchHost(Protocol):
    """The host's end of a start-up dialogue, sans I/O.

    Attributes:
        running: the device streams; everything received belongs to the decoder.
        failure: why the dialogue was given up, None while it was not.
    """

    running: bool
    failure: str | None

    def begin(self, now_ns: int) -> HostOutput:
        """Start the dialogue, whatever the device is doing."""

    def feed(self, data: bytes, now_ns: int) -> HostOutput:
        """Take what the port gave; afterwards pass the stream through."""

    def on_time(self, now_ns: int) -> HostOutput:
        """Repeat what is overdue, give up in the end."""


class WrenchDevice(Protocol):
    """The device's end of a start-up dialogue, for an emulator.

    Attributes:
        streaming: whether frames are being sent.
    """

    streaming: bool

    def boot(self) -> bytes:
        """Power on; what the device prints then."""

    def feed(self, data: bytes) -> bytes:
        """Take the host's bytes, return the answers."""


_DECODERS: dict[str, type[BotaDecoder | Robotiq300Decoder]] = {
    "bota": BotaDecoder,
    "robotiq-ft300": Robotiq300Decoder,
}
_HOSTS: dict[str, type[BotaHost | Ft300Host]] = {"bota": BotaHost, "robotiq-ft300": Ft300Host}
_DEVICES: dict[str, type[BotaDevice | Ft300Device]] = {
    "bota": BotaDevice,
    "robotiq-ft300": Ft300Device,
}

DEVICES = tuple(_DECODERS)
"""Device names a configuration may use."""

BAUD_RATES = {"bota": 460800, "robotiq-ft300": 19200}
"""Line speed as delivered [baud]; 8 data bits, no parity, 1 stop bit."""


def _known(device: str) -> str:
    if device not in _DECODERS:
        raise WrenchError(f"force-torque: no device {device!r}; there are {', '.join(DEVICES)}")
    return device


def make_decoder(device: str) -> WrenchDecoder:
    """A decoder for a device's stream.

    Raises:
        WrenchError: no such device.
    """
    return _DECODERS[_known(device)]()


def make_host(device: str) -> WrenchHost:
    """The host's end of a device's start-up dialogue, with its default settings.

    Raises:
        WrenchError: no such device.
    """
    return _HOSTS[_known(device)]()


def make_device(device: str) -> WrenchDevice:
    """The device's end of its start-up dialogue, for an emulator.

    Raises:
        WrenchError: no such device.
    """
    return _DEVICES[_known(device)]()
