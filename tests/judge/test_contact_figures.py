"""Figures of a contact on synthetic rows, whose result is known beforehand."""

import math

import numpy as np
import pytest

from linemate.simulators.judge.contact_figures import contact_figures
from linemate.simulators.judge.rows import CLAMPED, Rows, empty

CYCLE = 0.012
NOT_FIXING = np.zeros(1000, np.bool_)


def contact(amplitude: float, growth: float = 0.0, hz: float = 5.0) -> Rows:
    """Contact from 2 s to 10 s with an oscillation about 1 mm that grows."""
    rows = empty(1000)
    rows.t[:] = np.arange(1000) * CYCLE
    rows.contact[(rows.t >= 2.0) & (rows.t < 10.0)] = CLAMPED
    rows.relative[:] = 0.0
    rows.relative[:, 2] = -1e-3
    swing = amplitude * np.exp(growth * (rows.t - 2.0)) * np.sin(math.tau * hz * rows.t)
    rows.relative[:, 1] = swing
    rows.sway[:] = 0.0
    rows.sway[:, 1] = 3e-3 * np.sin(rows.t)
    rows.energy[:] = np.clip(rows.t - 2.0, 0.0, 3.0)
    rows.energy[rows.t > 6.0] = 2.0
    return rows


def test_a_run_without_contact_has_no_figures() -> None:
    assert contact_figures(empty(1000), NOT_FIXING) is None


def test_a_steady_oscillation_has_its_amplitude_in_every_window() -> None:
    figures = contact_figures(contact(0.8e-3), NOT_FIXING)
    assert figures is not None
    assert figures["oscillation_mm"] == pytest.approx(
        {"first": 0.8, "last": 0.8, "worst": 0.8}, rel=0.01
    )


def test_a_growing_oscillation_is_larger_at_the_end() -> None:
    figures = contact_figures(contact(0.1e-3, 0.5), NOT_FIXING)
    assert figures is not None
    shown = figures["oscillation_mm"]
    assert shown["last"] / shown["first"] == pytest.approx(math.exp(0.5 * 6.5), rel=0.15)
    assert shown["worst"] == shown["last"]


def test_sway_and_energy_are_those_of_the_contact() -> None:
    figures = contact_figures(contact(0.0), NOT_FIXING)
    assert figures is not None
    assert figures["sway_mm"] == pytest.approx(3.0, rel=0.01)
    assert figures["energy_j"] == pytest.approx({"last": 2.0, "worst": 3.0})


def test_what_the_screws_do_is_no_oscillation() -> None:
    rows = contact(0.2e-3)
    fixing = np.abs(rows.t - 6.0) <= 0.4
    rows.relative[fixing, 0] = 5e-3
    figures = contact_figures(rows, fixing)
    assert figures is not None
    assert figures["oscillation_mm"]["worst"] == pytest.approx(0.2, rel=0.02)


def test_a_short_contact_has_no_window() -> None:
    rows = contact(1e-3)
    rows.contact[rows.t > 3.0] = 0
    figures = contact_figures(rows, NOT_FIXING)
    assert figures is not None
    assert figures["oscillation_mm"] == {"first": None, "last": None, "worst": None}
