"""A controller whose dead time grows from 84 to 180 ms in one assembly: the control error stays.

One whole run, about 10 s: the drift must be followed before, in and after contact.
"""

from dataclasses import replace

from linemate.simulators.harness import lockstep, setup
from linemate.simulators.judge.judge import judge

RESTED_S, WARM_S = 0.084, 0.180
LARGEST_MM = 0.5


def rested(growth_s: float, overrides: tuple[str, ...] = ()) -> setup.Setup:
    """Return a cell whose controller lags by the rested dead time more than the servos do."""
    overrides = (f"scenario.robot.effects.warming.growth_s={growth_s}", *overrides)
    made = setup.make("wheel", overrides, controller="fanuc")
    later = RESTED_S - max(axis.dead_time_s for axis in made.scenario.robot.axes)
    axes = tuple(
        replace(axis, dead_time_s=axis.dead_time_s + later) for axis in made.scenario.robot.axes
    )
    servos = tuple(
        replace(servo, dead_time=servo.dead_time + later) for servo in made.control.servos
    )
    return replace(
        made,
        scenario=replace(made.scenario, robot=replace(made.scenario.robot, axes=axes)),
        control=replace(made.control, servos=servos),
    )


def test_a_dead_time_that_drifts_from_84_to_180_ms_costs_no_half_millimetre() -> None:
    made = rested(WARM_S - RESTED_S, ("control.drift.longer=0.11",))
    result = judge(lockstep.run(made, 0))
    assert result["assembled"]
    assert result["limits"]["violations"] == 0
    for window in ("approach", "impact", "contact", "restart"):
        assert result["control_error"][window]["max_mm"] < LARGEST_MM, window
