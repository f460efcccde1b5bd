"""Bota Systems serial force-torque sensors (Rokubi, SensONE): frames and start-up dialogue.

A frame is 37 bytes: 0xAA, ``<H6fIf`` (status, Fx Fy Fz [N], Mx My Mz [Nm], stamp [us],
temperature [deg C]), CRC-16/X-25 little endian over the 34 bytes between. Commands are ASCII
without terminator, each answered ``r,0,<command>,0``.

Reference: the maker's Python example and its ROS 2 driver.
"""

import math
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace

import fastcrc

from linemate.protocol.sensors.wrench_stream import (
    HostOutput,
    WrenchDecoder,
    WrenchError,
    WrenchHost,
)
from linemate.protocol.stamped_samples import WrenchSample

BOTA_HEADER = b"\xaa"
_HEADER_BYTE = BOTA_HEADER[0]
BOTA_FRAME_BYTES = 37
BOTA_BAUD_RATES = (9600, 57600, 115200, 230400, 460800)  # by baud code of the ``c`` command

STATUS_SKIPPED = 1 << 0  # the application took too long: measurements were skipped
STATUS_OVERRANGE = 1 << 1
STATUS_INVALID = 1 << 2
STATUS_RAW = 1 << 3

_PAYLOAD = struct.Struct("<H6fIf")
_FRAME = struct.Struct("<xH6fIf2x")


class BotaDecoder(WrenchDecoder):
    """Finds Bota frames in a byte stream."""

    __slots__ = ()

    def __init__(self) -> None:
        super().__init__(BOTA_HEADER, BOTA_FRAME_BYTES, fastcrc.crc16.ibm_sdlc)

    def feed(self, data: bytes, stamp_ns: int) -> list[WrenchSample]:
        """Return the samples; a good frame that comes alone needs no search."""
        if len(data) == BOTA_FRAME_BYTES and not self._buffer and not self._lost:
            crc = fastcrc.crc16.ibm_sdlc(data[1:35])
            if data[0] == _HEADER_BYTE and crc == data[35] | data[36] << 8:
                sample = self.sample(data, stamp_ns)
                if sample is not None:
                    self.frames += 1
                    return [sample]
        return super().feed(data, stamp_ns)

    def checked(self, frame: bytes) -> bytes:
        """Return the 34 payload bytes."""
        return frame[1:35]

    def sample(self, frame: bytes, stamp_ns: int) -> WrenchSample | None:
        """Return the sample of a frame, None if a value is not finite."""
        status, fx, fy, fz, mx, my, mz, device_us, temperature = _FRAME.unpack(frame)
        if not math.isfinite(fx + fy + fz + mx + my + mz + temperature):
            return None
        return WrenchSample(stamp_ns, (fx, fy, fz), (mx, my, mz), status, device_us, temperature)


def bota_frame(
    force: Sequence[float],
    torque: Sequence[float],
    *,
    status: int = 0,
    device_us: int = 0,
    temperature: float = 25.0,
) -> bytes:
    """Return one frame as the device sends it.

    Args:
        force: Fx Fy Fz [N].
        torque: Mx My Mz [Nm].
        device_us: the device's clock [us]; it wraps at 32 bits.
        temperature: of the sensor [deg C].

    Raises:
        WrenchError: a value does not fit. NaN and Inf fit, as from a broken device.
    """
    try:
        fx, fy, fz = force
        mx, my, mz = torque
        stamp = device_us & 0xFFFFFFFF
        payload = _PAYLOAD.pack(status, fx, fy, fz, mx, my, mz, stamp, temperature)
    except (struct.error, OverflowError, TypeError, ValueError) as error:
        raise WrenchError(f"bota: {force!r}, {torque!r} do not fit a frame: {error}") from error
    return BOTA_HEADER + payload + fastcrc.crc16.ibm_sdlc(payload).to_bytes(2, "little")


