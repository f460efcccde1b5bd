"""KUKA RSI over Ethernet: codec of the robot's telegram and the sensor's reply.

Invariants:
    A codec is made from an RSI_EthernetConfig.xml and serves either end.
    Any bytes give a telegram or RsiError, any telegram gives bytes or RsiError.
"""

from collections.abc import Iterable, Mapping, Sequence
from operator import mul
from typing import cast

from linemate.protocol.controller_link import PreparedReply
from linemate.protocol.rsi.ethernet_config import Element, RsiConfig, parse_config
from linemate.protocol.rsi.expected_telegram import ExpectedTelegram
from linemate.protocol.rsi.telegram import Channel, RobotTelegram, SensorTelegram
from linemate.protocol.rsi.telegram_layout import (
    Layout,
    Vector,
    robot_layout,
    sensor_constants,
    sensor_layout,
)
from linemate.protocol.rsi.telegram_reader import MAX_TELEGRAM_BYTES, TelegramReader, Texts
from linemate.protocol.rsi.telegram_writer import TelegramWriter
from linemate.protocol.rsi.xml_scan import RsiError
from linemate.protocol.stamped_samples import Vector6

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
        self._robot = robot_layout(config, linear)
        self._sensor = sensor_layout(config, linear, joint_tags, external_tags)
        self._robot_vectors = _Vectors(self._robot.vectors)
        self._sensor_vectors = _Vectors(self._sensor.vectors)
        whole = (v for v in self._robot.vectors if v.name == "joints" and len(v.fields) == v.width)
        self._joints = next(whole, None)
        # Of the last expected telegram: a robot at rest has the same ones in each cycle.
        self._bounds: tuple[Vector6 | None, float, tuple[float, ...], tuple[float, ...]]
        self._bounds = None, 0.0, (), ()
        self._robot_writer = TelegramWriter(self._robot, decimals)
        known = sensor_constants(config, self._sensor, constants or {})
        self._sensor_writer = TelegramWriter(self._sensor, decimals, known)
        self.robot_reader = TelegramReader(self._robot, self._robot_writer.example(ROBOT_TYPE))
        self.sensor_reader = TelegramReader(
            self._sensor, self._sensor_writer.example(config.sentype)
        )

    def parse_robot(self, data: bytes) -> RobotTelegram:
        """Read the controller's telegram.

        Raises:
            RsiError: not a telegram of this configuration; everything configured must be there.
        """
        texts, _ = self.robot_reader.read(data)
        layout = self._robot
        ipoc, ipoc_text = _ipoc(texts)
        vector = self._robot_vectors.read(texts).get
        return RobotTelegram(
            ipoc,
            ipoc_text,
            vector("joints"),
            vector("joint_setpoints"),
            vector("external"),
            vector("external_setpoints"),
            vector("tcp"),
            vector("tcp_setpoint"),
            None if layout.delay is None else int(cast(bytes, texts[layout.delay])),
            _channels(layout, texts),
        )

    def expect_robot(
        self, ipoc: int, delay: int | None, joints: Vector6, reach: float
    ) -> ExpectedTelegram | None:
        """Return the telegram to expect next, None without AIPos or with another Delay.

        Args:
            delay: the next Delay, None if none is configured.
            joints: the last measured joints [rad].
            reach: how far from there a joint may be [rad].
        """
        vector, position = self._joints, self._robot.delay
        if vector is None or (delay is None) != (position is None):
            return None
        reader, scales = self.robot_reader, vector.scales
        fields, texts = vector.fields, [b"%d" % ipoc]
        if delay is not None and position is not None:
            fields, texts = (*fields, position), [b"%d" % delay, *texts]
        kept, kept_reach, low, high = self._bounds
        if joints is not kept or reach != kept_reach:
            low = tuple([(q - reach) / scale for q, scale in zip(joints, scales, strict=True)])
            high = tuple([(q + reach) / scale for q, scale in zip(joints, scales, strict=True)])
            self._bounds = joints, reach, low, high
        return ExpectedTelegram(reader.match, reader.groups(fields), texts, low, high)

    def parse_sensor(self, data: bytes) -> SensorTelegram:
        """Read the daemon's reply; a value that it lacks is None, a channel is left out.

        Raises:
            RsiError: not a reply of this configuration, or part of a vector missing.
        """
        texts, sentype = self.sensor_reader.read(data)
        layout = self._sensor
        ipoc, ipoc_text = _ipoc(texts)
        vector = self._sensor_vectors.read(texts).get
        message = None if layout.message is None else texts[layout.message]
        return SensorTelegram(
            ipoc,
            ipoc_text,
            sentype,
            vector("joints"),
            vector("external"),
            _channels(layout, texts),
            None if message is None else message.decode("latin-1"),
        )

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


def _ipoc(texts: Texts) -> tuple[int, bytes]:
    text = cast(bytes, texts[-1])
    return int(text), text


class _Vectors:
    """Converts the vectors of one layout, all at once where their fields are one block."""

    def __init__(self, vectors: tuple[Vector, ...]) -> None:
        self._vectors = sorted(vectors, key=lambda vector: vector.fields[0])
        fields = [n for vector in self._vectors for n in vector.fields]
        first = fields[0] if fields else 0
        self._is_block = all(vector.contiguous for vector in vectors) and fields == list(
            range(first, first + len(fields))
        )
        self._block = slice(first, first + len(fields))
        self._scales = [scale for vector in self._vectors for scale in vector.scales]
        self._parts = [
            (v.name, slice(v.fields[0] - first, v.fields[-1] - first + 1)) for v in self._vectors
        ]

    def read(self, texts: Texts) -> dict[str, Vector6 | None]:
        """Return the vectors by name in SI; typed as six numbers, external ones may be fewer."""
        if not self._is_block or None in texts:
            return {v.name: cast(Vector6 | None, _vector(v, texts)) for v in self._vectors}
        raw = cast(Sequence[bytes], texts[self._block])
        numbers = tuple(map(mul, map(float, raw), self._scales))
        return {name: numbers[part] for name, part in self._parts}


def _vector(vector: Vector, texts: Texts) -> tuple[float, ...] | None:
    """Return one vector's values in SI; axes that are not configured are zero."""
    if texts[vector.fields[0]] is None:
        return None
    out = [0.0] * vector.width
    for position, axis, scale in zip(vector.fields, vector.axes, vector.scales, strict=True):
        out[axis] = float(cast(bytes, texts[position])) * scale
    return tuple(out)


def _channels(layout: Layout, texts: Texts) -> Mapping[str, Channel]:
    out: dict[str, Channel] = {}
    for key, n in layout.channels.items():
        text = texts[n]
        if text is not None:
            out[key] = _channel(layout.fields[n].type, text)
    return out


def _channel(kind: str, text: bytes) -> Channel:
    if kind == "LONG":
        return int(text)
    if kind == "DOUBLE":
        return float(text)
    return text.decode("latin-1") if kind == "STRING" else float(text) != 0.0
