"""Families of robot controllers in a run: emulated controller, daemon's link, both files.

Invariants:
    The two ends share the wire. Sizes of the emulated controller never reach the daemon's side.
    Without an exchange that the daemon must ask for, the controller speaks from the first cycle.
"""

from typing import Any

from linemate.protocol.controller_link import ControllerLink
from linemate.protocol.fanuc import packets
from linemate.protocol.fanuc.fanuc_link import FanucLink
from linemate.protocol.fanuc.packets import PacketKind
from linemate.protocol.rsi.codec import RsiCodec, parse_config
from linemate.protocol.rsi.rsi_link import RsiLink
from linemate.simulators.devices.fanuc.fanuc_controller import FanucConfig, FanucController
from linemate.simulators.devices.links.controllers import EmulatedController
from linemate.simulators.devices.robot_plant import RobotPlant
from linemate.simulators.devices.rsi_controller import ControllerConfig, RsiController

RSI, FANUC = "rsi", "fanuc"
FAMILIES = (RSI, FANUC)
CYCLE_MS = {RSI: 12.0, FANUC: 8.0}
"""Period of a family's controller unless another one is asked for [ms]."""

CYCLES_MS = {RSI: (4.0, 12.0), FANUC: (4.0, 8.0)}
"""Periods of the demonstration [ms]."""

RSI_CONFIG = "rsi_joints.xml"
LOOPBACK = "127.0.0.1"
SIGNALS_BYTE = 0


def pair(
    family: str, plant: RobotPlant, cycle_s: float, *, on_rail: bool
) -> tuple[EmulatedController, ControllerLink]:
    """Return the two ends of the exchange in virtual time, the stream begun.

    Args:
        on_rail: the arm stands on a linear axis.
    """
    if family == FANUC:
        config = FanucConfig(cycle_s=cycle_s, signals_byte=SIGNALS_BYTE)
        fanuc = FanucController(plant.read, plant.start, config)
        fanuc.on_reply(packets.write_short(PacketKind.START, config.version))
        link = FanucLink(config.version, on_rail=on_rail, signals_byte=SIGNALS_BYTE)
        return fanuc, link
    rsi = parse_config(_shipped(RSI_CONFIG))
    controller = RsiController(rsi, plant.read, plant.start, ControllerConfig(cycle_s=cycle_s))
    return controller, RsiLink(RsiCodec(rsi), on_rail=on_rail)


def daemon_sections(family: str, cycle_s: float, port: int) -> dict[str, Any]:
    """Return the daemon's sections of the controller.

    Args:
        port: UDP port that the controller listens on, if it must be asked.
    """
    cycle_ms = round(1e3 * cycle_s)
    if family == FANUC:
        section = {
            "peer": LOOPBACK,
            "peer_port": port,
            "cycle_ms": cycle_ms,
            "rail": True,
            "signals_byte": SIGNALS_BYTE,
        }
        return {"controller": {"kind": FANUC}, "fanuc": section}
    return {"rsi": {"port": 0, "cycle_ms": cycle_ms}}


def emulator_sections(family: str, port: int) -> dict[str, Any]:
    """Return the emulator's sections of the controller.

    Args:
        port: UDP port that the controller listens on, if it must be asked.
    """
    if family == FANUC:
        return {"fanuc": {"signals_byte": SIGNALS_BYTE}, "robot_bind": [LOOPBACK, port]}
    return {}


def _shipped(name: str) -> bytes:
    from linemate.daemon.config.files import PROTOCOL_DATA

    return (PROTOCOL_DATA / name).read_bytes()
