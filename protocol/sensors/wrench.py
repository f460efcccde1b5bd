"""Force-torque devices by name: decoder, host's and device's side of the start-up dialogue.

A further device is one file next to ``bota`` and one line in each table.
"""

import math
from typing import Protocol

from linemate.protocol.sensors.bota import (
    BotaDecoder,
    BotaDevice,
    BotaHost,
    BotaSettings,
    bota_frame,
)
from linemate.protocol.sensors.ft300 import (
    LARGEST_FORCE,
    Ft300Device,
    Ft300Host,
    Robotiq300Decoder,
    ft300_frame,
)
from linemate.protocol.sensors.wrench_stream import (
    HostOutput,
    WrenchDecoder,
    WrenchError,
    WrenchHost,
)

__all__ = [
    "BAUD_RATES",
    "DEVICES",
    "LARGEST_FORCES",
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


class WrenchDevice(Protocol):
    """Device's side of a start-up dialogue, for an emulator.

    Attributes:
        streaming: frames are being sent.
    """

    streaming: bool

    def boot(self) -> bytes:
        """Power on; return the banner."""

    def feed(self, data: bytes) -> bytes:
        """Return the answers to the host's bytes."""


_DECODERS: dict[str, type[BotaDecoder | Robotiq300Decoder]] = {
    "bota": BotaDecoder,
    "robotiq-ft300": Robotiq300Decoder,
}
_HOSTS: dict[str, type[BotaHost | Ft300Host]] = {"bota": BotaHost, "robotiq-ft300": Ft300Host}
_DEVICES: dict[str, type[BotaDevice | Ft300Device]] = {
    "bota": BotaDevice,
    "robotiq-ft300": Ft300Device,
}

DEVICES = tuple(_DECODERS)  # names in a configuration
# Line speed as delivered [baud]; 8 data bits, no parity, 1 stop bit.
BAUD_RATES = {"bota": 460800, "robotiq-ft300": 19200}
# Largest force that an axis can state [N]: a larger one reads so.
LARGEST_FORCES = {"bota": math.inf, "robotiq-ft300": LARGEST_FORCE}


def _known(device: str) -> str:
    if device not in _DECODERS:
        raise WrenchError(f"force-torque: no device {device!r}; there are {', '.join(DEVICES)}")
    return device


def make_decoder(device: str) -> WrenchDecoder:
    """Return a decoder of a device's stream.

    Raises:
        WrenchError: no such device.
    """
    return _DECODERS[_known(device)]()


def make_host(device: str) -> WrenchHost:
    """Return the host's side of a device's start-up dialogue with default settings.

    Raises:
        WrenchError: no such device.
    """
    return _HOSTS[_known(device)]()


def make_device(device: str) -> WrenchDevice:
    """Return the device's side of its start-up dialogue, for an emulator.

    Raises:
        WrenchError: no such device.
    """
    return _DEVICES[_known(device)]()
