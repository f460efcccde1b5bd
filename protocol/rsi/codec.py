"""KUKA RSI over Ethernet: codec of the robot's telegram and the sensor's reply.

Invariants:
    A codec is made from an RSI_EthernetConfig.xml and serves either end.
    Any bytes give a telegram or RsiError, any telegram gives bytes or RsiError.
"""

from collections.abc import Iterable, Mapping

from linemate.protocol.controller_link import PreparedReply
from linemate.protocol.rsi.ethernet_config import Element, RsiConfig, parse_config
from linemate.protocol.rsi.telegram import Channel, RobotTelegram, SensorTelegram
from linemate.protocol.rsi.telegram_layout import robot_layout, sensor_constants, sensor_layout
from linemate.protocol.rsi.telegram_reader import MAX_TELEGRAM_BYTES, RobotReader, SensorReader
from linemate.protocol.rsi.telegram_writer import TelegramWriter
from linemate.protocol.rsi.xml_scan import RsiError

__all__ = [
    "MAX_TELEGRAM_BYTES",
    "Channel",
    "Element",
    "PreparedReply",
    "RobotTelegram",
    "RsiCodec",
    "RsiConfig",
    "RsiError",
    "SensorTelegram",
    "parse_config",
]

ROBOT_TYPE = "KUKA"
MAX_DECIMALS = 16


class RsiCodec:
    """Reads and writes the telegrams of one configuration.

    Example::

        codec = RsiCodec(parse_config(xml))
        telegram = codec.parse_robot(datagram)
        reply = SensorTelegram(telegram.ipoc, telegram.ipoc_text, joints=..., external=(0.0,))
        datagram = codec.format_sensor(reply)
    """

    def __init__(
        self,
        config: RsiConfig,
        linear_external: Iterable[str] = ("E1",),
        decimals: int = 8,
        joint_tags: Iterable[str] = ("AK", "AKorr"),
        external_tags: Iterable[str] = ("EK", "EKorr"),
        constants: Mapping[str, Channel] | None = None,
    ) -> None:
        """Make the writers' templates and the readers' patterns.

        Args:
            linear_external: external axes that are linear (mm on the wire), others in degrees.
            decimals: digits after the point when writing, 1..16.
            joint_tags: elements of RECEIVE that mean corrections of A1..A6.
            external_tags: elements of RECEIVE that mean corrections of E1..E6.
            constants: values of RECEIVE elements that no reply gives, by TAG.

        Raises:
            RsiError: a configuration that makes no telegram, or a constant that does not fit.
        """
        if not 1 <= decimals <= MAX_DECIMALS:
            raise RsiError(f"{decimals} decimals, not 1..{MAX_DECIMALS}")
        linear = tuple(linear_external)
        self.config = config
        robot = robot_layout(config, linear)
        sensor = sensor_layout(config, linear, joint_tags, external_tags)
        self._robot_writer = TelegramWriter(robot, decimals)
        known = sensor_constants(config, sensor, constants or {})
        self._sensor_writer = TelegramWriter(sensor, decimals, known)
        self.robot_reader = RobotReader(robot, self._robot_writer.example(ROBOT_TYPE))
        self.sensor_reader = SensorReader(sensor, self._sensor_writer.example(config.sentype))

    def parse_robot(self, data: bytes) -> RobotTelegram:
        """Read the controller's telegram.

        Raises:
            RsiError: not a telegram of this configuration; everything configured must be there.
        """
        return self.robot_reader.parse(data)

    def parse_sensor(self, data: bytes) -> SensorTelegram:
        """Read the daemon's reply; a value that it lacks is None, a channel is left out.

        Raises:
            RsiError: not a reply of this configuration, or part of a vector missing.
        """
        return self.sensor_reader.parse(data)

    def format_robot(self, telegram: RobotTelegram) -> bytes:
        """Write the controller's telegram; channels that are not given are zero.

        Raises:
            RsiError: a configured vector or Delay missing, a value that the wire cannot carry.
        """
        return self._robot_writer.write(telegram, ROBOT_TYPE)

    def format_sensor(self, telegram: SensorTelegram) -> bytes:
        """Write the daemon's reply; channels that are not given are zero.

        Raises:
            RsiError: a configured vector missing, a value that the wire cannot carry, a
                correction that the configuration has no element for.
        """
        return self._sensor_writer.write(telegram, telegram.sentype or self.config.sentype)

    def prepare_sensor(self, telegram: SensorTelegram) -> PreparedReply:
        """Write the daemon's reply without its IPOC, which is ignored.

        Raises:
            RsiError: as :meth:`format_sensor`.
        """
        return self._sensor_writer.prepare(telegram, telegram.sentype or self.config.sentype)

    def bare_sensor(self) -> PreparedReply:
        """Write a reply of the constants only: no corrections and no signals."""
        return self._sensor_writer.bare(self.config.sentype)
