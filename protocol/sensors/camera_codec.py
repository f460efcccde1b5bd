"""Camera poses: one msgpack map in each datagram, both directions.

Invariants:
    A datagram gives one message or a ``CameraError``.
    Unknown keys are ignored, so that senders can add some. Known ones are typed, bounded, finite.
    ``CameraDecoder`` judges what one message alone does not show: gaps, old messages, the
    sender's clock.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Literal

import msgpack
import msgspec
from msgspec import Meta

from linemate.protocol.errors import ProtocolError
from linemate.protocol.sensors.clock_offset import ClockOffset
from linemate.protocol.stamped_samples import CameraSample, Quaternion

MAX_DATAGRAM_BYTES = 1199  # no network fragments it

QUATERNION_TOLERANCE = 1e-3
_DIAGONAL = (0, 6, 11, 15, 18, 20)

_Name = Annotated[str, Meta(min_length=1, max_length=64)]
_Counter = Annotated[int, Meta(ge=0)]
_Covariance = Annotated[tuple[float, ...], Meta(min_length=21, max_length=21)]


class CameraError(ProtocolError):
    """A datagram that is refused.

    Attributes:
        reason: name of its counter, one of ``REFUSALS``.
    """

    def __init__(self, reason: str, what: str, data: bytes = b"") -> None:
        super().__init__(f"camera: {what} ({len(data)} bytes: {data[:16].hex(' ') or '-'})")
        self.reason = reason
        self.data = data


# Reasons of refusal, and the names of their counters.
REFUSALS = (
    "malformed",
    "unexpected",
    "too_many_sources",
    "duplicates",
    "reordered",
    "clock_jumps",
    "stale",
)


class CameraMessage(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """Message with the wire's names: position ``p`` [m], unit quaternion ``q`` (w first).

    Attributes:
        seq: +1 for each message.
        t_exp: middle of the exposure on the sender's clock [ns].
        t_tx: time of sending on the sender's clock [ns].
        cov: upper triangle row by row, order x y z rx ry rz [m, rad], or None.
        reset: +1 when the tracker restarts.
    """

    v: Literal[1]
    src: _Name
    seq: _Counter
    t_exp: int
    t_tx: int
    frame: _Name
    obj: _Name
    p: tuple[float, float, float]
    q: tuple[float, float, float, float]
    cov: _Covariance | None = None
    quality: Annotated[int, Meta(ge=-1, le=100)] = -1
    reset: _Counter = 0


_decoder = msgspec.msgpack.Decoder(CameraMessage)
_OPTIONAL = {"cov": None, "quality": -1, "reset": 0}


def encode(message: CameraMessage) -> bytes:
    """Return the datagram of a message; optional fields with their default are left out.

    Values are not checked, so that tests can send wrong ones.

    Raises:
        CameraError: a value msgpack cannot carry, or 1200 bytes and more.
    """
    fields = msgspec.structs.asdict(message)
    for name, default in _OPTIONAL.items():
        if fields[name] == default:
            del fields[name]
    try:
        data: bytes = msgpack.packb(fields)
    except (TypeError, ValueError, OverflowError) as error:
        raise CameraError("malformed", f"cannot be encoded: {error}") from error
    if len(data) > MAX_DATAGRAM_BYTES:
        raise CameraError("malformed", f"over {MAX_DATAGRAM_BYTES} bytes", data)
    return data


def decode(data: bytes) -> CameraMessage:
    """Return the message of a datagram.

    Raises:
        CameraError: not a message of version 1, or a value that is not finite or out of bounds.
    """
    if len(data) > MAX_DATAGRAM_BYTES:
        raise CameraError("malformed", f"over {MAX_DATAGRAM_BYTES} bytes", data)
    try:
        message = _decoder.decode(data)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise CameraError("malformed", str(error), data) from error
    x, y, z = message.p
    if not math.isfinite(x + y + z) and not _all_finite(message.p):
        raise CameraError("malformed", f"position {message.p} is not finite", data)
    w, i, j, k = message.q
    if not abs(math.sqrt(w * w + i * i + j * j + k * k) - 1.0) <= QUATERNION_TOLERANCE:
        raise CameraError("malformed", f"{message.q} is no unit quaternion", data)
    if message.cov is not None:
        _check_covariance(message.cov, data)
    return message


def _all_finite(values: Sequence[float]) -> bool:
    return all(map(math.isfinite, values))


def _check_covariance(cov: tuple[float, ...], data: bytes) -> None:
    if not math.isfinite(sum(cov)) and not _all_finite(cov):
        raise CameraError("malformed", "covariance is not finite", data)
    if not all(cov[index] > 0.0 for index in _DIAGONAL):
        raise CameraError("malformed", "covariance has a variance that is not positive", data)


class _Source:
    """State of one camera."""

    __slots__ = (
        "arrival_ns",
        "backs",
        "candidate",
        "candidates",
        "clock",
        "jumps",
        "reset",
        "seq",
        "t_tx",
    )

    def __init__(self, window_s: float) -> None:
        self.clock = ClockOffset(window_s)
        self.seq = -1
        self.reset = 0
        self.t_tx = 0
        self.arrival_ns = 0
        self.candidate = -1
        self.candidates = 0
        self.jumps = 0
        self.backs = 0


MAX_GAP = 1_000  # lost messages that one gap counts at most
RESTART_MESSAGES = 3  # consecutive messages that prove a restart of the sender
RESTART_SILENCE_NS = 1_000_000_000  # after it, older numbers are no delayed messages


class CameraDecoder:
    """Turns datagrams into samples with local stamps; keeps a state for each camera.

    The exposure on the local clock is ``t_exp + offset``, at most the arrival. The offset is the
    smallest ``arrival - t_tx`` of the last ``window_s``.

    An older or equal sequence number is refused unless ``reset`` has risen. After
    ``RESTART_MESSAGES`` consecutive older numbers, sent later than the accepted ones or after a
    silence, the sender has restarted.

    Args:
        frame: the only frame accepted, None for any.
        obj: the only object accepted. None for any, one at a time: another one counts after the
            first has not been seen for ``RESTART_SILENCE_NS``.
        src: the only camera accepted, None for any.
        window_s: time over which the smallest transit is kept [s].
        max_age_s: oldest exposure accepted [s].
        max_sources: cameras kept at once; one that is silent for ``window_s`` is dropped.

    Attributes:
        gaps: places where sequence numbers are missing.
        lost: missing numbers, at most ``MAX_GAP`` for each gap.
        restarts: restarts of a sender without a rise of ``reset``.
        clamped: exposures after their arrival, set to it.
        refused: refusals by reason, one of ``REFUSALS``.
    """

    def __init__(
        self,
        frame: str | None = None,
        obj: str | None = None,
        src: str | None = None,
        *,
        window_s: float = 30.0,
        max_age_s: float = 1.0,
        max_sources: int = 8,
    ) -> None:
        self._expected = (frame, obj, src)
        self._window_s = window_s
        self._max_age_ns = round(max_age_s * 1e9)
        self._max_sources = max_sources
        self._sources: dict[str, _Source] = {}
        self._seen = ("", 0)
        self.accepted = 0
        self.gaps = 0
        self.lost = 0
        self.resets = 0
        self.restarts = 0
        self.clamped = 0
        self.refused = dict.fromkeys(REFUSALS, 0)

    def feed(self, data: bytes, stamp_ns: int) -> CameraSample:
        """Return the sample of a datagram that arrived at ``stamp_ns``.

        Raises:
            CameraError: the datagram is refused; it is counted by its reason.
        """
        try:
            message = decode(data)
            self._check_expected(message, data)
            self._check_seen(message.obj, stamp_ns, data)
            source = self._source(message.src, stamp_ns, data)
            offset_ns = self._follow(source, message, stamp_ns, data)
            exposure_ns = self._exposure(message.t_exp + offset_ns, stamp_ns, data)
        except CameraError as error:
            self.refused[error.reason] += 1
            raise
        self.accepted += 1
        self._seen = message.obj, stamp_ns
        return CameraSample(
            stamp_ns,
            exposure_ns,
            message.src,
            message.frame,
            message.obj,
            message.seq,
            message.p,
            _unit(message.q),
            message.cov,
            message.quality,
            message.reset,
        )

    def counters(self) -> dict[str, int]:
        """Return all counters by name, for a status."""
        return {
            "accepted": self.accepted,
            "gaps": self.gaps,
            "lost": self.lost,
            "resets": self.resets,
            "restarts": self.restarts,
            "clamped": self.clamped,
            **self.refused,
        }

    def offset_ns(self, src: str) -> int | None:
        """Return the offset of a camera's clock, local minus sender's [ns]; None if unknown."""
        source = self._sources.get(src)
        return None if source is None else source.clock.offset_ns

    def _check_expected(self, message: CameraMessage, data: bytes) -> None:
        received = (message.frame, message.obj, message.src)
        for expected, name in zip(self._expected, received, strict=True):
            if expected is not None and expected != name:
                raise CameraError("unexpected", f"{name!r} instead of {expected!r}", data)

    def _check_seen(self, obj: str, stamp_ns: int, data: bytes) -> None:
        """Refuse a second object in view: poses of two would be taken for one that jumps."""
        seen, seen_ns = self._seen
        if obj != seen and seen and stamp_ns - seen_ns < RESTART_SILENCE_NS:
            raise CameraError("unexpected", f"{obj!r} next to {seen!r}", data)

    def _source(self, src: str, stamp_ns: int, data: bytes) -> _Source:
        source = self._sources.get(src)
        if source is not None:
            return source
        if len(self._sources) >= self._max_sources:
            self._forget_silent(stamp_ns, data)
        source = self._sources[src] = _Source(self._window_s)
        return source

    def _forget_silent(self, stamp_ns: int, data: bytes) -> None:
        oldest = min(self._sources, key=lambda src: self._sources[src].arrival_ns)
        silence_ns = stamp_ns - self._sources[oldest].arrival_ns
        if silence_ns < self._window_s * 1e9:
            what = f"more than {self._max_sources} cameras"
            raise CameraError("too_many_sources", what, data)
        del self._sources[oldest]

    def _follow(self, source: _Source, message: CameraMessage, stamp_ns: int, data: bytes) -> int:
        """Update a camera's state with a message; return the offset of its clock [ns]."""
        if message.seq <= source.seq:
            self._go_back(source, message, stamp_ns, data)
        elif source.seq >= 0 and message.reset > source.reset:
            self.resets += 1
            _restart(source, message)
        offset_ns = self._offset(source, message, stamp_ns, data)
        if source.seq >= 0 and message.seq > source.seq + 1:
            self.gaps += 1
            self.lost += min(message.seq - source.seq - 1, MAX_GAP)
        source.seq, source.reset = message.seq, message.reset
        if not source.backs:
            source.t_tx = message.t_tx
        source.arrival_ns = stamp_ns
        source.candidates = 0
        return offset_ns

    def _go_back(self, source: _Source, message: CameraMessage, stamp_ns: int, data: bytes) -> None:
        """Judge an older or equal number: a restart of tracker or sender, else refused."""
        if message.reset > source.reset:
            self.resets += 1
            _restart(source, message)
            return
        if message.seq == source.seq and message.t_tx == source.t_tx:
            raise CameraError("duplicates", f"sequence {message.seq} again", data)
        in_row = message.seq == source.candidate + 1
        source.candidates = source.candidates + 1 if in_row and source.candidates else 1
        source.candidate = message.seq
        silent = stamp_ns - source.arrival_ns >= RESTART_SILENCE_NS
        if source.candidates >= RESTART_MESSAGES and (message.t_tx > source.t_tx or silent):
            self.restarts += 1
            _restart(source, message)
            return
        reason = "duplicates" if message.seq == source.seq else "reordered"
        raise CameraError(reason, f"sequence {message.seq} after {source.seq}", data)

    def _offset(self, source: _Source, message: CameraMessage, stamp_ns: int, data: bytes) -> int:
        """Update the offset; a transit far below all others must be confirmed by further ones.

        Otherwise one datagram with a wrong ``t_tx`` falsifies the minimum for a whole window.
        """
        transit_ns = stamp_ns - message.t_tx
        known = source.clock.offset_ns
        if known is not None and transit_ns < known - self._max_age_ns:
            source.jumps += 1
            if source.jumps < RESTART_MESSAGES:
                what = f"clock {(known - transit_ns) / 1e9:.3f} s ahead of itself"
                raise CameraError("clock_jumps", what, data)
            source.clock.clear()
        source.jumps = 0
        self._notice_clock_set_back(source, message)
        return source.clock.learn(transit_ns, stamp_ns)

    def _notice_clock_set_back(self, source: _Source, message: CameraMessage) -> None:
        """Drop the offset of a clock that was set back: its exposures would all be stale.

        No delay makes a later message an earlier one: it has a later number and was sent earlier.
        The newest message before that is kept as what the next ones are compared with.
        """
        if source.seq < 0 or message.t_tx >= source.t_tx - self._max_age_ns:
            source.backs = 0
            return
        source.backs += 1
        if source.backs >= RESTART_MESSAGES:
            source.backs = 0
            source.clock.clear()

    def _exposure(self, exposure_ns: int, stamp_ns: int, data: bytes) -> int:
        age_ns = stamp_ns - exposure_ns
        if age_ns < 0:
            self.clamped += 1
            return stamp_ns
        if age_ns > self._max_age_ns:
            raise CameraError("stale", f"exposed {age_ns / 1e9:.3f} s ago", data)
        return exposure_ns


def _restart(source: _Source, message: CameraMessage) -> None:
    """Drop the sequence, and the clock's offset if the sender's clock went back."""
    if message.t_tx < source.t_tx:
        source.clock.clear()
    source.seq = -1
    source.jumps = 0


def _unit(q: Quaternion) -> Quaternion:
    w, x, y, z = q
    scale = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    return (w * scale, x * scale, y * scale, z * scale)
