"""Figures of a contact: how tool and hub move against each other, and what the car takes up.

Invariants:
    Pure; of the plant's truth alone.
    The relative motion is that of the hub against the rigid tcp, which is the mount's deflection.
    While the clamp closes and the screws turn the hub, nothing is judged.
"""

from typing import Any

import numpy as np

from linemate.simulators.judge.rows import CLAMPED, Bools, Floats, Rows

SETTLED_S = 0.5
"""The clamp has closed and the touch has rung down this long after the catch."""

WINDOW_S = 1.0
"""An oscillation of 1 Hz and more shows its amplitude within this time."""


def contact_figures(rows: Rows, fixing: Bools) -> dict[str, Any] | None:
    """Return amplitudes and energies in contact; None without contact.

    ``oscillation_mm``: half of the largest side of the box that the relative motion fills in a
    window of a second: in the first one, the last one and the worst one.
    ``sway_mm``: the farthest that the carrier's modes moved the hub.
    ``energy_j``: work of the robot on the car relative to the conveyor: its end and its peak.
    A body without a source of energy of its own never gives back more than it got.

    Args:
        fixing: rows in which the screws are being fixed, (n,).
    """
    clamped = (rows.contact == CLAMPED) & np.isfinite(rows.relative).all(axis=1)
    if not clamped.any():
        return None
    settled = clamped & ~fixing & (rows.t >= rows.t[int(np.argmax(clamped))] + SETTLED_S)
    amplitudes = _amplitudes(rows.t, rows.relative * 1e3, settled)
    sway = np.linalg.norm(rows.sway[clamped, :3], axis=1) * 1e3
    energy = rows.energy[clamped]
    first, last, worst = (
        (amplitudes[0], amplitudes[-1], max(amplitudes)) if amplitudes else (None, None, None)
    )
    return {
        "oscillation_mm": {"first": first, "last": last, "worst": worst},
        "sway_mm": _round(sway.max()),
        "energy_j": {"last": _round(energy[-1]), "worst": _round(energy.max())},
    }


def _amplitudes(t: Floats, relative: Floats, judged: Bools) -> list[float]:
    """Half of the largest range in each window that is judged as a whole."""
    amplitudes: list[float] = []
    if len(t) < 2:
        return amplitudes
    length = max(2, round(WINDOW_S / float(np.median(np.diff(t)))))
    for begin in range(0, len(t) - length + 1, max(1, length // 4)):
        window = slice(begin, begin + length)
        if judged[window].all():
            amplitudes.append(_round(0.5 * np.ptp(relative[window], axis=0).max()))
    return amplitudes


def _round(value: float) -> float:
    return round(float(value), 6)
