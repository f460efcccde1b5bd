"""Progress of a run in the terminal: a live picture, or plain lines in a pipe.

Invariants:
    Output depends on the given ``Glimpse`` alone.
    In a pipe a line appears on a change, and at most one a second otherwise.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final, Protocol, TextIO

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

QUIET_LINE_S: Final = 2.0
EVENTS_SHOWN: Final = 6
BAR: Final = 24
COLOURS: Final = {
    "running": "green", "stopping": "yellow", "standing": "cyan", "starting": "yellow",
    "track": "green", "contact": "green", "retreat": "cyan", "hold": "yellow", "fault": "bold red",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class LinkGlimpse:
    """One link: its name, samples so far, the age of the newest [ms], trouble in words."""

    name: str
    samples: int | None = None
    age_ms: float | None = None
    trouble: str = ""


@dataclass(frozen=True, slots=True)
class Glimpse:
    """What there is to see at one moment; None is not known.

    Attributes:
        time_s: of the scenario, as the emulator has it, or since the start [s].
        state: of the daemon's operation.
        task_time: of the task's clock [s].
        scenario: class of the conveyor's motion.
        tentative: the class is not confirmed.
        speed: estimated, of the conveyor [m/s].
        errors: names and values with their units, e.g. ("control", "0.06 mm").
        idle_us: least idle time of a cycle after its reply [us].
        cycle_us: length of a cycle [us].
        missed: telegrams late, lost or refused so far.
        tolerated: of them, before the controller breaks off; None if that is not known.
        held: why the command is held.
    """

    time_s: float
    state: str = ""
    phase: str = ""
    task_time: float | None = None
    scenario: str = ""
    tentative: bool = False
    speed: float | None = None
    errors: tuple[tuple[str, str], ...] = ()
    links: tuple[LinkGlimpse, ...] = ()
    idle_us: float | None = None
    cycle_us: float | None = None
    missed: int | None = None
    tolerated: int | None = None
    held: str | None = None


class TerminalView(Protocol):
    """Something that shows a run."""

    def show(self, glimpse: Glimpse) -> None:
        """Show the present moment."""


@contextmanager
def view(title: str, stream: TextIO | None = None) -> Iterator[TerminalView]:
    """Open the view that fits the stream: drawn in place on a terminal, lines elsewhere."""
    console = Console(file=stream or sys.stderr, highlight=False)
    if not console.is_terminal:
        yield Lines(console)
        return
    drawn = Drawn(console, title)
    with Live(console=console, refresh_per_second=10, transient=True) as live:
        drawn.live = live
        yield drawn


@dataclass(slots=True)
class Lines:
    """Plain lines: one when state, phase or class changes, and one now and then."""

    console: Console
    _last: tuple[object, ...] = ()
    _last_line_s: float = field(default=-1e9)

    def show(self, glimpse: Glimpse) -> None:
        """Print a line if something changed or the last one is old."""
        key = (glimpse.state, glimpse.phase, glimpse.scenario, glimpse.tentative, glimpse.missed)
        if key == self._last and abs(glimpse.time_s - self._last_line_s) < QUIET_LINE_S:
            return
        self._last, self._last_line_s = key, glimpse.time_s
        self.console.print(line(glimpse), markup=False, soft_wrap=True)


@dataclass(slots=True)
class Drawn:
    """One picture that renews itself."""

    console: Console
    title: str
    live: Live | None = None
    _events: list[str] = field(default_factory=list)
    _last: tuple[str, str, str, bool] = ("", "", "", False)

    def show(self, glimpse: Glimpse) -> None:
        """Draw the present moment, and note what changed."""
        now = (glimpse.state, glimpse.phase, glimpse.scenario, glimpse.tentative)
        if now != self._last:
            self._events.append(f"{glimpse.time_s:6.2f} s  {_state_text(glimpse)}")
            del self._events[:-EVENTS_SHOWN]
            self._last = now
        if self.live is not None:
            self.live.update(picture(self.title, glimpse, self._events))


def line(glimpse: Glimpse) -> str:
    """Put a glimpse on one line."""
    parts = [f"{glimpse.time_s:6.2f} s", _state_text(glimpse)]
    parts += [f"{name} {value}" for name, value in glimpse.errors]
    if glimpse.idle_us is not None:
        parts.append(f"idle {glimpse.idle_us / 1e3:.1f} ms")
    if glimpse.missed is not None:
        parts.append(f"late {_late(glimpse)}")
    parts += [f"{link.name} down" for link in glimpse.links if link.trouble]
    if glimpse.held:
        parts.append(f"held: {glimpse.held}")
    return "  ".join(part for part in parts if part)


def picture(title: str, glimpse: Glimpse, events: list[str]) -> RenderableType:
    """Draw a glimpse for a terminal."""
    head = Table.grid(padding=(0, 3))
    head.add_row(Text(title, style="bold"), f"{glimpse.time_s:6.2f} s")
    facts = Table.grid(padding=(0, 3))
    facts.add_row("operation", _coloured(glimpse.state), "phase", glimpse.phase or "-")
    speed = "-" if glimpse.speed is None else f"{1e3 * glimpse.speed:6.1f} mm/s"
    facts.add_row(
        "conveyor", _coloured(glimpse.scenario, "?" if glimpse.tentative else ""), "speed", speed
    )
    for name, value in glimpse.errors:
        facts.add_row(name, value)
    facts.add_row("idle", _idle(glimpse))
    facts.add_row("late replies", _late(glimpse))
    if glimpse.held:
        facts.add_row("held", Text(glimpse.held, style="yellow"))
    links = Table(box=None, pad_edge=False, header_style="dim")
    for name, side in (("link", "left"), ("samples", "right"), ("age ms", "right"), ("", "left")):
        links.add_column(name, justify="right" if side == "right" else "left")
    for link in glimpse.links:
        links.add_row(
            link.name, *map(_number, (link.samples, link.age_ms)), Text(link.trouble, "red")
        )
    return Group(head, "", facts, "", links, "", *(Text(event, style="dim") for event in events))


def _state_text(glimpse: Glimpse) -> str:
    motion = glimpse.scenario + ("?" if glimpse.tentative else "")
    return f"{glimpse.state:8} {glimpse.phase:8} {motion:9}".rstrip()


def _late(glimpse: Glimpse) -> str:
    if glimpse.missed is None:
        return "-"
    bound = "" if glimpse.tolerated is None else f" ({glimpse.tolerated} tolerated)"
    return f"{glimpse.missed}{bound}"


def _coloured(word: str, mark: str = "") -> Text:
    return Text((word or "-") + mark, style=COLOURS.get(word, ""))


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.0f}"


def _idle(glimpse: Glimpse) -> Text:
    if glimpse.idle_us is None or not glimpse.cycle_us:
        return Text("-")
    share = min(max(glimpse.idle_us / glimpse.cycle_us, 0.0), 1.0)
    filled = round(BAR * share)
    colour = "green" if share > 0.5 else "yellow" if share > 0.2 else "red"
    bar = "\N{BLACK RECTANGLE}" * filled + "\N{WHITE RECTANGLE}" * (BAR - filled)
    return Text(f"{bar} {glimpse.idle_us / 1e3:.1f} of {glimpse.cycle_us / 1e3:.0f} ms", colour)