@dataclass(frozen=True, slots=True)
class BotaSettings:
    """Settings of the start-up dialogue.

    Attributes:
        sinc: length of the sinc filter, 51..512; the sample time is sinc x 19.53125 us.
        calibration: apply the calibration matrix, else raw values.
        chop: use the sinc filter with chopping.
        skip_fir: do not use the FIR filter.
    """

    sinc: int = 205
    baud_rate: int = 460800
    temperature_compensation: bool = False
    calibration: bool = True
    chop: bool = False
    fast: bool = False
    skip_fir: bool = True

    def __post_init__(self) -> None:
        """Refuse what the device refuses.

        Raises:
            WrenchError: sinc or baud rate out of range.
        """
        if not 51 <= self.sinc <= 512:
            raise WrenchError(f"bota: sinc is {self.sinc}, not within 51..512")
        if self.baud_rate not in BOTA_BAUD_RATES:
            raise WrenchError(f"bota: baud rate {self.baud_rate} is none of {BOTA_BAUD_RATES}")

    def commands(self) -> tuple[bytes, ...]:
        """Return the commands in order: configure, communication, filter, run."""
        baud_code = BOTA_BAUD_RATES.index(self.baud_rate)
        communication = (self.temperature_compensation, self.calibration, 0, baud_code)
        filters = (self.sinc, self.chop, self.fast, self.skip_fir)
        return (b"C", _command("c", communication), _command("f", filters), b"R")


def _command(letter: str, values: Sequence[int]) -> bytes:
    return ",".join([letter, *(str(int(value)) for value in values)]).encode()


_ANSWER = re.compile(rb"r,0,([A-Za-z]),(\d{1,3})")
_LONGEST_ANSWER = 16
ANSWER_TIMEOUT_NS = 500_000_000  # without an answer the dialogue starts again


class BotaHost(WrenchHost):
    """Host's side of the start-up dialogue: the device confirms every setting, then runs."""

    __slots__ = ("_commands", "_index", "_trimming")

    def __init__(self, settings: BotaSettings | None = None) -> None:
        super().__init__(BotaDecoder, ANSWER_TIMEOUT_NS)
        self._commands = (settings or BotaSettings()).commands()
        self._index = 0
        self._trimming = True

    def feed(self, data: bytes, now_ns: int) -> HostOutput:
        """Process what the port received: answers, banners and old frames, later the stream."""
        if self.running:
            return HostOutput(stream=self._trimmed(data))
        if self.failure is not None:
            return HostOutput()
        if self._streams_unasked(data, now_ns):
            self.running, self._trimming = True, False
            return HostOutput(stream=data)
        sent = b""
        rest = self._tail + data
        while not self.running and self.failure is None:
            answer = _ANSWER.search(rest)
            if answer is None:
                self._tail = rest[-(_LONGEST_ANSWER - 1) :]
                return HostOutput(send=sent)
            rest = rest[answer.end() :]
            sent += self._on_answer(answer, now_ns)
        self._tail = b""
        stream = self._trimmed(rest) if self.running else b""
        return HostOutput(send=sent, stream=stream)

    def _request(self) -> bytes:
        self._index = 0
        self._trimming = True
        return self._commands[0]

    def _unanswered(self) -> str:
        return f"bota: no answer to {self._commands[self._index].decode()!r}"

    def _on_answer(self, answer: re.Match[bytes], now_ns: int) -> bytes:
        """Continue after the expected answer; ignore one to an older command."""
        letter, code = answer.groups()
        command = self._commands[self._index]
        if letter != command[:1]:
            return b""
        if int(code) != 0:
            self.failure = f"bota: {command.decode()!r} refused with code {int(code)}"
            return b""
        self._index += 1
        self._deadline_ns = now_ns + ANSWER_TIMEOUT_NS
        if self._index == len(self._commands):
            self.running = True
            return b""
        return self._commands[self._index]

    def _trimmed(self, data: bytes) -> bytes:
        """Remove the line end of the last answer, which is no garbage."""
        if not self._trimming:
            return data
        data = data.lstrip(b"\r\n")
        self._trimming = not data
        return data


