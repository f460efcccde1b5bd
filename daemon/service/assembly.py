"""Parts of a daemon, built from its configuration: links, command port, recorder, production."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from linemate.daemon.config.config import LoadedConfig
from linemate.daemon.config.section_checks import group_ids
from linemate.daemon.config.settings import ControllerKind, Corrections
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.recording.recorder import MIB, Recorder, Rotation
from linemate.daemon.service.command_server import CommandPort, Handler, Snapshot
from linemate.daemon.service.endpoints import LocalEndpoint, UdpEndpoint
from linemate.daemon.service.event_log import EventLog
from linemate.daemon.service.parameter_service import ParameterService
from linemate.daemon.service.production.production_cell import ProductionCell
from linemate.daemon.service.production.record_files import RecordFiles
from linemate.drivers.udp.camera_udp import CameraLink
from linemate.drivers.udp.robot_udp import OnTelegram, RobotLink
from linemate.drivers.udp.stream_udp import StreamLink
from linemate.protocol.controller_link import ControllerLink
from linemate.protocol.egm.egm_codec import EgmCodec
from linemate.protocol.egm.egm_link import EgmLink
from linemate.protocol.fanuc.fanuc_link import FanucLink
from linemate.protocol.fanuc.handshake import FanucHandshake
from linemate.protocol.numeric_peer import parse_peer
from linemate.protocol.rsi.codec import RsiCodec
from linemate.protocol.rsi.rsi_link import RsiLink
from linemate.protocol.sensors.camera_codec import CameraDecoder
from linemate.protocol.sensors.distance import DistanceDecoder
from linemate.protocol.sensors.wrench import BAUD_RATES, make_decoder, make_host

if TYPE_CHECKING:
    from linemate.drivers.can_bus import CanLink
    from linemate.drivers.serial_port import SerialLink


def build_link(station: LoadedConfig, parameters: Parameters) -> ControllerLink:
    """Return the codec and the rules of the robot's controller."""
    if station.config.controller.kind is ControllerKind.EGM:
        return _build_egm(station, parameters)
    on_rail = parameters.controller.arm.linear_axis
    fanuc = station.config.fanuc
    if station.config.controller.kind is ControllerKind.FANUC:
        return FanucLink(
            fanuc.version,
            is_coupled=fanuc.coupled,
            on_rail=on_rail,
            signals_byte=fanuc.signals_byte,
        )
    settings, file = station.config.rsi, station.controller_file
    assert file is not None  # noqa: S101 - ``config.load`` refuses RSI without its file
    return RsiLink(
        RsiCodec(file, settings.linear_axes, constants=settings.constants),
        absolute=settings.corrections is Corrections.ABSOLUTE,
        on_rail=on_rail,
    )


def build_robot(station: LoadedConfig, on_telegram: OnTelegram, cycle: Cycle) -> RobotLink:
    """Return the link that answers the robot's controller."""
    fanuc, endpoint = station.config.fanuc, station.robot
    # Not a function of ours: it is called between a telegram and its reply.
    ready_reply = partial(getattr, cycle, "ready_reply")
    if station.config.controller.kind is ControllerKind.FANUC and endpoint.peer is not None:
        return StreamLink(
            on_telegram,
            endpoint.bind,
            endpoint.port,
            (endpoint.peer, fanuc.peer_port),
            FanucHandshake(fanuc.version, fanuc.cycle_ms),
            ready_reply=ready_reply,
            on_open=cycle.listen,
            on_start=cycle.restart_exchange,
        )
    return RobotLink(
        on_telegram,
        endpoint.bind,
        endpoint.port,
        ready_reply=ready_reply,
        on_open=cycle.listen,
        newest_acts=cycle.rules.newest_acts,
    )


def _build_egm(station: LoadedConfig, parameters: Parameters) -> EgmLink:
    settings = station.config.egm
    return EgmLink(
        EgmCodec(settings.linear_axes, settings.robotware),
        station.cycle_s,
        on_rail=parameters.controller.arm.linear_axis,
        signals=settings.signals and settings.robotware == 7,
    )


