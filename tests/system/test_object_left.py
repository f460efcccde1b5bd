"""The object leaves the reach of the linear axis while it is tracked."""

from dataclasses import replace

import numpy as np

from linemate.daemon.cycle.states import State
from linemate.simulators.harness.lockstep import Lockstep
from linemate.simulators.harness.setup import make
from linemate.simulators.judge.rows import CLAMPED, FREE, RELEASED, STATES, Rows


def run(upper: float, seconds: float) -> tuple[Lockstep, Rows]:
    """The wheel on a line that does not stop, the linear axis ending at ``upper`` [m]."""
    setup = make("no-stop", [], variant="default", cycle_ms=None)
    limits = list(setup.control.limits)
    limits[6] = replace(limits[6], upper=upper)
    control = replace(setup.control, limits=tuple(limits))
    scenario = replace(setup.scenario, duration_s=seconds)
    lockstep = Lockstep(replace(setup, scenario=scenario, control=control), 1)
    while lockstep.turn():
        pass
    return lockstep, lockstep.evidence().rows


def test_in_free_space_the_robot_is_held_before_the_axis_is_at_its_end() -> None:
    lockstep, rows = run(0.25, 6.0)
    assert lockstep.cycle.machine.state is State.HOLD
    assert lockstep.cycle.machine.because.startswith("the object has left")
    assert lockstep.world.collision is None
    assert rows.joints[:, 6].max() <= 0.25
    assert (rows.contact == FREE).all()
    first = rows.t[int(np.argmax(rows.state == STATES.index("hold")))]
    # The unit has gone 0.25 m after 2.36 s.
    assert 1.5 < first < 2.4


def test_in_contact_the_tool_is_released_and_withdrawn_without_overload() -> None:
    lockstep, rows = run(0.9, 12.0)
    assert lockstep.world.collision is None
    assert (rows.contact == CLAMPED).any()
    assert rows.contact[-1] == RELEASED
    retreat = rows.state == STATES.index("retreat")
    assert retreat.any()
    assert rows.t[int(np.argmax(retreat))] < 8.5
    force = np.linalg.norm(rows.force[rows.contact == CLAMPED], axis=1)
    assert force.max() < 200.0


def test_an_axis_that_is_long_enough_is_no_reason_to_stop() -> None:
    lockstep, rows = run(6.0, 8.0)
    assert lockstep.cycle.machine.state is State.CONTACT
    assert not np.isin(rows.state, [STATES.index("hold"), STATES.index("retreat")]).any()
