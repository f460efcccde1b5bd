"""What good assemblies teach becomes parameters of the running daemon."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from loops import run
from standing_daemon import Standing

from linemate.daemon.config.task_file import Task
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.service.learning.learners import Learners
from linemate.simulators.harness import lockstep, setup


@cache
def assembly(*changes: str) -> tuple[LogEntry, ...]:
    """Return the steps of a wheel."""
    entries: list[LogEntry] = []
    lockstep.run(setup.make("wheel", changes), 0, on_step=entries.append)
    return tuple(entries)


@pytest.fixture
def standing(tmp_path: Path, parameters: Parameters, task: Task) -> Standing:
    daemon = Standing(tmp_path, parameters, task)
    daemon.cycles(90)
    return daemon


def learners_of(daemon: Standing, *, distance: bool, touch: bool = False) -> Learners:
    config = replace(daemon.station.config, learn_distance=distance, learn_touches=touch)
    station = replace(daemon.station, config=config)
    service = daemon.service
    return Learners(
        station, daemon.cycle, 0.012, lambda: service.settings, service.set, daemon.lines.append
    )


def test_a_late_sensor_is_corrected_and_its_touch_teaches_the_camera_nothing(
    standing: Standing,
) -> None:
    async def learn() -> None:
        learners = learners_of(standing, distance=True, touch=True)
        learners.learn(assembly("scenario.distance.delay_s=0.021"))

    run(learn())
    tracking = standing.service.settings.tracking
    assert tracking.distance.late == pytest.approx(0.02, abs=0.005)
    assert tracking.camera.felt == (0.0, 0.0)
    assert {who for _, who, _ in standing.changes} == {"distances"}


def test_what_is_not_configured_is_not_learned(standing: Standing) -> None:
    learners_of(standing, distance=False).learn(assembly("scenario.distance.delay_s=0.021"))
    assert standing.changes == []


def test_what_the_parameters_refuse_is_an_event(standing: Standing) -> None:
    learners = learners_of(standing, distance=True)
    learners._set_values = lambda *_: {"refused": "out of range"}
    learners.learn(assembly("scenario.distance.delay_s=0.021"))
    assert standing.lines[-1] == "what the object's motion has shown is not used: out of range"