def build_sensors(
    station: LoadedConfig, cycle: Cycle
) -> Iterator[CanLink | CameraLink | SerialLink]:
    """Yield the link of each configured sensor; its samples go to the cycle."""
    config = station.config
    if config.distance is not None and station.dbc is not None:
        from linemate.drivers.can_bus import CanLink  # python-can is 5 % of a start

        distance = config.distance
        decoder = DistanceDecoder(
            station.dbc,
            distance.message,
            distance.signal,
            strength=distance.strength,
            can_id=distance.can_id,
            step=distance.step_m,
        )
        yield CanLink(distance.can, decoder, cycle.samples.distance.push)
    if config.camera is not None:
        camera = config.camera
        poses = CameraDecoder(camera.frame, camera.object, camera.source)
        peer = None if camera.peer is None else parse_peer(camera.peer)
        yield CameraLink(poses, cycle.samples.camera.push, camera.bind, camera.port, peer=peer)
    if config.force_torque is not None:
        from linemate.drivers.serial_port import SerialLink  # serialx is 6 % of a start

        wrench = config.force_torque
        yield SerialLink(
            wrench.url,
            make_decoder(wrench.device),
            cycle.samples.wrench.push,
            baudrate=wrench.baudrate or BAUD_RATES[wrench.device],
            host=partial(make_host, wrench.device) if wrench.dialogue else None,
        )


def build_command_port(station: LoadedConfig, handle: Handler, telemetry: Snapshot) -> CommandPort:
    """Return the command port with the configured endpoints."""
    command = station.config.command
    local = udp = None
    if command.socket is not None:
        operators = command.operate_groups
        local = LocalEndpoint(
            station.path.parent / command.socket,
            operate_gids=None if operators is None else group_ids(operators),
            view_gids=group_ids(command.view_groups),
        )
    if command.udp is not None:
        settings = command.udp
        udp = UdpEndpoint(settings.bind, settings.port, station.keys, settings.allow_remote)
    return CommandPort(handle, telemetry, local, udp)


def incident_directory(station: LoadedConfig) -> Path | None:
    """Return the directory of incident files, None without one."""
    name = station.config.realtime.incidents
    return None if name is None else station.path.parent / name


def build_recorder(station: LoadedConfig) -> Recorder | None:
    """Return the recorder, None if it is not configured."""
    settings = station.config.recording
    if settings is None:
        return None
    return Recorder(
        station.path.parent / settings.directory,
        dict(station.texts),
        settings.queue,
        settings.chunk_kib * 1024,
        settings.flush_s,
        Rotation(
            settings.rotate_mib * MIB,
            settings.rotate_min * 60.0,
            None if settings.total_mib is None else settings.total_mib * MIB,
            settings.reserve_mib * MIB,
        ),
    )


def build_production(
    station: LoadedConfig,
    cycle: Cycle,
    variants: Mapping[str, Parameters],
    parameters: ParameterService,
    events: EventLog,
    recorder: Recorder | None,
    refusal: Callable[[str], str | None],
) -> ProductionCell | None:
    """Return the production cell, None if it is not configured.

    Args:
        variants: compiled tasks by variant.
        refusal: returns why an order is refused now, for reasons of the process.
    """
    settings = station.config.production
    if settings is None:
        return None
    directory = None if settings.records is None else station.path.parent / settings.records

    def use_task(compiled: Parameters, variant: str) -> None:
        parameters.follow(compiled)
        events.add(f"task {compiled.tracker.task.name} of variant {variant} is in force")

    def recorded_file() -> str | None:
        return recorder.status.file if recorder is not None and recorder.status.recording else None

    return ProductionCell(
        settings,
        cycle,
        variants,
        RecordFiles(directory, settings.days),
        refusal=refusal,
        on_event=events.add,
        on_task=use_task,
        recording=recorded_file,
    )
