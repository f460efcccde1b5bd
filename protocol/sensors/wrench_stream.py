"""Bases of the force-torque devices: find frames in a byte stream, start it by a dialogue.

Invariants:
    Bytes may be cut anywhere. The samples are whole, checked and finite.
    A frame with a wrong CRC costs one byte: the search goes on within it.
    Less than one frame is kept between two calls. What is dropped is counted.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable

from msgspec import Struct

from linemate.protocol.errors import ProtocolError
from linemate.protocol.stamped_samples import WrenchSample


class WrenchError(ProtocolError):
    """A wrench, a device or a setting that the wire cannot carry."""


class HostOutput(Struct, frozen=True):
    """Output of the host's side of a dialogue.

    Attributes:
        send: bytes for the device.
        stream: bytes for the decoder, once the device runs.
    """

    send: bytes = b""
    stream: bytes = b""


# After so many requests without an answer and so many good frames since the last one, the device
# streams by itself: the converter passes one direction only, or it is a sender of bare frames.
SILENT_ATTEMPTS, SILENT_FRAMES = 3, 5
MAX_ATTEMPTS = 10  # a booting sensor ignores the first ones


class WrenchDecoder(ABC):
    """Finds one device's frames in a byte stream and counts the rest.

    Attributes:
        bad_crc: places with a header whose CRC is wrong.
        nonfinite: frames with a good CRC that hold NaN or Inf, dropped.
        garbage_bytes: bytes that belong to no good frame.
        resyncs: how often frames follow again after garbage.
    """

    __slots__ = (
        "_buffer",
        "_crc",
        "_header",
        "_lost",
        "_size",
        "bad_crc",
        "frames",
        "garbage_bytes",
        "nonfinite",
        "resyncs",
    )

    def __init__(self, header: bytes, size: int, crc: Callable[[bytes], int]) -> None:
        """Begin with an empty buffer.

        Args:
            header: first bytes of every frame.
            size: of a frame with header and CRC [bytes].
            crc: the 16-bit CRC over :meth:`checked`.
        """
        self._header = header
        self._size = size
        self._crc = crc
        self._buffer = b""
        self._lost = False
        self.frames = 0
        self.bad_crc = 0
        self.nonfinite = 0
        self.garbage_bytes = 0
        self.resyncs = 0

    @abstractmethod
    def checked(self, frame: bytes) -> bytes:
        """Return the part of a frame that its CRC covers."""

    @abstractmethod
    def sample(self, frame: bytes, stamp_ns: int) -> WrenchSample | None:
        """Return the sample of a checked frame, None if it is not finite."""

    def feed(self, data: bytes, stamp_ns: int) -> list[WrenchSample]:
        """Return the samples that the received bytes complete, stamped with their arrival [ns]."""
        buffer = self._buffer + data if self._buffer else data
        samples: list[WrenchSample] = []
        size, end, position = self._size, len(buffer), 0
        header = self._header
        while end - position >= size:
            if not buffer.startswith(header, position):
                position = self._next_header(buffer, position)
                continue
            frame = buffer[position : position + size]
            if not self._is_frame(frame):
                self.bad_crc += 1
                self._drop(1)
                position += 1
                continue
            self._accept(frame, stamp_ns, samples)
            position += size
        self._buffer = buffer[self._trim(buffer, position) :] if position < end else b""
        return samples

    def reset(self) -> None:
        """Drop the incomplete frame, as after reopening the port; the counters stay."""
        self._buffer = b""
        self._lost = False

    def counters(self) -> dict[str, int]:
        """Return the counters by name, for a status."""
        return {
            "frames": self.frames,
            "bad_crc": self.bad_crc,
            "nonfinite": self.nonfinite,
            "garbage_bytes": self.garbage_bytes,
            "resyncs": self.resyncs,
        }

    def _is_frame(self, data: bytes) -> bool:
        """Whether bytes of a frame's length are a frame."""
        crc = data[-2] | data[-1] << 8
        return data.startswith(self._header) and self._crc(self.checked(data)) == crc

    def _accept(self, frame: bytes, stamp_ns: int, samples: list[WrenchSample]) -> None:
        if self._lost:
            self._lost = False
            self.resyncs += 1
        sample = self.sample(frame, stamp_ns)
        if sample is None:
            self.nonfinite += 1
            return
        self.frames += 1
        samples.append(sample)

    def _drop(self, count: int) -> None:
        self.garbage_bytes += count
        self._lost = True

    def _next_header(self, buffer: bytes, position: int) -> int:
        """Drop up to the next header, or the part of one at the end; return its position."""
        header = buffer.find(self._header, position)
        if header < 0:
            header = self._partial_header(buffer)
        self._drop(header - position)
        return header

    def _partial_header(self, buffer: bytes) -> int:
        """Return the position of an incomplete header at the end, else the end."""
        for length in range(len(self._header) - 1, 0, -1):
            if buffer.endswith(self._header[:length]):
                return len(buffer) - length
        return len(buffer)

    def _trim(self, buffer: bytes, position: int) -> int:
        """Drop what cannot begin a frame, so that garbage is counted at once."""
        rest = buffer[position : position + len(self._header)]
        if not rest or self._header.startswith(rest):
            return position
        return self._next_header(buffer, position)


