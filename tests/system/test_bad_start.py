"""Programs that are started with what cannot work: they say all of it, touch nothing, and end.

Real processes only. The ports that a broken file names are held by the test, so
that a program that tried to bind before it was sure would end otherwise than it should.
"""

import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from daemon_process import LINEMATED, DaemonProcess

from linemate.daemon.config.files import DAEMON_DATA, PROTOCOL_DATA
from linemate.protocol.command.frame_codec import Role
from linemate.protocol.command.preshared_keys import key_line, make_key
from linemate.protocol.rsi.codec import RobotTelegram, RsiCodec, parse_config

LINEMATE_SIM = (sys.executable, "-m", "linemate.simulators.harness.main")
ERROR_LINE = re.compile(
    r"(?P<file>/[^:]+):(?P<line>\d+):(?P<column>\d+): (?P<key>[^:]+): (?P<what>.+)"
)
BAD_CONFIGURATION = 78
CANNOT_RUN = 1
UNAVAILABLE = 69
END_S = 3.0

Error = tuple[str, str, str, str]
"""File, what stands at the place that is reported, key, what is wrong."""


def ended(*command: str) -> subprocess.CompletedProcess[bytes]:
    """Run it to its end. One that does not end is aborted: it then says where it stands."""
    environment = {**os.environ, "PYTHONFAULTHANDLER": "1"}
    streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, env=environment, **streams) as process:
        try:
            out, error = process.communicate(timeout=60.0)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGABRT)
            _, error = process.communicate()
            pytest.fail(f"{command} did not end:\n{error.decode()}")
    return subprocess.CompletedProcess(command, process.returncode, out, error)


def daemon(path: Path, *more: str) -> subprocess.CompletedProcess[bytes]:
    return ended(*LINEMATED, "--config", str(path), *more)


def errors(done: subprocess.CompletedProcess[bytes]) -> list[Error]:
    """Every line of a refusal, with the text it points at; each line must be of the one form."""
    assert done.returncode == BAD_CONFIGURATION, done.stderr
    assert done.stdout == b""
    found = []
    for line in done.stderr.decode().splitlines():
        match = ERROR_LINE.fullmatch(line)
        assert match, line
        found.append((match["file"], _pointed(match), match["key"], match["what"]))
    return found


def _pointed(match: re.Match[str]) -> str:
    path = Path(match["file"])
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines() if path.exists() else []
    row, column = int(match["line"]) - 1, int(match["column"]) - 1
    return lines[row][column:] if row < len(lines) else ""


@pytest.fixture
def held() -> Iterator[int]:
    """A port of this host that is taken, for UDP."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as port:
        port.bind(("127.0.0.1", 0))
        yield port.getsockname()[1]


def test_every_error_of_every_file_is_reported_with_its_place_and_no_port_is_bound(
    tmp_path: Path, held: int
) -> None:
    task = (DAEMON_DATA / "wheel.yaml").read_text(encoding="utf-8")
    (tmp_path / "task.yaml").write_text(task + "\nwaypoint: []\n", encoding="utf-8")
    (tmp_path / "rsi.xml").write_text("<ROOT><CONFIG>", encoding="utf-8")
    (tmp_path / "bad.dbc").write_text("BO_ nonsense", encoding="utf-8")
    keys = tmp_path / "keys"
    keys.write_text(key_line(make_key("panel", Role.OPERATE, bytes(range(32)))))
    keys.chmod(0o644)
    path = tmp_path / "linemated.yaml"
    path.write_text(
        f"""\
task: task.yaml
rsi:
  config: rsi.xml
  port: {held}
  cycle_ms: twelve
  bind: localhost
distance: {{can: {{interface: slcan, channel: x}}, dbc: bad.dbc}}
camera:
  port: {held}
  bind: 127.0.0.1
  port: 1
force_torque: {{url: /dev/null, device: scales, baudrate: 1.5}}
command: {{socket: c.sock, udp: {{keys: keys, port: 70000}}}}
recording: {{directory: nowhere}}
realtime: {{priority: 99, lead_ms: .inf}}
watch: {{link_lost_s: .nan, missed_s: yes}}
control: {{horizon_s: null}}
trucking: {{}}
""",
        encoding="utf-8",
    )
    found = errors(daemon(path))
    own = [(key, text) for file, text, key, _ in found if file == str(path)]
    for key, text in (
        ("rsi.config", "rsi.xml"),
        ("rsi.cycle_ms", "twelve"),
        ("distance.dbc", "bad.dbc"),
        ("rsi.bind", "localhost"),
        ("camera.port", "port: 1"),
        ("force_torque.device", "scales"),
        ("force_torque.baudrate", "1.5"),
        ("command.udp.keys", "keys, port"),
        ("command.udp.port", "70000"),
        ("recording.directory", "nowhere"),
        ("realtime.priority", "99"),
        ("realtime.lead_ms", ".inf"),
        ("watch.link_lost_s", ".nan"),
        ("watch.missed_s", "yes"),
        ("control.horizon_s", "null"),
        ("trucking", "trucking:"),
    ):
        assert any(key == k and at.startswith(text) for k, at in own), (key, text, own)
    assert len(own) == 16, own
    assert [(key, text) for file, text, key, _ in found if file == str(tmp_path / "task.yaml")] == [
        ("waypoint", "waypoint: []")
    ]
    assert not (tmp_path / "c.sock").exists()
    checked = daemon(path, "--check")
    assert errors(checked) == found


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (None, "No such file"),
        (b"task: wheel.yaml\ncamera: \xff\xfe\n", "not UTF-8: byte 0xff"),
        (b"task: wheel.yaml\nrsi: {port: 1\n", "not YAML"),
        (b"- task\n- wheel.yaml\n", "should be a mapping"),
        (b"", "missing"),
    ],
    ids=["no file", "not UTF-8", "not YAML", "a list", "empty"],
)
def test_a_file_that_cannot_be_read_is_reported_in_the_same_form(
    tmp_path: Path, data: bytes | None, what: str
) -> None:
    path = tmp_path / "linemated.yaml"
    if data is not None:
        path.write_bytes(data)
    found = errors(daemon(path, "--check"))
    assert {file for file, _, _, _ in found} == {str(path)}
    assert any(what in text for _, _, _, text in found), found


def test_an_emulators_broken_file_is_reported_in_the_same_form(tmp_path: Path, held: int) -> None:
    path = tmp_path / "emulator.yaml"
    path.write_text(
        f"""\
