"""Write telegrams: one template for each direction, filled by one operation.

Invariants:
    Every configured value is written in the configured order, the IPOC last.
    No exponent, NaN or infinity is written.
    A value that the wire cannot carry is an error, never another value.
"""

import math
from collections.abc import Mapping, Sequence
from operator import attrgetter, truediv

from linemate.protocol.controller_link import PreparedReply
from linemate.protocol.rsi.telegram import Channel, RobotTelegram, SensorTelegram
from linemate.protocol.rsi.telegram_layout import Field, Layout, Vector
from linemate.protocol.rsi.telegram_reader import LONG_MAX, LONG_MIN, MAX_IPOC, MAX_TELEGRAM_BYTES
from linemate.protocol.rsi.xml_scan import RsiError, escape

MAX_IPOC_DIGITS = 20
MAX_MAGNITUDE = 1e12  # in the unit of the wire
MAX_SENDERS = 8  # root types whose template is kept

Telegram = RobotTelegram | SensorTelegram


class TelegramWriter:
    """Writes the telegrams of one direction."""

    def __init__(
        self, layout: Layout, decimals: int, constants: Mapping[str, Channel] | None = None
    ) -> None:
        """Make the template.

        Args:
            decimals: digits after the decimal point.
            constants: values of channels that no telegram has, by key; the others are zero.

        Raises:
            RsiError: a constant that its channel cannot carry.
        """
        self._layout = layout
        self._decimals = decimals
        self._template = _template(layout, decimals)
        self._neutral: list[Channel] = [
            0.0 if f.type == "DOUBLE" else "" if f.type == "STRING" else 0 for f in layout.fields
        ]
        self._constants: dict[int, Channel] = {}
        for key, value in (constants or {}).items():
            self._set_channel(key, value, self._neutral)
            position = layout.channels[key]
            self._constants[position] = self._neutral[position]
        self._vector_names = {vector.name for vector in layout.vectors}
        self._fills = [(attrgetter(v.name), v, _block(v)) for v in layout.vectors]
        self._around: dict[str, tuple[str, str]] = {}

    def write(self, telegram: Telegram, sender: str) -> bytes:
        """Return the telegram's bytes; ``sender`` is the root's Type.

        Raises:
            RsiError: a value missing, unknown, not finite or out of range; too long.
        """
        return self.prepare(telegram, sender).with_counter(_digits(telegram))

    def prepare(self, telegram: Telegram, sender: str) -> PreparedReply:
        """Return the telegram without its IPOC.

        Raises:
            RsiError: as :meth:`write`.
        """
        head, tail = self._around_ipoc(self._values(telegram), sender)
        if len(head) + len(tail) > MAX_TELEGRAM_BYTES - MAX_IPOC_DIGITS:
            raise RsiError(f"{len(head) + len(tail)} bytes, at most {MAX_TELEGRAM_BYTES}")
        return PreparedReply(head.encode("ascii"), tail.encode("ascii"))

    def bare(self, sender: str) -> PreparedReply:
        """Return a telegram of the constants only, without its IPOC."""
        positions = sorted(self._constants)
        fields = tuple(self._layout.fields[n] for n in positions)
        template = _template(
            Layout(self._layout.root, False, fields, (), None, None, {}), self._decimals
        )
        before, after = _root(self._layout.root, sender)
        body = template % tuple(self._constants[n] for n in positions)
        return PreparedReply(f"{before}{body}<IPOC>".encode("ascii"), after.encode("ascii"))

    def example(self, sender: str) -> str:
        """Return a telegram of zeros in the shape that this writer writes."""
        message = self._layout.message
        values = list(self._neutral)
        if message is not None:
            values[message] = _message(self._layout.fields[message], "")
        head, tail = self._around_ipoc(values, sender)
        return f"{head}0{tail}"

    def _around_ipoc(self, values: list[Channel], sender: str) -> tuple[str, str]:
        around = self._around.get(sender)
        if around is None:
            around = self._enclose(sender)
        head, tail = around
        return head % tuple(values), tail

    def _enclose(self, sender: str) -> tuple[str, str]:
        """Return the template within the root, and what follows the IPOC."""
        before, after = _root(self._layout.root, sender)
        around = f"{before.replace('%', '%%')}{self._template}<IPOC>", after
        if len(self._around) < MAX_SENDERS:
            self._around[sender] = around
        return around

    def _values(self, telegram: Telegram) -> list[Channel]:
        values = self._neutral.copy()
        for get, vector, block in self._fills:
            numbers = get(telegram)
            if block is not None and numbers is not None and len(numbers) == len(vector.axes):
                scaled = list(map(truediv, numbers, vector.scales))
                # One comparison for all values; NaN fails it too.
                if not sum(map(abs, scaled)) < MAX_MAGNITUDE:
                    raise RsiError(f"not finite or out of range: {numbers}", element=vector.element)
                values[block] = scaled
            else:
                _fill(vector, numbers, values)
        for key, value in telegram.channels.items():
            self._set_channel(key, value, values)
        if isinstance(telegram, RobotTelegram):
            self._set_delay(telegram, values)
        else:
            self._set_message(telegram, values)
            self._refuse_lost(telegram)
        return values

    def _set_channel(self, key: str, value: Channel, values: list[Channel]) -> None:
        position = self._layout.channels.get(key)
        if position is None:
            raise RsiError("not in the configuration", element=key)
        values[position] = _channel(self._layout.fields[position], value)

    def _set_delay(self, telegram: RobotTelegram, values: list[Channel]) -> None:
        position = self._layout.delay
        if position is None:
            return
        if telegram.delay is None:
            raise RsiError("configured, but not given", element="Delay")
        values[position] = _channel(self._layout.fields[position], telegram.delay)

    def _set_message(self, telegram: SensorTelegram, values: list[Channel]) -> None:
        position = self._layout.message
        if position is not None and telegram.message is not None:
            field = self._layout.fields[position]
            values[position] = _message(field, str(_channel(field, telegram.message)))
        elif telegram.message is not None:
            raise RsiError("not in the configuration", element="EStr")

    def _refuse_lost(self, telegram: SensorTelegram) -> None:
        """Refuse a correction that has no element in the configuration."""
        if "joints" not in self._vector_names and any(telegram.joints or ()):
            raise RsiError("no element for corrections of A1..A6 in the configuration")
        if "external" not in self._vector_names and any(telegram.external or ()):
            raise RsiError("no element for corrections of E1..E6 in the configuration")


