"""Parameters of a running daemon: all of a change or none, at the right time, and kept."""

import asyncio
import contextlib
import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loops import run
from msgspec import structs
from standing_daemon import TEXT, Standing

from linemate.daemon.config import config, overlays, parameter_list
from linemate.daemon.config import settings_tree as tree
from linemate.daemon.config.documents import FileError
from linemate.daemon.config.parameter_list import ChangeTime
from linemate.daemon.config.task_file import Task
from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core import parameters as compiling
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.cycle.states import Machine, State
from linemate.simulators.harness.setup import shipped_control

NOISE = "tracking.distance.deviation"
SERVO = "control.servos.2.frequency_hz"


Make = Callable[[], Standing]


@pytest.fixture
def make(tmp_path: Path, parameters: Parameters, task: Task) -> Make:
    return lambda: Standing(tmp_path, parameters, task)


def in_state(cycle: Cycle, state: State) -> None:
    cycle.operating.machine = Machine(state)


async def kept(answer: dict[str, Any]) -> dict[str, Any]:
    """The answer that was promised."""
    return await answer["promise"]


def test_a_live_change_is_in_force_with_the_next_step_and_in_none_before(make: Make) -> None:
    async def main() -> None:
        here = make()
        here.cycles(10)
        before = here.cycle.last
        answer = here.assign({NOISE: 0.001})
        assert answer == {"changed": {NOISE: {"old": 0.00038, "new": 0.001}}}
        assert here.cycle.parameters.tracker.settings.distance.deviation == 0.00038
        here.cycles(1)
        last = here.cycle.last
        assert before is not None
        assert last is not None
        assert last.parameters is here.changes[0][0]
        assert last.parameters.tracker.settings.distance.deviation == 0.001
        assert last.before is before.after
        assert here.changes[0][1:] == ("uid:7", {NOISE: {"old": 0.00038, "new": 0.001}})
        assert here.service.get({"names": [NOISE]}) == {"values": {NOISE: 0.001}}
        assert "uid:7 set" in here.lines[0]

    run(main())


def test_a_live_change_compiles_to_what_a_start_would(make: Make, task: Task) -> None:
    async def main() -> None:
        here = make()
        here.assign({NOISE: 0.001, "tracking.bank.perceived": 5.0, "tracking.camera.gate": 4.0})
        here.cycles(1)
        settings = here.service.settings
        fresh = compiling.build(
            task.file, task.urdf, settings.tracking, here.cycle.parameters.settings, 0.012
        )
        made = here.cycle.parameters.tracker
        assert made.settings == fresh.tracker.settings
        assert repr(made.classifier) == repr(fresh.tracker.classifier)
        assert repr(made.transverse) == repr(fresh.tracker.transverse)

    run(main())


def another(settings: tree.Settings, name: str, value: Any) -> tree.Settings:
    """Return the settings with another value of a parameter, within its range."""
    if isinstance(value, bool):
        return tree.change(settings, {name: not value})
    for factor in (2.0, 0.5, 1.01):
        changed = [type(each)(factor * each or 0.001) for each in np.atleast_1d(value).tolist()]
        with contextlib.suppress(tree.SettingError):
            return tree.change(settings, {name: changed if np.ndim(value) else changed[0]})
    raise AssertionError(name)


