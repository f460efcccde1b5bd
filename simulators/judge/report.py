"""Report of a run: fig4.png, fig5.png and one self-contained HTML page.

Invariants:
    A result and its rows in, files out.
    The page embeds its pictures and styles and loads nothing.
"""

from __future__ import annotations

import base64
import html
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from matplotlib.figure import Figure

from linemate.simulators.judge import figures, table
from linemate.simulators.judge.rows import Rows

STYLE: Final = """
:root { color-scheme: light; }
body { font: 15px/1.5 Georgia, "Times New Roman", serif; color: #222; background: #fff;
  max-width: 60rem; margin: 2.5rem auto; padding: 0 1.25rem; }
h1 { font-size: 1.5rem; font-weight: normal; margin: 0; }
h2 { font-size: 1.05rem; margin: 2rem 0 .5rem; }
.outcome { margin: .3rem 0 1.5rem; padding-left: .7rem; border-left: 4px solid #009e73; }
.outcome.failed { border-color: #d55e00; }
figure { margin: 1.5rem 0; } img { width: 100%; height: auto; }
figcaption, .notes { color: #555; font-size: .9rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .9rem; }
th { font-weight: normal; color: #555; border-bottom: 1px solid #999; }
th, td { padding: .15rem .9rem .15rem 0; text-align: left; white-space: nowrap; }
th.n, td.n { text-align: right; }
tr + tr td { border-top: 1px solid #eee; }
pre { font-size: .75rem; overflow-x: auto; background: #f7f7f7; padding: .7rem; }
@media print { body { margin: 0; } figure { break-inside: avoid; } }
"""

CAPTIONS: Final = {
    "fig4": "After the paper's Fig. 4: fused sensed trajectory x_f (dashed) and computed desired "
    "trajectory x_t (solid), in the conveyor's axes (x down, y along the travel, z to the car) "
    "relative to the nominal contact pose with the conveyor unit at its start position. "
    "Conveyor motion dash-dotted.",
    "fig5": "After the paper's Fig. 5: control error, the true tcp against the committed desired "
    "pose x_c, in the axes of x_c. Dotted: the limits that hold for approach and contact, "
    "1 mm and 2 mrad. Note the different scale.",
    "apart": "What adds up to the total error, norms. A small control error means little unless "
    "the others are small too; the plan's is large by design until the tcp has caught up with "
    "the part.",
}


def png(figure: Figure) -> bytes:
    """Render a figure as PNG bytes, the same bytes for the same figure."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=200, metadata={"Software": None})
    return buffer.getvalue()


def page(result: Mapping[str, Any], pictures: Mapping[str, bytes]) -> str:
    """Compose the page from a result and PNG pictures by name (`fig4`, `fig5`, `apart`)."""
    parts = [
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>linemate: {html.escape(table.outcome_line(result))}</title>",
        f"<style>{STYLE}</style></head><body>",
        "<h1>linemate: a wheel onto a moving hub</h1>",
        f'<p class="outcome{"" if result.get("assembled") else " failed"}">',
        f"{html.escape(table.outcome_line(result))}</p>",
    ]
    for name, data in pictures.items():
        source = base64.b64encode(data).decode("ascii")
        caption = html.escape(CAPTIONS.get(name, name))
        parts.append(
            f'<figure><img alt="{html.escape(name)}" src="data:image/png;base64,{source}">'
            f"<figcaption>{caption}</figcaption></figure>"
        )
    parts += [_table(result_table) for result_table in table.tables(result)]
    if table.notes(result):
        items = "".join(f"<li>{html.escape(note)}</li>" for note in table.notes(result))
        parts.append(f'<h2>Notes</h2><ul class="notes">{items}</ul>')
    source = html.escape(json.dumps(result, indent=1, default=str))
    parts.append(f"<h2>result.json</h2><details><summary>all of it</summary><pre>{source}</pre>")
    parts.append("</details></body></html>\n")
    return "\n".join(parts)


def write(out_dir: Path, result: Mapping[str, Any], rows: Rows) -> tuple[Path, ...]:
    """Write `fig4.png`, `fig5.png` and `report.html` into a directory.

    Args:
        out_dir: Made when it is missing.
        result: As `result.json` has it (interfaces, 7).
        rows: One a telegram, truth and the daemon's word side by side.

    Returns:
        The files, in the order of writing.
    """
    out_dir.mkdir(parents=True, exist_ok=True)
    pictures = {
        "fig4": png(figures.trajectories(rows, result)),
        "fig5": png(figures.control_error(rows, result)),
        "apart": png(figures.errors_apart(rows, result)),
    }
    written = []
    for name in ("fig4", "fig5"):
        written.append(out_dir / f"{name}.png")
        written[-1].write_bytes(pictures[name])
    written.append(out_dir / "report.html")
    written[-1].write_text(page(result, pictures), encoding="utf-8")
    return tuple(written)


def _table(result_table: table.ResultTable) -> str:
    numeric = [
        all(table.is_figure(row[i]) for row in result_table.rows)
        for i in range(len(result_table.head))
    ]

    def line(tag: str, cells: tuple[str, ...]) -> str:
        inner = "".join(
            f"<{tag}{' class=n' if right else ''}>{html.escape(cell)}</{tag}>"
            for cell, right in zip(cells, numeric, strict=True)
        )
        return f"<tr>{inner}</tr>"

    body = "".join(line("td", row) for row in result_table.rows)
    head = line("th", result_table.head)
    return f"<h2>{html.escape(result_table.title)}</h2><table>{head}{body}</table>"
