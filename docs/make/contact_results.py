"""Table and picture of docs/contact.md: the stability map of a contact.

``python -m docs.make.contact_results`` draws docs/contact.png from the stored results.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from linemate.simulators.lab import stability_map

Result = dict[str, Any]
Load = Callable[[str], Result]
Has = Callable[[str], bool]

FILE = Path(__file__).resolve().parents[1] / "contact.png"
COMMAND = "python -m linemate.simulators.lab.stability_map"
COMMANDS = {
    "stability": f"{COMMAND} --cycle-ms 12 --json",
    "stability-4ms": f"{COMMAND} --cycle-ms 4 --json",
}
NOT_MEASURED = "Not measured yet: `make results NAME=stability`."
LARGEST_SHOWN = 2.0  # growth at which the colours end


def whole(raw: Result) -> Result:
    """Return every case: the map is its cases."""
    return raw


def table(load: Load, has: Has) -> str:
    """Return a row for each cycle, mount and damping."""
    stored = [name for name in COMMANDS if has(name)]
    if not stored:
        return NOT_MEASURED
    lines = [
        "| cycle | mount, N/mm | damping | stable | rise again | grow"
        " | largest growth | peak force, N | energy, J |",
        "|---" * 9 + "|",
    ]
    for name in stored:
        result = load(name)
        cycle = f"[{result['cycle_ms']:g} ms](results/{name}.json)"
        lines += [
            f"| {cycle} | {mount / 1e3:g} | {100.0 * damping:g} % | " + " | ".join(_cells(part))
            + " |"
            for (mount, damping), part in stability_map.grouped(result["cases"])
        ]  # fmt: skip
    return "\n".join(lines)


def _cells(part: list[Mapping[str, Any]]) -> tuple[str, ...]:
    ends = [case["ends"] for case in part]
    return (
        f"{ends.count(stability_map.STABLE)} of {len(part)}",
        str(ends.count(stability_map.RISES)),
        str(ends.count(stability_map.GROWS)),
        f"{max(map(stability_map.growth, part)):.2f}",
        f"{max(case['force_n'] for case in part):.0f}",
        f"{max(case['energy_j'] for case in part):.3f}",
    )


def growing(load: Load, has: Has) -> str:
    """Return the cases that are not stable, a row each."""
    stored = [name for name in COMMANDS if has(name)]
    if not stored:
        return NOT_MEASURED
    lines = [
        "| cycle | ends | body | damping | mount, N/mm | amplitudes, mm | peak force, N"
        " | energy, J |",
        "|---" * 8 + "|",
    ]
    for name in stored:
        result = load(name)
        for case in sorted(filter(stability_map.is_unstable, result["cases"]), key=_order):
            amplitudes = ", ".join(f"{amplitude:.2f}" for amplitude in case["amplitudes_mm"])
            lines.append(
                f"| {result['cycle_ms']:g} ms | {case['ends']}"
                f" | {case['mass']:g} kg, {case['frequency_hz']:g} Hz"
                f" | {100.0 * case['damping']:g} % | {case['mount'] / 1e3:g} | {amplitudes}"
                f" | {case['force_n']:.0f} | {case['energy_j']:.3f} |"
            )
    return "\n".join(lines) if len(lines) > 2 else "No case grows or rises again."


def _order(case: Mapping[str, Any]) -> tuple[Any, ...]:
    return case["ends"], case["mass"], case["frequency_hz"], case["damping"], case["mount"]


def draw(load: Load, has: Has) -> Any:
    """Return the figure: growth by mass and frequency, a panel for each mount and damping."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    stored = [load(name) for name in COMMANDS if has(name)]
    rows = [
        (result["cycle_ms"], damping, result["cases"])
        for result in stored
        for damping in sorted({case["damping"] for case in result["cases"]})
    ]
    mounts = sorted({case["mount"] for result in stored for case in result["cases"]})
    figure = Figure(figsize=(12.0, 0.6 + 2.1 * len(rows)), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(rows), len(mounts), squeeze=False)
    image = None
    for (cycle_ms, damping, cases), line in zip(rows, axes, strict=True):
        for mount, axis in zip(mounts, line, strict=True):
            part = [case for case in cases if (case["damping"], case["mount"]) == (damping, mount)]
            image = _panel(axis, part)
            axis.set_title(f"{cycle_ms:g} ms, {100 * damping:g} %, {mount / 1e3:g} N/mm", size=9)
    bar = figure.colorbar(image, ax=axes, shrink=0.8, extend="max")
    bar.set_label("amplitude at the end / after the kick")
    figure.supxlabel("frequency of the body, Hz", size=9)
    figure.supylabel("mass of the body, kg", size=9)
    return figure


def _panel(axis: Any, part: list[Mapping[str, Any]]) -> Any:
    """Colour the growth of each body, write its peak force, frame what is not stable."""
    import numpy as np
    from matplotlib.patches import Rectangle

    masses = sorted({case["mass"] for case in part})
    frequencies = sorted({case["frequency_hz"] for case in part})
    values = np.full((len(masses), len(frequencies)), np.nan)
    for case in part:
        at = frequencies.index(case["frequency_hz"]), masses.index(case["mass"])
        value = min(stability_map.growth(case), LARGEST_SHOWN)
        values[at[::-1]] = value
        axis.text(*at, f"{case['force_n']:.0f}", ha="center", va="center", size=7,
                  color="white" if abs(value - 1.0) > 0.7 else "black")  # fmt: skip
        if stability_map.is_unstable(case):
            dashed = "-" if case["ends"] == stability_map.GROWS else ":"
            frame = Rectangle((at[0] - 0.46, at[1] - 0.46), 0.92, 0.92, fill=False, ls=dashed, lw=2)
            axis.add_patch(frame)
    image = axis.imshow(values, cmap="RdBu_r", vmin=0.0, vmax=LARGEST_SHOWN, origin="lower",
                        aspect="auto")  # fmt: skip
    axis.set_xticks(range(len(frequencies)), [f"{each:g}" for each in frequencies], size=8)
    axis.set_yticks(range(len(masses)), [f"{each:g}" for each in masses], size=8)
    return image


if __name__ == "__main__":
    from docs.make import results

    draw(results.load, results.is_stored).savefig(FILE)
