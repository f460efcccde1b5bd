"""A stop followed by a start around contact (catalogue X10), judged by the plant's truth."""

import pytest

from linemate.simulators.lab.faults import dst_run
from linemate.simulators.lab.faults.dst_plan import FaultPlan
from linemate.simulators.plants.conveyor_plan import ConveyorEvent

STOP, START = 0.104, 0.013  # as the task sets them [m/s^2]


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(("stop_s", "after_s"), [(0.85, 0.32), (0.95, 0.6), (1.15, 0.2)])
def test_a_stop_and_a_start_around_contact_leave_less_than_200_n_at_the_mount(
    stop_s: float, after_s: float, seed: int
) -> None:
    events = (
        ConveyorEvent("stop", stop_s, STOP),
        ConveyorEvent("start", round(stop_s + after_s, 3), START),
    )
    assert dst_run.run(FaultPlan(seed, duration_s=2.2, events=events)).violations == ()


@pytest.mark.parametrize(
    ("seed", "stop_s", "after_s"), [(2, 0.65, 0.2), (2, 0.7, 0.2), (4, 0.9, 0.2)]
)
def test_the_pull_of_a_clamp_that_closes_is_not_taken_for_a_motion_of_the_conveyor(
    seed: int, stop_s: float, after_s: float
) -> None:
    # The tool is 1 to 4 mm off the hub axis at the touch: the clamp bends the mount by that much.
    events = (
        ConveyorEvent("stop", stop_s, STOP),
        ConveyorEvent("start", round(stop_s + after_s, 3), START),
    )
    assert dst_run.run(FaultPlan(seed, duration_s=2.2, events=events)).violations == ()
