"""Lint of an RSI_EthernetConfig.xml: what the daemon would refuse, with line numbers.

Invariants:
    A pure function of the file's bytes and of what the cell needs.
    A finding is an error of the daemon's own checks; the lint has no rules of its own.
    A file that cannot be read has one finding, its first error.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from linemate.daemon.config import rsi_section
from linemate.daemon.config.settings import Corrections
from linemate.daemon.core.tracking.task import TaskFile
from linemate.protocol.rsi.codec import RsiCodec
from linemate.protocol.rsi.ethernet_config import parse_config
from linemate.protocol.rsi.xml_scan import RsiError

_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_BYTE = re.compile(r"at byte (\d+)")
_QUOTED = re.compile(r"'([^']+)'")
_TAG = re.compile(r"\b(SEND|RECEIVE) ([A-Za-z_][\w.]*)")
_SETTING = re.compile(r"^(ONLYSEND|SEND|RECEIVE)\b")


@dataclass(frozen=True, slots=True)
class LintFinding:
    """One thing that the daemon would refuse.

    Attributes:
        line: where it stands, from 1; None where no line is to blame.
    """

    line: int | None
    what: str


def lint(
    xml: bytes,
    corrections: Corrections = Corrections.ABSOLUTE,
    constants: Mapping[str, Any] | None = None,
    task: TaskFile | None = None,
) -> list[LintFinding]:
    """Return what the daemon would refuse, in the order of the lines.

    Args:
        corrections: how the controller reads them (``rsi.corrections``).
        constants: values of elements that linemate does not know (``rsi.constants``).
        task: whose arm and gates the file has to serve; None: an arm of six axes.
    """
    # Blank comments keep the place of every byte behind them.
    shown = _COMMENT.sub(lambda match: re.sub(rb"[^\n]", b" ", match[0]), xml)
    text = shown.decode("latin-1")
    try:
        rsi = parse_config(shown)
        RsiCodec(rsi)
    except RsiError as error:
        return [LintFinding(_line_of_error(text, error), str(error))]
    whats = [*rsi_section.unfilled(rsi, constants or {})]
    whats += rsi_section.exchange_errors(rsi, corrections)
    whats += [f"{tag}: {what}" for tag, what in rsi_section.constant_errors(rsi, constants or {})]
    missing = rsi_section.missing_axes(rsi, linear_axis=task is not None and task.arm.linear_axis)
    if missing:
        whats.append(f"the arm needs {', '.join(missing)}")
    if task is not None:
        whats += rsi_section.gate_errors(rsi, task)
    findings = [LintFinding(_line_of(text, what), what) for what in whats]
    return sorted(findings, key=lambda finding: finding.line or 0)


def _line_of_error(text: str, error: RsiError) -> int | None:
    place = _BYTE.search(error.reason)
    if place is not None:
        return _line(text, int(place[1]))
    twice = "given twice" in error.reason
    names = [error.element or ""] if error.element else []
    names = [part for name in names for part in (name.split("/@")[0], name)]
    for name in [*_QUOTED.findall(error.reason), *names]:
        places = [*_places(text, name)]
        if places:
            return _line(text, places[-1] if twice else places[0])
    return None


def _line_of(text: str, what: str) -> int | None:
    """Return the line that a check's message names, by TAG or by section."""
    tag = _TAG.search(what)
    names = [tag[2], tag[1]] if tag is not None else []
    section = _SETTING.match(what)
    names += [section[1]] if section is not None else []
    for name in names:
        for place in _places(text, name):
            return _line(text, place)
    return None


def _places(text: str, name: str) -> Iterator[int]:
    """Yield where an element with a TAG, a value or a name stands."""
    word = re.escape(name)
    for pattern in (
        rf"TAG\s*=\s*[\"']{word}[\"']",
        rf"[\"'>]\s*{word}\s*[\"'<]",
        rf"<{word}[\s>/]",
    ):
        places = [match.start() for match in re.finditer(pattern, text, re.IGNORECASE)]
        if places:
            yield from places
            return


def _line(text: str, place: int) -> int:
    return text.count("\n", 0, place) + 1
