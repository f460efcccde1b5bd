"""The cells of the fault campaign: what each differs in, and that its files fit together."""

from dataclasses import replace

import pytest

from linemate.daemon.commissioning.rehearsal import rehearse
from linemate.simulators.lab.faults import dst, dst_plan
from linemate.simulators.lab.faults.dst_cells import (
    CELLS,
    SHIPPED,
    axis_limits,
    compiled,
    rest_pose,
    scenario_of,
    station,
    station_of,
)
from linemate.simulators.lab.faults.dst_plan import OTHER_LINE, FaultPlan
from linemate.simulators.plants.conveyor_plan import Conveyor
from linemate.simulators.plants.scenario import Contact


@pytest.mark.parametrize("cell", CELLS)
def test_a_cell_has_files_that_fit_and_limits_for_seven_axes(cell: str) -> None:
    assert len(axis_limits(cell)) == len(rest_pose(cell)) == 7
    parameters = compiled(0.012, cell)
    assert rehearse(parameters).complaints == ()
    assert len(parameters.controller.limits.names) == (6 if cell == "six-axes" else 7)
    loaded = station_of(3.0, 4, cell)
    assert (loaded.cycle_s, loaded.config.realtime.lead_ms) == (0.004, 3.0)
    config = loaded.config
    device = None if config.force_torque is None else config.force_torque.device
    assert device == CELLS[cell].force_torque


def test_what_can_be_drawn_is_what_there_is() -> None:
    assert {SHIPPED, *dst.ASKED_CELLS} == set(CELLS)


def test_the_second_layout_tells_set_positions() -> None:
    tags = {element.tag for element in station("second-layout").controller_file.send}
    assert {"DEF_RIst", "DEF_RSol", "DEF_AIPos", "DEF_ASPos", "DEF_Delay"} <= tags


@pytest.mark.parametrize("cell", CELLS)
def test_every_run_has_the_shipped_clamp_and_the_cycle_that_the_controller_has(cell: str) -> None:
    scenario = scenario_of(FaultPlan(1, cell=cell, cycle_off=0.05))
    assert scenario.contact.release_s == Contact().release_s == 0.3
    assert scenario.contact.deflection_limit == Contact().deflection_limit
    assert scenario.cycle_s == pytest.approx(0.0126)


def test_a_cell_whose_sensor_shows_stops_too_late_has_a_line_that_announces_them() -> None:
    announced = station("tf03").task.file.conveyor.stop_input.bit
    assert announced is not None
    assert scenario_of(FaultPlan(1, cell="tf03")).conveyor.stop_signal.bit == announced
    assert scenario_of(FaultPlan(1)).conveyor.stop_signal.bit is None


def test_another_line_has_the_faults_of_each_plan_and_changes_that_no_task_file_states() -> None:
    for seed in range(40):
        plan, other = dst_plan.draw(seed, cell=SHIPPED), dst_plan.draw(seed, cell=OTHER_LINE)
        assert replace(other, cell=SHIPPED, events=plan.events) == plan
        onsets = [event.onset_s for event in other.events]
        assert onsets == sorted(onsets)
        assert dst_plan.draw(seed, cell=OTHER_LINE) == other
    lines = [dst_plan.draw(seed, cell=OTHER_LINE).events for seed in range(40)]
    stated = Conveyor().events[0].acceleration
    assert {len(events) for events in lines} == {2, 4}
    assert sum(events[0].acceleration != stated for events in lines) > 20
