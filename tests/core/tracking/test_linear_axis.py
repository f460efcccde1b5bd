"""The plan of the linear axis, and how near it stays to the conveyor unit in whole runs."""

from dataclasses import replace

import numpy as np
import pytest

from linemate.daemon.core.tracking import linear_axis
from linemate.simulators.harness import lockstep
from linemate.simulators.harness.setup import make
from linemate.simulators.judge.rows import STATES, Rows
from linemate.simulators.plants.conveyor_plan import ConveyorEvent

STEPS = 8
SPEED, RAMP = 0.106, 1.0
NEAR_M = 0.05  # the rail's distance from the object's way (catalogue X11)


def run(plan: linear_axis.AxisPlan, goals: np.ndarray, dt: float) -> np.ndarray:
    """Ends of the plan after each goal [m]."""
    ends = []
    for goal in goals:
        plan = linear_axis.advance(plan, float(goal), RAMP, dt)
        ends.append(plan.positions[-1])
    return np.array(ends)


@pytest.mark.parametrize("dt", [0.012, 0.004])
def test_a_step_appends_one_position_and_changes_none(dt: float) -> None:
    plan = linear_axis.at_rest(1.0, STEPS)
    for goal in np.arange(200) * SPEED * dt:
        later = linear_axis.advance(plan, float(goal), RAMP, dt)
        assert len(later.positions) == STEPS + 1
        assert (later.positions[:-1] == plan.positions[1:]).all()
        plan = later


@pytest.mark.parametrize("dt", [0.012, 0.004])
def test_the_plan_lags_behind_a_moving_goal_by_its_delay_alone(dt: float) -> None:
    times = np.arange(round(3.0 / dt)) * dt
    ends = run(linear_axis.at_rest(0.0, STEPS), SPEED * times, dt)
    late = linear_axis.delay(RAMP, dt)
    assert late == pytest.approx(0.5 * RAMP, abs=1.5 * dt)
    assert ends[-1] == pytest.approx(SPEED * (times[-1] - late), abs=1e-6)


@pytest.mark.parametrize("dt", [0.012, 0.004])
def test_a_goal_that_jumps_moves_the_axis_within_bounds_and_without_overshoot(dt: float) -> None:
    jump, rate = 0.03, linear_axis.RATE / RAMP
    ends = run(linear_axis.at_rest(0.0, STEPS), np.full(round(3.0 / dt), jump), dt)
    speed = np.diff(ends) / dt
    acceleration = np.diff(speed) / dt
    assert ends[-1] == pytest.approx(jump, abs=1e-6)
    assert speed.min() >= 0.0
    assert ends.max() <= jump + 1e-12
    assert speed.max() <= 0.28 * rate * jump  # of three equal lags: 2 exp(-2)
    assert np.abs(acceleration).max() <= 0.24 * rate**2 * jump  # (sqrt(2) - 1) exp(sqrt(2) - 2)


def test_an_axis_at_rest_stays_there() -> None:
    plan = linear_axis.at_rest(0.3, STEPS)
    for _ in range(10):
        plan = linear_axis.advance(plan, 0.3, RAMP, 0.012)
    assert (plan.positions == 0.3).all()


def rail_lead(rows: Rows) -> np.ndarray:
    """By how much the rail is ahead of the conveyor unit since the task's clock started [m]."""
    begun = int(np.argmax(np.nan_to_num(rows.task_time) > 0.0))
    rail, unit = rows.joints[begun:, 6], rows.unit_position[begun:]
    lead = (rail - rail[0]) - (unit - unit[0])
    moving = np.isin(rows.state[begun:], [STATES.index(s) for s in ("track", "contact")])
    assert moving.sum() > 300
    return np.asarray(lead[moving])


RUNS = {
    "steady": (9.0, ()),
    "stop in free space": (5.5, (("stop", 2.5, 0.104),)),
    "stop and slow start": (13.0, (("stop", 5.0, 0.104), ("start", 7.0, 0.013))),
    "start eight times as quick as set": (10.0, (("stop", 5.0, 0.104), ("start", 7.0, 0.1))),
    "stop three times as hard as set": (9.0, (("stop", 6.5, 0.3),)),
}


SLOWEST = "stop and slow start"


@pytest.mark.long
@pytest.mark.row
@pytest.mark.parametrize(
    ("name", "classifier"),
    [*((name, "default") for name in RUNS), (SLOWEST, "rule"), (SLOWEST, "imm")],
)
def test_the_rail_stays_within_50_mm_of_the_conveyor_unit(name: str, classifier: str) -> None:
    seconds, events = RUNS[name]
    setup = make("wheel", [], variant=classifier, cycle_ms=None)
    scenario = setup.scenario
    orders = tuple(ConveyorEvent(*event) for event in events)  # type: ignore[arg-type]
    conveyor = replace(scenario.conveyor, events=orders)
    scenario = replace(scenario, duration_s=seconds, conveyor=conveyor)
    lead = rail_lead(lockstep.run(replace(setup, scenario=scenario), 1).rows)
    assert np.abs(lead).max() < NEAR_M
