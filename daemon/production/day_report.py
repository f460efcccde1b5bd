"""Page of a day's quality records: yield, causes, trends with their drift, worst parts.

Invariants:
- Records in, one HTML text out. The page needs no network: its plots are inline SVG.
- Every text of a record is escaped.
"""

import html
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from statistics import median
from typing import Any, Final, NamedTuple

Record = Mapping[str, Any]


class TrendFigure(NamedTuple):
    """A figure of a record that is drawn over the day.

    Attributes:
        path: keys in the record.
        unit: for the axis and the table.
        worst_is_high: the largest value is the worst; None: the figure has no worst.
    """

    title: str
    path: tuple[str, ...]
    unit: str
    worst_is_high: bool | None = True


FIGURES: Final = (
    TrendFigure("Force at impact", ("force", "impact_n"), "N"),
    TrendFigure("Largest force", ("force", "largest_n"), "N"),
    TrendFigure("Expected error before contact", ("estimates", "prediction_mm"), "mm"),
    TrendFigure("Deviation of the estimate", ("estimates", "sigma_mm"), "mm"),
    TrendFigure("Contact beyond the estimate", ("reach_mm",), "mm"),
    TrendFigure("Time in the cell", ("duration_s",), "s"),
    TrendFigure("Replies lost", ("replies_lost",), ""),
)
WIDTH, HEIGHT, MARGIN = 460, 150, 44
DRIFT_SIGMAS: Final = 3.0  # a drift that is larger than so many of its deviations is marked
LEAST_FOR_DRIFT: Final = 8

STYLE: Final = """
body{font:15px/1.45 system-ui,sans-serif;margin:2rem auto;max-width:62rem;padding:0 1rem}
body{color:#1c2733;background:#fff}
h1{font-size:1.5rem;margin:0}h2{font-size:1.1rem;margin:2rem 0 .5rem}
.sub{color:#5b6b7b;margin:.2rem 0 1.2rem}.tiles{display:flex;gap:1rem;flex-wrap:wrap}
.tile{border:1px solid #d5dde5;border-radius:8px;padding:.7rem 1.1rem;min-width:8rem}
.tile b{display:block;font-size:1.6rem;font-variant-numeric:tabular-nums}.tile span{color:#5b6b7b}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}
th,td{text-align:left;padding:.3rem .6rem;border-bottom:1px solid #e4eaf0;vertical-align:top}
th{color:#5b6b7b;font-weight:600;white-space:nowrap}td.n,th.n{text-align:right}td.w{white-space:nowrap}.bad{color:#b3261e}.ok{color:#1b7f4b}
.plots{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(27rem,100%),1fr));gap:1rem}
figure{margin:0;border:1px solid #d5dde5;border-radius:8px;padding:.6rem .8rem}
figcaption b,figcaption span{display:block}figcaption span{color:#5b6b7b}
figcaption span.bad{color:#b3261e}.scroll{overflow-x:auto}
svg{width:100%;height:auto;display:block}.axis{stroke:#c3ced9}.dot{fill:#2a6fb0}.dot.no{fill:#b3261e}
.line{stroke:#1c2733;stroke-width:1.5;stroke-dasharray:5 3}
text{font:11px system-ui,sans-serif;fill:#5b6b7b}
"""


def page(records: Sequence[Record], day: str) -> str:
    """Return the page of a day.

    Args:
        records: in their order, of any stations.
        day: as the title names it.
    """
    stations = ", ".join(sorted({str(record["station"]) for record in records})) or "no station"
    body = [
        f"<h1>{_text(stations)}</h1><p class=sub>{_text(day)}, {_counted(len(records))}</p>",
        _tiles(records),
        _variants(records),
        _causes(records),
        _trends(records),
        _worst(records),
        _parts(records),
    ]
    head = f"<!doctype html><meta charset=utf-8><title>{_text(stations)}, {_text(day)}</title>"
    view = "<meta name=viewport content='width=device-width,initial-scale=1'>"
    return f"{head}{view}<style>{STYLE}</style>{''.join(body)}\n"


def value(record: Record, path: tuple[str, ...]) -> float | None:
    """Return a figure of a record, None if it has none."""
    entry: Any = record
    for key in path:
        entry = entry.get(key) if isinstance(entry, Mapping) else None
    if isinstance(entry, bool) or not isinstance(entry, (int, float)) or not math.isfinite(entry):
        return None
    return float(entry)


