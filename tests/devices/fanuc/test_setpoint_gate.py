"""Limits of a FANUC controller's setpoints, coasting and the stop."""

import pytest

from linemate.simulators.devices.fanuc.setpoint_gate import SetpointGate
from linemate.simulators.devices.limit_judge import AxisLimit

T = 0.008
LIMIT = AxisLimit(-1.0, 1.0, 2.0, 50.0, 20_000.0)


def gate(speed: float = 0.0) -> SetpointGate:
    """Standing at 0, or there with a steady speed."""
    made = SetpointGate((0.0,), (LIMIT,), T)
    made.speed = (speed,)
    return made


@pytest.mark.parametrize(
    ("speed", "wanted", "says"),
    [
        (1.9, 1.01, "position 1.01, -1..1"),
        (1.95, 2.05 * T, "speed 2.05, limit 2"),
        (0.0, 60.0 * T * T, "acceleration 60, limit 50"),
        (0.0, -60.0 * T * T, "acceleration -60, limit 50"),
    ],
)
def test_a_setpoint_beyond_a_limit_is_named(speed: float, wanted: float, says: str) -> None:
    assert f"axis 1 {says}" in (gate(speed).excess((wanted,)) or "")


def test_a_jerk_beyond_its_limit_is_named() -> None:
    tight = SetpointGate((0.0,), (AxisLimit(-1.0, 1.0, 2.0, 50.0, 1000.0),), T)
    assert "axis 1 jerk 1250, limit 1000" in (tight.excess((10.0 * T * T,)) or "")
    assert tight.excess((7.9 * T * T,)) is None


def test_a_setpoint_that_is_not_a_number_is_named() -> None:
    assert gate().excess((float("nan"),)) is not None


def test_the_rounding_of_a_reported_joint_is_no_excess() -> None:
    tight = SetpointGate((0.0,), (AxisLimit(-1.0, 1.0, 2.0, 50.0, 0.1),), T)
    assert tight.excess((2.5e-7,)) is None
    assert tight.excess((1e-6,)) is not None


def test_it_coasts_at_its_last_speed_and_stops_at_the_limit_of_acceleration() -> None:
    made = gate()
    made.accept((0.001,))
    made.accept((0.003,))
    made.coast()
    assert made.position == pytest.approx((0.005,))
    assert made.acceleration == (0.0,)
    made.speed = (1.0,)
    cycles = 0
    while made.speed != (0.0,):
        made.stop()
        cycles += 1
    assert cycles == 3  # 1 m/s at 50 m/s^2 in 20 ms
