"""Task files: the shipped one, and what is wrong in others."""

import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from linemate.daemon.config import documents, task_file
from linemate.daemon.config.documents import FileError
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.core import rotations

WHEEL = DAEMON_DATA / "wheel.yaml"


def errors(text: str) -> list[str]:
    with pytest.raises(FileError) as caught:
        task_file.parse(text.encode(), "t.yaml")
    return [line.removeprefix("t.yaml:") for line in caught.value.lines]


def edited(old: str, new: str) -> str:
    text = WHEEL.read_text(encoding="utf-8")
    assert old in text
    return text.replace(old, new, 1)


def test_the_shipped_task_loads_with_its_arm() -> None:
    task = task_file.load(WHEEL)
    assert task.file.name == "wheel"
    assert "<robot" in task.urdf
    assert task.text == WHEEL.read_text(encoding="utf-8")


def test_a_urdf_next_to_the_task_is_taken_before_a_shipped_one(tmp_path: Path) -> None:
    shutil.copy(WHEEL, tmp_path / "t.yaml")
    assert task_file.load(tmp_path / "t.yaml").urdf == (DAEMON_DATA / "arm.urdf").read_text()
    (tmp_path / "arm.urdf").write_text("<robot name='mine'/>")
    assert task_file.load(tmp_path / "t.yaml").urdf == "<robot name='mine'/>"


def test_a_missing_urdf_is_reported_with_the_other_errors(tmp_path: Path) -> None:
    text = edited("urdf: arm.urdf", "urdf: other.urdf").replace(
        "nominal_speed: 0.106", "nominal_speed: -1"
    )
    (tmp_path / "t.yaml").write_text(text)
    with pytest.raises(FileError) as caught:
        task_file.load(tmp_path / "t.yaml")
    assert len(caught.value.lines) == 2
    assert "arm.urdf: no such file" in caught.value.lines[0]
    assert "shipped are arm.urdf" in caught.value.lines[0]
    assert (
        "conveyor.nominal_speed: should be greater than or equal to 0.005" in caught.value.lines[1]
    )


def test_a_missing_task_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="No such file"):
        task_file.load(tmp_path / "none.yaml")
    with pytest.raises(FileError, match="not a regular file"):
        task_file.load(tmp_path)


def test_times_that_do_not_rise_are_reported_each() -> None:
    text = edited("time: 4.0", "time: 2.8").replace("time: 8.5, phase", "time: 1, phase")
    assert [line.split(": ", 1)[1] for line in errors(text)] == [
        "waypoints[2].time: should be later than the waypoint before (2.8), not 2.8",
        "waypoints[4].time: should be later than the waypoint before (6), not 1",
    ]


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        (
            "quaternion: [1.0, 0.0, 0.0, 0.0]",
            "quaternion: [1.0, 0.1, 0.0, 0.0]",
            "arm.camera_in_tcp.quaternion",
        ),
        (
            "nominal: {position: [2.20, 0.0, 1.10], quaternion: [0.7071067811865476",
            "nominal: {position: [2.20, 0.0, 1.10], quaternion: [0.8",
            "object.nominal.quaternion",
        ),
        (
            "position: [1.80, 0.0, 1.10], quaternion: [0.7071067811865476",
            "position: [1.80, 0.0, 1.10], quaternion: [0",
            "waypoints[0].pose.quaternion",
        ),
        ("axis: [0.0, 1.0, 0.0]", "axis: [0.0, 2.0, 0.0]", "conveyor.axis"),
    ],
)
def test_what_should_be_unit_and_is_not_is_reported(old: str, new: str, key: str) -> None:
    (line,) = errors(edited(old, new))
    assert f" {key}: should have length 1" in line


def test_an_object_whose_y_is_not_the_direction_of_travel_is_reported() -> None:
    (line,) = errors(edited("axis: [0.0, 1.0, 0.0]", "axis: [1.0, 0.0, 0.0]"))
    assert "object.nominal.quaternion: its y axis should lie along conveyor.axis" in line


def test_rounded_quaternions_come_out_exactly_unit() -> None:
    text = WHEEL.read_text(encoding="utf-8").replace("0.7071067811865476", "0.7071")
    task = task_file.parse(text.encode(), "t")
    for pose in (task.object.nominal, task.arm.tcp_in_flange, task.waypoints[0].pose):
        assert math.hypot(*pose.quaternion) == pytest.approx(1.0, abs=1e-15)


def test_errors_of_kind_and_of_relation_come_together() -> None:
    text = edited("time: 4.0", "time: soon").replace("phase: screws", "phase: rest")
    text = text.replace("time: 14.0", "time: 3")
    keys = [line.split(": ")[1] for line in errors(text)]
    assert keys == [
        "tool.fix_screws",
        "waypoints[2].time",
        "waypoints[4].phase",
        "waypoints[5].time",
    ]