class WrenchHost(ABC):
    """Host's side of a start-up dialogue, without I/O; afterwards it passes the stream through.

    Call :meth:`begin` once, then :meth:`feed` with everything received and :meth:`on_time`
    regularly. The sensor may be booting, streaming, or within another dialogue.

    Attributes:
        running: the device streams, as requested or without answering.
        failure: why the dialogue has failed, or None.
    """

    __slots__ = (
        "_attempts",
        "_deadline_ns",
        "_decoder",
        "_own_stream",
        "_tail",
        "_timeout_ns",
        "failure",
        "running",
    )

    def __init__(self, decoder: Callable[[], WrenchDecoder], timeout_ns: int) -> None:
        """Begin before the first request.

        Args:
            decoder: of the device's own stream.
            timeout_ns: without an answer for so long the dialogue starts again [ns].
        """
        self._decoder, self._timeout_ns = decoder, timeout_ns
        self._own_stream = decoder()
        self._tail = b""
        self._attempts = 0
        self._deadline_ns = 0
        self.running = False
        self.failure: str | None = None

    def begin(self, now_ns: int) -> HostOutput:
        """Start the dialogue, whatever the device does."""
        self.running, self.failure = False, None
        self._attempts = 0
        return self._restart(now_ns)

    @abstractmethod
    def feed(self, data: bytes, now_ns: int) -> HostOutput:
        """Process what the port received: answers and an old stream, later the stream."""

    def on_time(self, now_ns: int) -> HostOutput:
        """Begin again when an answer is overdue; fail after ``MAX_ATTEMPTS``."""
        if self.running or self.failure is not None or now_ns < self._deadline_ns:
            return HostOutput()
        if self._attempts >= MAX_ATTEMPTS:
            self.failure = f"{self._unanswered()} after {self._attempts} attempts"
            return HostOutput()
        return self._restart(now_ns)

    @abstractmethod
    def _request(self) -> bytes:
        """Return the first request of a dialogue that begins."""

    @abstractmethod
    def _unanswered(self) -> str:
        """Return which answer is overdue."""

    def _restart(self, now_ns: int) -> HostOutput:
        self._tail = b""
        self._own_stream = self._decoder()
        self._attempts += 1
        self._deadline_ns = now_ns + self._timeout_ns
        return HostOutput(send=self._request())

    def _streams_unasked(self, data: bytes, now_ns: int) -> bool:
        """Return whether requests stay unanswered while good frames come."""
        self._own_stream.feed(data, now_ns)
        return self._attempts >= SILENT_ATTEMPTS and self._own_stream.frames >= SILENT_FRAMES
