"""The sequence of production, against a cell that does what it is ordered."""

from typing import Any

import pytest

from linemate.daemon.config.settings import ProductionSettings, TrackingWindow
from linemate.daemon.cycle.states import Machine, State
from linemate.daemon.production.object_queue import AnnouncedPart
from linemate.daemon.production.supervisor import (
    MOST_WAYS_HOME,
    CellView,
    PartResult,
    Stage,
    Supervisor,
)

SETTINGS = ProductionSettings(
    variants={"sedan": "sedan.yaml"},
    window=TrackingWindow(start=-1.0, latest_start=-0.1, abort=3.0),
    announced_at=-2.0,
)
STEP = 0.05
"""Way of the conveyor from one look to the next [m]."""


class Cell:
    """A robot whose states follow its orders, and a conveyor that runs."""

    def __init__(self) -> None:
        self.machine = Machine(State.IDLE)
        self.cause = ""
        self.orders: list[str] = []
        self.results: list[PartResult] = []
        self.begun: list[str] = []
        self.refused: dict[str, str] = {}
        self.reading, self.decisions = 10.0, 0
        self.is_home, self.unseen = True, False
        self.waiting: str | None = None
        self.supervisor = Supervisor(SETTINGS, self, {"sedan": 1.0})

    def refusal(self, op: str) -> str | None:
        return self.refused.get(op)

    def order(self, op: str) -> str | None:
        reason = self.refusal(op)
        if reason is None:
            self.orders.append(op)
        return reason

    def begin_part(self, part: AnnouncedPart) -> None:
        self.begun.append(part.part)

    def end_part(self, result: PartResult) -> None:
        self.results.append(result)

    def look(self, times: int = 1, *, moves: bool = True) -> None:
        for _ in range(times):
            self.decisions += 10
            self.reading += STEP if moves else 0.0
            self.supervisor.supervise(
                CellView(
                    self.decisions,
                    self.machine,
                    self.cause,
                    self.decisions,
                    self.reading,
                    is_home=self.is_home,
                    stands=self.machine.state in {State.IDLE, State.ARMED, State.HOLD},
                    unseen=self.unseen,
                    waiting=self.waiting,
                )
            )

    def announce(self, name: str = "P1") -> None:
        reason = self.supervisor.queue.announce(AnnouncedPart(name, "sedan", self.reading))
        assert reason is None

    def until(self, op: str, most: int = 200) -> None:
        """Look until an order is given."""
        before = len(self.orders)
        for _ in range(most):
            self.look()
            if self.orders[before:]:
                assert self.orders[before:] == [op]
                return
        raise AssertionError(f"{op} was never ordered")


def started() -> Cell:
    """A cell that tracks its first part."""
    cell = Cell()
    cell.supervisor.release()
    cell.announce()
    cell.until("arm")
    cell.machine = Machine(State.ARMED)
    cell.until("start")
    cell.machine = Machine(State.TRACK)
    cell.look()
    return cell


def test_a_part_goes_through_the_whole_sequence_and_the_robot_comes_home() -> None:
    cell = started()
    assert cell.supervisor.stage is Stage.MATE
    cell.machine = Machine(State.CONTACT)
    cell.look(3)
    cell.machine = Machine(State.RETREAT, programmed=True)
    cell.look(3)
    cell.machine, cell.is_home = Machine(State.IDLE), False
    cell.look()
    assert [(each.is_good, each.reason) for each in cell.results] == [(True, "")]
    cell.until("home")
    assert cell.orders == ["arm", "start", "home"]
    assert cell.supervisor.counts == {"good": 1, "bad": 0}


def test_nothing_is_ordered_before_the_first_release() -> None:
    cell = Cell()
    cell.announce()
    cell.look(100)
    assert cell.orders == []
    assert [each.reason for each in cell.results] == [
        "let go at -0.1 m: on hold: start of the daemon"
    ]


def test_a_part_is_not_begun_before_its_window() -> None:
    cell = Cell()
    cell.supervisor.release()
    cell.announce()
    begun_at = None
    while not cell.begun:
        cell.look()
        begun_at = cell.reading - 10.0 - 2.0
    assert begun_at == pytest.approx(-1.0, abs=STEP)
    assert cell.supervisor.offset(AnnouncedPart("P", "sedan", 10.0)) == pytest.approx(1 - 2 - 10)


def test_a_part_that_cannot_be_started_in_time_is_reported_with_the_refusal() -> None:
    cell = Cell()
    cell.supervisor.release()
    cell.refused["arm"] = "the estimate of the object is not ready"
    cell.announce()
    cell.look(100)
    assert cell.orders == []
    (result,) = cell.results
    assert result.reason == "not started up to -0.1 m: the estimate of the object is not ready"


