"""A distance sensor that is noisier than configured does not lead the robot wrongly."""

import pytest

from linemate.simulators.harness import lockstep, setup
from linemate.simulators.judge.judge import judge


@pytest.mark.parametrize(("factor", "seed"), [(0.2, 1), (0.5, 1)])
def test_a_noise_that_is_given_too_small_moves_no_free_tool(factor: float, seed: int) -> None:
    """The gate rejected good readings, and the free tool was moved with 355 to 428 N."""
    deviation = factor * setup.make("plant-floor").tracking.distance.deviation
    case = setup.make("plant-floor", [f"tracking.distance.deviation={deviation}"])
    result = judge(lockstep.run(case, seed))
    assert result["outcome"] == "assembled", result["reason"]
    assert result["contact_force_n"]["max"] < 120.0
