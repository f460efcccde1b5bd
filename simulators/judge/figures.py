"""Figures 4 and 5 of the paper, and the errors over time, from the rows of a run.

Invariants:
    Rows in, matplotlib figures out; no file, no pyplot state.
    Positions are in the conveyor's frame c (x down, y travel, z to the car), relative to
        the nominal contact pose at s = 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from linemate.simulators.judge import judge
from linemate.simulators.judge.rows import CLAMPED, PHASES, Floats, Rows

# part_in_base at s = 0: position m, columns of the conveyor's frame (-Z_b, Y_b, X_b).
NOMINAL_POSITION: Final = np.array((2.20, 0.0, 1.10))
NOMINAL_ROTATION: Final = np.array(((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)))

COLOURS: Final = ("#0072b2", "#d55e00", "#009e73")
GREY: Final = "#8a8a8a"
STYLE: Final[Any] = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 9.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.dpi": 100.0,
    "savefig.dpi": 200.0,
}


def rotations(poses: Floats) -> Floats:
    """Turn unit quaternions w, x, y, z of poses (N, 7) into rotation matrices (N, 3, 3)."""
    w, x, y, z = (poses[:, i] for i in range(3, 7))
    entries = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in entries], axis=-2)


def rotation_vectors(matrices: Floats) -> Floats:
    """Take the logarithm of rotation matrices (N, 3, 3): rotation vectors (N, 3) [rad].

    Good below half a turn, which no deviation from a nominal pose comes near.
    """
    skew = 0.5 * np.stack(
        (
            matrices[:, 2, 1] - matrices[:, 1, 2],
            matrices[:, 0, 2] - matrices[:, 2, 0],
            matrices[:, 1, 0] - matrices[:, 0, 1],
        ),
        axis=-1,
    )
    sine = np.linalg.norm(skew, axis=-1)
    cosine = 0.5 * (np.trace(matrices, axis1=1, axis2=2) - 1.0)
    angle = np.arctan2(sine, cosine)
    small = sine < 1e-9
    factor = np.where(small, 1.0, angle / np.where(small, 1.0, sine))
    return np.asarray(skew * factor[:, None])


def deviation(poses: Floats, reference: Floats) -> tuple[Floats, Floats]:
    """Return poses (N, 7) in reference poses (N, 7): translation [m], rotation vector [rad]."""
    back = np.swapaxes(rotations(reference), 1, 2)
    shift = np.einsum("nij,nj->ni", back, poses[:, :3] - reference[:, :3])
    return shift, rotation_vectors(back @ rotations(poses))


def from_nominal(poses: Floats) -> tuple[Floats, Floats]:
    """Return poses (N, 7) relative to the nominal contact pose at s = 0 [m], [rad]."""
    shift = (poses[:, :3] - NOMINAL_POSITION) @ NOMINAL_ROTATION
    return shift, rotation_vectors(NOMINAL_ROTATION.T @ rotations(poses))


def trajectories(rows: Rows, result: Mapping[str, Any]) -> Figure:
    """Draw Fig. 4: fused sensed trajectory x_f dashed, computed trajectory x_t solid."""
    with rc_context(STYLE):
        figure, (left, right) = _panels("position [m]", "orientation [deg]")
        time = rows.t
        for poses, style, width in ((rows.target, "-", 1.1), (rows.sensed, (0, (4, 2)), 0.9)):
            shift, turn = from_nominal(poses)
            for i, colour in enumerate(COLOURS):
                left.plot(time, shift[:, i], color=colour, ls=style, lw=width)
                right.plot(time, np.degrees(turn[:, i]), color=colour, ls=style, lw=width)
        left.plot(time, rows.unit_position, color="black", ls="-.", lw=0.9)
        _events((left, right), rows, result)
        keys = _axis_keys()
        keys += [
            Line2D([], [], color="0.3", label="$x_t$ computed"),
            Line2D([], [], color="0.3", ls=(0, (4, 2)), lw=0.9, label="$x_f$ sensed"),
            Line2D([], [], color="black", ls="-.", lw=0.9, label="conveyor"),
        ]
        figure.legend(handles=keys, ncols=6, loc="outside lower center")
        return figure


def control_error(rows: Rows, result: Mapping[str, Any]) -> Figure:
    """Draw Fig. 5: the true tcp against the committed x_c, seen from x_c [mm], [mrad]."""
    with rc_context(STYLE):
        figure, (left, right) = _panels("position error [mm]", "orientation error [mrad]")
        clamped = (rows.contact == CLAMPED)[:, np.newaxis]
        shift, turn = deviation(np.where(clamped, rows.tcp_rigid, rows.tcp), rows.target)
        for axes, values, limit in ((left, 1e3 * shift, 1.0), (right, 1e3 * turn, 2.0)):
            for bound in (-limit, limit):
                axes.axhline(bound, color=GREY, lw=0.6, ls=(0, (1, 2)))
            for i, colour in enumerate(COLOURS):
                axes.plot(rows.t, values[:, i], color=colour, lw=0.8)
            # What is beyond three times the limit may leave the picture, which is of the rest.
            reach = float(np.nanmax(np.abs(values[rows.t >= 0.0]), initial=0.0))
            bound = min(max(1.2 * limit, 1.05 * reach), 3.0 * limit)
            axes.set_ylim(-bound, bound)
        _events((left, right), rows, result)
        keys = _axis_keys()
        keys.append(Line2D([], [], color=GREY, lw=0.6, ls=(0, (1, 2)), label="limit"))
        figure.legend(handles=keys, ncols=4, loc="outside lower center")
        return figure


def errors_apart(rows: Rows, result: Mapping[str, Any]) -> Figure:
    """Draw the norms of what adds up to the total error, as the judge has them, kept apart."""
    with rc_context(STYLE):
        figure, (left, right) = _panels("position error [mm]", "orientation error [mrad]")
        errors = judge.compute_errors(rows)
        names = {
            "plan": ("plan, $x_f - x_c$", COLOURS[2], 0.8),
            "prediction": ("prediction, true $-$ $x_f$", COLOURS[1], 0.8),
            "control": ("control, tcp $-$ $x_c$", COLOURS[0], 0.8),
            "total": ("total, tcp $-$ true", "0.1", 0.6),
        }
        for key, (name, colour, width) in names.items():
            for axes, values in zip((left, right), errors[key], strict=True):
                axes.plot(rows.t, 1e3 * values, color=colour, lw=width, label=name)
        for axes in (left, right):
            axes.set_yscale("log")
            axes.set_ylim(1e-2, None)
        _events((left, right), rows, result)
        handles, labels = left.get_legend_handles_labels()
        figure.legend(handles, labels, ncols=4, loc="outside lower center")
        return figure


def _axis_keys() -> list[Line2D]:
    return [
        Line2D([], [], color=colour, label=f"${name}$")
        for colour, name in zip(COLOURS, "xyz", strict=True)
    ]


def _panels(left: str, right: str) -> tuple[Figure, tuple[Axes, Axes]]:
    figure = Figure(figsize=(7.2, 3.1), layout="constrained")
    FigureCanvasAgg(figure)
    first, second = figure.subplots(1, 2, sharex=True)
    for axes, name in ((first, left), (second, right)):
        axes.set_ylabel(name)
        axes.set_xlabel("time [s]")
        axes.margins(x=0.0)
        axes.axhline(0.0, color=GREY, lw=0.4)
    return figure, (first, second)


def _events(panels: tuple[Axes, Axes], rows: Rows, result: Mapping[str, Any]) -> None:
    """Mark true stops, starts and contact, and the retreat, along the top."""
    marks = [
        (float(entry["onset_s"]), str(entry["event"]))
        for entry in result.get("detection") or ()
        if entry.get("onset_s") is not None
    ]
    marks += [
        (float(rows.t[int(np.argmax(holds))]), name)
        for name, holds in (
            ("contact", rows.contact == CLAMPED),
            ("retreat", rows.phase == PHASES.index("retreat")),
        )
        if holds.any()
    ]
    for axes in panels:
        # As in the paper, the plot begins when the car reaches the start position.
        axes.set_xlim(max(0.0, float(rows.t[0])), float(rows.t[-1]))
        for when, name in marks:
            axes.axvline(when, color=GREY, lw=0.5, ls=(0, (5, 4)), zorder=0)
            axes.annotate(
                name,
                (when, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(1.5, 2.0),
                textcoords="offset points",
                fontsize=7.5,
                color="0.35",
                ha="left" if name != "stop" else "right",
            )
