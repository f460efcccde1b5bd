"""A tolerant, linear-time reader of the small XML that RSI speaks.

Law of this file: text in, spans out, no meaning. Not an XML parser: KUKA's own telegrams may
hold names that XML forbids (``<GPIO 01="0"/>``), and a real parser can be made to work for
milliseconds by a datagram of 500 bytes. No entities beyond the five predefined, no document
types, bounded size and depth, possessive patterns so that no input makes it backtrack.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from linemate.protocol.errors import ProtocolError

MAX_DEPTH = 8
BLANK = " \t\r\n"

_NAME = r"[^\s<>/=\"'&?!]++"
# A group must not be possessive: in Debian's Python 3.11.2 one that fails half way leaves what it
# has read as read (gh-106052), and an attribute without a value was a good one.
_TOKEN = re.compile(
    rf"<(?P<open>{_NAME})"
    rf"(?P<attributes>(?:\s++{_NAME}\s*+=\s*+(?:\"[^\"<]*+\"|'[^'<]*+'))*)"
    r"\s*+(?P<empty>/?)>"
    rf"|</(?P<close>{_NAME})\s*+>"
    r"|(?P<text>[^<]++)",
    re.ASCII,
)
_ATTRIBUTE = re.compile(rf"({_NAME})\s*+=\s*+(?:\"([^\"<]*+)\"|'([^'<]*+)')", re.ASCII)
_PROLOG = re.compile(r"[ \t\r\n]*+(?:<\?xml[^<>]*+>)?[ \t\r\n]*+", re.ASCII)
_ENTITY = re.compile(r"&(lt|gt|amp|quot|apos);")
_ENTITIES = {"lt": "<", "gt": ">", "amp": "&", "quot": '"', "apos": "'"}


class RsiError(ProtocolError):
    """A configuration, a telegram or a value that the RSI wire refuses.

    Attributes:
        element: the element or attribute it is about (``"AIPos"``, ``"AIPos.A3"``), or None.
        evidence: the first bytes of what was read, empty when formatting.
        ipoc_text: the telegram's IPOC where it could still be read, so that a telegram
            that lacks something can be answered all the same; else None.
    """

    def __init__(
        self,
        reason: str,
        *,
        element: str | None = None,
        evidence: bytes = b"",
        ipoc_text: bytes | None = None,
    ) -> None:
        """Keep the evidence, bounded."""
        super().__init__(f"{element}: {reason}" if element else reason)
        self.reason = reason
        self.element = element
        self.evidence = evidence[:256]
        self.ipoc_text = ipoc_text


class XmlToken(NamedTuple):
    """One token in its place: ``depth`` is that of the element it belongs to, 0 the root."""

    kind: Literal["open", "close", "text"]
    depth: int
    name: str
    start: int
    end: int
    empty: bool


class Span(NamedTuple):
    """Where a value lies: of an attribute, or of an element's text (attribute None)."""

    element: str
    attribute: str | None
    start: int
    end: int


@dataclass(slots=True)
class FlatDocument:
    """A flat document: a root, its attributes, and the spans of its children's values.

    Attributes:
        root: the root's name as written.
        spans: values of attributes and texts of the root's children, in wire order.
        hollow: children written ``<Name/>`` without attributes.
        flat: False if some child has children (they are skipped).
    """

    root: str
    attributes: dict[str, str]
    spans: list[Span] = field(default_factory=list)
    hollow: set[str] = field(default_factory=set)
    flat: bool = True


def escape(text: str) -> str:
    """Text as it may stand in an attribute or an element."""
    out = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return out.replace('"', "&quot;")


def unescape(text: str) -> str:
    """The inverse of :func:`escape`; an unknown entity stays as it is."""
    return _ENTITY.sub(lambda match: _ENTITIES[match[1]], text)


def attributes(text: str, start: int, end: int) -> Iterator[tuple[str, int, int]]:
    """Name and span of the value of each attribute within a tag."""
    for match in _ATTRIBUTE.finditer(text, start, end):
        group = 2 if match.start(2) >= 0 else 3
        yield match[1], match.start(group), match.end(group)


def tokens(text: str) -> Iterator[XmlToken]:
    """The tokens of a document, nesting checked.

    For ``open`` the span is that of the attributes, for ``text`` that of the text, for
    ``close`` the place of the closing tag.

    Raises:
        RsiError: not one properly nested document with nothing before or after it.
    """
    open_names: list[str] = []
    prolog = _PROLOG.match(text)
    position = prolog.end() if prolog else 0
    ended = False
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            raise RsiError(f"malformed at byte {position}")
        event = _event(match, open_names, ended=ended)
        position = match.end()
        ended = ended or (not open_names and event.kind != "text")
        if event.depth >= 0:
            yield event
    if not ended:
        raise RsiError("ends before its root does")


def _event(match: re.Match[str], open_names: list[str], *, ended: bool) -> XmlToken:
    """One token as an event; keeps the stack of open names."""
    if match["text"] is not None:
        if not open_names and match["text"].strip(BLANK):
            raise RsiError(f"text outside the root at byte {match.start()}")
        return XmlToken("text", len(open_names) - 1, "", match.start(), match.end(), empty=False)
    if match["close"] is not None:
        if not open_names or open_names.pop() != match["close"]:
            raise RsiError(f"</{match['close'][:32]}> closes nothing")
        return XmlToken(
            "close", len(open_names), match["close"], match.start(), match.end(), empty=False
        )
    if ended or len(open_names) == MAX_DEPTH:
        raise RsiError("a second root" if ended else "nested too deeply")
    empty = match["empty"] == "/"
    depth = len(open_names)
    if not empty:
        open_names.append(match["open"])
    start, end = match.span("attributes")
    return XmlToken("open", depth, match["open"], start, end, empty)


def scan(text: str) -> FlatDocument:
    """Read a flat document.

    Raises:
        RsiError: malformed, or text directly inside the root.
    """
    document = FlatDocument("", {})
    child = _Child("")
    for event in tokens(text):
        if event.depth == 0:
            _read_root(text, event, document)
        elif event.depth == 1:
            child = _read_child(text, event, document, child)
        else:
            child.nested = True
            document.flat = False
    return document


@dataclass(slots=True)
class _Child:
    """The child of the root being read."""

    name: str
    text: tuple[int, int] | None = None
    nested: bool = False


def _read_root(text: str, event: XmlToken, document: FlatDocument) -> None:
    if event.kind == "open":
        document.root = event.name
        for name, start, end in attributes(text, event.start, event.end):
            document.attributes[name] = unescape(text[start:end])
    elif event.kind == "text" and text[event.start : event.end].strip(BLANK):
        raise RsiError(f"text between elements at byte {event.start}")


def _read_child(text: str, event: XmlToken, document: FlatDocument, child: _Child) -> _Child:
    if event.kind == "open":
        spans = [
            Span(event.name, name, start, end)
            for name, start, end in attributes(text, event.start, event.end)
        ]
        if event.empty and not spans:
            document.hollow.add(event.name)
        document.spans.extend(spans)
        return _Child(event.name)
    if event.kind == "text":
        child.text = (event.start, event.end)
        return child
    if not child.nested:
        start, end = child.text or (event.start, event.start)
        document.spans.append(Span(child.name, None, start, end))
    return child
