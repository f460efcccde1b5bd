"""Overrides and variants: what they change, and what they leave alone."""

from dataclasses import replace

import pytest

from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.simulators.harness import setup
from linemate.simulators.harness.cell import variants
from linemate.simulators.harness.cell.variants import UnknownVariantError
from linemate.simulators.harness.setup import OverrideError


def test_an_override_changes_its_key_and_nothing_else() -> None:
    plain = setup.make("wheel")
    changed = setup.override(plain, ["tracking.rule.tentative=2e-3"])
    tracking = replace(plain.tracking, rule=replace(plain.tracking.rule, tentative=2e-3))
    assert changed == replace(plain, tracking=tracking)


def test_truth_and_settings_are_kept_apart() -> None:
    made = setup.make("wheel", ["scenario.conveyor.events.0.acceleration=0.13"])
    assert made.scenario.events[0].acceleration == -0.13
    assert made.task.conveyor.deceleration == setup.make("wheel").task.conveyor.deceleration


def test_the_end_of_a_key_is_enough_where_it_is_unique() -> None:
    assert setup.make("wheel", ["feed_forward=false"]).control.feed_forward is False
    assert setup.make("wheel", ["camera.dropout_rate=0.1"]).scenario.camera.dropout_rate == 0.1


@pytest.mark.parametrize(
    ("override", "what"),
    [
        ("tracking.rule.tentativ=1", "near are tracking.rule.tentative"),
        ("dropout_rate=0.1", "could be"),
        ("tracking.rule.tentative", "KEY=VALUE"),
        ("tracking.rule.tentative=-1", "greater than"),
        ("tracking.rule.tentative=x", "valid number"),
        ("tracking.rule.tentative=.nan", "finite"),
        ("tracking.rule.tentative={", "YAML"),
        ("tracking.classifier=best", "tracking.classifier"),
        ("control.servos=[]", "control.servos"),
    ],
)
def test_an_override_that_does_not_fit_is_refused_with_its_reason(override: str, what: str) -> None:
    with pytest.raises(OverrideError, match="--set") as caught:
        setup.make("wheel", [override])
    assert what in str(caught.value)


def test_an_override_of_the_truth_keeps_to_the_files_ranges() -> None:
    with pytest.raises(OverrideError, match="at most 1"):
        setup.make("wheel", ["scenario.camera.dropout_rate=1.5"])


def test_every_variant_changes_the_settings_but_the_default_under_any_name() -> None:
    plain = (TrackingSettings(), setup.shipped_control())
    # The oracle's settings are the default's: it also gets the true future.
    same = {"default", variants.ORACLE, plain[0].classifier.value}
    for name in variants.VARIANTS:
        assert (variants.apply(name, *plain) == plain) == (name in same), name


def test_an_unknown_variant_names_those_that_there_are() -> None:
    with pytest.raises(UnknownVariantError, match="no-damping"):
        setup.make("wheel", variant="no-luck")


def test_the_cycle_on_the_command_line_is_the_plants() -> None:
    assert setup.make("wheel", cycle_ms=4).scenario.cycle_s == 0.004


def test_the_daemons_knowledge_of_the_sway_is_that_of_its_commissioning() -> None:
    sway = "scenario.body.carrier=[{frequency_hz: 0.62, damping: 0.02}]"
    for name, known in (
        ("wheel", True),
        ("quiet", True),
        ("world/nominal", True),
        ("world/sway-1.0hz", False),
        ("world/swing-along-1.2hz", False),
        ("plant-floor", False),
    ):
        assert (setup.make(name).tracking.sway.gain_deviation < 0.01) is known, name
    # The plant's truth is none of the daemon's settings.
    assert setup.make("wheel", [sway]).tracking == setup.make("wheel").tracking