_DEVICE_COMMAND = re.compile(
    rb"""(?P<simple>[CIRslw\#])
       | c,(?P<c>\d,\d,\d,\d)
       | f,(?P<f>\d{1,4},\d,\d,\d)
       | (?P<values>[bm][^\r\n]{0,119})[\r\n]""",
    re.VERBOSE,
)
_UNFINISHED = re.compile(rb"c(,\d?){0,4}|f(,\d{0,4}(,\d?){0,3})?|[bm][^\r\n]{0,119}")
REFUSED = 1  # code of a refusal; the maker documents 0 only, any other code is a refusal


class BotaDevice:
    """Device's side of the dialogue, for an emulated sensor.

    Attributes:
        streaming: frames are being sent (run mode).
        refused: bytes and commands that are unknown or out of range.
    """

    __slots__ = ("_buffer", "_pending", "refused", "settings", "streaming")

    def __init__(self) -> None:
        """Begin without power; :meth:`boot` powers on."""
        self._buffer = b""
        self._pending = self.settings = BotaSettings()
        self.streaming = False
        self.refused = 0

    def boot(self) -> bytes:
        """Power on and stream with the saved settings; return the banner."""
        self._buffer = b""
        self.streaming = True
        return b"linemate SensONE\r\nserial 0001\r\nfirmware 1.0\r\nApp Init\r\n"

    def feed(self, data: bytes) -> bytes:
        """Return the answers to the host's bytes, which may be cut anywhere."""
        buffer = self._buffer + data
        answers = b""
        while buffer:
            command = _DEVICE_COMMAND.match(buffer)
            if command is not None:
                answers += self._execute(command)
                buffer = buffer[command.end() :]
            elif _UNFINISHED.fullmatch(buffer):
                break
            else:
                self.refused += buffer[0] not in b"\r\n \0"
                buffer = buffer[1:]
        self._buffer = buffer
        return answers

    def _execute(self, command: re.Match[bytes]) -> bytes:
        letter = command[0][:1]
        if letter == b"#":
            return self.boot()
        if letter == b"C":
            self.streaming = False
            self._pending = self.settings
            return _answer(letter, 0)
        if self.streaming or not self._apply(letter, command):
            self.refused += 1
            return _answer(letter, REFUSED)
        return _answer(letter, 0)

    def _apply(self, letter: bytes, command: re.Match[bytes]) -> bool:
        """Execute one command of the configuration mode; return False to refuse it."""
        try:
            if letter == b"c":
                self._pending = _with_communication(self._pending, command["c"])
            elif letter == b"f":
                self._pending = _with_filter(self._pending, command["f"])
            elif letter == b"R":
                self.settings = self._pending
                self.streaming = True
        except WrenchError:
            return False
        return True


def _answer(letter: bytes, code: int) -> bytes:
    return b"r,0,%s,%d\r\n" % (letter, code)


def _with_communication(settings: BotaSettings, values: bytes) -> BotaSettings:
    compensation, calibration, data_format, baud_code = (int(v) for v in values.split(b","))
    if data_format != 0 or baud_code >= len(BOTA_BAUD_RATES) or max(compensation, calibration) > 1:
        raise WrenchError(f"bota: communication {values.decode()} refused")
    return replace(
        settings,
        baud_rate=BOTA_BAUD_RATES[baud_code],
        temperature_compensation=bool(compensation),
        calibration=bool(calibration),
    )


def _with_filter(settings: BotaSettings, values: bytes) -> BotaSettings:
    sinc, chop, fast, skip_fir = (int(v) for v in values.split(b","))
    if max(chop, fast, skip_fir) > 1:
        raise WrenchError(f"bota: filter {values.decode()} refused")
    return replace(settings, sinc=sinc, chop=bool(chop), fast=bool(fast), skip_fir=bool(skip_fir))