scenario: wheel
seed: first
robot_target: [127.0.0.1, {held}]
robot_bind: [127.0.0.1, {held}]
distance_mount: .nan
wait_answered: 1.5
cable: red
""",
        encoding="utf-8",
    )
    found = errors(ended(*LINEMATE_SIM, "emulator", "--config", str(path)))
    assert [(key, text) for _, text, key, _ in found] == [
        ("seed", "first"),
        ("distance_mount", ".nan"),
        ("wait_answered", "1.5"),
        ("cable", "cable: red"),
    ]


def test_an_emulator_that_cannot_do_what_it_is_reported_says_so(tmp_path: Path, held: int) -> None:
    (tmp_path / "scenario.yaml").write_text(
        "faults: [{at_s: 1, link: robot, kind: ipoc_flip, value: 0.1}]\n", encoding="utf-8"
    )
    path = tmp_path / "emulator.yaml"
    emulate = (*LINEMATE_SIM, "emulator", "--config", str(path))
    path.write_text("scenario: scenario.yaml\n", encoding="utf-8")
    ((_, _, _, what),) = errors(ended(*emulate))
    assert what.startswith("fault at 1.0 s: robot has no 'ipoc_flip'")
    for port in (held, 70_000):
        path.write_text(f"robot_bind: [127.0.0.1, {port}]\n", encoding="utf-8")
        done = ended(*emulate)
        assert done.returncode == UNAVAILABLE
        assert done.stderr.startswith(b"linemate-sim emulator: ")
        assert done.stderr.count(b"\n") == 1


def test_a_good_file_is_checked_without_binding_what_it_names(tmp_path: Path, held: int) -> None:
    path = tmp_path / "linemated.yaml"
    path.write_text(
        f"task: wheel.yaml\nrsi: {{port: {held}}}\ncamera: {{port: 0}}\n"
        "command: {socket: c.sock}\n",
        encoding="utf-8",
    )
    done = daemon(path, "--check")
    assert (done.returncode, done.stderr) == (0, b"")
    assert not (tmp_path / "c.sock").exists()


def test_a_second_daemon_says_what_is_taken_and_the_first_one_ends_on_order(tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    keys.write_text(key_line(make_key("panel", Role.OPERATE, bytes(range(32)))))
    keys.chmod(0o400)
    text = "task: wheel.yaml\nrsi: {port: 0}\ncommand: {socket: c.sock, udp: {port: 0, keys: keys}}"
    codec = RsiCodec(parse_config((PROTOCOL_DATA / "rsi_joints.xml").read_bytes()))
    other = tmp_path / "other.yaml"
    with (
        DaemonProcess(tmp_path, text) as first,
        closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as robot,
    ):
        robot.connect(first.robot())
        robot.settimeout(10.0)
        robot_port, udp_port = first.robot()[1], first.listening["command"]["udp"][1]
        for more, text in (
            (f"rsi: {{port: {robot_port}}}", "the robot's port cannot be opened"),
            (
                f"rsi: {{port: 0}}\ncommand: {{udp: {{port: {udp_port}, keys: keys}}}}",
                f"command port 127.0.0.1:{udp_port}",
            ),
            ("rsi: {port: 0}\ncommand: {socket: c.sock}", "another daemon listens there"),
        ):
            other.write_text(f"task: wheel.yaml\n{more}\n", encoding="utf-8")
            done = daemon(other)
            assert done.returncode == CANNOT_RUN
            complaints = [line for line in done.stderr.decode().splitlines() if "ERROR" in line]
            assert len(complaints) == 1
            assert text in complaints[0]
            assert f"(process {first.process.pid}" in complaints[0]
            assert b"Traceback" not in done.stderr
        # The first one lives, with its endpoints, and answers the robot up to its end.
        ipocs = range(1000, 1000 + 30 * 12, 12)
        for ipoc in ipocs:
            robot.send(
                codec.format_robot(
                    RobotTelegram(
                        ipoc,
                        joints=(0.0, -1.57, 1.57, 0.0, 0.0, 0.0),
                        external=(0.0,) * 6,
                        tcp=(0.0,) * 6,
                        delay=0,
                        channels={"DiL": 0},
                    )
                )
            )
            assert codec.parse_sensor(robot.recv(2048)).ipoc == ipoc
        assert first.status()["telegrams"]["unreadable"] == 0
        code, took_s = first.end()
        assert (code, first.process.poll()) == (0, 0), first.log_text()
        assert took_s < END_S
        assert not (tmp_path / "c.sock").exists()
    for kind, address in ((socket.SOCK_DGRAM, robot_port), (socket.SOCK_DGRAM, udp_port)):
        with closing(socket.socket(socket.AF_INET, kind)) as free:
            free.bind(("127.0.0.1", address))
