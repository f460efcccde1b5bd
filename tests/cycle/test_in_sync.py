"""In sync: by state, tolerance and what the step says, and as a bit of the tool's signals."""

import dataclasses
from typing import Any

import pytest
from cycle_station import PERIOD, Station
from msgspec.structs import replace

from linemate.daemon.config.task_file import Task
from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.step_state import Outputs
from linemate.daemon.cycle.in_sync import is_in_sync
from linemate.daemon.cycle.states import State
from linemate.daemon.cycle.step_log import LogEntry
from linemate.simulators.devices.rsi_controller import RsiController
from linemate.simulators.harness import setup
from linemate.simulators.harness.lockstep import Lockstep

BIT = 3
POSE = (1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0)


@pytest.fixture
def outputs(entries: tuple[LogEntry, ...]) -> Outputs:
    return replace(entries[-1].outputs, target=POSE, sensed=POSE, held=None)


@pytest.mark.parametrize(
    ("state", "changes", "in_sync"),
    [
        ("track", {}, True),
        ("contact", {}, True),
        ("track", {"sensed": (1.0019, *POSE[1:])}, True),
        ("track", {"sensed": (1.0021, *POSE[1:])}, False),
        ("track", {"sensed": None}, False),
        ("track", {"held": "limited: A1"}, False),
        ("hold", {}, False),
        ("retreat", {}, False),
        ("home", {}, False),
        ("idle", {}, False),
    ],
)
def test_in_sync_needs_a_robot_that_follows_within_the_tolerance(
    outputs: Outputs, state: str, changes: dict[str, Any], in_sync: bool
) -> None:
    assert is_in_sync(state, replace(outputs, **changes), 0.002) == in_sync


class Run(Lockstep):
    """A run that is looked into.

    Attributes:
        rows: of each cycle its state, whether the daemon shows in sync, and the tool's signals.
    """

    def __init__(self, bit: int | None) -> None:
        super().__init__(setup.make("no-stop"), 0)
        operating = self.cycle.operating
        operating.settings = dataclasses.replace(operating.settings, in_sync_bit=bit)
        self.rows: list[tuple[State, bool, int]] = []
        assert isinstance(self.controller, RsiController)
        self.rsi = self.controller

    def until(self, time_s: float) -> "Run":
        while self.world.time_s < time_s:
            assert self.turn()
            cycle = self.cycle
            shown = cycle.last is not None and cycle.status()["in_sync"]
            self.rows.append((cycle.machine.state, shown, self.rsi._digital_out))
        return self


def test_the_bit_is_set_while_the_robot_follows_and_changes_no_setpoint() -> None:
    with_bit, without = Run(BIT).until(2.4), Run(None).until(2.4)
    assert with_bit.cycle.order("stop") is None
    assert without.cycle.order("stop") is None
    with_bit.until(2.6)
    without.until(2.6)
    assert with_bit.rsi.setpoints == without.rsi.setpoints
    assert not any(signals for _, _, signals in without.rows)
    assert all(signals == shown << BIT for _, shown, signals in with_bit.rows)
    followed = [shown for state, shown, _ in with_bit.rows if state is State.TRACK]
    assert not followed[0]
    assert followed[-1]
    assert not any(shown for state, shown, _ in with_bit.rows if state is not State.TRACK)
    assert with_bit.rows[-1][0] is State.HOLD


def test_a_reply_without_setpoint_clears_the_bit(parameters: Parameters, task: Task) -> None:
    station = Station(parameters, task, watch_settings=WatchSettings(in_sync_bit=BIT))
    # The robot's program ran before: it is unknown where corrections count from.
    station.axes = (station.axes[0] + 0.2, *station.axes[1:])
    station.delay = 40
    station.cycle.listen(station.stamp_ns - PERIOD)
    reply = station.cycle.on_telegram(station.telegram(), station.stamp_ns)
    assert reply == b'<Sen Type="ImFree"><DiO>0</DiO><IPOC>%d</IPOC></Sen>' % station.ipoc
