"""The page that an engineer signs: what was measured of a site, and what was not.

Invariants:
- Pure: state and facts in, Markdown out. Every step is on it, also those without a result.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from linemate.daemon.commissioning.walk import (
    STEPS,
    SiteState,
    StepName,
    StepOutcome,
    StepRecordOfSite,
    WalkStep,
)


@dataclass(frozen=True, slots=True)
class PageFacts:
    """What the page says of the site.

    Attributes:
        digests: SHA-256 by file's name: configuration, task and overlays.
    """

    site: str
    config: str
    program: str
    when: str
    digests: Mapping[str, str]


_WORDS = {
    StepOutcome.MEASURED: "measured",
    StepOutcome.REFUSED: "NOT measured: refused",
    StepOutcome.SKIPPED: "NOT measured: skipped",
    StepOutcome.DUE: "NOT measured",
}


def page(state: SiteState, facts: PageFacts) -> str:
    """Return the page as Markdown."""
    lines = [
        f"# Commissioning of {facts.site}",
        "",
        f"Configuration `{facts.config}`, {facts.program}, {facts.when}.",
        "",
        "| step | result | when | took | rests on |",
        "|---|---|---|---|---|",
        *(_summary(step, state.of(step.name)) for step in _measured_steps()),
        "",
        *_total(state),
        *_not_measured(state),
    ]
    for step in _measured_steps():
        lines += _section(step, state.of(step.name))
    lines += ["## Files", "", "| file | SHA-256 |", "|---|---|"]
    lines += [f"| {_cell(name)} | `{digest}` |" for name, digest in facts.digests.items()]
    lines += [
        "",
        "## Signature",
        "",
        "The figures above were measured on this cell. What is not measured is named above.",
        "",
        "| name | date | signature |",
        "|---|---|---|",
        "| | | |",
        "",
    ]
    return "\n".join(lines)


def _measured_steps() -> Iterator[WalkStep]:
    return (step for step in STEPS if step.name is not StepName.PAGE)


def _summary(step: WalkStep, record: StepRecordOfSite) -> str:
    rests = ", ".join(record.recordings) or "-"
    cells = (
        step.name.value,
        _WORDS[record.outcome],
        record.when or "-",
        duration_text(record),
        rests,
    )
    return f"| {' | '.join(map(_cell, cells))} |"


def duration_text(record: StepRecordOfSite) -> str:
    """Return how long a step took as minutes and seconds."""
    if not record.took_s:
        return "-"
    minutes, seconds = divmod(round(record.took_s), 60)
    return f"{minutes} min {seconds} s" if minutes else f"{seconds} s"


def _total(state: SiteState) -> Iterator[str]:
    total_s = sum(state.of(step.name).took_s for step in _measured_steps())
    if total_s:
        yield f"All steps together took {total_s / 60.0:.0f} min, without what lies between them."
        yield ""


def _not_measured(state: SiteState) -> Iterator[str]:
    """Yield what has no result, and why."""
    open_steps = [
        s for s in _measured_steps() if state.of(s.name).outcome is not StepOutcome.MEASURED
    ]
    yield "## Not measured"
    yield ""
    if not open_steps:
        yield "Every step has a result. Refused figures stand in their tables."
    for step in open_steps:
        reason = state.of(step.name).reason or "not done"
        yield f"- **{step.name.value}** ({step.about}): {_cell(reason)}"
    yield ""


def _section(step: WalkStep, record: StepRecordOfSite) -> Iterator[str]:
    if not record.figures:
        return
    yield f"## {step.name.value}: {step.about}"
    yield ""
    yield "| figure | value | +- | unit | rests on |"
    yield "|---|---|---|---|---|"
    yield from (_row(figure) for figure in record.figures)
    yield ""
    if record.overlay is not None:
        yield f"Overlay: `{record.overlay}`; figures with * are in it."
        yield ""


def _row(figure: Mapping[str, Any]) -> str:
    name = f"{figure.get('name', '')}{' *' if figure.get('in_overlay') else ''}"
    if "refused" in figure:
        cells = (name, "-", "", figure.get("unit", ""), f"refused: {figure['refused']}")
    else:
        cells = (
            name,
            _number(figure.get("value")),
            _number(figure.get("deviation")) if figure.get("deviation") else "",
            figure.get("unit", ""),
            figure.get("basis", ""),
        )
    return f"| {' | '.join(_cell(str(cell)) for cell in cells)} |"


def _number(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, (int, float)) else "-"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
