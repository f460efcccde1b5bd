"""An ABB controller that stops, loses its daemon or is not ready: no setpoint without a proof."""

import numpy as np
import pytest

from linemate.daemon.cycle.states import State
from linemate.simulators.devices.egm.egm_controller import EgmController
from linemate.simulators.harness import setup
from linemate.simulators.harness.cell import families
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


class LateReplies(Run):
    """In motion each fortieth reply goes out when the next message has come, before its reply."""

    def __init__(self, *, is_measured: bool) -> None:
        super().__init__()
        self._is_measured, self._held, self._replies = is_measured, b"", 0

    def _exchange(self, data: bytes, t: float) -> None:
        stamp_ns = self.links.stamp(t)
        late_ns = round(1.1e9 * CYCLE_S) if self._held and self._is_measured else 0
        self.cycle.session.turnaround_ns = late_ns
        reply = self.cycle.on_telegram(data, stamp_ns)
        assert reply
        if self._held:
            self.egm.on_reply(self._held)
        self._replies += 1
        self._held = reply if t > 1.0 and self._replies % 40 == 0 else b""
        if not self._held:
            self.egm.on_reply(reply)


@pytest.mark.parametrize("is_measured", [True, False])
def test_a_reply_that_went_out_too_late_makes_no_double_step(*, is_measured: bool) -> None:
    run = LateReplies(is_measured=is_measured).until(2.6)
    assert run.state in MOVING
    assert run.egm.counts.lost >= 4
    assert (run.cycle.session.replies_lost >= 4) is is_measured
    # The planted error shows that the judge can see it.
    assert (run.egm.judge.violations == 0) is is_measured
