"""Estimation: the plan is held against a wrench at the time of the wrench."""

import pytest

from linemate.daemon.core.tracking.estimation import at_delay


@pytest.mark.parametrize(
    ("late", "value"), [(-1.0, 8.0), (0.0, 8.0), (0.5, 6.0), (1.0, 4.0), (1.75, 1.0), (9.0, 0.0)]
)
def test_a_plan_is_taken_at_the_time_of_the_wrench(late: float, value: float) -> None:
    assert at_delay((0.0, 4.0, 8.0), late) == pytest.approx(value)


def test_a_plan_of_one_step_is_the_same_at_any_time() -> None:
    assert at_delay((3.0,), 0.6) == 3.0
