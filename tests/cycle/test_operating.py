"""Operating state between two steps: what the watch is given."""

import pytest
from cell import World, parameters
from msgspec import structs

from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core.step_state import Outputs
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


@pytest.mark.parametrize(
    ("state", "last_approach", "is_lost"),
    [(State.TRACK, True, True), (State.TRACK, False, False), (State.CONTACT, True, False)],
)
def test_an_excluded_distance_ends_the_last_approach_alone(
    last: Outputs, state: State, last_approach: bool, is_lost: bool
) -> None:
    operating = Operating(WatchSettings(), 0.012, wrench_expected=False)
    operating.machine = Machine(state)
    samples = SensorQueues()
    samples.distance_health.exclude(NOW_NS, "it jumped by 0.013 m")
    situation = Situation(
        last, None, None, settling=False, sensed=True, last_approach=last_approach
    )
    facts = operating._facts(NOW_NS, samples, situation, telegram=True)
    assert (facts.distance_lost, facts.contradicted) == (is_lost, False)


def test_a_motion_that_its_programme_alone_leads_needs_no_pose_that_fits(last: Outputs) -> None:
    assert not is_contradicted(last, State.IDLE, refused=CONTRADICTIONS, sensed=False)


@pytest.mark.parametrize(
    ("state", "speed", "is_seen"),
    [
        (State.HOLD, 0.0, True),
        (State.FAULT, 0.106, True),
        (State.FAULT, 0.005, False),
        (State.FAULT, None, False),
        (State.IDLE, 0.106, False),
    ],
)
def test_in_a_fault_the_gap_to_an_object_counts_only_while_it_moves(
    last: Outputs, state: State, speed: float | None, is_seen: bool
) -> None:
    operating = Operating(WatchSettings(), 0.012, wrench_expected=False)
    operating.machine = Machine(state)
    seen = structs.replace(last, speed=speed, part=last.target)
    situation = Situation(seen, None, None, settling=False, sensed=True)
    facts = operating._facts(NOW_NS, SensorQueues(), situation, telegram=True)
    assert (facts.gap_m is not None) is is_seen


def test_a_refused_arm_names_the_sensor_that_is_not_fresh() -> None:
    settings = WatchSettings()
    operating = Operating(settings, 0.012, wrench_expected=True)
    operating.machine = Machine(State.IDLE)
    situation = Situation(None, None, None, settling=False, sensed=True)
    operating.decide(10**9, SensorQueues(), situation, telegram=True)
    refusal = operating.order("arm", situation)
    assert refusal is not None
    assert "no fresh position of the object" in refusal
    assert ": distance silent since the start, camera silent since the start (limit " in refusal
    assert "force_torque silent since the start (limit " in refusal
