"""Telegram bytes to values, and the telegram that is expected next.

Invariants:
- The fast reader is a pattern of the shape last seen: literal except for the values.
- What the pattern does not match is read by the tolerant reader, which decides.
- What the pattern matches, the tolerant reader accepts with the same result.
- Too long a telegram and ``<!`` are refused before either.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from operator import itemgetter, mul
from typing import cast

from linemate.protocol.rsi.telegram import Channel, RobotTelegram, SensorTelegram
from linemate.protocol.rsi.telegram_layout import Field, Layout, Vector
from linemate.protocol.rsi.xml_scan import BLANK, FlatDocument, RsiError, Span, scan, unescape
from linemate.protocol.stamped_samples import Vector6

MAX_TELEGRAM_BYTES = 2048
MAX_IPOC = 2**64 - 1
LONG_MIN, LONG_MAX = -(2**31), 2**32 - 1

# Telegrams of another shape before a pattern is made for it, doubled each time. Compiling a pattern
# takes 1 to 2 ms: a sender that alternates shapes must not cause that each time.
_FIRST_RELEARN = 3
_LAST_RELEARN = 4096

_NUMBER = re.compile(
    r"[+-]?(?:[0-9]{1,16}(?:\.[0-9]{0,32})?|\.[0-9]{1,32})(?:[eE][+-]?[0-9]{1,3})?", re.ASCII
)
MAX_NUMBER = 1e16  # as many digits as a number without exponent may have
_WHOLE = re.compile(r"([+-]?[0-9]{1,10})(?:\.0{0,32})?", re.ASCII)
_IPOC = re.compile(r"[0-9]{1,20}", re.ASCII)
_COUNTER = re.compile(rb"<IPOC>\s*([0-9]{1,20})\s*</IPOC>")
_TRUTHS = {"TRUE": "1", "FALSE": "0"}
_TRAILING = "\0" + BLANK

# Short enough to be in range whatever the digits; the tolerant reader reads what is longer.
# Possessive, because no value is followed by its own characters: it takes a fifth of the time.
# Groups themselves are not possessive, see ``xml_scan``.
_FAST_GROUPS = {
    "DOUBLE": r"(-?+[0-9]{1,16}+(?:\.[0-9]{0,32}+)?(?:[eE]-[0-9]{1,3}+)?)",
    "BOOL": r"(-?+[0-9]{1,16}+(?:\.[0-9]{0,32}+)?)",
    "LONG": r"(-?+[0-9]{1,9}+)(?:\.0{0,32}+)?",
    "STRING": r"([^\"'<>&]*+)",
}
_FAST_IPOC = r"([0-9]{1,19}+)"
_FAST_UNKNOWN = r"[^\"'<>&]*+"

# Texts of the values in the order of ``Layout.fields``, then the IPOC's; None for an absent one.
Texts = Sequence[bytes | None]

_Key = tuple[str, str | None]
_IPOC_KEY: _Key = ("IPOC", None)


class ExpectedTelegram:
    """Accepts one counter, one Delay and a range for each joint.

    Invariants:
        It is made before the telegram comes. One match and eight comparisons are left.
        What it accepts, ``RsiCodec.parse_robot`` accepts too.

    Attributes:
        matched: the datagram that was compared last, and its match.
    """

    __slots__ = ("_groups", "_high", "_low", "_match", "_texts", "matched")

    def __init__(
        self,
        match: Callable[[bytes], re.Match[bytes] | None],
        groups: Sequence[int],
        texts: Sequence[bytes],
        low: Sequence[float],
        high: Sequence[float],
    ) -> None:
        """Keep the expected values.

        Args:
            match: matches a whole telegram in the shape last seen.
            groups: numbers of the joints' groups, then those of ``texts``.
            texts: Delay if there is one, and IPOC, as they must stand in the telegram.
            low: open lower bound of each joint, in the unit of the wire [deg].
            high: the upper bounds [deg].
        """
        self.matched: tuple[bytes | None, re.Match[bytes] | None] = None, None
        self._match = match
        self._groups = tuple(groups)
        self._texts = list(texts)
        self._low = tuple(low)
        self._high = tuple(high)

    def matches(self, data: bytes) -> bool:
        """Return whether a datagram is the telegram."""
        match = self._match(data)
        self.matched = data, match
        # A datagram as long as the buffer may be incomplete.
        if match is None or len(data) >= MAX_TELEGRAM_BYTES:
            return False
        a, b, c, d, e, f, *texts = match.group(*self._groups)
        if texts != self._texts:
            return False
        low, high = self._low, self._high
        # Unrolled: a loop costs a microsecond of the turn-around.
        return (
            low[0] < float(a) < high[0]
            and low[1] < float(b) < high[1]
            and low[2] < float(c) < high[2]
            and low[3] < float(d) < high[3]
            and low[4] < float(e) < high[4]
            and low[5] < float(f) < high[5]
        )


class TelegramReader:
    """Reads the telegrams of one direction.

    Attributes:
        fast: telegrams that the pattern has read.
        tolerant: telegrams, good or bad, that the tolerant reader has read.
    """

    def __init__(self, layout: Layout, example: str) -> None:
        """Learn the shape of ``example``, a telegram as the codec writes it."""
        self._layout = layout
        self._positions: dict[_Key, int] = {
            (field.element, field.attribute): n for n, field in enumerate(layout.fields)
        }
        self._positions[_IPOC_KEY] = len(layout.fields)
        self._vectors = _Vectors(layout.vectors)
        self._relearn_after = _FIRST_RELEARN
        self._mismatches = 0
        self.fast = 0
        self.tolerant = 0
        self._learn(example, scan(example))

    def read(self, data: bytes) -> tuple[Texts, str]:
        """Return the texts of the values, the last of them the IPOC's, and the root's Type.

        Raises:
            RsiError: not a telegram of this layout.
        """
        if len(data) > MAX_TELEGRAM_BYTES:
            raise RsiError(f"{len(data)} bytes, at most {MAX_TELEGRAM_BYTES}", evidence=data)
        if b"<!" in data:
            raise RsiError("document types and entities are refused", evidence=data)
        # The comparison before the reply has matched it already.
        compared, match = (None, None) if self._next is None else self._next.matched
        if compared is not data:
            match = self._pattern.fullmatch(data)
        if match is None:
            return self._read_tolerantly(data)
        self.fast += 1
        self._mismatches = 0
        groups = match.groups()
        return (groups if self._order is None else self._order(groups)), self._type

    def _groups_of(self, fields: tuple[int, ...]) -> tuple[int, ...]:
        """Return the pattern's groups of positions in ``Layout.fields``, then the IPOC's."""
        groups = self._groups.get(fields)
        if groups is None:
            whole = (*fields, len(self._layout.fields))
            groups = self._groups[fields] = tuple([1 + self._seen.index(n) for n in whole])
        return groups

    def _read_tolerantly(self, data: bytes) -> tuple[Texts, str]:
        self.tolerant += 1
        text = data.decode("latin-1").rstrip(_TRAILING)
        try:
            document = scan(text)
            texts = self._texts(text, document)
        except RsiError as error:
            error.evidence = error.evidence or data[:256]
            error.ipoc_text = error.ipoc_text or _counter(data)
            raise
        self._mismatches += 1
        if self._mismatches >= self._relearn_after and _is_plain(document) and None not in texts:
            self._relearn_after = min(2 * self._relearn_after, _LAST_RELEARN)
            self._learn(text, document)
        return texts, _type_of(document)

    def _texts(self, text: str, document: FlatDocument) -> Texts:
        if document.root.lower() != self._layout.root.lower():
            raise RsiError(f"root is <{document.root[:32]}>, not <{self._layout.root}>")
        values = self._values(text, document)
        ipoc = values.get(_IPOC_KEY, "").strip(BLANK)
        if not _IPOC.fullmatch(ipoc) or int(ipoc) > MAX_IPOC:
            raise RsiError("missing, not digits or out of range", element="IPOC")
        texts: list[bytes | None] = []
        try:
            texts.extend(self._text(field, values) for field in self._layout.fields)
            self._refuse_parts(texts)
        except RsiError as error:
            error.ipoc_text = ipoc.encode("ascii")
            raise
        return (*texts, ipoc.encode("ascii"))

    def _values(self, text: str, document: FlatDocument) -> dict[_Key, str]:
        """Return the texts of the configured values as written."""
        values: dict[_Key, str] = {
            (name, None): "" for name in document.hollow if (name, None) in self._positions
        }
        for span in document.spans:
            key = (span.element, span.attribute)
            if key in self._positions:
                if key in values:
                    raise RsiError("stands twice in the telegram", element=_name(span))
                values[key] = text[span.start : span.end]
        return values

    def _text(self, field: Field, values: dict[_Key, str]) -> bytes | None:
        raw = values.get((field.element, field.attribute))
        if raw is not None:
            return _checked(field, raw).encode("latin-1")
        if self._layout.required:
            raise RsiError("missing", element=field.key)
        return None

    def _refuse_parts(self, texts: Texts) -> None:
        """Refuse a vector that is not complete."""
        for vector in self._layout.vectors:
            missing = [n for n in vector.fields if texts[n] is None]
            if missing and len(missing) < len(vector.fields):
                raise RsiError("missing", element=self._layout.fields[missing[0]].key)

    def _learn(self, text: str, document: FlatDocument) -> None:
        """Make the pattern of an accepted, complete telegram."""
        parts: list[tuple[str, int | None]] = []
        end = 0
        for span in document.spans:
            position = self._positions.get((span.element, span.attribute))
            parts.append((re.escape(text[end : span.start]), position))
            end = span.end
        rest = re.escape(text[end:]) + r"[\0 \t\r\n]*"
        self._seen = [position for _, position in parts if position is not None]
        self._groups: dict[tuple[int, ...], tuple[int, ...]] = {}
        whole = "".join(literal + self._group(position) for literal, position in parts) + rest
        self._pattern = re.compile(whole.encode("latin-1"), re.ASCII)
        self._order = _permutation(self._seen)
        self._type = _type_of(document)
        self._mismatches = 0
        self._next: ExpectedTelegram | None = None

    def _group(self, position: int | None) -> str:
        if position is None:
            return _FAST_UNKNOWN
        if position == len(self._layout.fields):
            return _FAST_IPOC
        return _FAST_GROUPS[self._layout.fields[position].type]


class RobotReader(TelegramReader):
    """Reads the controller's telegrams, and knows how the next one looks."""

    def __init__(self, layout: Layout, example: str) -> None:
        """Learn the shape of ``example``, a telegram as the codec writes it."""
        super().__init__(layout, example)
        whole = (v for v in layout.vectors if v.name == "joints" and len(v.fields) == v.width)
        self._joints = next(whole, None)
        # Of the last expected telegram: a robot at rest has the same ones in each cycle.
        self._bounds: tuple[Vector6 | None, float, tuple[float, ...], tuple[float, ...]]
        self._bounds = None, 0.0, (), ()
        delay = () if layout.delay is None else (layout.delay,)
        self._expected = () if self._joints is None else (*self._joints.fields, *delay)

    def parse(self, data: bytes) -> RobotTelegram:
        """Return the values of a telegram.

        Raises:
            RsiError: not a telegram of this configuration; everything configured must be there.
        """
        texts, _ = self.read(data)
        layout = self._layout
        ipoc, ipoc_text = _ipoc(texts)
        vector = self._vectors.read(texts).get
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

    def expect(
        self, ipoc: int, delay: int | None, joints: Vector6, reach: float
    ) -> ExpectedTelegram | None:
        """Return the telegram to expect next, None without AIPos or with another Delay.

        Args:
            delay: the next Delay, None if none is configured.
            joints: the last measured joints [rad].
            reach: how far from there a joint may be [rad].
        """
        vector, position = self._joints, self._layout.delay
        if vector is None or (delay is None) != (position is None):
            return None
        texts = [b"%d" % ipoc] if delay is None else [b"%d" % delay, b"%d" % ipoc]
        kept, kept_reach, low, high = self._bounds
        if joints is not kept or reach != kept_reach:
            scales = vector.scales
            low = tuple([(q - reach) / scale for q, scale in zip(joints, scales, strict=True)])
            high = tuple([(q + reach) / scale for q, scale in zip(joints, scales, strict=True)])
            self._bounds = joints, reach, low, high
        groups = self._groups_of(self._expected)
        self._next = ExpectedTelegram(self._pattern.fullmatch, groups, texts, low, high)
        return self._next


