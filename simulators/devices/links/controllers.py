"""Emulated controllers by family: what the socket needs of them, and how they are built."""

from collections import Counter, deque
from dataclasses import replace
from typing import Protocol

from linemate.protocol.exchange_controller import ControllerCounts, Judgement
from linemate.protocol.rsi.codec import parse_config
from linemate.simulators.devices.egm.egm_controller import EgmController
from linemate.simulators.devices.fanuc.fanuc_controller import FanucController
from linemate.simulators.devices.limit_judge import AxisLimit, LimitJudge
from linemate.simulators.devices.links.emulator_config import EmulatorConfig
from linemate.simulators.devices.links.endpoint import Address
from linemate.simulators.devices.robot_plant import RobotPlant
from linemate.simulators.devices.rsi_controller import Applied, RsiController

FANUC_TARGET = ("127.0.0.1", 60015)
EGM_TARGET = ("127.0.0.1", 6510)  # port that EGM's sensor listens on in ABB's examples


class SetUp(Protocol):
    """What every family's set-up has."""

    @property
    def cycle_s(self) -> float:
        """Period of the exchange [s]."""

    @property
    def limits(self) -> tuple[AxisLimit, ...]:
        """Limits of each axis."""

    @property
    def total_tolerated(self) -> int | None:
        """Cycles in all without a good answer that are tolerated; None if they count in a row."""


class EmulatedController(Protocol):
    """Controller's side of a cyclic exchange, pure; its attributes are as in RsiController."""

    judge: LimitJudge
    refusals: Counter[str]
    clamped: int
    messages: deque[str]

    @property
    def config(self) -> SetUp:
        """How it is set up."""

    @property
    def counts(self) -> ControllerCounts:
        """Telegrams sent, answered, late, lost and refused."""

    @property
    def delay(self) -> int:
        """Cycles that count against the tolerance."""

    @property
    def broken(self) -> str | None:
        """Why the exchange ended, None while it goes on."""

    def begin(self) -> None:
        """Count and charge from the next cycle on, in the same session."""

    def telegram(self) -> bytes | None:
        """Open a cycle; None once the exchange has ended."""

    def on_reply(self, data: bytes, stamp_ns: int = 0, deadline_ns: int | None = None) -> Judgement:
        """Judge a datagram of the daemon."""

    def end_of_cycle(self) -> Applied:
        """Close the open cycle and apply what it brought."""


def build_controller(
    config: EmulatorConfig, plant: RobotPlant
) -> tuple[EmulatedController, Address]:
    """Build the station's controller.

    Returns:
        The controller, and where its telegrams go.

    Raises:
        OSError: a file that cannot be read.
        ProtocolError: a configuration that makes no telegram.
        ValueError: a set-up that makes no sense.
    """
    cycle_s, waits = config.scenario.cycle_s, config.wait_answered > 0
    if config.egm is not None:
        egm = replace(config.egm, cycle_s=cycle_s, patient=config.egm.patient or waits)
        return EgmController(plant.read, plant.start, egm), config.robot_target or EGM_TARGET
    if config.fanuc is not None:
        fanuc = replace(config.fanuc, cycle_s=cycle_s, patient=config.fanuc.patient or waits)
        # Packets go to the client that asks.
        return FanucController(plant.read, plant.start, fanuc), config.robot_target or FANUC_TARGET
    rsi = parse_config(config.rsi_xml.read_bytes())
    own = config.controller
    controller = RsiController(
        rsi, plant.read, plant.start, replace(own, cycle_s=cycle_s, patient=own.patient or waits)
    )
    return controller, config.robot_target or (rsi.ip, rsi.port)
