"""Both ends of a run's links in virtual time, as the cell's configuration sets them up.

Invariants:
    Without a configuration: the shipped cell's links.
    The daemon's end is built by the daemon; the emulated end has the same files, never its state.
"""

from dataclasses import replace
from typing import Literal

from linemate.daemon.config.config import LoadedConfig
from linemate.daemon.config.settings import ControllerKind, Corrections
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.service.assembly import build_link
from linemate.protocol.controller_link import ControllerLink
from linemate.protocol.fanuc import packets
from linemate.protocol.fanuc.packets import PacketKind
from linemate.protocol.sensors.camera_codec import CameraDecoder
from linemate.protocol.sensors.distance import DistanceDecoder, DistanceEncoder
from linemate.simulators.devices.egm.egm_controller import EgmConfig, EgmController
from linemate.simulators.devices.fanuc.fanuc_controller import FanucConfig, FanucController
from linemate.simulators.devices.limit_judge import AxisLimit
from linemate.simulators.devices.links.controllers import EmulatedController
from linemate.simulators.devices.robot_plant import RobotPlant
from linemate.simulators.devices.rsi_controller import ControllerConfig, RsiController
from linemate.simulators.devices.sensing.camera_sender import CameraSender
from linemate.simulators.harness.cell import families
from linemate.simulators.harness.cell.cell_truth import axis_limits
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.harness.sensor_links import CAMERA_CLOCK_NS, SensorEnds
from linemate.simulators.harness.setup import Setup


def of(station: LoadedConfig | None) -> SensorEnds:
    """Return both ends of the sensors' links; None: those of the shipped cell.

    Raises:
        SetupError: a sensor that a run needs is not configured.
    """
    if station is None:
        return SensorEnds()
    config, dbc = station.config, station.dbc
    distance, camera, wrench = config.distance, config.camera, config.force_torque
    if distance is None or dbc is None or camera is None:
        name = "camera" if camera is None else "distance"
        raise SetupError(f"the configuration has no section {name}: the emulated cell needs it")
    message = (dbc, distance.message, distance.signal)
    size = {"strength": distance.strength, "can_id": distance.can_id, "step": distance.step_m}
    sender = CameraSender(clock_offset_ns=CAMERA_CLOCK_NS)
    sender = CameraSender(
        camera.source or sender.source,
        camera.frame or sender.frame,
        camera.object or sender.object_id,
        CAMERA_CLOCK_NS,
    )
    return SensorEnds(
        DistanceEncoder(*message, **size),  # type: ignore[arg-type]
        DistanceDecoder(*message, **size),  # type: ignore[arg-type]
        sender,
        CameraDecoder(camera.frame, camera.object, camera.source),
        None if wrench is None else wrench.device,
        config.watch,
    )


def pair(
    setup: Setup, plant: RobotPlant, parameters: Parameters
) -> tuple[EmulatedController, ControllerLink]:
    """Return the controller and the daemon's link to it, the stream begun."""
    cycle_s = setup.scenario.cycle_s
    on_rail = parameters.controller.arm.linear_axis
    limits = axis_limits(setup.urdf, setup.task)
    station = setup.station
    if station is None or station.config.controller.kind.value != setup.controller:
        return families.pair(setup.controller, plant, cycle_s, on_rail=on_rail, limits=limits)
    emulated = controller(station, plant, cycle_s, limits, on_rail=on_rail)
    if isinstance(emulated, FanucController):
        emulated.on_reply(packets.write_short(PacketKind.START, emulated.config.version))
    return emulated, build_link(station, parameters)


def controller(
    station: LoadedConfig,
    plant: RobotPlant,
    cycle_s: float,
    limits: tuple[AxisLimit, ...],
    *,
    on_rail: bool,
    timeout_rule: Literal["total", "row"] = "total",
) -> RsiController | FanucController | EgmController:
    """Return the emulated controller that a configuration belongs to; FANUC's has no stream yet.

    Args:
        limits: of the emulated controller, A1..A6 and E1.
        on_rail: the arm stands on a linear axis.
        timeout_rule: how RSI counts late replies.
    """
    config = station.config
    if config.controller.kind is ControllerKind.FANUC:
        plain = FanucConfig(cycle_s, config.fanuc.version, config.fanuc.coupled, limits=limits)
        own = replace(plain, has_rail=on_rail, signals_byte=config.fanuc.signals_byte)
        return FanucController(plant.read, plant.start, own)
    if config.controller.kind is ControllerKind.EGM:
        guided = EgmConfig(cycle_s, robotware=config.egm.robotware, limits=limits)
        return EgmController(plant.read, plant.start, guided)
    assert station.controller_file is not None  # noqa: S101 - ``config.load`` refuses RSI without its file
    relative = config.rsi.corrections is Corrections.RELATIVE
    rsi = ControllerConfig(
        cycle_s,
        timeout_rule=timeout_rule,
        mode="relative" if relative else "absolute",
        limits=limits,
    )
    return RsiController(station.controller_file, plant.read, plant.start, rsi)
