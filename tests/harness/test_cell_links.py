"""Links of a run by a cell's configuration, and a six-axis arm through the whole chain."""

from argparse import Namespace
from dataclasses import replace

import pytest

from linemate.daemon.config.settings import CameraSettings, Corrections
from linemate.simulators.devices.robot_plant import RobotPlant
from linemate.simulators.harness import cell_links, lockstep, setup
from linemate.simulators.harness.cell import cell_files
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.harness.setup import Setup
from linemate.simulators.lab.faults.dst_cells import TASKS
from linemate.simulators.plants.world import World


def made(file: str, controller: str | None = None, cycle_ms: float | None = None) -> Setup:
    """Return the set-up of one of the fault campaign's cells, short and easy."""
    cell = cell_files.chosen(Namespace(cell=None, config=TASKS / file, task=None))
    easy = ("scenario.body.tilt=0.02", "scenario.body.offset_range=[0.01, 0.01, 0.01]")
    times = ("scenario.lead_in_s=2.0", "scenario.duration_s=3.2", "nutrunner_s=0.2")
    return setup.make(
        "no-stop", (*easy, *times), controller=controller, cycle_ms=cycle_ms, cell=cell
    )


@pytest.mark.parametrize(("controller", "cycle_ms"), [("rsi", 12.0), ("fanuc", 8.0), ("egm", 12.0)])
def test_a_six_axis_arm_assembles_behind_each_controller(controller: str, cycle_ms: float) -> None:
    evidence = lockstep.run(made("dst_six_axes.yaml", controller, cycle_ms), 0)
    assert evidence.collision is None
    assert (evidence.rows.contact == 1).any()
    assert (evidence.rows.command[:, 6] == 0.0).all()


def test_a_configuration_without_a_force_sensor_has_none_in_the_run() -> None:
    links = cell_links.of(made("dst_no_force.yaml").station)
    assert links.device is None


def test_the_device_and_the_message_are_those_of_the_configuration() -> None:
    assert cell_links.of(made("dst_ft300.yaml").station).device == "robotiq-ft300"
    plain, other = (
        cell_links.of(made("dst_daemon.yaml").station),
        cell_links.of(made("dst_tf03.yaml").station),
    )
    assert plain.encoder.can_id != other.encoder.can_id


def test_the_camera_sends_the_names_that_are_expected() -> None:
    made_setup = made("dst_six_axes.yaml")
    assert made_setup.station is not None
    config = replace(made_setup.station.config, camera=CameraSettings(object="panel", source="c2"))
    station = replace(made_setup.station, config=config)
    sender = cell_links.of(station).sender
    assert (sender.source, sender.frame, sender.object_id) == ("c2", "camera", "panel")


def test_a_sensor_that_the_cell_needs_is_named() -> None:
    made_setup = made("dst_six_axes.yaml")
    assert made_setup.station is not None
    config = replace(made_setup.station.config, camera=None)
    station = replace(made_setup.station, config=config)
    with pytest.raises(SetupError, match="no section camera"):
        cell_links.of(station)


def test_a_relative_configuration_has_a_relative_controller() -> None:
    made_setup = made("dst_six_axes.yaml")
    station = made_setup.station
    assert station is not None
    rsi = replace(station.config.rsi, corrections=Corrections.RELATIVE)
    station = replace(station, config=replace(station.config, rsi=rsi))
    made_setup = replace(made_setup, station=station)
    scenario = made_setup.scenario
    compiled = lockstep.parameters(
        made_setup.task, made_setup.urdf, made_setup.tracking, made_setup.control, 0.012
    )
    body = replace(scenario.body, offset=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.0), swings=())
    plant = RobotPlant(World(replace(scenario, body=body)))
    controller, _ = cell_links.pair(made_setup, plant, compiled)
    assert controller.config.mode == "relative"  # type: ignore[attr-defined]
