"""Read RSI_EthernetConfig.xml, the file that sets up controller and daemon.

Invariants:
    Comments, byte order marks and other case are accepted.
    What the two sides could read differently is refused by name.
"""

import ipaddress
import re
from dataclasses import dataclass
from typing import Literal

from linemate.protocol.rsi.xml_scan import BLANK, RsiError, XmlToken, attributes, tokens, unescape

ElementType = Literal["BOOL", "LONG", "DOUBLE", "STRING"]

MAX_CONFIG_BYTES = 262_144
MAX_CHANNEL = 64
PLACEHOLDER = "FREE"

_TYPES: dict[str, ElementType] = {
    "BOOL": "BOOL",
    "LONG": "LONG",
    "DOUBLE": "DOUBLE",
    "STRING": "STRING",
}
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_TAG = re.compile(r"[A-Za-z0-9_:-]+(?:\.[A-Za-z0-9_:-]+)?", re.ASCII)


@dataclass(frozen=True, slots=True)
class Element:
    """One ELEMENT of SEND or RECEIVE.

    Attributes:
        tag: as written, ``"DEF_RIst"``, ``"AK.A1"``, ``"DiO"``.
        type: BOOL, LONG, DOUBLE or STRING.
        index: channel 1..64 of the ETHERNET object, None for INTERNAL.
        holdon: RECEIVE only: True if the last value stays when a reply is missing.
    """

    tag: str
    type: ElementType
    index: int | None = None
    holdon: bool = True


@dataclass(frozen=True, slots=True)
class RsiConfig:
    """The contents of an RSI_EthernetConfig.xml.

    Attributes:
        ip: address of the sensor's side (the daemon).
        sentype: what ``Sen/@Type`` must be.
        onlysend: True if the controller expects no replies.
        send: robot to daemon, in order.
        receive: daemon to robot, in order.
    """

    ip: str
    port: int
    sentype: str
    onlysend: bool
    send: tuple[Element, ...]
    receive: tuple[Element, ...]


def parse_config(xml: bytes) -> RsiConfig:
    """Read an RSI_EthernetConfig.xml.

    Raises:
        RsiError: anything missing, malformed, out of range or double, by name.
    """
    if len(xml) > MAX_CONFIG_BYTES:
        raise RsiError(f"configuration of {len(xml)} bytes, at most {MAX_CONFIG_BYTES}")
    bare = _COMMENT.sub(b"", xml.removeprefix(b"\xef\xbb\xbf"))
    if b"<!" in bare:
        raise RsiError("document types and entities are refused", evidence=xml)
    text = bare.decode("latin-1")
    reader = _ConfigReader(text)
    for token in tokens(text):
        reader.read(token)
    return reader.config()


class _ConfigReader:
    """Collects settings and elements of one configuration."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._path: list[str] = []
        self._settings: dict[str, str] = {}
        self._elements: dict[str, list[Element]] = {"SEND": [], "RECEIVE": []}

    def read(self, token: XmlToken) -> None:
        """Read one token."""
        if token.kind == "close":
            return
        if token.kind == "text":
            self._read_text(token)
            return
        del self._path[token.depth :]
        self._path.append(token.name.upper())
        match self._path:
            case ["ROOT", ("SEND" | "RECEIVE") as side, "ELEMENTS", "ELEMENT"]:
                self._elements[side].append(_element(self._attributes(token), side))
            case _:
                pass

    def _read_text(self, token: XmlToken) -> None:
        path = self._path[: token.depth + 1]
        value = self._text[token.start : token.end].strip(BLANK)
        if len(path) == 3 and path[:2] == ["ROOT", "CONFIG"]:
            if path[2] in self._settings:
                raise RsiError("given twice", element=path[2])
            self._settings[path[2]] = unescape(value)

    def _attributes(self, token: XmlToken) -> dict[str, str]:
        values: dict[str, str] = {}
        for name, start, end in attributes(self._text, token.start, token.end):
            if name.upper() in values:
                raise RsiError("given twice", element=f"ELEMENT/@{name.upper()}")
            values[name.upper()] = unescape(self._text[start:end]).strip(BLANK)
        return values

    def config(self) -> RsiConfig:
        """Return what was collected, if it is complete."""
        for side, elements in self._elements.items():
            _refuse_doubles(side, elements)
        sentype = self._setting("SENTYPE")
        if not (sentype.isascii() and sentype.isprintable()):
            raise RsiError("only printable ASCII", element="SENTYPE")
        return RsiConfig(
            ip=_address(self._setting("IP_NUMBER")),
            port=_integer(self._setting("PORT"), "PORT", 1, 65535),
            sentype=sentype,
            onlysend=_truth(self._settings.get("ONLYSEND", "FALSE"), "ONLYSEND"),
            send=tuple(self._elements["SEND"]),
            receive=tuple(self._elements["RECEIVE"]),
        )

    def _setting(self, name: str) -> str:
        value = self._settings.get(name)
        if not value:
            raise RsiError("missing in CONFIG", element=name)
        return value


def _address(text: str) -> str:
    try:
        return str(ipaddress.IPv4Address(text))
    except ValueError:
        raise RsiError(f"{text[:32]!r} is no IPv4 address", element="IP_NUMBER") from None


def _element(values: dict[str, str], side: str) -> Element:
    tag = values.get("TAG", "")
    if not _TAG.fullmatch(tag):
        raise RsiError(f"TAG {tag[:64]!r} is no name", element=f"{side}/ELEMENT")
    kind = _TYPES.get(values.get("TYPE", "").upper())
    if kind is None:
        raise RsiError(f"TYPE must be one of {', '.join(_TYPES)}", element=tag)
    index = values.get("INDX", "").upper()
    return Element(
        tag=tag,
        type=kind,
        index=None if index == "INTERNAL" else _integer(index, f"{tag}/@INDX", 1, MAX_CHANNEL),
        holdon=_truth(values.get("HOLDON", "1"), f"{tag}/@HOLDON"),
    )


def _refuse_doubles(side: str, elements: list[Element]) -> None:
    seen: set[str] = set()
    for element in elements:
        if element.tag in seen and element.tag != PLACEHOLDER:
            raise RsiError(f"given twice in {side}", element=element.tag)
        seen.add(element.tag)


def _integer(text: str, name: str, low: int, high: int) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= 9 and low <= int(text) <= high):
        raise RsiError(f"{text[:32]!r} is not a number in {low}..{high}", element=name)
    return int(text)


def _truth(text: str, name: str) -> bool:
    if text.upper() not in {"TRUE", "FALSE", "1", "0"}:
        raise RsiError(f"{text[:32]!r} is neither TRUE nor FALSE", element=name)
    return text.upper() in {"TRUE", "1"}
