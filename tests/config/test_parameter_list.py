"""Parameters as operators see them: everything comes from the settings themselves."""

import json
from dataclasses import fields, replace

import pytest

from linemate.daemon.config import config
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.config.parameter_list import (
    RULES,
    ChangeRule,
    ChangeTime,
    Parameter,
    change_rule,
    list_parameters,
    read_values,
    select,
)
from linemate.daemon.config.settings import CameraSettings, Config, RecordingSettings
from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core.tracking.across.transverse import Transverse
from linemate.daemon.core.tracking.settings import CameraNoise, FusionSettings
from linemate.protocol.command.frame_codec import MAX_RESULT_BYTES
from linemate.protocol.command.payloads import encode_result
from linemate.simulators.harness.setup import shipped_control

CONFIG = replace(Config("t"), control=shipped_control(), watch=WatchSettings(healthy_cycles=7))


@pytest.fixture(scope="module")
def listed() -> tuple[Parameter, ...]:
    return tuple(list_parameters(CONFIG))


def test_the_shipped_schema_is_that_of_the_settings() -> None:
    text = (DAEMON_DATA / "linemated.schema.json").read_text(encoding="utf-8")
    assert json.loads(text) == config.schema(), "run `make docs-write`"


def test_a_parameter_has_value_default_range_unit_and_meaning(
    listed: tuple[Parameter, ...],
) -> None:
    by_name = {one["name"]: one for one in listed}
    assert by_name["watch.healthy_cycles"] == {
        "name": "watch.healthy_cycles",
        "value": 7,
        "default": 250 if WatchSettings().healthy_cycles == 250 else WatchSettings().healthy_cycles,
        "live": True,
        "change": "live",
        "type": "int",
        "min": 1,
        "max": 10_000,
        "describe": by_name["watch.healthy_cycles"]["describe"],
    }
    confirmed = by_name["tracking.imm.confirmed"]
    assert (confirmed["min"], confirmed["max"]) == (0.0, 1.0)
    assert confirmed["excluded"] == ["min", "max"]
    deviation = by_name["tracking.distance.deviation"]
    assert deviation["unit"] == "m"
    assert deviation["min"] == 1e-5
    assert "sigma" in deviation["describe"]


def test_items_of_lists_have_names_of_their_own(listed: tuple[Parameter, ...]) -> None:
    names = [one["name"] for one in listed]
    assert "control.servos.6.frequency_hz" in names
    assert "tracking.swing.0.levers" in names
    assert len(names) == len(set(names)) > 80


def test_a_prefix_picks_and_a_wrong_name_is_refused(listed: tuple[Parameter, ...]) -> None:
    picked = select(listed, {"prefix": "control.limits.0."})["params"]
    assert {one["name"].rpartition(".")[2] for one in picked} == {
        "lower",
        "upper",
        "speed",
        "acceleration",
        "jerk",
    }
    assert read_values(listed, {"names": ["watch.missed_s"]}) == {
        "values": {"watch.missed_s": 0.03}
    }
    assert "nonsense" in read_values(listed, {"names": ["watch.missed_s", "nonsense"]})["refused"]


def test_every_parameter_says_what_it_means_and_what_it_may_be(
    listed: tuple[Parameter, ...],
) -> None:
    assert [one["name"] for one in listed if not one.get("describe")] == []
    assert {one["type"] for one in listed} <= {"bool", "int", "float", "text", "list", "map"}
    by_name = {one["name"]: one for one in listed}
    assert by_name["tracking.classifier"]["choices"] == ["rule", "imm", "bank", "none"]
    assert by_name["fanuc.version"]["choices"] == [3, 4]


def test_a_parameter_changes_live_idle_or_with_a_restart(listed: tuple[Parameter, ...]) -> None:
    change = {one["name"]: one["change"] for one in listed}
    assert change["tracking.distance.deviation"] == "live"
    assert change["tracking.distance.delay"] == "idle"
    assert change["control.servos.3.damping"] == "idle"
    assert change["rsi.port"] if "rsi.port" in change else change["rsi.bind"] == "restart"
    assert change_rule("tracking.tactile.contact_force") == ChangeRule(
        ChangeTime.LIVE, in_contact=False
    )
    assert change_rule("command.socket").change is ChangeTime.RESTART


def test_every_rule_is_of_a_parameter_that_there_is(listed: tuple[Parameter, ...]) -> None:
    names = [one["name"] for one in listed]
    for prefix in RULES:
        assert any(name == prefix or name.startswith(f"{prefix}.") for name in names), prefix


def test_the_whole_list_fits_into_one_answer(listed: tuple[Parameter, ...]) -> None:
    assert len(encode_result(select(listed, {}))) < MAX_RESULT_BYTES


def test_a_section_that_is_off_by_default_differs_by_nothing_when_it_is_there() -> None:
    camera, recording = CameraSettings(port=1), RecordingSettings(".")
    config = Config(task="wheel.yaml", camera=camera, recording=recording)
    listed = {one["name"]: one for one in list_parameters(config)}
    different = {
        name
        for name, one in listed.items()
        if name.startswith(("camera.", "recording.")) and one["value"] != one["default"]
    }
    assert different == {"camera.port", "recording.directory"}


def test_what_changes_the_number_of_the_filters_states_waits_for_idle() -> None:
    def size(camera: CameraNoise) -> int:
        return Transverse(FusionSettings(), (), camera).size

    for field in fields(CameraNoise):
        if isinstance(getattr(CameraNoise(), field.name), float):
            sizes = {size(replace(CameraNoise(), **{field.name: v})) for v in (0.0, 0.5)}
            rule = change_rule(f"tracking.camera.{field.name}")
            assert len(sizes) == 1 or rule.change is ChangeTime.IDLE, field.name
