"""Overlay of an identification: what a configuration refuses is left out, with its reason."""

from linemate.daemon.identification.outcome import Refusal
from linemate.daemon.identification.pipeline import fitting

GOOD = {
    "tracking": {"distance": {"deviation": 0.0004}},
    "control": {"effector": [{"frequency_hz": 5.0, "damping": 0.02}] * 6},
}


def test_an_overlay_that_fits_stays_as_it_is() -> None:
    assert fitting(GOOD) == (GOOD, {})


def test_a_noise_below_its_range_is_refused_and_the_rest_is_kept() -> None:
    overlay = {**GOOD, "tracking": {**GOOD["tracking"], "tactile": {"deflection": 6e-06}}}
    kept, unfit = fitting(overlay)
    assert kept == GOOD
    (line,) = unfit.values()
    assert line.name == "tracking.tactile.deflection"
    assert isinstance(line.outcome, Refusal)
    assert "should be greater than or equal to 0.00001, not 6e-06" in line.outcome.reason
    assert overlay["tracking"]["tactile"] == {"deflection": 6e-06}


def test_a_mode_out_of_its_range_takes_its_list_with_it() -> None:
    modes = [{"frequency_hz": 5.0, "damping": 0.02}] * 5 + [{"frequency_hz": 1e9, "damping": 0.02}]
    kept, unfit = fitting({"control": {"effector": modes}})
    assert kept == {}
    assert list(unfit) == ["control.effector[5].frequency_hz"]


def test_several_values_are_refused_at_once() -> None:
    kept, unfit = fitting(
        {"tracking": {"tactile": {"deflection": 6e-06, "angle": 9.0, "gate": 20.0}}}
    )
    assert kept == {"tracking": {"tactile": {"gate": 20.0}}}
    assert len(unfit) == 2


def test_a_key_that_does_not_exist_is_refused_too() -> None:
    kept, unfit = fitting({"tracking": {"nonsense": 1.0}})
    assert kept == {}
    assert list(unfit) == ["tracking.nonsense"]
