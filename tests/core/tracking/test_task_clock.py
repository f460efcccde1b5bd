"""Task clock: the release of the wheel waits for a calm contact."""

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from linemate.daemon.core import parameters
from linemate.daemon.core.tracking import task_clock
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.touch import release
from linemate.daemon.core.tracking.tracker import at_rest
from linemate.daemon.core.tracking.tracker_state import StepSamples, Tracker, TrackerState
from linemate.simulators.harness import setup

SAMPLES = StepSamples(0, None, 0, (), (), (), 0)
CALM, SWINGS = 10.0, 80.0
FIXED = frozenset({Gate.OBJECT_CLOSE, Gate.OBJECT_SEEN, Gate.SCREWS_FIXED})


@cache
def compiled() -> Tracker:
    cell = setup.make("wheel")
    return parameters.build(cell.task, cell.urdf, cell.tracking, cell.control, 0.012).tracker


def on_the_object(before_s: float) -> TrackerState:
    """The state of a clamped tool whose wheel is released after some time."""
    tracker = compiled()
    steps = round((tracker.task.tool.release_wheel - before_s) / tracker.cycle_s)
    state = at_rest(tracker, np.zeros(6), 0.0)
    return replace(
        state, contact=True, started=True, passed=FIXED, blended=10.0, time=steps * tracker.cycle_s
    )


def later(
    state: TrackerState, seconds: float, rms: float, pull: float = 0.0, *, retreat: bool = False
) -> TrackerState:
    tracker = compiled()
    for _ in range(round(seconds / tracker.cycle_s)):
        complied = replace(state.compliance, power=rms**2)
        state = replace(state, compliance=complied, pull=(0.0, pull, -50.0))
        earlier = state.time
        state = task_clock.advance_clock(tracker, state, None, SAMPLES, retreat)
        assert state.time >= earlier
    return state


def test_a_calm_contact_is_released_on_time() -> None:
    state = later(on_the_object(0.3), 0.6, CALM)
    assert state.releasing is not None
    assert state.oscillated is None


@pytest.mark.parametrize(("rms", "pull"), [(SWINGS, 0.0), (CALM, 60.0)])
def test_a_wheel_is_not_released_while_the_object_swings_or_is_pulled_across(
    rms: float, pull: float
) -> None:
    state = later(on_the_object(0.3), 5.0, rms, pull)
    assert state.releasing is None
    assert state.oscillated is not None
    assert state.time < compiled().task.tool.release_wheel
    assert later(state, 0.1, CALM).releasing is not None


def test_the_wait_for_a_calm_contact_ends() -> None:
    state = later(on_the_object(0.3), release.LONGEST_WAIT_S + 1.0, SWINGS)
    assert state.releasing is not None


def test_a_retreat_does_not_wait_for_a_calm_contact() -> None:
    state = later(on_the_object(0.3), 1.0, SWINGS)
    assert later(state, 0.024, SWINGS, retreat=True).releasing is not None
