"""An ABB controller that stops, loses its daemon or is not ready: no setpoint without a proof."""

import numpy as np

from linemate.daemon.cycle.states import State
from linemate.simulators.devices.egm.egm_controller import EgmController
from linemate.simulators.harness import families, setup
from linemate.simulators.harness.lockstep import Lockstep

CYCLE_S = 0.008
MOVING = {State.TRACK, State.CONTACT}


class Run(Lockstep):
    """A run over EGM that is looked into."""

    def __init__(self) -> None:
        super().__init__(setup.make("no-stop", controller=families.EGM, cycle_ms=8), 0)
        assert isinstance(self.controller, EgmController)
        self.egm: EgmController = self.controller

    def until(self, time_s: float) -> "Run":
        while self.world.time_s < time_s:
            assert self.turn()
        return self

    @property
    def state(self) -> State:
        return self.cycle.machine.state


def test_every_message_is_answered_from_the_reported_position_on() -> None:
    run = Run()
    start = np.array(run.egm.setpoints)
    run.turn()
    assert run.egm.counts.answered == 1
    assert np.abs(np.array(run.egm.setpoints) - start).max() < 1e-6
    run.until(1.0)
    assert run.state in MOVING
    assert run.egm.counts.answered == run.egm.counts.sent
    assert not run.egm.refusals


def test_motors_off_in_motion_stop_the_robot_and_no_setpoint_goes_out() -> None:
    run = Run().until(1.0)
    run.egm.is_motors_on = False
    answered = run.egm.counts.answered
    run.until(1.5)
    assert run.egm.counts.answered == answered
    assert run.cycle.is_unproven
    assert run.cycle.session.unproven is not None
    assert "motors are not on" in run.cycle.session.unproven
    run.egm.is_motors_on = True
    standing = np.array(run.egm.setpoints)
    run.until(2.0)
    assert run.state not in MOVING
    assert not run.cycle.is_unproven
    assert run.egm.counts.answered > answered
    # The first setpoint is where the robot stands, not where it was sent before.
    assert np.abs(np.array(run.egm.setpoints) - standing).max() < 2e-3
    assert run.egm.judge.violations == 0


def test_a_controller_whose_run_has_ended_gets_no_setpoint_of_the_run_before() -> None:
    run = Run().until(1.0)
    where = run.egm.setpoints
    run.egm.is_rapid_running = False
    run.until(1.2)
    assert run.cycle.session.unproven is not None
    assert "RAPID does not run" in run.cycle.session.unproven
    assert np.abs(np.array(run.egm.setpoints) - np.array(where)).max() < 0.02
