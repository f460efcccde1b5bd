"""Distance sensor: CAN frames by a DBC, both directions.

Invariants:
    A frame gives a sample, ``None`` (another device's frame) or a ``DistanceError``.
    The DBC has the bits, the factor, the range and the cycle time; no device is in the code.
    A frame that is too short, out of the DBC's range or not finite is refused with its bytes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from operator import or_
from pathlib import Path
from typing import TYPE_CHECKING, cast

from linemate.protocol.errors import ProtocolError
from linemate.protocol.sensors import distance_bits
from linemate.protocol.sensors.distance_bits import Bits
from linemate.protocol.stamped_samples import DistanceSample

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal

# TF03, TF02 and CIA406_TPDO1 (node 3).
SHIPPED_DBC = Path(__file__).parents[1] / "data" / "distance.dbc"

MAX_FRAME_BYTES = 64  # of CAN FD

_METRES_PER_UNIT = {"m": 1.0, "": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6}


class DistanceError(ProtocolError):
    """A frame or a DBC that is refused.

    Attributes:
        can_id: identifier of the frame, None for an error of the DBC.
    """

    def __init__(self, what: str, can_id: int | None = None, data: bytes = b"") -> None:
        where = "" if can_id is None else f" (id 0x{can_id:X}, data {data[:16].hex(' ') or '-'})"
        super().__init__(f"distance: {what}{where}")
        self.can_id = can_id
        self.data = data


@dataclass(frozen=True, slots=True)
class _Scale:
    """Conversion of one signal from counts: ``(count * factor + offset) * unit``.

    ``low`` and ``high`` bound the value in the DBC's unit, ``rounding`` is added at both ends.
    """

    name: str
    factor: float
    offset: float
    unit: float
    low: float
    high: float
    rounding: float

    def value(self, count: float) -> float:
        """Return the physical value in the DBC's unit."""
        return count * self.factor + self.offset

    def count(self, value: float) -> float:
        """Return the counts of a value in the DBC's unit, not rounded."""
        return (value - self.offset) / self.factor

    def is_in_range(self, value: float) -> bool:
        """Whether a value in the DBC's unit is finite and in the DBC's range."""
        return self.low - self.rounding < value < self.high + self.rounding


@dataclass(frozen=True, slots=True)
class _Layout:
    """One message of a DBC with its distance and strength signals.

    Attributes:
        plain: places of both signals if they are whole numbers without multiplexer, else None.
    """

    message: Message
    can_id: int
    extended: bool
    length: int
    position: _Scale
    strength: _Scale | None
    plain: dict[str, Bits] | None


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
    """Parse a DBC once; both ends and each run of a campaign read the same one."""
    import cantools  # A tenth of a start, for a station with a distance sensor alone.

    return cast("Database", cantools.database.load_string(text, database_format="dbc"))


def message_names(dbc: str | Path) -> tuple[str, ...]:
    """Return the names of a DBC's messages.

    Args:
        dbc: text of the DBC, or path of its file.

    Raises:
        DistanceError: it cannot be read.
    """
    return tuple(message.name for message in _load(dbc).messages)