@pytest.mark.parametrize("value", ["3", "[]", "{}", "[[1]]", "[{time: 1}]", "null", "text"])
def test_waypoints_of_any_kind_are_reported_and_nothing_else_happens(value: str) -> None:
    head = WHEEL.read_text(encoding="utf-8").split("waypoints:")[0]
    assert all("waypoints" in line for line in errors(f"{head}waypoints: {value}\n"))


def test_the_schema_describes_a_task() -> None:
    schema = task_file.schema()
    assert set(schema["required"]) == {"name", "arm", "object", "waypoints"}
    assert schema["title"] == "linemate task"


def test_a_gate_on_a_signal_that_is_ordered_later_is_reported() -> None:
    (line,) = errors(edited("fix_screws: 8.5", "fix_screws: 14.1"))
    assert "tool.fix_screws: 14.1 s is after waypoints[5] at 14 s, which waits for it" in line
    (line,) = errors(edited("release_wheel: 14.5", "release_wheel: 850"))
    assert "tool.release_wheel: 850 s is after waypoints[7] at 15 s" in line


def overlaid(text: str, *, is_variant: bool = False) -> task_file.Task:
    over = documents.read(text.encode(), "o.yaml")
    return task_file.laid_over(task_file.load(WHEEL), over, is_variant=is_variant)


def test_an_overlay_replaces_a_frame_of_the_tool_and_its_text_says_so() -> None:
    made = overlaid("task: {arm: {camera_in_tcp: {position: [0.1, 0.2, 0.3]}, sensor_sign: -1}}")
    assert made.file.arm.camera_in_tcp.position == (0.1, 0.2, 0.3)
    assert made.file.arm.sensor_sign == -1
    assert made.file.arm.tcp_in_flange == task_file.load(WHEEL).file.arm.tcp_in_flange
    assert task_file.parse(made.text.encode(), "text") == made.file


def test_a_measured_direction_of_the_conveyor_turns_the_nominal_object_with_it() -> None:
    c, s = math.cos(0.01), math.sin(0.01)
    made = overlaid(f"task: {{conveyor: {{axis: [{-s}, {c}, 0.0]}}}}")
    before = rotations.matrix(task_file.load(WHEEL).file.object.nominal.quaternion)
    after = rotations.matrix(made.file.object.nominal.quaternion)
    assert after[:, 1] == pytest.approx((-s, c, 0.0), abs=1e-9)
    assert float(np.linalg.norm(rotations.log(before.T @ after))) == pytest.approx(0.01, abs=1e-6)
    assert made.file.object.nominal.position == (2.2, 0.0, 1.1)


def test_the_object_of_an_overlay_is_not_that_of_a_variant() -> None:
    text = "task: {object: {nominal: {position: [2.0, 0.0, 1.0], quaternion: [0.70710678, 0.0, "
    text += "0.70710678, 0.0]}}, arm: {sensor_sign: -1}}"
    assert overlaid(text).file.object.nominal.position == (2.0, 0.0, 1.0)
    variant = overlaid(text, is_variant=True)
    assert variant.file.object.nominal.position == (2.2, 0.0, 1.1)
    assert variant.file.arm.sensor_sign == -1


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("task: {arm: {urdf: other.urdf}}", "arm.urdf: an overlay of a task may hold tcp_in"),
        ("task: {waypoints: []}", "waypoints: an overlay of a task may hold arm, conveyor, object"),
        ("task: wheel.yaml", "should hold arm, conveyor or object"),
        ("task: {conveyor: {nominal_speed: 9.0}}", "conveyor.nominal_speed: should be less"),
        ("task: {conveyor: {axis: [0.0, -1.0, 0.0]}}", "its y axis should lie along conveyor.axis"),
        ("task: {arm: {sensor_in_tcp: {position: [0, 0, 0], quaternion: [2, 0, 0, 0]}}}", "length"),
    ],
)
def test_what_an_overlay_of_a_task_may_not_hold_is_refused(text: str, what: str) -> None:
    with pytest.raises(FileError) as caught:
        overlaid(text)
    assert any(what in line and line.startswith("o.yaml:1:") for line in caught.value.lines)


def test_an_order_before_contact_or_a_release_before_the_screws_is_reported() -> None:
    (line,) = errors(edited("fix_screws: 8.5", "fix_screws: 5.9"))
    assert "tool.fix_screws: 5.9 s is before waypoints[3] at 6 s, where contact begins" in line
    (line,) = errors(edited("release_wheel: 14.5", "release_wheel: 0.0"))
    assert "tool.release_wheel: 0 s is before tool.fix_screws at 8.5 s" in line