def test_every_live_change_compiles_to_what_a_start_would(task: Task) -> None:
    control = shipped_control()
    settings = tree.Settings(TrackingSettings(), control, WatchSettings())
    made = compiling.build(task.file, task.urdf, settings.tracking, control, 0.012)
    for name, value in tree.leaves(settings):
        is_live = parameter_list.change_rule(name).change is ChangeTime.LIVE
        if is_live and name.startswith("tracking."):
            settings = another(settings, name, value)
    live = compiling.retuned(made, settings.tracking).tracker
    fresh = compiling.build(task.file, task.urdf, settings.tracking, control, 0.012)
    with np.printoptions(threshold=10**6, precision=17):
        for part in fields(live):
            assert repr(getattr(live, part.name)) == repr(getattr(fresh.tracker, part.name))


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({NOISE: -1.0}, "tracking.distance.deviation: should be greater than or equal to 0.00001"),
        ({NOISE: "small"}, "tracking.distance.deviation"),
        ({NOISE: True}, "tracking.distance.deviation"),
        ({NOISE: None}, "tracking.distance.deviation"),
        ({NOISE: [1.0]}, "tracking.distance.deviation"),
        ({"tracking.nonsense": 1}, "no parameter tracking.nonsense"),
        ({"tracking.distance": 1}, "no parameter tracking.distance"),
        ({"nonsense": 1}, "no parameter nonsense"),
        ({"control.servos.9.damping": 1.0}, "no parameter control.servos.9.damping"),
        ({"tracking.classifier": "oracle"}, "tracking.classifier"),
        ({"watch.missed_s": 0}, "watch.missed_s"),
        ({"watch.healthy_cycles": 2.5}, "watch.healthy_cycles"),
        ({"watch.missed_s": 0.2}, "watch.missed_s: 0.2 s is longer than watch.link_lost_s: 0.1 s"),
        ({"rsi.cycle_ms": 4}, "the configuration file"),
        ({"command.socket": "/tmp/x"}, "the configuration file"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_name_and_nothing_of_it_is_taken(
    make: Make, values: dict[str, Any], reason: str
) -> None:
    async def main() -> None:
        here = make()
        here.cycles(5)
        settings, made_with = here.service.settings, here.cycle.parameters
        answer = here.assign({"watch.healthy_cycles": 33, **values})
        assert reason in answer["refused"]
        here.cycles(2)
        assert here.service.settings is settings
        assert here.cycle.parameters is made_with
        assert here.service.get({"names": ["watch.healthy_cycles"]})["values"] != {
            "watch.healthy_cycles": 33
        }
        assert not here.changes

    run(main())


def test_every_error_of_a_change_is_reported_at_once(make: Make) -> None:
    async def main() -> None:
        answer = make().assign({NOISE: -1.0, "tracking.camera.gate": 0.0, "watch.missed_s": -3})
        for name in (NOISE, "tracking.camera.gate", "watch.missed_s"):
            assert name in answer["refused"]

    run(main())


def test_what_needs_the_compiler_begins_again_where_the_robot_stands(make: Make) -> None:
    async def main() -> None:
        here = make()
        here.cycles(20)
        last = here.cycle.last
        assert last is not None
        answer = await kept(here.assign({SERVO: 5.0, "control.horizon_s": 0.6}))
        assert set(answer["changed"]) == {SERVO, "control.horizon_s"}
        here.cycles(2)
        now = here.cycle.last
        assert now is not None
        assert now.outputs.command == last.outputs.command
        assert now.parameters is here.changes[0][0]
        assert here.cycle.parameters.settings.servos[2].frequency_hz == 5.0
        assert here.cycle.parameters.controller.steps == 50

    run(main())


def test_the_loop_answers_while_the_compiler_runs_and_one_change_waits_for_another(
    make: Make,
) -> None:
    async def main() -> None:
        here = make()
        here.cycles(5)
        promise = here.assign({SERVO: 5.0})["promise"]
        assert "compiled" in here.assign({NOISE: 0.001})["refused"]
        cycles = 0
        while not promise.done():
            here.cycles(1)
            cycles += 1
            await asyncio.sleep(0)
        assert cycles > 0
        assert "changed" in promise.result()
        assert "changed" in here.assign({NOISE: 0.001})
        here.cycles(1)
        made = here.cycle.parameters
        assert (made.settings.servos[2].frequency_hz, made.tracker.settings.distance.deviation) == (
            5.0,
            0.001,
        )

    run(main())


def test_a_live_change_keeps_a_compiled_one_that_waits_for_its_step(make: Make) -> None:
    async def main() -> None:
        here = make()
        here.cycles(5)
        await kept(here.assign({SERVO: 5.0}))
        here.assign({NOISE: 0.001})
        here.cycles(1)
        assert here.cycle.parameters.settings.servos[2].frequency_hz == 5.0
        assert here.cycle.parameters.tracker.settings.distance.deviation == 0.001

    run(main())


@pytest.mark.parametrize("state", [State.ARMED, State.TRACK, State.CONTACT, State.RETREAT])
def test_the_robots_model_does_not_change_while_it_may_move(make: Make, state: State) -> None:
    async def main() -> None:
        here = make()
        here.cycles(5)
        in_state(here.cycle, state)
        for name, value in ((SERVO, 5.0), ("tracking.distance.scale", 1.01)):
            assert name in here.assign({name: value})["refused"]
        if state is State.CONTACT:
            refused = here.assign({"tracking.tactile.contact_force": 20.0})["refused"]
            assert "not change in contact" in refused
        if state is State.TRACK:
            assert "changed" in here.assign({"tracking.tactile.contact_force": 20.0})
        assert "changed" in here.assign({NOISE: 0.001})

    run(main())


@pytest.mark.parametrize("state", [State.FAULT, State.IDLE])
def test_a_tool_that_was_left_on_the_object_is_not_forgotten_for_another_model(
    make: Make, state: State
) -> None:
    here = make()
    here.cycles(5)
    last = here.cycle.last
    assert last is not None
    here.cycle.last = structs.replace(last, outputs=structs.replace(last.outputs, contact=True))
    in_state(here.cycle, state)
    assert here.cycle.stands
    for name in (SERVO, "tracking.tactile.contact_force"):
        assert here.assign({name: 5.0})["refused"] == f"{name} does not change in contact"


def test_a_compiled_change_is_not_taken_by_a_robot_that_has_moved(make: Make) -> None:
    async def main() -> None:
        here = make()
        here.cycles(5)
        answer = here.assign({SERVO: 5.0})
        in_state(here.cycle, State.ARMED)
        assert "has moved since" in (await kept(answer))["refused"]
        here.cycles(1)
        assert here.cycle.parameters.settings.servos[2].frequency_hz == 4.5
        assert not here.changes

    run(main())


def test_what_is_already_so_changes_nothing(make: Make) -> None:
    async def main() -> None:
        here = make()
        assert here.assign({NOISE: 0.00038, SERVO: 4.5}) == {"changed": {}}

    run(main())


def test_what_was_saved_is_in_force_after_a_restart_and_the_users_file_is_as_it_was(
    make: Make, tmp_path: Path
) -> None:
    async def main() -> None:
        here = make()
        here.cycles(5)
        here.assign({NOISE: 0.001, "watch.missed_s": 0.04})
        await kept(here.assign({SERVO: 5.0}))
        (listed,) = here.service.describe({"prefix": NOISE})["params"]
        assert (listed["by"], listed["unsaved"], listed["file"]) == ("uid:7", True, 0.00038)
        answer = here.service.save("uid:7")
        assert isinstance(answer, asyncio.Future)
        assert (await answer)["saved"] == str(tmp_path / overlays.NAME)
        (listed,) = here.service.describe({"prefix": NOISE})["params"]
        assert "unsaved" not in listed
        assert here.path.read_text() == TEXT
        again = make()
        assert again.service.settings == here.service.settings
        assert again.station.written.tracking.distance.deviation == 0.00038
        assert again.service.settings.control.brake.jerk == 20.0
        again.assign({NOISE: 0.00038, "watch.missed_s": 0.03})
        await kept(again.assign({SERVO: 4.5}))
        saved = again.service.save("uid:7")
        assert isinstance(saved, asyncio.Future)
        await saved
        assert not (tmp_path / overlays.NAME).exists()

    run(main())


def test_who_changed_what_is_in_the_log_of_changes(make: Make, tmp_path: Path) -> None:
    async def main() -> None:
        here = make()
        here.assign({NOISE: 0.001}, "panel")
        saved = here.service.save("panel")
        assert isinstance(saved, asyncio.Future)
        await saved
        await asyncio.get_running_loop().shutdown_default_executor()
        first, second = map(json.loads, (tmp_path / overlays.JOURNAL).read_text().splitlines())
        assert first["who"] == "panel"
        assert first["changed"] == {NOISE: {"old": 0.00038, "new": 0.001}}
        assert second["saved"].endswith(overlays.NAME)

    run(main())


def test_a_disk_that_refuses_is_a_refusal(make: Make, tmp_path: Path) -> None:
    async def main() -> None:
        here = make()
        here.assign({"watch.missed_s": 0.04})
        (tmp_path / overlays.NAME).mkdir()
        saved = here.service.save("uid:7")
        assert isinstance(saved, asyncio.Future)
        assert "not saved" in (await saved)["refused"]

    run(main())
    assert [path.name for path in tmp_path.glob(".parameters*")] == []


def test_without_a_directory_nothing_is_saved_and_the_reason_says_what_to_do(
    tmp_path: Path, parameters: Parameters, task: Task
) -> None:
    (tmp_path / "linemated.yaml").write_text("task: wheel.yaml\n")

    async def main() -> None:
        answer = Standing(tmp_path, parameters, task).service.save("uid:7")
        assert isinstance(answer, dict)
        assert "StateDirectory" in answer["refused"]

    run(main())


def test_overlays_are_laid_in_their_order_and_reported_by_their_own_place(tmp_path: Path) -> None:
    path = tmp_path / "linemated.yaml"
    path.write_text("task: wheel.yaml\nstate: .\noverlays: [one.yaml]\nwatch: {missed_s: 0.05}\n")
    (tmp_path / "one.yaml").write_text("watch: {missed_s: 0.06, leak_s: 0.12}\n")
    (tmp_path / overlays.NAME).write_text("watch: {missed_s: 0.07}\n")
    station = config.load(path)
    assert (station.config.watch.missed_s, station.config.watch.leak_s) == (0.07, 0.12)
    assert station.written.watch.missed_s == 0.06
    (tmp_path / overlays.NAME).write_text("watch:\n  missed_s: no\nrsi: {port: 1}\n")
    with pytest.raises(FileError) as caught:
        config.load(path)
    where = tmp_path / overlays.NAME
    assert any(line.startswith(f"{where}:2:13: watch.missed_s") for line in caught.value.lines)
    assert any(line.startswith(f"{where}:3:1: rsi") for line in caught.value.lines)


def test_one_bad_overlay_does_not_hide_what_is_wrong_with_the_next(tmp_path: Path) -> None:
    path = tmp_path / "linemated.yaml"
    path.write_text("task: wheel.yaml\noverlays: [none.yaml, one.yaml, two.yaml]\n")
    (tmp_path / "one.yaml").write_text("watch: {nope: 1}\n")
    (tmp_path / "two.yaml").write_text("watch: {missed_s: no}\n")
    with pytest.raises(FileError) as caught:
        config.load(path)
    lines = [line.removeprefix(f"{tmp_path}/").split(": ")[:2] for line in caught.value.lines]
    assert lines == [
        ["none.yaml:1:1", "(file)"],
        ["one.yaml:1:9", "watch.nope"],
        ["two.yaml:1:19", "watch.missed_s"],
    ]


def test_an_overlay_cannot_put_time_outs_out_of_their_order(tmp_path: Path) -> None:
    path = tmp_path / "linemated.yaml"
    path.write_text("task: wheel.yaml\noverlays: [one.yaml]\nwatch: {link_lost_s: 0.05}\n")
    (tmp_path / "one.yaml").write_text("watch: {missed_s: 0.06}\n")
    with pytest.raises(FileError) as caught:
        config.load(path)
    (line,) = caught.value.lines
    assert "one.yaml:1:19: watch.missed_s: 0.06 s is longer than watch.link_lost_s" in line


def test_an_overlay_lets_no_dead_time_drift_where_servos_are_learned(tmp_path: Path) -> None:
    path = tmp_path / "linemated.yaml"
    path.write_text("task: wheel.yaml\noverlays: [one.yaml]\nlearning: {}\n")
    (tmp_path / "one.yaml").write_text("control: {drift: {longer: 0.05}}\n")
    with pytest.raises(FileError) as caught:
        config.load(path)
    (line,) = caught.value.lines
    assert "one.yaml:1:18: control.drift: learning is set" in line


def test_a_difference_laid_over_its_base_gives_the_whole() -> None:
    base = {"a": 1, "b": {"c": [1, 2], "d": 2.0}, "e": "x"}
    whole = {"a": 1, "b": {"c": [1, 3], "d": 2.0}, "e": "y"}
    over = tree.difference(whole, base)
    assert over == {"b": {"c": [1, 3]}, "e": "y"}
    assert tree.merge(base, over) == whole
    assert tree.difference(base, base) == {}


def test_a_touch_that_is_felt_at_the_overload_is_refused_as_in_the_file(make: Make) -> None:
    here = make()
    here.cycles(3)
    answer = here.assign({"tracking.tactile.contact_force": 300.0})
    assert "contact_force: a touch is felt from 300 N on, at most half" in answer["refused"]


def test_a_deviation_below_that_of_the_counts_is_refused_as_in_the_file(make: Make) -> None:
    """Saved, it would keep the daemon from its next start."""
    here = make()
    sensor = "distance: {can: {interface: virtual}, message: TF03, signal: Distance}\n"
    here.path.write_text(f"{TEXT}{sensor}tracking: {{distance: {{deviation: 3e-3}}}}\n")
    here = make()
    here.cycles(3)
    answer = here.assign({NOISE: 0.001})
    assert answer["refused"].startswith(f"{NOISE}: 1 mm is less than counts of 10 mm have, 2.9 mm")


@pytest.mark.parametrize("key", ["shorter", "longer"])
def test_dead_times_may_not_drift_while_servos_are_learned(make: Make, key: str) -> None:
    """A longer dead time would be learned as a slower servo, as in the file."""
    here = make()
    here.path.write_text(f"{TEXT}learning: {{}}\n")
    here = make()
    here.cycles(3)
    answer = here.assign({f"control.drift.{key}": 0.05})
    assert answer["refused"].startswith("control.drift: learning is set: a longer dead time would")


def test_a_limit_wider_than_the_urdfs_is_refused_with_both(make: Make) -> None:
    here = make()
    here.cycles(3)
    answer = here.assign({"control.limits.3.speed": 3.1})
    assert answer["refused"] == (
        "control.limits.3.speed: 3.1 is wider than the URDF's for A4: 2.37365"
    )
