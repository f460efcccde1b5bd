"""``linemate ros2`` and a foreign ROS 2 node, each in a process of its own, over real zenoh."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rosbags", reason="rosbags is in the extra ros2")
pytest.importorskip("zenoh", reason="eclipse-zenoh is in the extra ros2")
pytest.importorskip("zenoh_ros2_sdk", reason="zenoh-ros2-sdk is in the extra dev")
from rerun import LINEMATE, Rerun, rerun

from linemate.daemon.operator import main as tool
from linemate.daemon.operator.ros2.ros2_command import ROUTER, is_loopback, refused_session
from linemate.protocol.sensors.camera_codec import CameraDecoder, CameraError

WITNESS = Path(__file__).with_name("foreign_node.py")


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port: int = found.getsockname()[1]
        return port


@contextlib.contextmanager
def publishing(folder: Path, *words: str) -> Iterator[int]:
    """``linemate ros2`` without a router; the port of its zenoh."""
    port = free_port()
    command = [*LINEMATE, "ros2", "--socket", str(folder / "command.sock"), "--domain", "7"]
    command += ["--listen", f"tcp/127.0.0.1:{port}", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == f"/linemate in domain 7 at tcp/127.0.0.1:{port}\n"
            yield port
        finally:
            process.send_signal(signal.SIGTERM)
            try:
                assert process.wait(20.0) == 0
            finally:
                process.kill()


def foreign(port: int, *words: str) -> dict[str, Any]:
    """What the foreign node has seen."""
    done = subprocess.run(
        [sys.executable, str(WITNESS), str(port), *words],
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
        env={**os.environ, "ROS_DOMAIN_ID": "7"},
    )
    assert done.returncode == 0, done.stderr
    seen: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return seen


@pytest.mark.timeout(120)
def test_a_foreign_node_finds_every_topic_and_reads_it(tmp_path: Path) -> None:
    rerunning = Rerun(0.1, 2.0)
    with rerun(tmp_path, rerunning), publishing(tmp_path) as port:
        seen = foreign(port, "listen")
    assert seen["joints"] == ["A1", "A2", "A3", "A4", "A5", "A6", "E1"]
    assert {"tcp", "tcp_measured", "camera", "rail"} <= set(seen["frames"])
    assert seen["pose"] == ["base", pytest.approx(1.0, abs=1e-6)]
    assert seen["wrench"][0] == "force_torque"
    assert seen["nodes"] == ["linemate"]
    assert set(rerunning.asked) <= {"scene", "sensors"}


@pytest.mark.timeout(120)
def test_a_foreign_nodes_poses_reach_the_cameras_port(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as camera:
        camera.bind(("127.0.0.1", 0))
        camera.settimeout(20.0)
        where = f"127.0.0.1:{camera.getsockname()[1]}"
        with rerun(tmp_path, Rerun(0.1, 2.0)), publishing(tmp_path, "--camera", where) as port:
            assert foreign(port, "publish")["sent"] == 5
            decoder = CameraDecoder("camera", "hub")
            samples = []
            with contextlib.suppress(CameraError, TimeoutError):
                while len(samples) < 5:
                    samples.append(decoder.feed(camera.recv(2048), 10**9 + len(samples)))
                    camera.settimeout(2.0)
    # The first ones may be lost: a ROS 2 publisher does not wait for its subscribers.
    assert len(samples) >= 2
    assert {sample.position for sample in samples} == {(0.1, 0.2, 0.7)}
    assert {sample.quaternion for sample in samples} == {(0.5, 0.1, 0.7, 0.5)}
    assert samples[-1].covariance is not None


def test_an_address_that_others_can_reach_needs_consent(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--listen", "tcp/0.0.0.0:7447"], ["--connect", "tcp/192.0.2.7:7447"]):
        assert tool.main(["ros2", *words]) == 2
        assert "--allow-remote" in capsys.readouterr().err
    assert is_loopback("tcp/127.0.0.1:7447")
    assert not is_loopback("tcp/192.0.2.7:7447")


@pytest.mark.parametrize(
    "words",
    [["--domain", "300"], ["--prefix", "a/b"], ["--rate", "0"], ["--camera", "host:1"]],
    ids=str,
)
def test_a_wrong_option_is_refused(words: list[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        tool.main(["ros2", *words])
    assert ended.value.code == 2


def test_without_a_router_the_reason_is_one_sentence_without_a_place_in_a_source() -> None:
    place = "at /root/.cargo/git/zenoh/src/net/runtime/orchestrator.rs:447."
    text = f"Unable to connect to any of [Single({ROUTER})]!  {place}"
    refused = refused_session(text, ROUTER, is_router=True)
    assert refused.startswith(f"{ROUTER}: Unable to connect to any of [Single({ROUTER})]. Start")
    inner = f"Can not listen: [in use (os error 98) {place}] {place}"
    assert refused_session(inner, "tcp/127.0.0.1:9", is_router=False) == (
        "tcp/127.0.0.1:9: Can not listen: [in use (os error 98)]"
    )


def test_a_wrong_domain_of_the_environment_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "many")
    assert tool.main(["ros2"]) == 2
    assert "ROS_DOMAIN_ID: 'many'" in capsys.readouterr().err
