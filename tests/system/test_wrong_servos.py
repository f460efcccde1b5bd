"""Servos that are not those identified: the wheel is assembled, and the mount is not torn."""

import pytest

from linemate.simulators.harness import lockstep, setup
from linemate.simulators.judge.judge import judge

LARGEST_N = 160.0  # at a contact with a tool that lags


@pytest.mark.row
@pytest.mark.parametrize(
    ("key", "factor", "shift"),
    [("dead_time", 1.0, -0.024), ("frequency_hz", 0.5, 0.0), ("frequency_hz", 2.0, 0.0)],
)
def test_a_robot_whose_servos_are_misjudged_assembles(
    key: str, factor: float, shift: float
) -> None:
    """24 ms of dead time left out dragged the released tool along the hub: 192 N, 12 mm."""
    servos = setup.make("plant-floor").control.servos
    values = [max(factor * getattr(servo, key) + shift, 0.0) for servo in servos]
    overrides = [f"control.servos.{i}.{key}={value}" for i, value in enumerate(values)]
    run = lockstep.run(setup.make("plant-floor", overrides), 0)
    result = judge(run)
    assert run.collision is None
    assert result["assembled"]
    assert result["contact_force_n"]["max"] < LARGEST_N
