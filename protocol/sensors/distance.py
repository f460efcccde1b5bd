"""The distance sensor: CAN frames through a DBC, both directions.

Law of this file: one frame gives one sample, ``None`` (somebody else's frame) or a
``DistanceError``; nothing else. The DBC says where the bits are, what a count is worth, which
range is sane and how often a frame is due; no device is written into the code.
A frame that is too short, out of the DBC's range or not finite is refused with its bytes.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from operator import or_
from pathlib import Path
from typing import cast

import cantools
from cantools.database.can import Database, Message, Signal

from linemate.protocol.errors import ProtocolError
from linemate.protocol.samples import DistanceSample
from linemate.protocol.sensors import distance_bits
from linemate.protocol.sensors.distance_bits import Bits

SHIPPED_DBC = Path(__file__).parents[1] / "data" / "distance.dbc"
"""TF03, TF02 and CIA406_TPDO1 (node 3)."""

MAX_FRAME_BYTES = 64
"""The longest payload any CAN carries (CAN FD)."""

_METRES_PER_UNIT = {"m": 1.0, "": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6}


class DistanceError(ProtocolError):
    """A frame, or the description of a frame, that cannot be used.

    Attributes:
        can_id: identifier of the frame, None where the DBC itself is at fault.
        data: payload of the frame.
    """

    def __init__(self, what: str, can_id: int | None = None, data: bytes = b"") -> None:
        """Keep the evidence and print it."""
        where = "" if can_id is None else f" (id 0x{can_id:X}, data {data[:16].hex(' ') or '-'})"
        super().__init__(f"distance: {what}{where}")
        self.can_id = can_id
        self.data = data


@dataclass(frozen=True, slots=True)
class _Scale:
    """How counts of one signal become a physical value: ``(count * factor + offset) * unit``.

    ``low`` and ``high`` bound the value in the DBC's own unit; ``hair`` keeps rounding from
    refusing the range's own ends.
    """

    name: str
    factor: float
    offset: float
    unit: float
    low: float
    high: float
    hair: float

    def value(self, count: float) -> float:
        """Physical value in the DBC's unit."""
        return count * self.factor + self.offset

    def count(self, value: float) -> float:
        """Counts of a physical value in the DBC's unit, not rounded."""
        return (value - self.offset) / self.factor

    def is_sane(self, value: float) -> bool:
        """Whether a value in the DBC's unit is a finite number inside the DBC's range."""
        return self.low - self.hair < value < self.high + self.hair


@dataclass(frozen=True, slots=True)
class _Layout:
    """One message of a DBC and the two signals of it that matter here."""

    message: Message
    can_id: int
    extended: bool
    length: int
    position: _Scale
    strength: _Scale | None
    plain: dict[str, Bits] | None
    """Where the two lie, if that is simple."""


def _load(dbc: str | Path) -> Database:
    """Read a DBC: a ``Path`` or one line is a file's name, anything longer the text itself."""
    try:
        is_text = isinstance(dbc, str) and "\n" in dbc
        text = str(dbc) if is_text else Path(dbc).read_text(encoding="latin-1")
        return _parsed(text)
    except OSError as error:
        raise DistanceError(f"cannot read the DBC: {error}") from error
    except Exception as error:
        raise DistanceError(f"not a DBC: {error}") from error


@lru_cache(maxsize=8)
def _parsed(text: str) -> Database:
    """Both ends of a wire read one DBC, and a campaign reads it anew for every run."""
    return cast("Database", cantools.database.load_string(text, database_format="dbc"))


def message_names(dbc: str | Path) -> tuple[str, ...]:
    """What a DBC describes.

    Args:
        dbc: the DBC's text, or the path of its file.

    Raises:
        DistanceError: it cannot be read.
    """
    return tuple(message.name for message in _load(dbc).messages)


