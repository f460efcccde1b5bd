"""The same task over another family's wire, in virtual time: moves, gaps, alarms."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from linemate.daemon.cycle.setpoint_reference import Proof
from linemate.daemon.cycle.states import State
from linemate.simulators.devices.fanuc.fanuc_controller import FanucController
from linemate.simulators.harness import setup
from linemate.simulators.harness.cell import families
from linemate.simulators.harness.lockstep import Lockstep
from linemate.simulators.plants.scenario import Fault

CYCLE_S = 0.008


@cache
def made() -> setup.Setup:
    return setup.make("no-stop", controller=families.FANUC)


class Run(Lockstep):
    """A run over Stream Motion that is looked into."""

    def __init__(self, faults: tuple[Fault, ...] = ()) -> None:
        whole = made()
        super().__init__(replace(whole, scenario=replace(whole.scenario, faults=faults)), 0)
        assert isinstance(self.controller, FanucController)
        self.fanuc: FanucController = self.controller

    def until(self, time_s: float) -> "Run":
        while self.world.time_s < time_s:
            assert self.turn()
        return self

    @property
    def is_tracking(self) -> bool:
        return self.cycle.machine.state in {State.TRACK, State.CONTACT}


def test_the_period_is_the_familys_own() -> None:
    assert made().scenario.cycle_s == CYCLE_S


def test_every_packet_is_answered_from_the_first_one_at_the_reported_position() -> None:
    run = Run()
    start = np.array(run.fanuc.setpoints)
    run.turn()
    assert run.fanuc.counts.answered == 1
    assert run.cycle.session.proof is Proof.REPORTED
    assert np.abs(np.array(run.fanuc.setpoints) - start).max() < 1e-6
    run.until(1.0)
    assert run.is_tracking
    assert run.fanuc.counts.answered == run.fanuc.counts.sent
    assert not run.fanuc.refusals
    assert run.fanuc.judge.violations == 0


@pytest.mark.parametrize("cycles", [1, 2, 5])
def test_the_robot_coasts_through_a_gap_and_goes_on_within_all_limits(cycles: int) -> None:
    silence = Fault(0.5, "robot", "silence", cycles * CYCLE_S)
    run = Run((silence,)).until(1.5)
    assert run.fanuc.counts.lost == cycles
    assert run.fanuc.alarm is None
    assert not run.fanuc.refusals
    assert run.fanuc.judge.violations == 0
    assert run.is_tracking == (cycles * CYCLE_S <= made_missed_s())


def made_missed_s() -> float:
    """A silence of more than this holds the robot (``watch.missed_s``)."""
    return 0.03


def test_after_the_controllers_alarm_nothing_is_commanded_until_a_new_proof() -> None:
    run = Run((Fault(0.5, "robot", "silence", 0.2),)).until(0.75)
    assert run.fanuc.alarm is not None
    assert "silence" in run.fanuc.alarm
    unproven = run.cycle.session.unproven
    assert unproven is not None
    assert "the controller takes no setpoints: an alarm" in unproven
    assert run.cycle.order("arm") == unproven
    run.fanuc.reset()
    openings = run.cycle.openings
    run.until(1.5)
    assert run.cycle.openings == openings + 1
    assert run.cycle.session.proof is Proof.REPORTED
    assert not run.is_tracking  # an operator must arm again
    assert run.fanuc.alarm is None
    assert run.fanuc.counts.refused == 0


def test_an_emergency_stop_ends_the_motion_with_its_reason() -> None:
    run = Run().until(0.5)
    assert run.is_tracking
    run.fanuc.is_emergency_stop = True
    run.until(0.7)
    assert not run.is_tracking
    assert "emergency stop" in (run.cycle.session.unproven or "")
    run.fanuc.is_emergency_stop = False
    run.until(1.2)
    assert run.cycle.session.unproven is None
    assert run.fanuc.alarm is None
    assert not run.fanuc.refusals


def test_a_prepared_reply_answers_the_packet_that_it_expects() -> None:
    run = Run().until(0.5)
    stamp_ns = run.links.stamp(run.world.time_s)
    run.links.carry()
    assert run.cycle.prepare(stamp_ns)
    ready = run.cycle.ready_reply
    data = run.fanuc.telegram()
    assert ready is not None
    assert data is not None
    assert ready.telegram.matches(data)
    assert run.cycle.on_telegram(data, stamp_ns, is_answered=True) == ready.data
