"""Families of robot controllers in a run: emulated controller, daemon's link, both files.

Invariants:
    The two ends share the wire. Sizes of the emulated controller never reach the daemon's side.
    Without an exchange that the daemon must ask for, the controller speaks from the first cycle.
"""

from dataclasses import replace
from typing import Any, Literal

from linemate.protocol.controller_link import ControllerLink
from linemate.protocol.egm.egm_codec import EgmCodec
from linemate.protocol.egm.egm_link import EgmLink
from linemate.protocol.fanuc import packets
from linemate.protocol.fanuc.fanuc_link import FanucLink
from linemate.protocol.fanuc.packets import PacketKind
from linemate.protocol.rsi.codec import RsiCodec, parse_config
from linemate.protocol.rsi.rsi_link import RsiLink
from linemate.simulators.devices.egm.egm_controller import EgmConfig, EgmController
from linemate.simulators.devices.fanuc.fanuc_controller import FanucConfig, FanucController
from linemate.simulators.devices.limit_judge import LIMITS, AxisLimit
from linemate.simulators.devices.links.controllers import EmulatedController
from linemate.simulators.devices.robot_plant import RobotPlant
from linemate.simulators.devices.rsi_controller import ControllerConfig, RsiController
from linemate.simulators.plants.scenario import Axis, Robot, Scenario

RSI, FANUC, EGM = "rsi", "fanuc", "egm"
FAMILIES = (RSI, FANUC, EGM)
CYCLE_MS = {RSI: 12.0, FANUC: 8.0, EGM: 4.0}
"""Period of a family's controller unless another one is asked for [ms]."""

CYCLES_MS = {RSI: (4.0, 8.0, 12.0, 24.0), FANUC: (4.0, 8.0), EGM: (4.0, 8.0, 12.0, 24.0)}
"""Periods of the demonstration [ms]."""

RSI_CONFIG = "rsi_joints.xml"
LOOPBACK = "127.0.0.1"
SIGNALS_BYTE = 0
ROBOTWARE: Literal[7] = 7  # the generation that carries the tool's signals

_EGM_AXES = (
    Axis(8.0, 0.80, 0.016, 8.0),
    Axis(8.0, 0.80, 0.016, 8.0),
    Axis(8.5, 0.80, 0.016, 10.0),
    Axis(10.0, 0.85, 0.012, 14.0),
    Axis(10.0, 0.80, 0.012, 16.0),
    Axis(11.0, 0.80, 0.012, 20.0),
    Axis(7.0, 0.80, 0.020, 3.0),
)
"""Servos behind EGM's filter and position loop: 48 ms on a ramp, to which LpFilter adds 8 ms."""


def truth(family: str, scenario: Scenario) -> Scenario:
    """Return a scenario with the servos behind a family's controller, unless it has its own."""
    robot = scenario.robot
    if family != EGM or robot.axes != Robot().axes:
        return scenario
    return replace(scenario, robot=replace(robot, axes=_EGM_AXES))


def pair(
    family: str,
    plant: RobotPlant,
    cycle_s: float,
    *,
    on_rail: bool,
    limits: tuple[AxisLimit, ...] = LIMITS,
) -> tuple[EmulatedController, ControllerLink]:
    """Return the two ends of the exchange in virtual time, the stream begun.

    Args:
        on_rail: the arm stands on a linear axis.
        limits: of the emulated controller, A1..A6 and E1.
    """
    if family == FANUC:
        config = FanucConfig(
            cycle_s=cycle_s, has_rail=on_rail, signals_byte=SIGNALS_BYTE, limits=limits
        )
        fanuc = FanucController(plant.read, plant.start, config)
        fanuc.on_reply(packets.write_short(PacketKind.START, config.version))
        link = FanucLink(config.version, on_rail=on_rail, signals_byte=SIGNALS_BYTE)
        return fanuc, link
    if family == EGM:
        guided = EgmConfig(cycle_s, robotware=ROBOTWARE, limits=limits)
        egm = EgmController(plant.read, plant.start, guided)
        return egm, EgmLink(EgmCodec(robotware=ROBOTWARE), cycle_s, on_rail=on_rail)
    rsi = parse_config(_shipped(RSI_CONFIG))
    own = ControllerConfig(cycle_s=cycle_s, limits=limits)
    controller = RsiController(rsi, plant.read, plant.start, own)
    return controller, RsiLink(RsiCodec(rsi), on_rail=on_rail)


def daemon_sections(
    family: str, cycle_s: float, port: int, *, on_rail: bool = True
) -> dict[str, Any]:
    """Return the daemon's sections of the controller.

    Args:
        on_rail: the arm stands on a linear axis.
        port: UDP port that the controller listens on, if it must be asked.
    """
    cycle_ms = round(1e3 * cycle_s)
    if family == FANUC:
        section = {
            "peer": LOOPBACK,
            "peer_port": port,
            "cycle_ms": cycle_ms,
            "rail": on_rail,
            "signals_byte": SIGNALS_BYTE,
        }
        return {"controller": {"kind": FANUC}, "fanuc": section}
    own = {"port": 0, "cycle_ms": cycle_ms}
    return {"controller": {"kind": EGM}, "egm": own} if family == EGM else {"rsi": own}


def emulator_sections(family: str, port: int) -> dict[str, Any]:
    """Return the emulator's sections of the controller.

    Args:
        port: UDP port that the controller listens on, if it must be asked.
    """
    if family == FANUC:
        return {"fanuc": {"signals_byte": SIGNALS_BYTE}, "robot_bind": [LOOPBACK, port]}
    return {"egm": {"robotware": ROBOTWARE}} if family == EGM else {}


def _shipped(name: str) -> bytes:
    from linemate.daemon.config.files import PROTOCOL_DATA

    return (PROTOCOL_DATA / name).read_bytes()