def _scale(signal: Signal, step: float | None, unit: float) -> _Scale:
    """What a signal's counts are worth; ``step`` [m] replaces the DBC's factor."""
    factor = float(signal.scale) if step is None else step / unit
    if not math.isfinite(factor) or factor == 0.0:
        raise DistanceError(f"signal {signal.name}: a count is worth {factor!r}")
    return _Scale(
        name=signal.name,
        factor=factor,
        offset=float(signal.offset),
        unit=unit,
        low=-math.inf if signal.minimum is None else float(signal.minimum),
        high=math.inf if signal.maximum is None else float(signal.maximum),
        hair=abs(factor) * 1e-6,
    )


def _find_message(database: Database, name: str) -> Message:
    try:
        return database.get_message_by_name(name)
    except KeyError:
        known = ", ".join(sorted(m.name for m in database.messages)) or "none"
        raise DistanceError(f"the DBC has no message {name!r}; it has {known}") from None


def _find_signal(message: Message, name: str) -> Signal:
    for signal in message.signals:
        if signal.name == name:
            return signal
    known = ", ".join(s.name for s in message.signals) or "none"
    raise DistanceError(f"message {message.name} has no signal {name!r}; it has {known}")


def _layout(
    dbc: str | Path,
    message: str,
    signal: str,
    strength: str | None,
    can_id: int | None,
    step: float | None,
) -> _Layout:
    """Resolve names once, so that a frame costs no look-up."""
    found = _find_message(_load(dbc), message)
    position = _find_signal(found, signal)
    unit = _METRES_PER_UNIT.get(position.unit or "")
    if unit is None:
        raise DistanceError(f"signal {signal} is in {position.unit!r}, not in a unit of length")
    if strength is None and any(s.name == "Strength" for s in found.signals):
        strength = "Strength"
    names = [signal] if strength is None else [signal, strength]
    return _Layout(
        message=found,
        can_id=found.frame_id if can_id is None else can_id,
        extended=found.is_extended_frame,
        length=found.length,
        position=_scale(position, step, unit),
        strength=None if strength is None else _scale(_find_signal(found, strength), None, 1.0),
        plain=distance_bits.find(found, names),
    )


class DistanceDecoder:
    """Turns CAN frames into distance samples.

    Args:
        dbc: the DBC's text, or the path of its file.
        message: name of the message in the DBC.
        signal: name of the signal that is the distance.
        strength: name of the signal strength's signal; ``Strength`` is found by itself.
        can_id: identifier instead of the DBC's, e.g. 0x180 + node.
        step: worth of one count [m] instead of the DBC's, e.g. as set by object 6501h.

    Attributes:
        extended: whether it is a 29-bit identifier.
        period_s: cycle time by the DBC's GenMsgCycleTime [s], None if it says nothing.

    Raises:
        DistanceError: the DBC cannot be read or lacks what is named.
    """

    def __init__(
        self,
        dbc: str | Path = SHIPPED_DBC,
        message: str = "CIA406_TPDO1",
        signal: str = "Position",
        *,
        strength: str | None = None,
        can_id: int | None = None,
        step: float | None = None,
    ) -> None:
        """Resolve the names in the DBC."""
        self._layout = layout = _layout(dbc, message, signal, strength, can_id, step)
        self._position = layout.position
        self._decode = layout.message.decode
        self.can_id = layout.can_id
        self.extended = layout.extended
        cycle_ms = layout.message.cycle_time
        self.period_s = cycle_ms * 1e-3 if cycle_ms else None

    def decode(
        self, can_id: int, data: bytes, stamp_ns: int, extended: bool = False
    ) -> DistanceSample | None:
        """One frame's sample, or None if the frame is not this sensor's.

        A multiplexed message that carries other signals this time is not this sensor's either.

        Args:
            can_id: identifier of the frame.
            stamp_ns: arrival [ns].
            extended: whether the identifier has 29 bits.

        Raises:
            DistanceError: short or overlong frame, value out of the DBC's range, not finite.
        """
        if can_id != self.can_id or extended != self.extended:
            return None
        counts = self._counts(data)
        scale = self._position
        count = counts.get(scale.name)
        if count is None:
            return None
        value = scale.value(count)
        if not scale.is_sane(value):
            raise DistanceError(
                f"{scale.name} = {value:g}, outside {scale.low:g}..{scale.high:g}", can_id, data
            )
        return DistanceSample(stamp_ns, value * scale.unit, self._strength(counts, data))

    def _counts(self, data: bytes) -> dict[str, float]:
        """Raw counts of the signals in the frame, the two that matter among them."""
        if not self._layout.length <= len(data) <= MAX_FRAME_BYTES:
            what = f"{len(data)} bytes instead of {self._layout.length}"
            raise DistanceError(what, self.can_id, data)
        if self._layout.plain is not None:
            return {name: bits.read(data) for name, bits in self._layout.plain.items()}
        try:
            counts = self._decode(data, decode_choices=False, scaling=False)
        except Exception as error:
            raise DistanceError(f"cannot be decoded: {error}", self.can_id, data) from error
        return cast("dict[str, float]", counts)

    def _strength(self, counts: dict[str, float], data: bytes) -> float | None:
        scale = self._layout.strength
        if scale is None or scale.name not in counts:
            return None
        value = scale.value(counts[scale.name])
        if not math.isfinite(value):
            raise DistanceError(f"{scale.name} = {value}", self.can_id, data)
        return value


