"""Sway across the line from seen stops: found within its deviations, or none."""

import math

import pytest
from swaying_body import Body, recorded, viewed
from traces import CAMERA

from linemate.daemon.core.tracking.settings import SwingMode, TrackingSettings
from linemate.daemon.identification import sway_across
from linemate.daemon.identification.sway_across import across_findings, identify_across

TRACKING = TrackingSettings(swing=())


@pytest.fixture(autouse=True)
def _narrow_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search at four frequencies: the whole range takes a minute."""
    monkeypatch.setattr(sway_across, "SEARCH_HZ", (0.84, 0.96))


def across(*bodies: Body) -> list[SwingMode]:
    traces = [recorded(body) for body in bodies]
    return identify_across(*viewed(traces), traces, CAMERA, TRACKING)


@pytest.mark.row
@pytest.mark.parametrize(("axis", "gain"), [(2, 0.3), (2, -0.3), (0, 0.3)])
def test_a_sway_across_the_line_is_found_as_a_swing_without_a_turn(axis: int, gain: float) -> None:
    (mode,) = across(Body(frequency_hz=0.9, gain=gain, axis=axis, seed=3))
    assert mode.frequency_hz == pytest.approx(0.9, abs=3.0 * mode.spread * 0.9)
    assert mode.gain == pytest.approx(abs(gain), abs=3.0 * mode.gain_deviation)
    assert mode.gain_deviation < 0.1
    levers = [0.0, 0.0, 0.0]
    levers[axis] = math.copysign(sway_across.LONGEST_LEVER, gain)
    assert list(mode.levers) == levers
    names = [line.name for line in across_findings([mode])]
    assert names == [f"sway across, {'xyz'[axis]}: {what}" for what in ("frequency", "gain")]


@pytest.mark.row
def test_recordings_that_do_not_show_it_one_by_one_show_it_together(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sway_across, "ACROSS", (2,))
    bodies = [Body(frequency_hz=0.9, gain=0.2, axis=2, lateral=0.8e-3, seed=i) for i in range(3)]
    assert across(bodies[0]) == []
    (mode,) = across(*bodies)
    assert mode.gain == pytest.approx(0.2, abs=3.0 * mode.gain_deviation)


def test_a_sway_along_the_line_is_none_across_it() -> None:
    assert across(Body()) == []


def test_recordings_without_a_stop_show_no_sway() -> None:
    assert across(Body(ramps=())) == []
