"""Way and speed of an emergency retraction."""

import math

import numpy as np
import pytest
from msgspec import structs

from linemate.daemon.core import parameters
from linemate.daemon.core.tracking.goal.rest_state import at_rest
from linemate.daemon.core.tracking.goal.retraction import withdraw
from linemate.daemon.core.tracking.touch.withdrawal import (
    ENDS_S,
    FASTEST,
    RAMP_S,
    SLOWEST,
    WAY,
    Withdrawal,
    compile_withdrawal,
    lag,
)
from linemate.simulators.harness.setup import Setup
from linemate.simulators.plants.scenario import Scenario


@pytest.mark.parametrize("speed", [SLOWEST, 0.3, FASTEST])
def test_a_retraction_goes_its_way_within_its_duration_at_its_speed(speed: float) -> None:
    withdrawal = Withdrawal(speed)
    times = np.linspace(-0.1, withdrawal.duration + 0.1, 4001)
    way = withdrawal.way(times)
    assert (way[times <= 0.0] == 0.0).all()
    assert way[times >= withdrawal.duration] == pytest.approx(WAY)
    speeds = np.diff(way) / np.diff(times)
    assert speeds.min() > -1e-9
    assert speeds.max() == pytest.approx(speed, rel=1e-6)


def test_a_retraction_that_begins_again_goes_the_rest_of_its_way() -> None:
    times = np.linspace(0.0, 1.0, 1001)
    for gone in (0.02, 0.1, WAY, 0.2):
        way = Withdrawal(FASTEST).way(times, gone)
        assert way[-1] == pytest.approx(max(WAY - gone, 0.0))
        assert (np.diff(way) >= -1e-12).all()


@pytest.mark.parametrize("gone", [0.0, 0.1, 0.2, 0.4])
def test_a_retraction_goes_on_for_what_is_left_of_a_second(gone: float) -> None:
    withdrawal = Withdrawal(0.3, 0.3)
    further = withdrawal.further(0.0)
    assert withdrawal.lasting(further) == pytest.approx(ENDS_S)
    assert WAY + further > 0.21
    times = np.linspace(0.0, ENDS_S, 2001)
    way = withdrawal.way(times, gone, further)
    assert way[-1] == pytest.approx(max(WAY + further - gone, 0.0))
    assert (np.diff(way) >= -1e-12).all()
    assert Withdrawal(SLOWEST, 0.3).further(0.0) == 0.0


@pytest.mark.parametrize(
    ("gap", "further"), [(0.02, 0.08), (0.08, 0.02), (0.1, 0.0), (0.15, 0.0), (0.4, 0.0)]
)
def test_a_retraction_leads_no_farther_than_the_task_does(gap: float, further: float) -> None:
    assert Withdrawal(FASTEST, 0.25).further(gap) == pytest.approx(further)
    assert Withdrawal(FASTEST).further(gap) == 0.0


def test_an_object_is_taken_up_as_gradually_as_the_way_is() -> None:
    missing = lag(np.array([-0.1, 0.0, RAMP_S, 1.0]))
    assert missing == pytest.approx([0.0, 0.0, RAMP_S / 2.0, RAMP_S / 2.0])


def test_a_retraction_from_a_moving_object_keeps_the_free_speed_of_the_tcp() -> None:
    free, conveyor = 0.34, 0.106
    along = compile_withdrawal(free, conveyor, 0.3).speed
    assert 0.9 * free < math.hypot(along, conveyor) < free


def test_a_retraction_is_not_endless_where_the_tcp_may_hardly_move() -> None:
    assert compile_withdrawal(0.05, 0.106, 0.3).speed == SLOWEST
    assert compile_withdrawal(1.5, 0.106, 0.3).speed == FASTEST


@pytest.mark.parametrize("leaving", [0.0, 0.15, 0.3, 0.6])
def test_a_retraction_in_the_tasks_own_retreat_makes_the_tool_no_faster(leaving: float) -> None:
    """The sum of both was beyond the tcp's limit: the arm left its way, the free tool swung."""
    cell = Setup(Scenario())
    tracker = parameters.build(cell.task, cell.urdf, cell.tracking, cell.control, 0.012).tracker
    programme = np.zeros((tracker.steps + 1, 6))
    programme[:, 2] = -leaving * tracker.span
    state = structs.replace(at_rest(tracker, np.zeros(6), 0.0), withdrawn=0.0)
    state, goal = withdraw(tracker, state, programme, None, programme)
    speeds = -np.diff(goal[:, 2]) / tracker.cycle_s
    fastest = max(tracker.withdrawal.speed, leaving)
    assert speeds.max() == pytest.approx(fastest, rel=1e-3)
    assert -goal[-1, 2] >= 0.99 * tracker.withdrawal.way(tracker.span)[-1]
