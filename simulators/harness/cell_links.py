"""Both ends of a run's links in virtual time, as the cell's configuration sets them up.

Invariants:
    Without a configuration: the shipped cell's links.
    The daemon's end is built by the daemon; the emulated end has the same files, never its state.
"""

from collections.abc import Callable
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
from linemate.simulators.devices.rsi_controller import ControllerConfig, RobotReading, RsiController
from linemate.simulators.devices.sensing.camera_sender import CameraSender
from linemate.simulators.harness.cell import families
from linemate.simulators.harness.cell.cell_truth import axis_limits
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.harness.sensor_links import CAMERA_CLOCK_NS, SensorEnds
from linemate.simulators.harness.setup import Setup
from linemate.simulators.plants.scenario import Vector7


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
    emulated = controller(station, plant.read, plant.start, cycle_s, limits)
    if isinstance(emulated, FanucController):
        emulated.on_reply(packets.write_short(PacketKind.START, emulated.config.version))
    return emulated, build_link(station, parameters)


def controller(
    station: LoadedConfig,
    read: Callable[[], RobotReading],
    pose: Vector7,
    cycle_s: float,
    limits: tuple[AxisLimit, ...],
    *,
    timeout_rule: Literal["total", "row"] = "total",
    first: int | None = None,
) -> RsiController | FanucController | EgmController:
    """Return the emulated controller that a configuration belongs to; FANUC's has no stream yet.

    Args:
        read: gives the robot's state at a cycle's start.
        pose: where its robot stands, A1..A6 [rad], E1 [m].
        limits: of the emulated controller, A1..A6 and E1.
        timeout_rule: how RSI counts late replies.
        first: its first counter, None for its family's own.
    """
    config = station.config
    if config.controller.kind is ControllerKind.FANUC:
        fanuc = FanucConfig(
            cycle_s,
            config.fanuc.version,
            config.fanuc.coupled,
            has_rail=station.task.file.arm.linear_axis,
            signals_byte=config.fanuc.signals_byte,
            limits=limits,
        )
        return FanucController(read, pose, fanuc)
    if config.controller.kind is ControllerKind.EGM:
        egm = EgmConfig(cycle_s, first or 0, robotware=config.egm.robotware, limits=limits)
        return EgmController(read, pose, egm)
    assert station.controller_file is not None  # noqa: S101 - ``config.load`` refuses RSI without it
    relative = config.rsi.corrections is Corrections.RELATIVE
    rsi = ControllerConfig(
        cycle_s,
        first_ipoc=ControllerConfig().first_ipoc if first is None else first,
        timeout_rule=timeout_rule,
        mode="relative" if relative else "absolute",
        limits=limits,
    )
    return RsiController(station.controller_file, read, pose, rsi)