class SensorReader(TelegramReader):
    """Reads the daemon's replies."""

    def parse(self, data: bytes) -> SensorTelegram:
        """Return the values of a reply; one that it lacks is None, a channel is left out.

        Raises:
            RsiError: not a reply of this configuration, or part of a vector missing.
        """
        texts, sentype = self.read(data)
        layout = self._layout
        ipoc, ipoc_text = _ipoc(texts)
        vector = self._vectors.read(texts).get
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


def _counter(data: bytes) -> bytes | None:
    """Return the IPOC's digits in an unreadable telegram, None unless there is exactly one."""
    counters = _COUNTER.findall(data)
    return counters[0] if len(counters) == 1 and int(counters[0]) <= MAX_IPOC else None


def _permutation(order: list[int]) -> Callable[[tuple[bytes, ...]], tuple[bytes, ...]] | None:
    """Return what reorders groups from wire order to layout order, None if they are equal."""
    if order == sorted(order):
        return None
    return itemgetter(*(order.index(n) for n in range(len(order))))


def _is_plain(document: FlatDocument) -> bool:
    return document.flat and not document.hollow


def _type_of(document: FlatDocument) -> str:
    return next((v for name, v in document.attributes.items() if name.lower() == "type"), "")


def _name(span: Span) -> str:
    return span.element if span.attribute is None else f"{span.element}.{span.attribute}"


def _checked(field: Field, raw: str) -> str:
    """Return the text of one value for float() or int().

    Raises:
        RsiError: a comma, NaN, infinity, out of range, or no number at all.
    """
    if field.type == "STRING":
        return unescape(raw)
    text = raw.strip(BLANK)
    if field.type == "LONG":
        whole = _WHOLE.fullmatch(text)
        if whole is None:
            raise RsiError(f"{text[:32]!r} is no whole number", element=field.key)
        if not LONG_MIN <= int(whole[1]) <= LONG_MAX:
            raise RsiError(f"{text[:32]} is out of range", element=field.key)
        return whole[1]
    if field.type == "BOOL":
        text = _TRUTHS.get(text.upper(), text)
    if not _NUMBER.fullmatch(text):
        raise RsiError(f"{text[:32]!r} is no number", element=field.key)
    if not abs(float(text)) < MAX_NUMBER:
        raise RsiError(f"{text[:32]} is out of range", element=field.key)
    return text


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
