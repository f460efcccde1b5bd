"""Tolerant, linear-time scanner of the XML that RSI uses.

It is no XML parser: KUKA's telegrams may hold names that XML forbids (``<GPIO 01="0"/>``), and 500
bytes can occupy a real parser for milliseconds.

Invariants:
    Text in, spans out.
    Only the five predefined entities, no document types, bounded size and depth.
    Possessive patterns: no input makes them backtrack.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from linemate.protocol.controller_link import ControllerError

MAX_DEPTH = 8
BLANK = " \t\r\n"

_NAME = r"[^\s<>/=\"'&?!]++"
# A group must not be possessive: after a failure within it Python 3.11.2 keeps what was read
# (gh-106052), and an attribute without a value was accepted.
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


class RsiError(ControllerError):
    """A configuration, a telegram or a value that the RSI wire refuses.

    Attributes:
        element: name of the element or attribute (``"AIPos"``, ``"AIPos.A3"``), or None.
        evidence: first bytes of what was read, empty when formatting.
        ipoc_text: the telegram's IPOC if it could be read: an incomplete telegram can still be
            answered.
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

    @property
    def counter(self) -> tuple[int, bytes] | None:
        """The telegram's IPOC and its digits, if it could be read."""
        return None if self.ipoc_text is None else (int(self.ipoc_text), self.ipoc_text)


class XmlToken(NamedTuple):
    """One token; ``depth`` is that of its element, 0 for the root."""

    kind: Literal["open", "close", "text"]
    depth: int
    name: str
    start: int
    end: int
    empty: bool


class Span(NamedTuple):
    """Place of a value: of an attribute, or of an element's text (attribute None)."""

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
    """Return text with the characters replaced that attributes and elements cannot hold."""
    out = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return out.replace('"', "&quot;")


def unescape(text: str) -> str:
    """Undo :func:`escape`; an unknown entity stays unchanged."""
    return _ENTITY.sub(lambda match: _ENTITIES[match[1]], text)


def attributes(text: str, start: int, end: int) -> Iterator[tuple[str, int, int]]:
    """Yield name and span of the value of each attribute within a tag."""
    for match in _ATTRIBUTE.finditer(text, start, end):
        group = 2 if match.start(2) >= 0 else 3
        yield match[1], match.start(group), match.end(group)


def tokens(text: str) -> Iterator[XmlToken]:
    """Yield the tokens of a document and check their nesting.

    The span is that of the attributes for ``open``, of the text for ``text``, of the tag for
    ``close``.

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
        token = _token(match, open_names, ended=ended)
        position = match.end()
        ended = ended or (not open_names and token.kind != "text")
        if token.depth >= 0:
            yield token
    if not ended:
        raise RsiError("ends before its root does")


def _token(match: re.Match[str], open_names: list[str], *, ended: bool) -> XmlToken:
    """Return one token and keep the stack of open names."""
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
    for token in tokens(text):
        if token.depth == 0:
            _read_root(text, token, document)
        elif token.depth == 1:
            child = _read_child(text, token, document, child)
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


def _read_root(text: str, token: XmlToken, document: FlatDocument) -> None:
    if token.kind == "open":
        document.root = token.name
        for name, start, end in attributes(text, token.start, token.end):
            document.attributes[name] = unescape(text[start:end])
    elif token.kind == "text" and text[token.start : token.end].strip(BLANK):
        raise RsiError(f"text between elements at byte {token.start}")


def _read_child(text: str, token: XmlToken, document: FlatDocument, child: _Child) -> _Child:
    if token.kind == "open":
        spans = [
            Span(token.name, name, start, end)
            for name, start, end in attributes(text, token.start, token.end)
        ]
        if token.empty and not spans:
            document.hollow.add(token.name)
        document.spans.extend(spans)
        return _Child(token.name)
    if token.kind == "text":
        child.text = (token.start, token.end)
        return child
    if not child.nested:
        start, end = child.text or (token.start, token.start)
        document.spans.append(Span(child.name, None, start, end))
    return child
