"""An assembly after the commissioning step that measures the arm: measure, identify, overlay."""

import pytest

from linemate.simulators.harness import setup
from linemate.simulators.lab.campaign import CampaignJob, execute
from linemate.simulators.lab.world import measured_arm

SEED = 3
LARGEST_CONTROL_MM = 0.12
LARGEST_IMPACT_MM = 0.4


@pytest.mark.row
def test_an_arm_that_was_measured_is_as_exact_as_its_drives() -> None:
    plain = setup.make("world/uncalibrated-arm")
    measured = measured_arm.identified(plain, SEED)
    known, unknown = execute([CampaignJob(each, SEED) for each in (measured, plain)], 1)
    assert known["assembled"]
    assert known["control_error"]["approach"]["max_mm"] < LARGEST_CONTROL_MM
    assert known["total_error"]["impact"]["max_mm"] < LARGEST_IMPACT_MM
    assert known["false_alarms"]["confirmed"] == 0
    assert unknown["control_error"]["approach"]["max_mm"] > 2.0 * LARGEST_CONTROL_MM
