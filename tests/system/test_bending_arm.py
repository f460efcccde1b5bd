"""Assemblies with an arm that winds up, with and without ``control.windup``."""

import pytest

from linemate.simulators.harness.setup import make
from linemate.simulators.lab.campaign import CampaignJob, execute

DEPTH = 0.6e-3
LARGEST_CONTROL_MM = 0.5
LARGEST_IMPACT_MM = 0.4


def overrides(travel: float, *, is_configured: bool) -> tuple[str, ...]:
    plant = "scenario.robot.effects.windup"
    axis = f"{{depth: {DEPTH}, travel: {travel}}}"
    known = f"control.windup=[{axis}, {axis}, {axis}]"
    lines = (
        f"{plant}.depth=[{DEPTH}, {DEPTH}, {DEPTH}, 0, 0, 0]",
        f"{plant}.travel=[{', '.join([str(travel)] * 6)}]",
    )
    return (*lines, known) if is_configured else lines


@pytest.mark.row
@pytest.mark.parametrize("travel", [1e-3, 10e-3])
def test_an_arm_whose_windup_is_known_is_as_exact_as_one_without(travel: float) -> None:
    jobs = [
        CampaignJob(make("wheel", overrides(travel, is_configured=known)), 3)
        for known in (True, False)
    ]
    known, unknown = execute(jobs, 1)
    assert known["assembled"]
    assert known["control_error"]["approach"]["max_mm"] < LARGEST_CONTROL_MM
    assert known["total_error"]["impact"]["max_mm"] < LARGEST_IMPACT_MM
    assert known["false_alarms"]["confirmed"] == 0
    assert unknown["control_error"]["approach"]["max_mm"] > 2.0 * LARGEST_CONTROL_MM
