"""Scenario files: what is shipped loads, and what is wrong is reported with its place."""

import json

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from linemate.daemon.config.documents import FileError
from linemate.simulators.harness import scenario_file
from linemate.simulators.plants.scenario import Scenario
from linemate.simulators.plants.scenario_draw import sample


def complaints(text: str) -> list[str]:
    with pytest.raises(FileError) as caught:
        scenario_file.parse(text.encode(), "x.yaml")
    return list(caught.value.lines)


@pytest.mark.parametrize("name", scenario_file.shipped())
def test_every_shipped_scenario_loads_under_its_own_name(name: str) -> None:
    assert scenario_file.load(name).name == name


def test_the_default_scenario_is_the_papers_experiment() -> None:
    events = scenario_file.load(scenario_file.DEFAULT).events
    assert [(e.kind, e.onset_s) for e in events] == [("stop", 5.0), ("start", 9.0)]
    assert events[1].settled_s == pytest.approx(17.15, abs=0.01)


def test_an_empty_file_is_the_default_scenario() -> None:
    assert scenario_file.parse(b"", "default.yaml") == Scenario(name="default")


def test_every_error_is_reported_at_once_in_order_with_its_place() -> None:
    text = (
        "lead_in_s: -1\n"
        "conveyr: 1\n"
        "conveyor:\n"
        '  nominal_speed: "0.1"\n'
        "  events:\n"
        "   - {kind: stp, onset_s: 5, acceleration: .nan}\n"
        "   - {kind: stop, onset_s: 2001-01-01}\n"
        "camera: {dropout_rate: 1.5, dropout_rate: 1}\n"
        "cycle_s: 0.005\n"
    )
    assert [line.split(": ")[:2] for line in complaints(text)] == [
        ["x.yaml:1:12", "lead_in_s"],
        ["x.yaml:2:1", "conveyr"],
        ["x.yaml:4:18", "conveyor.nominal_speed"],
        ["x.yaml:6:13", "conveyor.events[0].kind"],
        ["x.yaml:6:44", "conveyor.events[0].acceleration"],
        ["x.yaml:7:6", "conveyor.events[1].acceleration"],
        ["x.yaml:7:28", "conveyor.events[1].onset_s"],
        ["x.yaml:8:24", "camera.dropout_rate"],
        ["x.yaml:8:29", "camera.dropout_rate"],
        ["x.yaml:9:10", "cycle_s"],
    ]


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("a: {", "not YAML"),
        ("- 1", "mapping"),
        ("a: &a [*a]", "levels"),
        ("seed: !!python/object:os.system x", "tags"),
        ("seed: yes", "quoted text"),
        ("seed: 1.5", "valid integer"),
        ("conveyor: 3", "conveyor"),
        ("contact: {step: [1, 2]}", "contact.step"),
        ("faults: [{at_s: 1, link: fax, kind: silence}]", "faults[0].link"),
        ("faults: [{at_s: 1, link: camera, kind: deafness}]", "faults[0].kind"),
        ("faults: [1]", "faults[0]"),
        ("faults: 1", "faults"),
    ],
)
def test_a_broken_file_is_refused_with_a_reason(text: str, what: str) -> None:
    assert what in "\n".join(complaints(text))


def test_a_missing_file_names_those_that_are_shipped() -> None:
    with pytest.raises(FileError, match="wheel"):
        scenario_file.load("no-such-scenario")


def test_numbers_may_be_written_with_an_exponent() -> None:
    assert scenario_file.parse(b"camera: {sigma: 1e-3}", "x.yaml").camera.sigma == 1e-3


@given(st.integers(0, 2**32))
def test_a_drawn_scenario_survives_its_own_file(seed: int) -> None:
    drawn = sample(seed, Scenario())
    text = yaml.safe_dump(scenario_file.to_plain(drawn))
    assert scenario_file.parse(text.encode(), "x.yaml") == drawn


@given(st.binary(max_size=200))
def test_any_bytes_give_a_scenario_or_the_one_error(data: bytes) -> None:
    try:
        assert isinstance(scenario_file.parse(data, "x.yaml"), Scenario)
    except FileError as error:
        assert all(line.startswith("x.yaml:") for line in error.lines)  # noqa: PT017


def test_the_schemas_know_every_key_and_the_ranges() -> None:
    scenario = scenario_file.schema("scenario")
    assert scenario["additionalProperties"] is False
    assert {"conveyor", "camera", "faults"} <= set(scenario["properties"])
    rate = scenario["$defs"]["Camera"]["properties"]["dropout_rate"]
    assert (rate["minimum"], rate["maximum"]) == (0.0, 1.0)
    task = scenario_file.schema("task")
    assert {"waypoints", "arm", "object"} <= set(task["required"])
    json.dumps(task)