def drift(values: Sequence[float]) -> tuple[float, float] | None:
    """Return the slope of a line through values, and its standard deviation, a part.

    Returns:
        None for too few values.
    """
    n = len(values)
    if n < LEAST_FOR_DRIFT:
        return None
    centre, mean = (n - 1) / 2.0, sum(values) / n
    spread = sum((i - centre) ** 2 for i in range(n))
    slope = sum((i - centre) * (v - mean) for i, v in enumerate(values)) / spread
    rest = sum((v - mean - slope * (i - centre)) ** 2 for i, v in enumerate(values))
    return slope, math.sqrt(rest / (n - 2) / spread)


def _text(value: object) -> str:
    return html.escape(str(value))


def _counted(count: int) -> str:
    return f"{count} part{'' if count == 1 else 's'}"


def _number(value: float | None, unit: str = "") -> str:
    if value is None:
        return "-"
    shown = f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"
    return f"{shown} {unit}".strip()


def _tiles(records: Sequence[Record]) -> str:
    good = sum(bool(record["ok"]) for record in records)
    times = [t for record in records if (t := value(record, ("duration_s",))) and record["ok"]]
    forces = [
        f for record in records if record["ok"] and (f := value(record, ("force", "impact_n")))
    ]
    tiles = (
        (f"{100.0 * good / len(records):.1f} %" if records else "-", "yield"),
        (str(good), "good"),
        (str(len(records) - good), "not good"),
        (_number(median(times) if times else None, "s"), "median time"),
        (_number(max(forces, default=None), "N"), "largest impact"),
    )
    cells = (
        f"<div class=tile><b>{_text(shown)}</b><span>{name}</span></div>" for shown, name in tiles
    )
    return f"<div class=tiles>{''.join(cells)}</div>"


def _table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    numbers: Sequence[int] = (),
    whole: Sequence[int] = (),
) -> str:
    """Return a table; its cells are HTML already.

    Args:
        numbers: columns that are aligned right.
        whole: columns that are not wrapped.
    """

    def cells(tag: str, row: Sequence[str]) -> str:
        marks = (
            " class=n" if i in numbers else " class=w" if i in whole else ""
            for i in range(len(row))
        )
        return "".join(f"<{tag}{m}>{c}</{tag}>" for m, c in zip(marks, row, strict=True))

    lines = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f"<div class=scroll><table><tr>{cells('th', head)}</tr>{lines}</table></div>"


def _variants(records: Sequence[Record]) -> str:
    total = Counter(str(record["variant"]) for record in records)
    good = Counter(str(record["variant"]) for record in records if record["ok"])
    rows = [
        (_text(name), str(count), str(good[name]), f"{100.0 * good[name] / count:.1f} %")
        for name, count in sorted(total.items())
    ]
    return "<h2>Variants</h2>" + _table(("variant", "parts", "good", "yield"), rows, (1, 2, 3))


def _causes(records: Sequence[Record]) -> str:
    """Return the reasons of parts that are not good, the commonest first."""
    reasons = Counter(str(r["reason"]).partition(":")[0] for r in records if not r["ok"])
    if not reasons:
        return "<h2>Causes</h2><p>Every part is good.</p>"
    rows = [(_text(reason), str(count)) for reason, count in reasons.most_common(20)]
    return "<h2>Causes</h2>" + _table(("not good because", "parts"), rows, (1,))


def _trends(records: Sequence[Record]) -> str:
    plots = "".join(filter(None, (_plot(figure, records) for figure in FIGURES)))
    return f"<h2>Trends</h2><div class=plots>{plots}</div>" if plots else ""


