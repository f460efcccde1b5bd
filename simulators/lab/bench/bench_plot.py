"""Plot of a bench result: reply times as multiples of an echo.

Invariants:
    Input is the output of ``bench --json``.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

MODES = ("idle", "loaded", "inline")


def draw(result: Mapping[str, Any], path: Path) -> None:
    """Draw the turn-around's ratios.

    Args:
        result: of a bench that measured turn-around.
        path: of the picture; its ending says the format.
    """
    turnaround = result.get("turnaround", {})
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    for panel, (axes, name) in enumerate(zip(figure.subplots(1, 2), ("p50", "p99"), strict=True)):
        for place, mode in enumerate(MODES):
            heights = [modes[mode][f"{name}_ratio"] or 0.0 for modes in turnaround.values()]
            at = [n + 0.27 * (place - 1) for n in range(len(heights))]
            bars = axes.bar(at, heights, 0.25, label=mode)
            axes.bar_label(bars, fmt="%.2f", fontsize=7)
        axes.axhline(1.0, color="0.4", linewidth=0.8)
        axes.set_xticks(range(len(turnaround)), list(turnaround))
        axes.set_title(f"turn-around {name}, times that of an echo")
        if panel == 0:
            axes.legend()
    figure.savefig(path, dpi=120)