def test_a_hold_in_tracking_is_left_by_a_retreat_and_reported_with_its_cause() -> None:
    cell = started()
    cell.machine, cell.cause = Machine(State.HOLD), "no fresh force: force_torque silent"
    cell.until("retreat")
    cell.machine, cell.cause = Machine(State.RETREAT), "ordered to retreat"
    cell.look(3)
    cell.machine, cell.is_home = Machine(State.IDLE), False
    cell.look()
    assert cell.results[0].reason == "no fresh force: force_torque silent"
    cell.until("home")
    assert cell.supervisor.held is None


def test_an_emergency_retreat_is_no_good_part_and_its_cause_is_reported() -> None:
    cell = started()
    cell.machine, cell.cause = Machine(State.RETREAT), "overload: force 400 N"
    cell.look(2)
    cell.machine, cell.cause = Machine(State.IDLE), "retreated: the tool is free"
    cell.look()
    assert (cell.results[0].is_good, cell.results[0].reason) == (False, "overload: force 400 N")


def test_a_retreat_with_trouble_in_it_is_no_good_part() -> None:
    cell = started()
    cell.machine = Machine(State.RETREAT, programmed=True)
    cell.look(2)
    cell.machine, cell.cause = Machine(State.RETREAT, programmed=False), "axis limit"
    cell.look(2)
    cell.machine, cell.cause = Machine(State.IDLE), "retreated"
    cell.look()
    assert (cell.results[0].is_good, cell.results[0].reason) == (False, "axis limit")


def test_a_fault_ends_the_part_and_puts_production_on_hold() -> None:
    cell = started()
    cell.machine, cell.cause = Machine(State.FAULT, latched=True), "robot link lost in motion"
    cell.look()
    assert cell.results[0].reason == "robot link lost in motion"
    assert cell.supervisor.held == "fault: robot link lost in motion"
    cell.machine, cell.is_home = Machine(State.IDLE), False
    cell.look(20)
    assert cell.orders == ["arm", "start"]
    cell.supervisor.release()
    cell.until("home")


def test_a_part_beyond_the_abort_position_is_left() -> None:
    cell = started()
    cell.unseen = True
    cell.until("retreat", 400)
    cell.machine = Machine(State.RETREAT)
    cell.look(2)
    cell.machine = Machine(State.IDLE)
    cell.look()
    assert "3 m behind the start position: the part was not seen" in cell.results[0].reason


def test_after_an_operators_stop_nothing_is_ordered_until_the_release() -> None:
    cell = started()
    cell.supervisor.interrupt("stop ordered by uid:1000")
    cell.machine = Machine(State.HOLD)
    cell.look(50)
    assert cell.orders == ["arm", "start"]
    cell.supervisor.release()
    cell.until("retreat")
    cell.machine = Machine(State.RETREAT)
    cell.look()
    cell.machine = Machine(State.IDLE)
    cell.look()
    assert cell.results[0].reason == "stop ordered by uid:1000"


def test_a_part_that_passes_while_another_is_assembled_is_reported() -> None:
    cell = started()
    cell.announce("P2")
    cell.look(50)
    cell.machine = Machine(State.RETREAT, programmed=True)
    cell.look()
    cell.machine = Machine(State.IDLE)
    cell.look(3)
    assert [(each.part.part, each.is_good) for each in cell.results] == [
        ("P1", True),
        ("P2", False),
    ]


def test_ways_home_that_end_early_are_not_repeated_for_ever() -> None:
    cell = Cell()
    cell.supervisor.release()
    cell.is_home = False
    cell.look(50)
    assert cell.orders == ["home"] * MOST_WAYS_HOME
    assert cell.supervisor.held == f"{MOST_WAYS_HOME} ways home have ended early"


def test_a_skipped_part_is_reported_and_the_present_one_is_not_skipped() -> None:
    cell = started()
    assert "is being assembled" in str(cell.supervisor.skip("P1"))
    assert cell.supervisor.skip(None) == "no part waits"
    cell.announce("P2")
    assert cell.supervisor.skip(None) is None
    assert cell.results[0].reason == "skipped by order"


def test_a_hold_lets_the_present_part_be_finished() -> None:
    cell = started()
    cell.supervisor.hold("hold ordered by uid:1000")
    cell.machine = Machine(State.RETREAT, programmed=True)
    cell.look()
    cell.machine, cell.is_home = Machine(State.IDLE), False
    cell.look(10)
    assert cell.results[0].is_good
    assert cell.orders == ["arm", "start"]


def test_each_order_waits_for_the_decision_on_the_last() -> None:
    cell = Cell()
    cell.supervisor.release()
    cell.announce()
    while not cell.begun:
        cell.look()
    orders: list[Any] = []
    for _ in range(10):
        view = CellView(0, cell.machine, "", cell.decisions + 5, cell.reading, True, True)
        cell.supervisor.supervise(view)
        orders = list(cell.orders)
    assert orders == ["arm"]
