"""The live server asked by a WebSocket client that knows Foxglove's protocol."""

import json
import signal
import struct
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("foxglove", reason="foxglove-sdk is in the extra foxglove")
pytest.importorskip("mcap_protobuf", reason="mcap-protobuf-support is in the extra dev")
pytest.importorskip("websockets", reason="websockets is in the extra dev")
import base64

from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory
from rerun import LINEMATE, Rerun, rerun
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from linemate.daemon.operator import main as tool
from linemate.daemon.view.channels.channel_messages import TOPICS

PROTOCOL = Subprotocol("foxglove.sdk.v1")
MESSAGE = struct.Struct("<BIQ")  # opcode 1, subscription, time [ns]
CLASSES = {"running", "stopping", "standing", "starting"}


@contextmanager
def serving(folder: Path) -> Iterator[str]:
    """``linemate view --foxglove`` as a process of its own; its address."""
    words = ("view", "--foxglove", "--port", "0", "--socket", str(folder / "command.sock"))
    with subprocess.Popen([*LINEMATE, *words], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            address = process.stdout.readline().strip()
            assert address.startswith("ws://127.0.0.1:")
            assert Path(process.stdout.readline().strip().removeprefix("layout: ")).exists()
            yield address
        finally:
            process.send_signal(signal.SIGTERM)
            assert process.wait(20.0) == 0


def advertised(link: ClientConnection) -> dict[str, Any]:
    """The channels by topic, as the server announces them."""
    channels: dict[str, Any] = {}
    while len(channels) < len(TOPICS):
        message = json.loads(link.recv(10.0))
        if message["op"] == "serverInfo":
            assert message["capabilities"] == []
        elif message["op"] == "advertise":
            channels |= {channel["topic"]: channel for channel in message["channels"]}
    return channels


def received(address: str, *topics: str) -> dict[str, tuple[int, Any]]:
    """The first message of each topic: its time, and the value."""
    with connect(address, subprotocols=[PROTOCOL]) as link:
        channels = advertised(link)
        assert set(channels) == set(TOPICS)
        wanted = [{"id": n, "channelId": channels[t]["id"]} for n, t in enumerate(topics)]
        link.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        found: dict[str, tuple[int, Any]] = {}
        deadline = time.monotonic() + 20.0
        while len(found) < len(topics) and time.monotonic() < deadline:
            data = link.recv(10.0)
            if isinstance(data, bytes) and data[0] == 1:
                _, number, time_ns = MESSAGE.unpack_from(data)
                value = decoded(channels[topics[number]], data[MESSAGE.size :])
                found.setdefault(topics[number], (time_ns, value))
    return found


def decoded(channel: Any, data: bytes) -> Any:
    assert channel["schemaEncoding"] == channel["encoding"] == "protobuf"
    descriptors = base64.b64decode(channel["schema"])
    schema = Schema(id=1, name=channel["schemaName"], encoding="protobuf", data=descriptors)
    decoder = DecoderFactory().decoder_for("protobuf", schema)
    assert decoder is not None
    return decoder(data)


@pytest.mark.timeout(90)
def test_a_client_gets_every_channel_of_a_running_daemon(tmp_path: Path) -> None:
    rerunning = Rerun(0.1, 2.0)
    topics = tuple(topic for topic in TOPICS if topic != "/log")
    with rerun(tmp_path, rerunning), serving(tmp_path) as address:
        found = received(address, *topics)
        assert set(found) == set(topics)
        assert found["/conveyor"][1].scenario in CLASSES
        assert found["/wrench"][1].frame_id == "force_torque"
        assert found["/camera/pose"][1].frame_id == "camera"
        assert found["/cycle"][1].turnaround == pytest.approx(400e-6)
        assert abs(found["/errors"][0] - time.time_ns()) < 60_000_000_000
        assert [joint.name for joint in found["/joints"][1].joints][-1] == "E1"
    assert set(rerunning.asked) <= {"scene", "sensors"}


@pytest.mark.timeout(60)
def test_a_daemon_is_asked_for_samples_while_a_client_wants_them_alone(tmp_path: Path) -> None:
    rerunning = Rerun(1.0, 5.0)
    with rerun(tmp_path, rerunning), serving(tmp_path) as address:
        assert set(received(address, "/errors")) == {"/errors"}
        assert "sensors" not in rerunning.asked
        assert set(received(address, "/distance")) == {"/distance"}
        assert "sensors" in rerunning.asked


@pytest.mark.timeout(60)
def test_a_daemon_that_does_not_answer_is_named_in_the_log(tmp_path: Path) -> None:
    with serving(tmp_path) as address:
        assert "command.sock" in received(address, "/log")["/log"][1].message


def test_a_recording_and_a_port_that_is_taken_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tool.main(["view", "--foxglove", str(tmp_path / "r.mcap")]) == 2
    assert "linemate export" in capsys.readouterr().err
    with serving(tmp_path) as address:
        port = address.rpartition(":")[2]
        socket = str(tmp_path / "command.sock")
        assert tool.main(["view", "--foxglove", "--port", port, "--socket", socket]) == 2
    assert f"127.0.0.1:{port}" in capsys.readouterr().err
