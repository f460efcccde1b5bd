"""Relative corrections: an increment whose reply was lost is sent again, never twice.

The emulated controller adds up what it takes (#RELATIVE, HOLDON="0"); its setpoints are compared
with what the daemon takes for them.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from linemate.daemon.config.files import PROTOCOL_DATA
from linemate.daemon.cycle.cycle import Cycle
from linemate.protocol.rsi.codec import RsiCodec, parse_config
from linemate.protocol.rsi.rsi_link import RsiLink
from linemate.simulators.devices.rsi_controller import ControllerConfig, RsiController
from linemate.simulators.harness import setup
from linemate.simulators.harness.lockstep import Lockstep
from linemate.simulators.harness.sensor_links import SensorLinks
from linemate.simulators.judge.judge import judge
from linemate.simulators.plants.scenario import Fault

pytestmark = pytest.mark.row

SHIPPED = (PROTOCOL_DATA / "rsi_joints.xml").read_bytes()
END_S = 5.0
AGREES = 1e-7
"""Between controller and daemon: a thousand roundings of the eighth decimal [rad, m]."""


class Relative(Lockstep):
    """A run whose controller adds increments up."""

    def __init__(self, faults: tuple[Fault, ...], cycle_ms: float, holdon: bytes = b"0") -> None:
        made = setup.make("no-stop", cycle_ms=cycle_ms)
        truth = replace(made.scenario, faults=faults, duration_s=END_S)
        super().__init__(replace(made, scenario=truth), 0)
        rsi = parse_config(SHIPPED.replace(b'HOLDON="1"', b'HOLDON="' + holdon + b'"'))
        settings = ControllerConfig(cycle_s=truth.cycle_s, mode="relative")
        self.controller = RsiController(rsi, self._plant.read, self._plant.start, settings)
        link = RsiLink(RsiCodec(rsi), absolute=False, on_rail=True)
        self.cycle = Cycle(self.cycle.parameters, link)
        self.links = SensorLinks(
            self.world, self.cycle, self._faults, made.task.conveyor.start_position
        )
        self._operator.__init__(self.cycle)  # type: ignore[misc]

    def off(self) -> float:
        """How far the controller is from where the daemon takes it to be [rad, m]."""
        there = np.array(self.controller.setpoints)
        return float(np.abs(there - np.array(self.cycle.session.held)).max())


def played(run: Relative) -> dict[str, Any]:
    while run.turn():
        pass
    return judge(run.evidence())


def losses(share: float, *links: str) -> tuple[Fault, ...]:
    return tuple(Fault(3.0, link, "loss", 1.0, share) for link in links)


@pytest.mark.parametrize(
    ("share", "cycle_ms"), [(0.05, 12.0), (0.1, 12.0), (0.2, 12.0), (0.2, 4.0)]
)
@pytest.mark.parametrize("links", [("reply",), ("robot",), ("reply", "robot")], ids="+".join)
def test_no_increment_is_lost_or_made_twice(
    links: tuple[str, ...], share: float, cycle_ms: float
) -> None:
    run = Relative(losses(share, *links), cycle_ms)
    result = played(run)
    assert result["telegrams"]["lost"] > 0
    assert result["limits"]["violations"] == 0
    assert result["outcome"] != "collision"
    assert run.off() < AGREES


def test_with_holdon_1_a_lost_reply_repeats_an_increment() -> None:
    run = Relative(losses(0.1, "reply"), 12.0, holdon=b"1")
    played(run)
    assert run.off() > 1e-3
