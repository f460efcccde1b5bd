"""What viewers are shown: the shapes that they know, and the numbers of the step."""

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from msgspec.structs import replace

from linemate.daemon.config.task_file import Task
from linemate.daemon.core import rotations
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.recording import viewer_messages
from linemate.daemon.recording.step_file import StepFile
from linemate.daemon.recording.step_items import StepItems, metadata_of

KINDS: dict[str, tuple[type, ...]] = {
    "object": (dict,),
    "array": (list,),
    "number": (int, float),
    "integer": (int,),
    "string": (str,),
}


def check(value: Any, schema: dict[str, Any], where: str = "") -> None:
    """Hold a value to the part of JSON schema that these schemas use."""
    if "oneOf" in schema:
        assert value in [option["const"] for option in schema["oneOf"]], where
        return
    assert isinstance(value, KINDS[schema["type"]]), where
    assert not isinstance(value, bool), where
    if schema["type"] == "object":
        assert set(schema.get("required", ())) <= set(value), where
        assert set(value) <= set(schema["properties"]), where
        for key, item in value.items():
            check(item, schema["properties"][key], f"{where}.{key}")
    elif schema["type"] == "array":
        for item in value:
            check(item, schema["items"], f"{where}[]")
    else:
        assert schema.get("minimum", value) <= value <= schema.get("maximum", value), where


@pytest.fixture(scope="module")
def recording(
    tmp_path_factory: pytest.TempPathFactory, entries: tuple[LogEntry, ...], task: Task
) -> Path:
    path = tmp_path_factory.mktemp("viewers") / "r.mcap"
    file, feed = (
        StepFile(path.open("wb"), metadata_of({"urdf": task.urdf}), wall_offset_ns=10**18),
        StepItems(),
    )
    last = entries[-1]
    seen = replace(last.outputs, part=last.outputs.target, sensed=last.outputs.target)
    for entry in (*entries[:-2], replace(last, outputs=seen)):
        for item in feed.convert(entry):
            file.write_item(item)
    file.close()
    return path


def messages(path: Path) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            if schema is not None and schema.name.startswith("foxglove."):
                assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
                value = json.loads(message.data)
                check(value, json.loads(schema.data), channel.topic)
                found.setdefault(channel.topic, []).append((message, value))
    return found


def test_every_message_has_the_shape_that_its_schema_says(recording: Path) -> None:
    assert set(messages(recording)) == set(viewer_messages.TOPICS)


def test_joints_and_poses_are_those_of_the_step(
    recording: Path, entries: tuple[LogEntry, ...], parameters: Parameters
) -> None:
    found = messages(recording)
    first = entries[0]
    joints = {joint["name"]: joint["position"] for joint in found["/joints"][0][1]["joints"]}
    assert first.inputs.robot is not None
    measured = (*first.inputs.robot.joints, first.inputs.robot.external[0])
    assert list(joints) == ["A1", "A2", "A3", "A4", "A5", "A6", "E1"]
    assert list(joints.values()) == pytest.approx(measured, abs=1e-6)
    pose = found["/pose/target"][0][1]["pose"]
    w, x, y, z = (pose["orientation"][part] for part in "wxyz")
    assert np.allclose(
        rotations.matrix((w, x, y, z)), rotations.matrix(first.outputs.target[3:]), atol=1e-5
    )
    transforms = found["/tf"][0][1]["transforms"]
    assert {t["child_frame_id"] for t in transforms} == {"rail", "tcp"}
    assert {t["parent_frame_id"] for t in transforms} == {"base"}


def test_viewers_are_shown_fifty_steps_a_second_at_most(
    recording: Path, entries: tuple[LogEntry, ...]
) -> None:
    stamps = [message.publish_time for message, _ in messages(recording)["/tf"]]
    assert min(b - a for a, b in pairwise(stamps)) >= 20_000_000
    assert len(stamps) == len(entries) // 2


def test_times_are_those_of_the_wall(recording: Path, entries: tuple[LogEntry, ...]) -> None:
    message, value = messages(recording)["/tf"][0]
    wall_ns = entries[0].inputs.stamp_ns + 10**18
    time = value["transforms"][0]["timestamp"]
    assert time["sec"] * 10**9 + time["nsec"] == message.log_time == wall_ns


def test_the_arm_goes_along_for_viewers_that_draw_it(recording: Path, task: Task) -> None:
    with recording.open("rb") as stream:
        (arm,) = make_reader(stream).iter_attachments()
    assert arm.name == "arm.urdf"
    assert arm.data.decode() == task.urdf
    assert viewer_messages.root_link(task.urdf) == "rail"
    assert viewer_messages.root_link("<robot") == "base"


def test_a_scene_keeps_the_joints_of_a_urdf_and_leaves_its_looks_out() -> None:
    urdf = (
        '<robot name="r"><link name="a"><visual><geometry><mesh filename="x"/></geometry></visual>'
        '</link><link name="b"/><joint name="j" type="revolute"><parent link="a"/><child link="b"/>'
        '<origin xyz="1 2 3"/><axis xyz="0 0 1"/><limit lower="0" upper="1"/></joint></robot>'
    )
    scene = viewer_messages.scene({"task": "name: t", "urdf": urdf, "config": "secret"}, 0.004)
    assert scene["task"] == "name: t"
    assert scene["cycle_s"] == 0.004
    assert "mesh" not in scene["urdf"]
    assert '<origin xyz="1 2 3" />' in scene["urdf"]
    assert viewer_messages.root_link(scene["urdf"]) == "a"
    assert "secret" not in str(scene)


def test_a_scene_without_a_readable_urdf_has_no_arm() -> None:
    assert viewer_messages.scene({"urdf": "<robot"}, 0.012)["urdf"] == ""
