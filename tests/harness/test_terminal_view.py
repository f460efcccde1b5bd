"""The live view shows what it is given, in place on a terminal and as lines in a pipe."""

import io
from dataclasses import replace

from rich.console import Console

from linemate.simulators.harness.terminal_view import (
    Glimpse,
    Lines,
    LinkGlimpse,
    line,
    picture,
    view,
)

MOMENT = Glimpse(
    time_s=5.25,
    state="track",
    phase="approach",
    scenario="stopping",
    tentative=True,
    speed=0.0874,
    errors=(("control", "0.06 mm"),),
    links=(LinkGlimpse("robot", 1234, 4.0), LinkGlimpse("camera", None, None, "lost")),
    idle_us=10_800.0,
    cycle_us=12_000.0,
    missed=3,
    tolerated=100,
)


def test_a_line_tells_class_error_idle_time_and_a_link_in_trouble() -> None:
    text = line(MOMENT)
    for word in (
        "5.25 s",
        "approach",
        "stopping?",
        "0.06 mm",
        "10.8 ms",
        "camera down",
        "late 3 (100 tolerated)",
    ):
        assert word in text
    assert "\n" not in text


def test_a_picture_tells_the_same_and_every_link() -> None:
    console = Console(file=io.StringIO(), width=100, force_terminal=True)
    console.print(picture("wheel", MOMENT, ["  5.16 s  stopping?"]))
    drawn = console.file.getvalue()  # type: ignore[attr-defined]
    for word in ("stopping?", "87.4 mm/s", "robot", "1234", "camera", "lost", "10.8 of 12 ms"):
        assert word in drawn


def test_what_is_not_known_is_drawn_as_a_dash() -> None:
    console = Console(file=io.StringIO(), width=100)
    console.print(picture("wheel", Glimpse(0.0), []))
    assert "-" in console.file.getvalue()  # type: ignore[attr-defined]


def test_a_pipe_gets_a_line_for_each_change_and_few_others() -> None:
    stream = io.StringIO()
    with view("wheel", stream) as shown:
        assert isinstance(shown, Lines)
        for i in range(100):
            shown.show(replace(MOMENT, time_s=0.01 * i))
        shown.show(replace(MOMENT, time_s=1.0, tentative=False))
        shown.show(replace(MOMENT, time_s=9.0, tentative=False))
    lines = stream.getvalue().splitlines()
    assert len(lines) == 3
    assert "\x1b" not in stream.getvalue()
