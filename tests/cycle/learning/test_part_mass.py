"""The part's mass is learned from what the tool weighs less after a good assembly."""

from functools import cache

import numpy as np
import pytest
from msgspec import structs

from linemate.daemon.core.tracking.settings import PayloadSettings
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.tracker_state import TrackerState
from linemate.daemon.cycle.learning.part_mass import (
    LARGEST_STEP,
    LEAST_GAIN,
    PART_MASS,
    PartLearner,
    weighed,
)
from linemate.daemon.cycle.step_log import LogEntry
from linemate.simulators.harness import lockstep, setup

WHEEL = 20.0  # [kg]
DOWN = (1.0, 0.0, 0.0)


@cache
def wheel() -> tuple[LogEntry, ...]:
    """Return the steps of a wheel with its weight."""
    load = [f"scenario.effector.load.{key}" for key in ("tool_mass=8.0", f"wheel_mass={WHEEL}")]
    entries: list[LogEntry] = []
    lockstep.run(setup.make("wheel", load), 0, on_step=entries.append)
    return tuple(entries)


def mass_of(entries: tuple[LogEntry, ...]) -> float | None:
    learner = PartLearner()
    for entry in entries:
        learner.record_weight([entry])
    return learner.mass


def changed(entry: LogEntry, **fields: object) -> LogEntry:
    if entry.after is None:
        return entry
    tracker: TrackerState = structs.replace(entry.after.tracker, **fields)
    return structs.replace(entry, after=structs.replace(entry.after, tracker=tracker))


def test_a_released_wheel_shows_its_mass() -> None:
    assert mass_of(wheel()) == pytest.approx(WHEEL, rel=0.05)


def test_a_retreat_and_an_unscrewed_wheel_show_nothing() -> None:
    assert mass_of(tuple(changed(entry, withdrawn=1.0) for entry in wheel())) is None
    loose = frozenset({Gate.WHEEL_RELEASED})
    assert mass_of(tuple(changed(entry, passed=loose) for entry in wheel())) is None


@pytest.mark.parametrize(
    "force", [(20.0, 0.0, 0.0), (-200.0, 0.0, 0.0), (100.0, 200.0, 0.0), (np.nan, 0.0, 0.0)]
)
def test_a_difference_that_is_no_weight_is_none(force: tuple[float, ...]) -> None:
    assert weighed(np.array(force), DOWN) is None


def kept(learner: PartLearner, mass: float, known: float) -> float:
    learner.mass = mass
    return learner.keep(PayloadSettings(part_mass=known)).get(PART_MASS, known)


def test_the_first_weight_counts_whole_and_later_ones_less() -> None:
    learner = PartLearner()
    assert kept(learner, 24.0, 0.0) == 24.0
    assert kept(learner, 26.0, 24.0) == 25.0
    value = 25.0
    for _ in range(30):
        value = kept(learner, 27.0, value)
    assert value == pytest.approx(27.0, abs=0.6)
    assert kept(learner, 17.0, 27.0) == pytest.approx(27.0 - 8.1 * LEAST_GAIN)


def test_a_stated_mass_moves_slowly_and_not_far_by_one_assembly() -> None:
    assert kept(PartLearner(), 24.0, 20.0) == pytest.approx(20.8)
    assert kept(PartLearner(), 90.0, 20.0) == pytest.approx(20.0 * (1.0 + LARGEST_STEP / 5.0))


def test_without_news_nothing_changes() -> None:
    learner = PartLearner()
    assert learner.keep(PayloadSettings()) == {}
    assert kept(learner, 24.02, 24.0) == 24.0
