"""Frames out of a serial byte stream: what the force-torque decoders have in common.

Law of this file: a stream never raises. Bytes go in as the port gives them, cut anywhere; whole,
checked, finite samples come out. A frame that fails its CRC costs one byte, then the hunt for
the header goes on inside what was taken for a frame, so no good frame behind garbage is lost.
Between two calls less than one frame is kept; everything dropped is counted.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable

from msgspec import Struct

from linemate.protocol.errors import ProtocolError
from linemate.protocol.samples import WrenchSample


class WrenchError(ProtocolError):
    """A wrench, a device or a setting that the serial wire cannot carry."""


class HostOutput(Struct, frozen=True):
    """What the host's end of a dialogue gives after some bytes or some time.

    Attributes:
        send: bytes for the device.
        stream: bytes that belong to the decoder, once the device runs.
    """

    send: bytes = b""
    stream: bytes = b""


DEAF_ATTEMPTS, DEAF_FRAMES = 3, 5
"""A device that was asked so often, and sent so many good frames instead of an answer to the last,
streams by itself: behind a converter that passes one direction only, or a sender of bare frames."""


class WrenchDecoder(ABC):
    """Finds one device's frames in a byte stream and counts what is not one.

    Attributes:
        frames: good frames given out.
        bad_crc: places that looked like a frame and failed its check.
        nonfinite: frames with a good check that hold NaN or Inf, dropped.
        garbage_bytes: bytes that belong to no good frame.
        resyncs: how often the stream was found again after garbage.
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
        """Start with an empty buffer, in step with the stream.

        Args:
            header: what every frame begins with.
            size: bytes in a frame, header and check included.
            crc: the 16-bit check over :meth:`checked`.
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
        """The part of a frame that its CRC is over."""

    @abstractmethod
    def sample(self, frame: bytes, stamp_ns: int) -> WrenchSample | None:
        """What a checked frame says, None if it is not finite."""

    def feed(self, data: bytes, stamp_ns: int) -> list[WrenchSample]:
        """Take what the port gave, return the samples now complete, in order.

        Args:
            stamp_ns: their arrival [ns]; every sample completed by them carries it.
        """
        buffer = self._buffer + data if self._buffer else data
        samples: list[WrenchSample] = []
        size, end, position = self._size, len(buffer), 0
        header = self._header
        while end - position >= size:
            if not buffer.startswith(header, position):
                position = self._hunt(buffer, position)
                continue
            frame = buffer[position : position + size]
            if not self._is_frame(frame):
                self.bad_crc += 1
                self._drop(1)
                position += 1
                continue
            self._take(frame, stamp_ns, samples)
            position += size
        self._buffer = buffer[self._trim(buffer, position) :] if position < end else b""
        return samples

    def reset(self) -> None:
        """Forget the unfinished frame, as after a port was reopened; counters stay."""
        self._buffer = b""
        self._lost = False

    def counters(self) -> dict[str, int]:
        """The counters by name, for a status."""
        return {
            "frames": self.frames,
            "bad_crc": self.bad_crc,
            "nonfinite": self.nonfinite,
            "garbage_bytes": self.garbage_bytes,
            "resyncs": self.resyncs,
        }

    def _is_frame(self, data: bytes) -> bool:
        """Whether bytes of a frame's length are one."""
        crc = data[-2] | data[-1] << 8
        return data.startswith(self._header) and self._crc(self.checked(data)) == crc

    def _take(self, frame: bytes, stamp_ns: int, samples: list[WrenchSample]) -> None:
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

    def _hunt(self, buffer: bytes, position: int) -> int:
        """Where the next header, or the start of one at the very end, is; drops up to there."""
        found = buffer.find(self._header, position)
        if found < 0:
            found = self._partial_header(buffer)
        self._drop(found - position)
        return found

    def _partial_header(self, buffer: bytes) -> int:
        """Where a header begins whose rest has not come yet; the end if none does."""
        for length in range(len(self._header) - 1, 0, -1):
            if buffer.endswith(self._header[:length]):
                return len(buffer) - length
        return len(buffer)

    def _trim(self, buffer: bytes, position: int) -> int:
        """Drop at once what cannot begin a frame, so that garbage is counted as it comes."""
        rest = buffer[position : position + len(self._header)]
        if not rest or self._header.startswith(rest):
            return position
        return self._hunt(buffer, position)
