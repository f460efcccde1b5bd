"""Robotiq FT300 force-torque sensor: stream frames and the request that starts them.

Law of this file: bytes and states, no port and no clock; time comes as an argument.
A frame is 16 bytes: 20 4E, six int16 little endian (Fx Fy Fz in 1/100 N, Mx My Mz in 1/1000 Nm),
CRC-16/MODBUS little endian over the first 14. It has no stamp and no counter.
The stream is stopped by 50 bytes of FF and started by writing 0x0200 to Modbus register 410.
Source: the maker's manual.
"""

import math
import struct
from collections.abc import Sequence

import fastcrc

from linemate.protocol.samples import WrenchSample
from linemate.protocol.sensors.wrench_stream import (
    DEAF_ATTEMPTS,
    DEAF_FRAMES,
    HostOutput,
    WrenchDecoder,
    WrenchError,
)

FT300_HEADER = b"\x20\x4e"
FT300_FRAME_BYTES = 16
FORCE_COUNTS_PER_N = 100.0
TORQUE_COUNTS_PER_NM = 1000.0

_FRAME = struct.Struct("<2x6h2x")
_COUNTS = struct.Struct("<6h")
_MIN_COUNT, _MAX_COUNT = -32768, 32767


class Robotiq300Decoder(WrenchDecoder):
    """FT300 frames out of a byte stream."""

    __slots__ = ()

    def __init__(self) -> None:
        """Start in step, with an empty buffer."""
        super().__init__(FT300_HEADER, FT300_FRAME_BYTES, fastcrc.crc16.modbus)

    def checked(self, frame: bytes) -> bytes:
        """The first 14 bytes."""
        return frame[:14]

    def sample(self, frame: bytes, stamp_ns: int) -> WrenchSample:
        """Force and torque; integers are always finite."""
        fx, fy, fz, mx, my, mz = _FRAME.unpack(frame)
        return WrenchSample(
            stamp_ns, (fx / 100.0, fy / 100.0, fz / 100.0), (mx / 1e3, my / 1e3, mz / 1e3)
        )


def ft300_frame(force: Sequence[float], torque: Sequence[float]) -> bytes:
    """One frame as the device sends it, saturated at the ends of its range.

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
    body = FT300_HEADER + _COUNTS.pack(*counts)
    return body + _check(body)


def _count(value: float) -> int:
    return round(min(max(value, _MIN_COUNT), _MAX_COUNT))


def _check(body: bytes) -> bytes:
    return fastcrc.crc16.modbus(body).to_bytes(2, "little")


def _checked(body: bytes) -> bytes:
    return body + _check(body)


FT300_STOP = b"\xff" * 50
FT300_START = _checked(bytes.fromhex("0910019a0001020200"))
"""Modbus RTU: slave 9, write multiple registers, one register, 410 = 0x0200."""
FT300_STARTED = _checked(bytes.fromhex("0910019a0001"))
"""The slave's answer to it."""

ANSWER_TIMEOUT_NS = 700_000_000
"""How long the host waits for the answer; the 50 bytes and the device take some of it."""
MAX_ATTEMPTS = 10


class Ft300Host:
    """The host's end of the start: stop whatever runs, start the stream, pass it through.

    Attributes:
        running: the device has confirmed and streams, or streams whatever it is asked.
        failure: why it was given up, None while it was not.
    """

    __slots__ = ("_attempts", "_deadline_ns", "_tail", "_unasked", "failure", "running")

    def __init__(self) -> None:
        """Nothing sent yet."""
        self._tail = b""
        self._unasked = Robotiq300Decoder()
        self._attempts = 0
        self._deadline_ns = 0
        self.running = False
        self.failure: str | None = None

    def begin(self, now_ns: int) -> HostOutput:
        """Stop an old stream and ask for a new one."""
        self.running, self.failure = False, None
        self._attempts = 0
        return self._restart(now_ns)

    def feed(self, data: bytes, now_ns: int) -> HostOutput:
        """Take what the port gave: remains of an old stream, the answer, the stream."""
        if self.running:
            return HostOutput(stream=data)
        if self.failure is not None:
            return HostOutput()
        received = self._tail + data
        _, answer, stream = received.partition(FT300_STARTED)
        if not answer:
            self._unasked.feed(data, now_ns)
            if self._attempts >= DEAF_ATTEMPTS and self._unasked.frames >= DEAF_FRAMES:
                self.running = True
                return HostOutput(stream=data)
            self._tail = received[-(len(FT300_STARTED) - 1) :]
            return HostOutput()
        self._tail = b""
        self.running = True
        return HostOutput(stream=stream)

    def on_time(self, now_ns: int) -> HostOutput:
        """Ask again when the answer is overdue; give up after ``MAX_ATTEMPTS``."""
        if self.running or self.failure is not None or now_ns < self._deadline_ns:
            return HostOutput()
        if self._attempts >= MAX_ATTEMPTS:
            self.failure = f"ft300: no answer after {self._attempts} attempts"
            return HostOutput()
        return self._restart(now_ns)

    def _restart(self, now_ns: int) -> HostOutput:
        self._tail = b""
        self._unasked = Robotiq300Decoder()
        self._attempts += 1
        self._deadline_ns = now_ns + ANSWER_TIMEOUT_NS
        return HostOutput(send=FT300_STOP + FT300_START)


class Ft300Device:
    """The device's end: what an emulated sensor answers.

    Attributes:
        streaming: whether frames are being sent.
        refused: bytes that belong to no request understood.
    """

    __slots__ = ("_buffer", "_stops", "refused", "streaming")

    def __init__(self) -> None:
        """Powered on, not streaming."""
        self._buffer = b""
        self._stops = 0
        self.streaming = False
        self.refused = 0

    def boot(self) -> bytes:
        """Power on: silent until asked."""
        self._buffer = b""
        self._stops = 0
        self.streaming = False
        return b""

    def feed(self, data: bytes) -> bytes:
        """Take the host's bytes, cut anywhere; return the answers."""
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
