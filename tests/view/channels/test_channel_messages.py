"""Messages of the standard channels: frames that fit together, units, and what is missing."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("foxglove", reason="foxglove-sdk is in the extra foxglove")
pytest.importorskip("mcap_protobuf", reason="mcap-protobuf-support is in the extra dev")
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory

from linemate.daemon.core import rotations
from linemate.daemon.recording.reader import read
from linemate.daemon.view.cell import Cell, read_cell
from linemate.daemon.view.channels.channel_messages import (
    TOPICS,
    ChannelMessage,
    StandardChannels,
    descriptor,
)

GOLDEN = Path(__file__).parents[2] / "system" / "golden" / "wheel.mcap"
MOMENT = {
    "stamp_ns": 1_000_000_000,
    "k": 1,
    "state": "track",
    "phase": "approach",
    "task_time": 0.5,
    "scenario": "stopping",
    "scenario_state": "tentative",
    "confidence": 2.5,
    "speed": 0.1,
    "contact": False,
    "held": None,
    "target": (1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0),
    "sensed": (1.0, 2.0, 3.001, 1.0, 0.0, 0.0, 0.0),
    "part": None,
    "command": (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7),
}


def decode(message: ChannelMessage) -> Any:
    name = TOPICS[message.topic]
    schema = Schema(id=1, name=name, encoding="protobuf", data=descriptor(name))
    decoder = DecoderFactory().decoder_for("protobuf", schema)
    assert decoder is not None
    return decoder(message.data)


def by_topic(channels: StandardChannels, moment: dict[str, Any], wall_ns: int) -> dict[str, Any]:
    return {message.topic: decode(message) for message in channels.moment(moment, wall_ns)}


def test_a_moment_gives_class_state_and_errors_in_si() -> None:
    shown = by_topic(StandardChannels(Cell()), MOMENT, 7_000_000_000)
    conveyor, state, errors = shown["/conveyor"], shown["/state"], shown["/errors"]
    assert (conveyor.scenario, conveyor.scenario_number, conveyor.tentative) == (
        "stopping",
        1,
        True,
    )
    assert (conveyor.confidence, conveyor.speed) == (2.5, 0.1)
    assert (state.state, state.state_number, state.phase) == ("track", 3, "approach")
    assert errors.plan == pytest.approx(0.001)
    assert np.isnan(errors.control)
    assert shown["/pose/sensed"].pose.position.z == 3.001
    assert shown["/pose/sensed"].timestamp.seconds == 7
    commanded = {joint.name: joint.position for joint in shown["/joints_commanded"].joints}
    assert commanded == {
        "A1": 0.1,
        "A2": 0.2,
        "A3": 0.3,
        "A4": 0.4,
        "A5": 0.5,
        "A6": 0.6,
        "E1": 0.7,
    }


def test_what_is_not_known_has_no_message() -> None:
    shown = by_topic(StandardChannels(Cell()), MOMENT, 0)
    assert not {"/pose/part", "/pose/measured", "/joints"} & set(shown)
    assert {transform.child_frame_id for transform in shown["/tf"].transforms} == {
        "base",
        "tcp",
        "tcp_sensed",
    }


def test_scene_and_transforms_come_fifty_times_a_second_at_most() -> None:
    channels = StandardChannels(Cell())
    shown = [
        set(by_topic(channels, {**MOMENT, "stamp_ns": k * 4_000_000}, k * 4_000_000))
        for k in range(10)
    ]
    assert ["/tf" in topics for topics in shown] == [k % 5 == 0 for k in range(10)]
    assert all("/errors" in topics for topics in shown)


def test_a_line_of_the_log_keeps_its_level_and_its_writer() -> None:
    line = decode(StandardChannels(Cell()).line(5, "the camera is frozen", 3, "linemated"))
    assert (line.message, line.level, line.name) == ("the camera is frozen", 3, "linemated")


def matrix(pose: Any) -> np.ndarray[Any, Any]:
    where = getattr(pose, "position", None) or pose.translation
    turn = getattr(pose, "orientation", None) or pose.rotation
    whole = np.eye(4)
    whole[:3, :3] = rotations.matrix((turn.w, turn.x, turn.y, turn.z))
    whole[:3, 3] = where.x, where.y, where.z
    return whole


def test_the_camera_sees_the_object_where_the_transforms_place_it() -> None:
    recording = read(GOLDEN)
    channels = StandardChannels(read_cell(recording.texts))
    distances = []
    joints: tuple[float, ...] = ()
    for step in recording.steps:
        robot = step.inputs.robot
        joints = joints if robot is None else (*robot.joints, *robot.external)
        if not step.inputs.camera or step.outputs["part"] is None or step.state != "track":
            continue
        seen = step.inputs.camera[-1]
        camera = decode(channels.camera(0, seen.frame, (*seen.position, *seen.quaternion)))
        moment = {**step.outputs, "stamp_ns": step.inputs.stamp_ns, "state": step.state}
        shown = by_topic(channels, {**moment, "measured": joints[:7], "measured_ns": 0}, 0)
        if "/tf" not in shown:
            channels._shown_ns = None
            continue
        channels._shown_ns = None
        frames = {transform.child_frame_id: transform for transform in shown["/tf"].transforms}
        assert frames["camera"].parent_frame_id == "tcp_measured"
        placed = matrix(frames["tcp_measured"]) @ matrix(frames["camera"]) @ matrix(camera.pose)
        distances.append(np.linalg.norm(placed[:3, 3] - matrix(shown["/pose/part"].pose)[:3, 3]))
    assert len(distances) > 50
    # The image is 0.1 s old, and the line runs at 0.1 m/s.
    assert np.median(distances) < 0.02
