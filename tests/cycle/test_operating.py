"""Operating state between two steps: what the watch is given."""

import pytest
from cell import World, parameters

from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core.step import Outputs
from linemate.daemon.cycle.operating import Operating, Situation
from linemate.daemon.cycle.sensing.samples import SensorQueues
from linemate.daemon.cycle.sensing.sensor_health import CONTRADICTIONS
from linemate.daemon.cycle.states import Machine, State

NOW_NS = 10**12


@pytest.fixture(scope="module")
def last() -> Outputs:
    return World(parameters()).run(0.5)


def is_contradicted(last: Outputs, state: State, *, refused: int, sensed: bool = True) -> bool:
    """Whether the watch counts the sensors of the position as contradicting each other."""
    operating = Operating(WatchSettings(), 0.012, wrench_expected=False)
    operating.machine = Machine(state)
    samples = SensorQueues()
    samples.camera_health.add_result(refused, refused)
    situation = Situation(last, None, None, settling=False, sensed=sensed)
    return bool(operating._facts(NOW_NS, samples, situation, telegram=True).contradicted)


@pytest.mark.parametrize("state", [State.IDLE, State.ARMED, State.TRACK])
def test_no_motion_begins_or_goes_on_with_a_camera_that_contradicts_the_estimate(
    last: Outputs, state: State
) -> None:
    assert is_contradicted(last, state, refused=CONTRADICTIONS)
    assert not is_contradicted(last, state, refused=CONTRADICTIONS - 1)


@pytest.mark.parametrize("state", [State.CONTACT, State.RETREAT, State.HOLD])
def test_a_camera_that_contradicts_ends_no_contact_and_no_retreat(
    last: Outputs, state: State
) -> None:
    assert not is_contradicted(last, state, refused=CONTRADICTIONS)


def test_a_motion_that_its_programme_alone_leads_needs_no_pose_that_fits(last: Outputs) -> None:
    assert not is_contradicted(last, State.IDLE, refused=CONTRADICTIONS, sensed=False)