def _scale(signal: Signal, step: float | None, unit: float) -> _Scale:
    """Return the conversion of a signal; ``step`` [m] replaces the DBC's factor, not its sign."""
    factor = float(signal.scale)
    if step is not None:
        factor = math.copysign(step / unit, factor)
    if not math.isfinite(factor) or factor == 0.0:
        raise DistanceError(f"signal {signal.name}: a count is worth {factor!r}")
    return _Scale(
        name=signal.name,
        factor=factor,
        offset=float(signal.offset),
        unit=unit,
        low=-math.inf if signal.minimum is None else float(signal.minimum),
        high=math.inf if signal.maximum is None else float(signal.maximum),
        rounding=abs(factor) * 1e-6,
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
    """Resolve the names once, so that a frame needs no look-up."""
    described = _find_message(_load(dbc), message)
    position = _find_signal(described, signal)
    unit = _METRES_PER_UNIT.get(position.unit or "")
    if unit is None:
        raise DistanceError(f"signal {signal} is in {position.unit!r}, not in a unit of length")
    if strength is None and any(s.name == "Strength" for s in described.signals):
        strength = "Strength"
    names = [signal] if strength is None else [signal, strength]
    return _Layout(
        message=described,
        can_id=described.frame_id if can_id is None else can_id,
        extended=described.is_extended_frame,
        length=described.length,
        position=_scale(position, step, unit),
        strength=None if strength is None else _scale(_find_signal(described, strength), None, 1.0),
        plain=distance_bits.find(described, names),
    )


class DistanceDecoder:
    """Turns CAN frames into distance samples.

    Args:
        dbc: text of the DBC, or path of its file.
        message: name of the message in the DBC.
        strength: name of the signal strength's signal, by default ``Strength`` if there is one.
        can_id: identifier instead of the DBC's, e.g. 0x180 + node.
        step: one count [m] instead of the DBC's factor, e.g. as set by object 6501h.

    Attributes:
        extended: the identifier has 29 bits.
        period_s: cycle time by the DBC's GenMsgCycleTime [s], None without.
        step_m: size of one count, the given one or that of the DBC [m].

    Raises:
        DistanceError: the DBC cannot be read or lacks a name.
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
        self._layout = layout = _layout(dbc, message, signal, strength, can_id, step)
        self._position = layout.position
        self.step_m = abs(layout.position.factor * layout.position.unit)
        self._decode = layout.message.decode
        self.can_id = layout.can_id
        self.extended = layout.extended
        cycle_ms = layout.message.cycle_time
        self.period_s = cycle_ms * 1e-3 if cycle_ms else None

    def decode(
        self, can_id: int, data: bytes, stamp_ns: int, extended: bool = False
    ) -> DistanceSample | None:
        """Return the sample of a frame that arrived at ``stamp_ns``.

        None for another identifier, and for a multiplexed message without the signal.

        Args:
            extended: the identifier has 29 bits.

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
        if not scale.is_in_range(value):
            raise DistanceError(
                f"{scale.name} = {value:g}, outside {scale.low:g}..{scale.high:g}", can_id, data
            )
        return DistanceSample(stamp_ns, value * scale.unit, self._strength(counts, data))

    def _counts(self, data: bytes) -> dict[str, float]:
        """Return the counts of the signals in a frame."""
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
    """Return the multiplexers' values with which a frame carries a signal."""
    selectors: dict[str, float] = {}
    signal = _find_signal(message, name)
    while signal.multiplexer_signal and signal.multiplexer_ids:
        selectors[signal.multiplexer_signal] = signal.multiplexer_ids[0]
        signal = _find_signal(message, signal.multiplexer_signal)
    return selectors


def _packed(plain: dict[str, Bits], counts: dict[str, float]) -> bytes | None:
    """Return a frame with these counts and zeros, None if a count does not fit."""
    frame = b""
    for name, bits in plain.items():
        count = int(counts[name])
        if not bits.fits(count):
            return None
        part = bits.packed(count)
        frame = bytes(map(or_, frame, part)) if frame else part
    return frame


class DistanceEncoder:
    """Turns a distance into the sensor's frame; arguments as of the decoder."""

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
        self._layout = _layout(dbc, message, signal, strength, can_id, step)
        self._blank: dict[str, float] = {s.name: 0 for s in self._layout.message.signals}
        self._blank.update(_selectors(self._layout.message, signal))
        self._floats = {s.name for s in self._layout.message.signals if s.is_float}
        self.can_id = self._layout.can_id
        self.extended = self._layout.extended

    def encode(self, position: float, strength: float | None = None) -> tuple[int, bytes]:
        """Return identifier and payload for a distance [m], rounded to the nearest count.

        Args:
            strength: signal strength, ignored if the message has none.

        Raises:
            DistanceError: the value does not fit the signal or is out of the DBC's range.
        """
        layout = self._layout
        given = {layout.position.name: self._count(layout.position, position)}
        if layout.strength is not None:
            given[layout.strength.name] = self._count(layout.strength, strength or 0.0)
        if layout.plain is not None:
            data = _packed(layout.plain, given)
            if data is not None:
                return layout.can_id, data
        counts = {**self._blank, **given}
        try:
            return layout.can_id, bytes(layout.message.encode(counts, scaling=False, strict=False))
        except Exception as error:
            raise DistanceError(f"{position!r} m does not fit the frame: {error}") from error

    def _count(self, scale: _Scale, value: float) -> float:
        physical = value / scale.unit
        if not scale.is_in_range(physical):
            raise DistanceError(
                f"{scale.name} = {physical:g}, outside {scale.low:g}..{scale.high:g}"
            )
        count = scale.count(physical)
        return count if scale.name in self._floats else round(count)
