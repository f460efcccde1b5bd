"""The distance sensor is corrected by how the clamped tool moves with its object."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from msgspec import structs

from linemate.daemon.config import parameter_list
from linemate.daemon.config.parameter_list import ChangeTime
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.estimation.step_measurements import distance_measurement
from linemate.daemon.core.tracking.settings import DistanceNoise
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.wrench_frame import WrenchFrame, force_in_sensor
from linemate.daemon.cycle.learning.distances import (
    LARGEST_S,
    LARGEST_SCALE,
    LARGEST_SLIP,
    LATE,
    LATEST_S,
    SCALE,
    DistanceLearner,
)
from linemate.daemon.cycle.step_log import LogEntry
from linemate.protocol.stamped_samples import DistanceSample
from linemate.simulators.harness import lockstep, setup

STATED = DistanceNoise()
KNOWN = np.diag((0.002**-2.0, 0.001**-2.0))  # what an assembly in which the line starts shows


@cache
def wheel(*changes: str) -> tuple[LogEntry, ...]:
    """Return the steps of a wheel whose line starts while the tool is clamped."""
    entries: list[LogEntry] = []
    lockstep.run(setup.make("wheel", list(changes)), 0, on_step=entries.append)
    return tuple(entries)


def shown(entries: tuple[LogEntry, ...]) -> tuple[Array, Array] | None:
    learner = DistanceLearner()
    for entry in entries:
        learner.record_motion([entry])
    return learner.shown


@pytest.mark.parametrize(
    ("change", "late", "slip"),
    [
        ("scenario.distance.delay_s=0.021", 0.02, 0.0),
        ("scenario.distance.effects.slip=0.01", 0.0, -0.01),
    ],
)
def test_a_wheel_shows_how_late_the_sensor_is_and_how_its_wheel_slips(
    change: str, late: float, slip: float
) -> None:
    learner = DistanceLearner()
    learner.record_motion(wheel(change))
    changed = learner.keep(STATED)
    assert changed[LATE] == pytest.approx(late, abs=0.005)
    assert changed[SCALE] == pytest.approx(1.0 - slip, abs=0.002)
    assert learner.spoils_touch


def test_a_sensor_as_stated_is_left_as_it_is() -> None:
    learner = DistanceLearner()
    learner.record_motion(wheel())
    changed = learner.keep(STATED)
    assert changed.get(LATE, 0.0) == pytest.approx(0.0, abs=0.005)
    assert changed.get(SCALE, 1.0) == pytest.approx(1.0, abs=0.002)
    assert not learner.spoils_touch


def test_an_object_that_sways_shows_nothing() -> None:
    sways = 'scenario.body.carrier=[{"frequency_hz": 1.0, "damping": 0.02, "drive": 1.0}]'
    assert shown(wheel(sways)) is None


def test_a_wheel_that_was_not_finished_shows_nothing() -> None:
    released = next(
        i
        for i, entry in enumerate(wheel())
        if entry.after is not None and Gate.WHEEL_RELEASED in entry.after.tracker.passed
    )
    assert shown(wheel()[: released - 1]) is None
    assert shown(wheel()[:released] + wheel()[-1:]) is None


def test_a_contact_that_slides_shows_nothing() -> None:
    def slides(entry: LogEntry) -> LogEntry:
        made = entry.parameters
        if made is None:
            return entry
        tactile = replace(made.tracker.settings.tactile, holds=False)
        settings = replace(made.tracker.settings, tactile=tactile)
        tracker = replace(made.tracker, settings=settings)
        return structs.replace(entry, parameters=replace(made, tracker=tracker))

    assert shown(tuple(map(slides, wheel()))) is None


def test_a_sensor_that_is_turned_in_the_tool_shows_the_same() -> None:
    frame = WrenchFrame(((0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)), (0.0, 0.0, 0.0))

    def turned(entry: LogEntry) -> LogEntry:
        if entry.parameters is None:
            return entry
        wrench = tuple(
            structs.replace(sample, force=force_in_sensor(frame, sample.force))
            for sample in entry.inputs.wrench
        )
        inputs = structs.replace(entry.inputs, wrench=wrench)
        made = replace(entry.parameters, wrench_frame=frame)
        return structs.replace(entry, inputs=inputs, parameters=made)

    seen, plain = shown(tuple(map(turned, wheel()))), shown(wheel())
    assert seen is not None
    assert plain is not None
    for of_turned, of_plain in zip(seen, plain, strict=True):
        assert of_turned == pytest.approx(of_plain, rel=1e-6)


def kept(
    learner: DistanceLearner, true: DistanceNoise, present: DistanceNoise, noise: float = 0.0
) -> DistanceNoise:
    """Return the settings after an assembly with a sensor of given truth."""
    off = np.array((true.late - present.late, 1.0 - true.scale / present.scale))
    learner.shown = KNOWN, KNOWN @ (off + noise * np.array((0.002, 0.001)))
    learner._speed = 0.1
    changed = learner.keep(present)
    return DistanceNoise(
        late=changed.get(LATE, present.late), scale=changed.get(SCALE, present.scale)
    )


def test_the_mean_of_the_assemblies_is_reached_and_held() -> None:
    learner, true, present = DistanceLearner(), DistanceNoise(late=0.015, scale=1.008), STATED
    for noise in (1.0, -1.0) * 15:
        present = kept(learner, true, present, noise)
    assert present.late == pytest.approx(true.late, abs=0.0003)
    assert present.scale == pytest.approx(true.scale, abs=0.0002)


def test_values_that_were_taken_back_are_learned_as_at_first() -> None:
    learner, true = DistanceLearner(), DistanceNoise(late=0.015, scale=1.008)
    first = kept(learner, true, STATED)
    kept(learner, true, first)
    assert kept(learner, true, STATED) == first


def test_a_large_error_is_refused_and_a_value_stays_within_the_settings() -> None:
    for off in ({"late": 1.2 * LARGEST_S}, {"scale": 1.0 + 1.2 * LARGEST_SLIP}):
        learner = DistanceLearner()
        assert kept(learner, DistanceNoise(**off), STATED) == STATED
        assert learner.spoils_touch
    learner, present = DistanceLearner(), STATED
    for _ in range(60):
        beyond = DistanceNoise(late=present.late + 0.02, scale=present.scale + 0.005)
        present = kept(learner, beyond, present)
    assert (present.late, present.scale) == (LATEST_S, LARGEST_SCALE)
    assert learner.keep(present) == {}


def test_what_is_learned_needs_no_compiler_which_a_cell_of_variants_has_at_its_start_alone() -> (
    None
):
    for name in (LATE, SCALE):
        rule = parameter_list.change_rule(name)
        assert rule.change is ChangeTime.LIVE
        assert not rule.in_contact


def test_the_scale_counts_from_the_start_position() -> None:
    plain, scaled = (
        lockstep.parameters_of(setup.make("wheel", changes), 0.012).tracker
        for changes in ((), (f"{SCALE}=1.01",))
    )
    start = plain.task.conveyor.start_position
    for way in (0.0, 0.5):
        sample = DistanceSample(0, start + way, 1.0)
        values = [distance_measurement(tracker, 0, sample).value for tracker in (plain, scaled)]
        assert values[1] - values[0] == pytest.approx(0.01 * way)