def _plot(figure: TrendFigure, records: Sequence[Record]) -> str:
    """Return a plot of a figure over the parts, with its drift; empty without values."""
    points = [
        (i, v, bool(r["ok"]))
        for i, r in enumerate(records)
        if (v := value(r, figure.path)) is not None
    ]
    if not points:
        return ""
    top = max(v for _, v, _ in points) or 1.0
    low = min(0.0, *(v for _, v, _ in points))
    last = max(len(records) - 1, 1)

    def place(i: float, v: float) -> tuple[float, float]:
        x = MARGIN + (WIDTH - MARGIN - 8) * i / last
        return x, HEIGHT - 20 - (HEIGHT - 32) * (v - low) / (top - low)

    dots = "".join(
        f"<circle class='dot{'' if ok else ' no'}' cx={x:.1f} cy={y:.1f} r=2.6>"
        f"<title>{_text(records[i]['part'])}: {_number(v, figure.unit)}</title></circle>"
        for i, v, ok in points
        for x, y in [place(i, v)]
    )
    trend, note = _trend(points, place, figure.unit)
    axes = (
        f"<line class=axis x1={MARGIN} x2={WIDTH - 8} y1={HEIGHT - 20} y2={HEIGHT - 20} />"
        f"<text x={MARGIN - 4} y={HEIGHT - 20} text-anchor=end>{_number(low)}</text>"
        f"<text x={MARGIN - 4} y=18 text-anchor=end>{_number(top)}</text>"
        f"<text x={WIDTH - 8} y={HEIGHT - 6} text-anchor=end>part {len(records)}</text>"
        f"<text x={MARGIN} y={HEIGHT - 6}>part 1</text>"
    )
    unit = f" [{figure.unit}]" if figure.unit else ""
    caption = f"<figcaption><b>{figure.title}{unit}</b>{note}</figcaption>"
    svg = f"<svg viewBox='0 0 {WIDTH} {HEIGHT}' role=img>{axes}{dots}{trend}</svg>"
    return f"<figure>{caption}{svg}</figure>"


def _trend(points: Sequence[tuple[int, float, bool]], place: Any, unit: str) -> tuple[str, str]:
    """Return the line of the good parts' drift, and a note about it."""
    good = [(i, v) for i, v, ok in points if ok]
    drifted = drift([v for _, v in good])
    if drifted is None:
        return "", "<span>too few good parts for a drift</span>"
    slope, deviation = drifted
    mean, centre = sum(v for _, v in good) / len(good), (len(good) - 1) / 2.0
    x1, y1 = place(good[0][0], mean - slope * centre)
    x2, y2 = place(good[-1][0], mean + slope * centre)
    line = f"<line class=line x1={x1:.1f} y1={y1:.1f} x2={x2:.1f} y2={y2:.1f} />"
    if len({v for _, v in good}) == 1:
        return line, "<span>constant</span>"
    is_sure = abs(slope) > DRIFT_SIGMAS * deviation
    word = "drifts by" if is_sure else "no drift:"
    shown = f"{word} {_number(100.0 * slope, unit)} in 100 parts"
    mark = " class=bad" if is_sure else ""
    return line, f"<span{mark}>{shown} &plusmn; {_number(100.0 * deviation, unit)}</span>"


def _worst(records: Sequence[Record]) -> str:
    """Return the worst good part of each figure."""
    rows = []
    for figure in FIGURES:
        if not figure.worst_is_high:
            continue
        good = [(v, r) for r in records if r["ok"] and (v := value(r, figure.path)) is not None]
        if good:
            worst, record = max(good, key=lambda pair: pair[0])
            row = (figure.title, _number(worst, figure.unit), _text(record["part"]))
            rows.append((*row, _text(record["variant"]), _link(record)))
    if not rows:
        return ""
    return "<h2>Worst good parts</h2>" + _table(
        ("figure", "value", "part", "variant", "recording"), rows, (1,)
    )


def _link(record: Record) -> str:
    name = record.get("recording")
    if not name:
        return "-"
    return f"<a href='{_text(name)}'>{_text(str(name).rpartition('/')[2])}</a>"


def _time(at: object) -> str:
    """Return the time of day of a stamp; the page's head has the day."""
    return str(at).partition("T")[2].removesuffix("Z") or str(at)


def _parts(records: Sequence[Record]) -> str:
    """Return each part that is not good."""
    rows = [
        (_text(_time(r["at"])), _text(r["part"]), _text(r["variant"]), _text(r["reason"]), _link(r))
        for r in records
        if not r["ok"]
    ]
    if not rows:
        return ""
    return "<h2>Parts that are not good</h2>" + _table(
        ("at (UTC)", "part", "variant", "reason", "recording"), rows, whole=(0, 1, 2, 4)
    )
