"""Firmness: proved by a calm force, lost by one that swings, a push or growth."""

import math

import pytest

from linemate.daemon.core.tracking.touch import firmness
from linemate.daemon.core.tracking.touch.firmness import PROOF_S, SWING_N, UNKNOWN, Firmness

DT = 0.012
FIRM = Firmness(is_firm=True)


def after(
    seconds: float, amplitude: float, frequency_hz: float, state: Firmness, *, is_calm: bool = True
) -> Firmness:
    """The state after a force that oscillates along y."""
    for k in range(round(seconds / DT)):
        force = amplitude * math.sin(math.tau * frequency_hz * k * DT)
        state = firmness.advance(state, (0.0, force, 0.0), DT, is_calm=is_calm, gives_way=False)
    return state


def test_a_calm_force_proves_an_object_firm_after_a_second() -> None:
    assert after(PROOF_S - 0.05, 0.0, 1.0, UNKNOWN).is_firm is None
    assert after(PROOF_S + 0.05, 0.0, 1.0, UNKNOWN).is_firm


def test_a_force_that_is_not_calm_starts_the_proof_again() -> None:
    begun = after(0.9, 0.0, 1.0, UNKNOWN)
    disturbed = after(0.1, 0.0, 1.0, begun, is_calm=False)
    assert after(0.9, 0.0, 1.0, disturbed).is_firm is None


@pytest.mark.parametrize("frequency_hz", [0.7, 1.0, 2.0, 4.7, 10.0])
def test_a_force_that_swings_shows_that_an_object_gives_way(frequency_hz: float) -> None:
    seconds = 0.5 * (firmness.TURNS + 1.5) / frequency_hz
    assert after(seconds, 2.0 * SWING_N, frequency_hz, FIRM).is_firm is False


def test_a_small_swing_is_normal() -> None:
    assert after(10.0, 0.9 * SWING_N, 2.0, FIRM).is_firm


def test_a_bend_to_one_side_and_back_is_no_swing() -> None:
    bent = after(0.5, 5.0 * SWING_N, 2.0, FIRM)
    assert bent.is_firm
    # A second one later is none either.
    assert after(0.5, 5.0 * SWING_N, 2.0, after(1.2, 0.0, 1.0, bent)).is_firm


def test_a_push_or_a_growing_oscillation_shows_that_an_object_gives_way() -> None:
    still = (0.0, 0.0, 0.0)
    assert firmness.advance(FIRM, still, DT, is_calm=True, gives_way=True).is_firm is False


def test_an_object_that_has_given_way_is_not_firm_again() -> None:
    assert after(5.0, 0.0, 1.0, Firmness(is_firm=False)).is_firm is False


def test_next_to_a_running_line_no_object_is_firm_and_one_that_gave_way_stays_so() -> None:
    assert firmness.without_proof(FIRM).is_firm is None
    assert after(PROOF_S - 0.05, 0.0, 1.0, firmness.without_proof(FIRM)).is_firm is None
    assert firmness.without_proof(Firmness(is_firm=False)).is_firm is False


def swung(seconds: float, frequency_hz: float, state: Firmness = UNKNOWN) -> Firmness:
    """The state after a swing, where half a period below 0.2 s is quick."""
    for k in range(round(seconds / DT)):
        force = 2.0 * SWING_N * math.sin(math.tau * frequency_hz * k * DT)
        state = firmness.advance(
            state, (0.0, force, 0.0), DT, is_calm=False, gives_way=False, quick_s=0.2
        )
    return state


def test_a_quick_swing_counts_for_as_long_as_it_lasts() -> None:
    assert swung(3.0, 4.0).quick_s == pytest.approx(3.0, abs=0.3)
    assert swung(3.0, 1.5).quick_s < 0.3
    assert swung(1.0, 1.5, swung(3.0, 4.0)).quick_s < 0.3