def _root(root: str, sender: str) -> tuple[str, str]:
    """Return the root's opening tag, and what follows the IPOC."""
    if not (sender.isascii() and sender.isprintable()):
        raise RsiError(f"{sender!r:.64} is no printable ASCII text", element="Type")
    return f'<{root} Type="{escape(sender)}">', f"</IPOC></{root}>"


def _template(layout: Layout, decimals: int) -> str:
    forms = {"DOUBLE": f"%.{decimals}f", "LONG": "%d", "BOOL": "%d", "STRING": "%s"}
    parts: list[str] = []
    element = ""
    for n, field in enumerate(layout.fields):
        if n == layout.message:
            parts.append("%s")
        elif field.attribute is None:
            parts.append(f"<{field.element}>{forms[field.type]}</{field.element}>")
        else:
            if field.element != element:
                parts.append(f"<{field.element}")
            parts.append(f' {field.attribute}="{forms[field.type]}"')
            following = layout.fields[n + 1].element if n + 1 < len(layout.fields) else ""
            if following != field.element:
                parts.append("/>")
        element = field.element
    return "".join(parts)


def _block(vector: Vector) -> slice | None:
    """Return the place of a vector that is contiguous and starts with the first axis."""
    first, width = vector.fields[0], len(vector.fields)
    whole = vector.axes == tuple(range(width))
    return slice(first, first + width) if whole and vector.contiguous else None


def _fill(vector: Vector, given: Sequence[float] | None, values: list[Channel]) -> None:
    if given is None:
        raise RsiError("configured, but not given", element=vector.element)
    if len(given) <= vector.axes[-1]:
        raise RsiError(f"{len(given)} values are too few", element=vector.element)
    total = 0.0
    for position, axis, scale in zip(vector.fields, vector.axes, vector.scales, strict=True):
        value = given[axis] / scale
        values[position] = value
        total += abs(value)
    # One comparison for all values; NaN fails it too.
    if not total < MAX_MAGNITUDE:
        raise RsiError(f"not finite or out of range: {given}", element=vector.element)
    if len(given) > len(vector.axes):
        unwritten = set(range(len(given))).difference(vector.axes)
        if any(given[axis] for axis in unwritten):
            raise RsiError(f"axes not in the configuration: {given}", element=vector.element)


def _channel(field: Field, value: Channel) -> Channel:
    """Return a channel's value for the template."""
    if field.type == "STRING":
        if isinstance(value, str) and value.isascii() and value.isprintable():
            return escape(value)
        raise RsiError(f"{value!r:.64} is no printable ASCII text", element=field.key)
    if isinstance(value, str):
        raise RsiError(f"{value!r:.64} is no {field.type}", element=field.key)
    if field.type == "DOUBLE":
        if math.isfinite(value) and abs(value) < MAX_MAGNITUDE:
            return float(value)
        raise RsiError(f"{value} is not finite or out of range", element=field.key)
    low, high = (0, 1) if field.type == "BOOL" else (LONG_MIN, LONG_MAX)
    if low <= value <= high and value == int(value):
        return int(value)
    raise RsiError(f"{value} is no {field.type}", element=field.key)


def _message(field: Field, escaped: str) -> str:
    return f"<{field.element}>{escaped}</{field.element}>"


def _digits(telegram: Telegram) -> bytes:
    if not 0 <= telegram.ipoc <= MAX_IPOC:
        raise RsiError(f"{telegram.ipoc} is out of range", element="IPOC")
    text = telegram.ipoc_text
    if not text:
        return b"%d" % telegram.ipoc
    if not text.isdigit() or len(text) > MAX_IPOC_DIGITS or int(text) != telegram.ipoc:
        raise RsiError(f"{text!r:.64} is not {telegram.ipoc}", element="IPOC")
    return text
