"""Overlay of an identification: what a configuration refuses is left out, with its reason."""

import pytest

from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.core.inputs import Inputs
from linemate.daemon.identification import pipeline
from linemate.daemon.identification.outcome import Refusal
from linemate.daemon.identification.pipeline import IdentifyError, Recorded, fitting, identify
from linemate.daemon.recording.step_codec import StepRecord
from linemate.protocol.stamped_samples import DistanceSample

TEXTS = {
    "task": (DAEMON_DATA / "wheel.yaml").read_text(encoding="utf-8"),
    "urdf": (DAEMON_DATA / "arm.urdf").read_text(encoding="utf-8"),
}

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


def recorded(name: str, distances: tuple[float, ...], first: int = 0) -> Recorded:
    steps = [
        StepRecord(None, "idle", inputs_of(first + i, distance), {})
        for i, distance in enumerate(distances)
    ]
    return Recorded(name, TEXTS, steps)


def inputs_of(k: int, distance: float) -> Inputs:
    return Inputs(k, 12_000_000 * k, None, (DistanceSample(12_000_000 * k, distance),))


@pytest.mark.parametrize("copied", [recorded("b", (1.0, 2.0, 3.0)), recorded("b", (2.0, 3.0), 1)])
def test_a_recording_and_its_copy_are_not_used_together(copied: Recorded) -> None:
    with pytest.raises(IdentifyError, match="b: its steps are in a too"):
        identify([recorded("a", (1.0, 2.0, 3.0)), copied])


@pytest.mark.parametrize("other", [recorded("b", (1.0, 2.5)), recorded("b", (2.0, 3.0), 9)])
def test_other_steps_are_no_copy(other: Recorded) -> None:
    assert not pipeline._is_same(recorded("a", (1.0, 2.0, 3.0)), other)
