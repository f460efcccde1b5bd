"""Cases: what they change is the truth, and only what they say."""

from dataclasses import replace

import pytest

from linemate.simulators.harness import setup
from linemate.simulators.harness.cell.variants import VARIANTS, SetupError
from linemate.simulators.lab import cases
from linemate.simulators.lab.cases import CASES, TUNED, VERIFY, WRONG, Case


@pytest.mark.parametrize("name", CASES)
def test_every_case_can_be_made(name: str) -> None:
    made = CASES[name].setup()
    assert made.variant == CASES[name].variant
    assert made.scenario.cycle_s * 1e3 == pytest.approx(CASES[name].cycle_ms)


@pytest.mark.parametrize("name", [name for name in WRONG if not WRONG[name].sets])
def test_a_wrong_model_changes_the_plant_and_no_setting(name: str) -> None:
    wrong, nominal = WRONG[name].setup(), setup.make("wheel", cycle_ms=12.0)
    assert wrong.scenario != nominal.scenario
    assert replace(wrong, scenario=nominal.scenario) == nominal


def test_what_was_learnt_is_what_the_plant_has_become() -> None:
    servos = WRONG["servo-0.9-learnt"].setup()
    assert [model.frequency_hz for model in servos.control.servos] == pytest.approx(
        [axis.frequency_hz for axis in servos.scenario.robot.axes], rel=0.002
    )
    modes = WRONG["mode-0.9-known"].setup()
    assert [mode.frequency_hz for mode in modes.control.effector] == pytest.approx(
        modes.scenario.effector.frequency_hz, rel=0.002
    )


def test_the_plant_differs_by_the_factor_that_the_case_is_named_after() -> None:
    nominal = setup.make("wheel").scenario
    slower = WRONG["servo-0.9"].setup().scenario.robot.axes
    assert [axis.frequency_hz for axis in slower] == pytest.approx(
        [0.9 * axis.frequency_hz for axis in nominal.robot.axes]
    )
    camera = WRONG["camera-2"].setup().scenario.camera
    assert camera.sigma == pytest.approx(2.0 * nominal.camera.sigma)
    # Twice the noise under a covariance that still speaks of once.
    assert camera.sigma * camera.covariance_honesty == pytest.approx(nominal.camera.sigma)
    softer = WRONG["mode-0.9"].setup().scenario.effector.frequency_hz
    assert softer == pytest.approx(tuple(0.9 * f for f in nominal.effector.frequency_hz))


def test_a_case_is_what_its_command_says() -> None:
    case = WRONG["mode-0.9"]
    assert "--set 'scenario.effector.frequency_hz=[4.5, 4.05" in case.command()
    assert setup.make("wheel", case.overrides(), cycle_ms=12.0) == case.setup()
    assert CASES["fine-4ms"].command().startswith("linemate-sim campaign --cycle-ms 4 --set ")


def test_what_a_variant_takes_away_an_overlay_does_not_bring_back() -> None:
    overlay = {"tracking": {"swing": [{"frequency_hz": 0.7}], "distance": {"deviation": 5e-4}}}
    made = CASES["no-swing"].setup(overlay)
    assert made.tracking.swing == ()
    assert made.tracking.distance.deviation == 5e-4
    # A case that sets the sensor has the last word about it.
    assert CASES["fine"].setup(overlay).tracking.distance.deviation == 5.8e-5


def test_a_path_that_the_scenario_does_not_have_is_refused() -> None:
    with pytest.raises((KeyError, SetupError)):
        Case("no such", scaled=(("conveyor.events.0.colour", 2.0),)).setup()


def test_seeds_that_verify_are_not_tuned_on() -> None:
    assert not set(TUNED) & set(VERIFY)
    assert all(case.tuned <= len(TUNED) and case.verify <= len(VERIFY) for case in CASES.values())
    assert cases.NOMINAL in CASES
    assert {case.variant for case in CASES.values()} <= set(VARIANTS)
