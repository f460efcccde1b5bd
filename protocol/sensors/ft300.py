"""Robotiq FT300 force-torque sensor: stream frames and the request that starts them.

A frame is 16 bytes: 20 4E, six int16 little endian (Fx Fy Fz in 1/100 N, Mx My Mz in 1/1000 Nm),
CRC-16/MODBUS little endian over the first 14. It has no stamp and no counter. 50 bytes of FF stop
the stream; writing 0x0200 to Modbus register 410 starts it.

Reference: the maker's manual.
"""

import math
import struct
from collections.abc import Sequence

import fastcrc

from linemate.protocol.sensors.wrench_stream import (
    HostOutput,
    WrenchDecoder,
    WrenchError,
    WrenchHost,
)
from linemate.protocol.stamped_samples import WrenchSample

FT300_HEADER = b"\x20\x4e"
FT300_FRAME_BYTES = 16
FORCE_COUNTS_PER_N = 100.0
TORQUE_COUNTS_PER_NM = 1000.0

_FRAME = struct.Struct("<2x6h2x")
_COUNTS = struct.Struct("<6h")
_MIN_COUNT, _MAX_COUNT = -32768, 32767
LARGEST_FORCE = _MAX_COUNT / FORCE_COUNTS_PER_N  # that an axis can state [N]


class Robotiq300Decoder(WrenchDecoder):
    """Finds FT300 frames in a byte stream."""

    __slots__ = ()

    def __init__(self) -> None:
        super().__init__(FT300_HEADER, FT300_FRAME_BYTES, fastcrc.crc16.modbus)

    def checked(self, frame: bytes) -> bytes:
        """Return the first 14 bytes."""
        return frame[:14]

    def sample(self, frame: bytes, stamp_ns: int) -> WrenchSample:
        """Return force and torque; integers are always finite."""
        fx, fy, fz, mx, my, mz = _FRAME.unpack(frame)
        return WrenchSample(
            stamp_ns, (fx / 100.0, fy / 100.0, fz / 100.0), (mx / 1e3, my / 1e3, mz / 1e3)
        )


def ft300_frame(force: Sequence[float], torque: Sequence[float]) -> bytes:
    """Return one frame as the device sends it, saturated at the ends of its range.

    Args:
        force: Fx Fy Fz [N], rounded to 0.01 N.
        torque: Mx My Mz [Nm], rounded to 0.001 Nm.

    Raises:
        WrenchError: not three and three finite values.
    """
    if len(force) != 3 or len(torque) != 3 or not all(map(math.isfinite, (*force, *torque))):
        raise WrenchError(f"ft300: {force!r}, {torque!r} are not three and three finite values")
    counts = [_count(value * FORCE_COUNTS_PER_N) for value in force]
    counts += [_count(value * TORQUE_COUNTS_PER_NM) for value in torque]
    return _checked(FT300_HEADER + _COUNTS.pack(*counts))


def _count(value: float) -> int:
    return round(min(max(value, _MIN_COUNT), _MAX_COUNT))


def _checked(body: bytes) -> bytes:
    return body + fastcrc.crc16.modbus(body).to_bytes(2, "little")


FT300_STOP = b"\xff" * 50
# Modbus RTU: slave 9, write multiple registers, one register, 410 = 0x0200; and its answer.
FT300_START = _checked(bytes.fromhex("0910019a0001020200"))
FT300_STARTED = _checked(bytes.fromhex("0910019a0001"))

ANSWER_TIMEOUT_NS = 700_000_000  # includes the time of the 50 bytes on the line


class Ft300Host(WrenchHost):
    """Host's side of the start: stop a stream, start a new one, pass it through."""

    __slots__ = ()

    def __init__(self) -> None:
        super().__init__(Robotiq300Decoder, ANSWER_TIMEOUT_NS)

    def feed(self, data: bytes, now_ns: int) -> HostOutput:
        """Process what the port received: rest of an old stream, the answer, the stream."""
        if self.running:
            return HostOutput(stream=data)
        if self.failure is not None:
            return HostOutput()
        received = self._tail + data
        _, answer, stream = received.partition(FT300_STARTED)
        if not answer:
            if self._streams_unasked(data, now_ns):
                self.running = True
                return HostOutput(stream=data)
            self._tail = received[-(len(FT300_STARTED) - 1) :]
            return HostOutput()
        self._tail = b""
        self.running = True
        return HostOutput(stream=stream)

    def _request(self) -> bytes:
        return FT300_STOP + FT300_START

    def _unanswered(self) -> str:
        return "ft300: no answer"


class Ft300Device:
    """Device's side, for an emulated sensor.

    Attributes:
        streaming: frames are being sent.
        refused: bytes that belong to no known request.
    """

    __slots__ = ("_buffer", "_stops", "refused", "streaming")

    def __init__(self) -> None:
        """Begin powered on and not streaming."""
        self._buffer = b""
        self._stops = 0
        self.streaming = False
        self.refused = 0

    def boot(self) -> bytes:
        """Power on; it is silent until a request."""
        self._buffer = b""
        self._stops = 0
        self.streaming = False
        return b""

    def feed(self, data: bytes) -> bytes:
        """Return the answers to the host's bytes, which may be cut anywhere."""
        answers = b""
        for index in range(len(data)):
            answers += self._on_byte(data[index : index + 1])
        return answers

    def _on_byte(self, byte: bytes) -> bytes:
        self._stops = self._stops + 1 if byte == b"\xff" else 0
        if self._stops >= len(FT300_STOP):
            self.streaming = False
        if self._stops and not self._buffer:
            return b""
        self._buffer += byte
        while not FT300_START.startswith(self._buffer):
            self.refused += 1
            self._buffer = self._buffer[1:]
        if self._buffer != FT300_START or self.streaming:
            return b""
        self._buffer = b""
        self.streaming = True
        return FT300_STARTED
