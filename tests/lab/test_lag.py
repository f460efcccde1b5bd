"""The sweeps over lag and cycle: what a cell with a lag is made of."""

import pytest

from linemate.simulators.lab import lag


def test_the_slowest_axis_has_the_lag_and_the_daemon_knows_it() -> None:
    made = lag.lagging(0.12)
    dead_times = [axis.dead_time_s for axis in made.scenario.robot.axes]
    assert max(dead_times) == pytest.approx(0.12)
    for servo, dead_time_s in zip(made.control.servos, dead_times, strict=True):
        assert servo.dead_time == pytest.approx(dead_time_s, abs=1e-4)
    assert made.controller == "fanuc"
    assert made.control.drift.longer == 0.0


def test_a_lag_that_grows_does_so_in_the_plant_and_may_do_so_in_the_daemon() -> None:
    made = lag.lagging(0.084, 0.096)
    assert made.scenario.robot.effects.warming.growth_s == 0.096
    assert made.control.drift.longer == pytest.approx(0.11)
    assert max(servo.dead_time for servo in made.control.servos) == pytest.approx(0.084, abs=1e-4)