def _selectors(message: Message, name: str) -> dict[str, float]:
    """Values of the multiplexers above a signal, so that the frame carries that signal."""
    selectors: dict[str, float] = {}
    signal = _find_signal(message, name)
    while signal.multiplexer_signal and signal.multiplexer_ids:
        selectors[signal.multiplexer_signal] = signal.multiplexer_ids[0]
        signal = _find_signal(message, signal.multiplexer_signal)
    return selectors


def _packed(plain: dict[str, Bits], counts: dict[str, float]) -> bytes | None:
    """A frame with these counts and zeros; None if one of them is too great for its place."""
    frame = b""
    for name, bits in plain.items():
        count = int(counts[name])
        if not bits.fits(count):
            return None
        one = bits.put(count)
        frame = bytes(map(or_, frame, one)) if frame else one
    return frame


class DistanceEncoder:
    """The other end: turns a distance into the frame a sensor would send.

    The arguments are the decoder's.
    """

    def __init__(
        self,
        dbc: str | Path = SHIPPED_DBC,
        message: str = "CIA406_TPDO1",
        signal: str = "Position",
        *,
        strength: str | None = None,
        can_id: int | None = None,
        step: float | None = None,
    ) -> None:
        """Resolve the names in the DBC."""
        self._layout = _layout(dbc, message, signal, strength, can_id, step)
        self._blank: dict[str, float] = {s.name: 0 for s in self._layout.message.signals}
        self._blank.update(_selectors(self._layout.message, signal))
        self._floats = {s.name for s in self._layout.message.signals if s.is_float}
        self.can_id = self._layout.can_id
        self.extended = self._layout.extended

    def encode(self, position: float, strength: float | None = None) -> tuple[int, bytes]:
        """One frame, rounded to the nearest count.

        Args:
            position: distance [m].
            strength: signal strength; 0 if not given, ignored if the message has none.

        Returns:
            identifier and payload.

        Raises:
            DistanceError: the value does not fit the signal or is out of the DBC's range.
        """
        layout = self._layout
        told = {layout.position.name: self._count(layout.position, position)}
        if layout.strength is not None:
            told[layout.strength.name] = self._count(layout.strength, strength or 0.0)
        if layout.plain is not None:
            data = _packed(layout.plain, told)
            if data is not None:
                return layout.can_id, data
        counts = {**self._blank, **told}
        try:
            return layout.can_id, bytes(layout.message.encode(counts, scaling=False, strict=False))
        except Exception as error:
            raise DistanceError(f"{position!r} m does not fit the frame: {error}") from error

    def _count(self, scale: _Scale, value: float) -> float:
        physical = value / scale.unit
        if not scale.is_sane(physical):
            raise DistanceError(
                f"{scale.name} = {physical:g}, outside {scale.low:g}..{scale.high:g}"
            )
        count = scale.count(physical)
        return count if scale.name in self._floats else round(count)
