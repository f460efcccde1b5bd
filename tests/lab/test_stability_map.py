"""The stability map: cases that must stay calm, and what counts as calm."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from linemate.daemon.core.tracking.touch import compliance
from linemate.simulators.lab import stability_map, two_bodies
from linemate.simulators.lab.two_bodies import CarMode, ContactTrace, TwoBodies, TwoBodyCell

SOFT, STIFF = (TwoBodyCell(0.012, mount, dead_time=0.04) for mount in (50e3, 100e3))
CALM = (
    (SOFT, CarMode(100.0, 4.7, 0.009)),
    (SOFT, CarMode(300.0, 3.0, 0.009)),
    (SOFT, CarMode(1000.0, 4.7, 0.009)),
    (SOFT, CarMode(2000.0, 10.0, 0.009)),
    (STIFF, CarMode(100.0, 8.0, 0.009)),
    (STIFF, CarMode(300.0, 6.0, 0.009)),
    (STIFF, CarMode(1000.0, 3.0, 0.05)),
    (STIFF, CarMode(2000.0, 4.7, 0.05)),
)


@lru_cache(maxsize=3)
def begun(cell: TwoBodyCell) -> TwoBodies:
    return two_bodies.approached(cell)


def shown(loop: TwoBodies, mode: CarMode) -> dict[str, Any]:
    seconds = stability_map.WINDOWS * stability_map.WINDOW_S
    trace = two_bodies.kicked(loop, mode, seconds, stability_map.KICK)
    return stability_map.figures(trace, loop.cell.cycle_s)


def is_calm(figures: dict[str, Any], cell: TwoBodyCell) -> bool:
    """Tell whether a case is stable, without more force or energy than press and kick make."""
    largest_n = 2.4e-3 * cell.mount if cell is SOFT else 2.1e-3 * cell.mount
    return (
        figures["ends"] == stability_map.STABLE
        and figures["force_n"] < largest_n
        and figures["energy_j"] < 0.1
    )


@pytest.mark.row
@pytest.mark.parametrize(("cell", "mode"), CALM, ids=str)
def test_a_body_that_is_kicked_in_contact_comes_to_rest(cell: TwoBodyCell, mode: CarMode) -> None:
    figures = shown(begun(cell), mode)
    assert is_calm(figures, cell), figures


def test_the_tool_presses_until_a_case_ends() -> None:
    loop = begun(SOFT).fork()
    for _ in range(round(stability_map.WINDOWS * stability_map.WINDOW_S / SOFT.cycle_s)):
        outputs = loop.turn()
    assert outputs.contact
    assert abs(loop.force[2]) > 0.5e-3 * SOFT.mount  # of the 1 mm that the task presses


def test_a_target_that_follows_force_at_once_drives_the_body(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plain = two_bodies.identified()
    tactile = replace(plain.tracking.tactile, compliance=1.0)
    planted = replace(plain, tracking=replace(plain.tracking, tactile=tactile))
    monkeypatch.setattr(two_bodies, "identified", lambda: planted)
    loop = two_bodies.approached(SOFT)
    assert [is_calm(shown(loop, mode), SOFT) for _, mode in CALM[:2]] == [False, False]


RUNNING, STANDING = SOFT, replace(SOFT, speed=0.0)
UNKICKED = (
    (RUNNING, CarMode(300.0, 3.0, 0.009)),
    (RUNNING, CarMode(1000.0, 4.7, 0.009)),
    (STANDING, CarMode(300.0, 3.0, 0.009)),
    (STANDING, CarMode(1000.0, 4.7, 0.009)),
)
CALM_N = 60.0
PROVED = {"is_at_rest": True}


def around_a_late_kick(cell: TwoBodyCell, mode: CarMode) -> dict[str, Any]:
    seconds = stability_map.WINDOWS * stability_map.WINDOW_S
    trace = two_bodies.kicked(
        begun(cell), mode, seconds, stability_map.KICK, calm_s=stability_map.CALM_S
    )
    return stability_map.figures(trace, cell.cycle_s)


@pytest.mark.row
@pytest.mark.parametrize(("cell", "mode"), UNKICKED, ids=str)
def test_a_body_that_nothing_excites_is_not_driven_and_comes_to_rest_after_a_late_kick(
    cell: TwoBodyCell, mode: CarMode
) -> None:
    figures = around_a_late_kick(cell, mode)
    assert figures["calm_n"] < CALM_N, figures
    assert not stability_map.is_unstable(figures), figures


def test_a_proof_next_to_a_running_line_drives_a_body_that_nothing_excites(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # The lighter body: the delay of the clamped tool's merge drives 3 Hz most.
    plain = around_a_late_kick(*UNKICKED[0])
    advance = compliance.advance
    monkeypatch.setattr(
        compliance, "advance", lambda *given, **named: advance(*given, **named | PROVED)
    )
    driven = around_a_late_kick(*UNKICKED[0])
    assert driven["calm_n"] > CALM_N
    assert driven["calm_mm"] > 2.0 * plain["calm_mm"]


def trace(*amplitudes_mm: float, cycle_s: float = 0.012) -> ContactTrace:
    """Return a motion with an amplitude in each window."""
    length = round(stability_map.WINDOW_S / cycle_s)
    times = cycle_s * np.arange(length * len(amplitudes_mm))
    moved = np.repeat(np.array(amplitudes_mm) * 1e-3, length) * np.cos(20.0 * times)
    zeros = np.zeros(len(times))
    return ContactTrace(
        times, np.column_stack((zeros, moved, zeros)), np.zeros((len(times), 3)), zeros, ()
    )


@pytest.mark.parametrize(
    ("amplitudes_mm", "ends"),
    [
        ((1.0, 0.8, 0.6, 0.5), stability_map.STABLE),
        ((1.0, 0.8, 0.5, 0.9), stability_map.RISES),
        ((1.0, 1.1, 1.2, 1.3), stability_map.GROWS),
        ((0.1, 0.1, 0.1, 0.2), stability_map.STABLE),
        ((1.0, 0.8), stability_map.GROWS),
    ],
)
def test_a_case_is_judged_by_its_last_window(amplitudes_mm: tuple[float, ...], ends: str) -> None:
    figures = stability_map.figures(trace(*amplitudes_mm), 0.012)
    assert figures["ends"] == ends
    assert figures["amplitudes_mm"] == pytest.approx(amplitudes_mm, rel=0.01)


def test_a_whole_map_has_every_body_on_every_mount() -> None:
    chosen = stability_map.cases(12.0)
    assert len(set(chosen)) == len(chosen) == 192
    assert {case.cell.mount for case in chosen} == set(stability_map.MOUNTS)


def test_the_table_names_what_grows_and_what_broke_the_mount() -> None:
    mode = {"mount": 50e3, "damping": 0.009, "mass": 100.0, "frequency_hz": 2.0}
    calm = mode | stability_map.figures(trace(1.0, 0.5, 0.4, 0.3), 0.012)
    broken = mode | stability_map.figures(trace(1.0, 2.0), 0.012)
    printed = stability_map.text({"cases": [calm, broken]})
    assert printed.count("100 kg") == 1
    assert "grows: 100 kg, 2 Hz, 0.9 %, 50 N/mm: 1.00 2.00 mm" in printed
    assert "inf" in printed
