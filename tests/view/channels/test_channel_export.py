"""Exported channels: read by MCAP's own protobuf decoder, and by the layout that is shipped."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("foxglove", reason="foxglove-sdk is in the extra foxglove")
pytest.importorskip("mcap_protobuf", reason="mcap-protobuf-support is in the extra dev")
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from msgspec.structs import astuple, replace

from linemate.daemon.config.task_file import Task
from linemate.daemon.cycle.clock.timing import CycleTimes
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.operator import main as tool
from linemate.daemon.recording.format import Item, ItemKind
from linemate.daemon.recording.step_file import StepFile
from linemate.daemon.recording.step_items import StepItems, metadata_of
from linemate.daemon.view.channels.channel_messages import LAYOUT_FILE, TOPICS

WALL_NS = 10**18
Decoded = dict[str, list[tuple[Any, Any]]]


@pytest.fixture(scope="module")
def recording(
    tmp_path_factory: pytest.TempPathFactory, entries: tuple[LogEntry, ...], task: Task
) -> Path:
    path = tmp_path_factory.mktemp("channels") / "r.mcap"
    texts = metadata_of({"urdf": task.urdf, "task": task.text})
    file, feed = StepFile(path.open("wb"), texts, wall_offset_ns=WALL_NS), StepItems()
    for entry in entries:
        target = entry.outputs.target
        outputs = replace(entry.outputs, part=target, sensed=target)
        for item in feed.convert(replace(entry, outputs=outputs)):
            file.write_item(item)
        stamp_ns = entry.inputs.stamp_ns
        times = CycleTimes(1, stamp_ns, None, None, 0, None, 350_000, True, "track")
        file.write_item(Item(ItemKind.TIMING, stamp_ns, astuple(times)))
    file.close()
    return path


@pytest.fixture(scope="module")
def exported(recording: Path) -> Path:
    out = recording.with_name("channels.mcap")
    assert tool.main(["export", str(recording), "--foxglove", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def decoded(exported: Path) -> Decoded:
    found: Decoded = {}
    with exported.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for schema, channel, message, value in reader.iter_decoded_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
            assert schema.name == TOPICS[channel.topic]
            found.setdefault(channel.topic, []).append((message, value))
    return found


def test_every_channel_is_a_protobuf_message_with_its_descriptor(decoded: Decoded) -> None:
    assert set(decoded) == set(TOPICS)


def test_every_sample_is_there_with_all_its_digits(
    decoded: Decoded, entries: tuple[LogEntry, ...]
) -> None:
    wrenches = [sample for entry in entries for sample in entry.inputs.wrench]
    forces = [(w.force.x, w.force.y, w.force.z) for _, w in decoded["/wrench"]]
    assert forces == [sample.force for sample in wrenches]
    distances = [sample for entry in entries for sample in entry.inputs.distance]
    assert [d.position for _, d in decoded["/distance"]] == [d.position for d in distances]
    images = [sample for entry in entries for sample in entry.inputs.camera]
    assert [p.pose.position.z for _, p in decoded["/camera/pose"]] == [
        image.position[2] for image in images
    ]
    assert len(decoded["/errors"]) == len(entries)
    assert decoded["/cycle"][0][1].turnaround == pytest.approx(350e-6)


def test_times_are_those_of_the_wall(decoded: Decoded, entries: tuple[LogEntry, ...]) -> None:
    message, distance = decoded["/distance"][0]
    stamp_ns = entries[0].inputs.distance[0].stamp_ns + WALL_NS
    time = distance.timestamp
    assert time.seconds * 10**9 + time.nanos == message.log_time == stamp_ns
    exposed_ns = entries[0].inputs.camera[0].exposure_ns + WALL_NS
    assert decoded["/camera/pose"][0][0].log_time == exposed_ns


def test_the_arm_goes_along(exported: Path, task: Task) -> None:
    with exported.open("rb") as stream:
        (arm,) = make_reader(stream).iter_attachments()
    assert arm.data.decode() == task.urdf


def named(layout: Any) -> Iterator[tuple[str, str]]:
    """The topics and fields that a layout names."""
    for name, panel in layout["configById"].items():
        kind = name.partition("!")[0]
        if kind in {"Plot", "StateTransitions"}:
            for path in panel["paths"]:
                topic, _, fields = path["value"].partition(".")
                yield topic, fields
        elif kind == "3D":
            yield from ((topic, "") for topic in panel["topics"])
        elif kind == "RosOut":
            yield panel["topicToRender"], ""
        else:
            raise AssertionError(f"a panel that this test does not know: {name}")


def missing(layout: Any, decoded: Decoded) -> list[str]:
    """What a layout names and no message has."""
    found = []
    for topic, fields in named(layout):
        values: list[Any] = [value for _, value in decoded.get(topic, ())]
        for field in filter(None, fields.split(".")):
            values = [getattr(value, field) for value in values if hasattr(value, field)]
        if not values:
            found.append(f"{topic}.{fields}")
    return found


def test_all_that_the_shipped_layout_names_is_in_a_recording(decoded: Decoded) -> None:
    layout = json.loads(LAYOUT_FILE.read_text(encoding="utf-8"))
    assert not missing(layout, decoded)
    text = json.dumps(layout)
    damaged = json.loads(
        text.replace("/wrench.force.x", "/wrench.force.u").replace("/log", "/logs")
    )
    assert missing(damaged, decoded) == ["/wrench.force.u", "/logs."]


def test_the_layout_places_every_panel_once_and_names_frames_that_exist(decoded: Decoded) -> None:
    layout = json.loads(LAYOUT_FILE.read_text(encoding="utf-8"))
    placed = re.findall(r'"(\w+!\w+)"', json.dumps(layout["layout"]))
    assert sorted(placed) == sorted(layout["configById"])
    frames = {t.child_frame_id for _, tf in decoded["/tf"] for t in tf.transforms} | {"base"}
    scene = layout["configById"]["3D!cell"]
    shown = {name.removeprefix("frame:") for name in scene["transforms"]}
    assert shown | {scene["followTf"]} <= frames


def test_a_file_is_not_overwritten_and_what_is_no_recording_leaves_none(
    recording: Path, exported: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = exported.read_bytes()
    assert tool.main(["export", str(recording), "--foxglove", str(exported)]) == 2
    assert exported.read_bytes() == before
    out = exported.with_name("none.mcap")
    assert tool.main(["export", str(exported), "--foxglove", str(out)]) == 1
    assert not out.exists()
    assert "not a linemate recording" in capsys.readouterr().err


def test_a_recording_that_was_cut_short_gives_its_good_part(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recording.read_bytes()[:-200])
    out = tmp_path / "out.mcap"
    assert tool.main(["export", str(cut), "--foxglove", str(out)]) == 1
    assert "damaged" in capsys.readouterr().err
    with out.open("rb") as stream:
        assert make_reader(stream).get_summary() is not None
