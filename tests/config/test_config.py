"""Configuration files: the errors of a bad one, and what a good one resolves to."""

import base64
from collections.abc import Callable
from pathlib import Path

import pytest

from linemate.daemon.config import config
from linemate.daemon.config.documents import FileError
from linemate.daemon.config.files import DAEMON_DATA, PROTOCOL_DATA
from linemate.daemon.config.section_checks import group_ids
from linemate.daemon.config.settings import CameraSettings, Corrections
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.simulators.harness.setup import shipped_control

Write = Callable[[str], Path]

KEY = f"panel operate {base64.b64encode(bytes(range(32))).decode()}\n"


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write(text: str) -> Path:
        path = tmp_path / "linemated.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def errors(path: Path) -> list[str]:
    with pytest.raises(FileError) as caught:
        config.load(path)
    return [line.removeprefix(f"{path}:") for line in caught.value.lines]


def test_the_shortest_file_names_a_task_and_takes_every_default(write: Write) -> None:
    station = config.load(write("task: wheel.yaml\n"))
    assert station.task.file.name == "wheel"
    assert station.config.rsi.corrections is Corrections.ABSOLUTE
    assert station.controller_file is not None
    assert station.robot.port == station.controller_file.port == 49152
    assert station.config.tracking == TrackingSettings()
    assert station.config.control == shipped_control()
    assert station.dbc is None
    assert set(station.texts) == {"config", "task", "urdf", "rsi"}


def test_a_touch_is_felt_with_half_the_overload_at_most(write: Write) -> None:
    text = "task: wheel.yaml\ntracking: {{tactile: {{contact_force: {}, overload_force: 120}}}}\n"
    (line,) = errors(write(text.format(61.0)))
    assert line.startswith("2:37: tracking.tactile.contact_force: a touch is felt from 61 N on")
    assert "at most half the overload of 120 N" in line
    assert config.load(write(text.format(60.0)))


def test_an_overload_that_bends_the_mount_by_more_than_any_tool_is_refused(write: Write) -> None:
    (line,) = errors(write("task: wheel.yaml\ntracking: {tactile: {overload_force: 6000}}\n"))
    assert "overload_force: 6000 N bend the mount by 120 mm at 50000 N/m, 100 mm at most" in line


def test_a_force_torque_sensor_beyond_the_tool_is_refused(write: Write, tmp_path: Path) -> None:
    text = (DAEMON_DATA / "wheel.yaml").read_text(encoding="utf-8")
    for place, is_good in (("[-0.1, 0.0, -0.4]", True), ("[0.0, 0.0, -1.5]", False)):
        mount = f"  sensor_in_tcp: {{position: {place}}}\n  rest_joints"
        (tmp_path / "task.yaml").write_text(text.replace("  rest_joints", mount), encoding="utf-8")
        path = write("task: task.yaml\nforce_torque: {url: /dev/ttyS0}\n")
        if is_good:
            assert config.load(path)
            continue
        (refused,) = errors(path)
        assert "arm.sensor_in_tcp.position: the sensor would be 1." in refused
        assert "m from the flange, at most 0.5 m" in refused


def test_a_broken_link_is_no_reason_to_take_a_shipped_file(write: Write, tmp_path: Path) -> None:
    (tmp_path / "wheel.yaml").symlink_to("none")
    (refused,) = errors(write("task: wheel.yaml\n"))
    assert refused.endswith("wheel.yaml: No such file or directory")


def test_a_value_that_is_left_to_its_default_does_not_hide_the_order_of_time_outs(
    write: Write,
) -> None:
    text = "task: wheel.yaml\nwatch: {in_sync_bit: null, missed_s: 1.7}\n"
    (line,) = errors(write(text))
    assert "watch.missed_s: 1.7 s is longer than watch.link_lost_s: 0.1 s" in line


def test_lists_and_maps_are_called_so(write: Write) -> None:
    (line,) = errors(write('task: wheel.yaml\nrealtime: {cpus: "0-1"}\n'))
    assert 'realtime.cpus: should be a list, not "0-1"' in line
    (line,) = errors(write("task: wheel.yaml\nproduction: {variants: {}}\n"))
    assert "production.variants: should have at least 1 items, not 0" in line


def test_an_empty_text_is_refused_in_plain_words(write: Write) -> None:
    assert "1:7: task: should not be empty" in errors(write('task: ""\n'))


def test_every_section_can_be_given(write: Write, tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    keys.write_text(KEY)
    keys.chmod(0o400)
    xml = (PROTOCOL_DATA / "rsi_joints_setpoints.xml").read_text(encoding="utf-8")
    (tmp_path / "rsi.xml").write_text(xml.replace('HOLDON="1"', 'HOLDON="0"'), encoding="utf-8")
    station = config.load(
        write(
            """
task: wheel.yaml
rsi: {config: rsi.xml, port: 0, cycle_ms: 4, corrections: relative}
distance:
  can: {interface: slcan, channel: /dev/ttyACM0, bitrate: 500000, ttyBaudrate: 115200}
  message: TF03
  signal: Distance
camera: {port: 0, frame: null}
force_torque: {url: "socket://127.0.0.1:5000", device: robotiq-ft300}
command: {socket: command.sock, udp: {port: 0, keys: keys}}
recording: {directory: .}
realtime: {priority: 60, cpus: [1], lock_memory: true, timer_slack_ns: 1}
watch: {healthy_cycles: 50}
tracking: {classifier: rule, distance: {deviation: 3e-3}, tactile: {overload_force: 300.0}}
control: {horizon_s: 0.25}
"""
        )
    )
    assert station.robot.port == 0
    assert station.config.distance is not None
    assert station.config.distance.can["ttyBaudrate"] == 115200
    assert station.dbc is not None
    assert [key.name for key in station.keys] == ["panel"]
    assert station.config.tracking.distance.deviation == 3e-3
    assert station.config.tracking.distance.gate == TrackingSettings().distance.gate


def test_an_overload_beyond_what_the_force_sensor_can_state_is_refused(write: Write) -> None:
    text = "task: wheel.yaml\nrsi: {config: rsi_joints.xml}\n"
    text += "force_torque: {url: virtual, device: robotiq-ft300}\ntracking:\n"
    (line,) = errors(write(text + "  tactile: {overload_force: 350.0}\n"))
    assert (
        "tracking.tactile.overload_force: 350 N and the tool's 0 N are beyond what an axis" in line
    )
    assert "robotiq-ft300 can state, 328 N" in line
    heavy = "  tactile: {overload_force: 300.0}\n  payload: {mass: 3.0}\n"
    (line,) = errors(write(text + heavy))
    assert "300 N and the tool's 29 N" in line
    config.load(write(text + "  tactile: {overload_force: 300.0}\n"))
    config.load(write(text.replace("robotiq-ft300", "bota") + "  distance: {deviation: 4e-4}\n"))


@pytest.mark.parametrize("name", ["mass", "part_mass"])
def test_a_payload_that_no_mount_bears_is_refused(write: Write, name: str) -> None:
    text = "task: wheel.yaml\nrsi: {config: rsi_joints.xml}\ntracking:\n  payload: {"
    (line,) = errors(write(f"{text}{name}: 2000}}\n"))
    assert f"tracking.payload.{name}: 2000 kg bend the mount by 392 mm at 50000 N/m" in line
    config.load(write(f"{text}{name}: 200}}\n"))
    # A mount may be soft along its axis alone.
    soft = "  tactile: {stiffness: [50000, 50000, 3000]}\n"
    config.load(write(f"{text}{name}: 60}}\n{soft}"))


@pytest.mark.parametrize("family", ["rsi", "egm", "fanuc"])
def test_any_cycle_from_1_to_24_ms_is_taken(write: Write, family: str) -> None:
    peer = (
        "peer: 192.0.2.10, bind: 192.0.2.1, rail: true, signals_byte: 0, "
        if family == "fanuc"
        else ""
    )
    text = f"task: wheel.yaml\ncontroller: {{kind: {family}}}\n{family}: {{{peer}cycle_ms: "
    for cycle_ms in range(1, 25):
        assert config.load(write(text + f"{cycle_ms}}}\n")).cycle_s == pytest.approx(
            1e-3 * cycle_ms
        )
    for wrong in ("0", "25", "4.5"):
        (line,) = errors(write(text + wrong + "}\n"))
        assert f"{family}.cycle_ms: " in line


def test_every_error_of_every_file_is_reported_at_once(write: Write, tmp_path: Path) -> None:
    (tmp_path / "task.yaml").write_text("name: 3\narm: {urdf: none.urdf}\n")
    path = write(
        """
task: task.yaml
rsi: {config: nope.xml, cycle_ms: 25, bind: localhost}
distance: {can: {channel: x}, message: Missing}
camera: {port: 70000, port: 1}
command: {socket: /nonexistent/s, udp: {bind: 192.0.2.1, keys: keys}}
recording: {directory: none}
tracking: {distance: {deviation: .nan}}
watch: {wrench_s: -1}
speeling: 1
"""
    )
    lines = errors(path)
    own = [line.split(": ")[1] for line in lines if not line.startswith(str(tmp_path))]
    assert own == [
        "rsi.config",
        "rsi.cycle_ms",
        "rsi.bind",
        "distance.can",
        "distance.message",
        "camera.port",
        "camera.port",
        "command.socket",
        "command.udp.bind",
        "command.udp.keys",
        "recording.directory",
        "tracking.distance.deviation",
        "watch.wrench_s",
        "speeling",
    ]
    others = [line for line in lines if line.startswith(str(tmp_path / "task.yaml"))]
    assert len(others) == 5
    assert any("name: should be a valid string, not 3" in line for line in others)
    assert any("arm.urdf: no such file" in line for line in others)


def test_a_missing_file_is_reported_in_the_same_form(tmp_path: Path) -> None:
    (line,) = errors(tmp_path / "none.yaml")
    assert line.startswith("1:1: (file): ")
    assert line.endswith("No such file or directory")


def test_a_file_beyond_the_limit_is_not_read(write: Write) -> None:
    (line,) = errors(write("#" * 10_000_000))
    assert "longer than" in line


def test_a_controller_file_that_makes_no_telegram_is_reported_at_its_key(
    write: Write, tmp_path: Path
) -> None:
    (tmp_path / "rsi.xml").write_text("<ROOT><CONFIG></CONFIG></ROOT>")
    (line,) = errors(write("task: wheel.yaml\nrsi: {config: rsi.xml}\n"))
    assert line.startswith("2:15: rsi.config: ")


def test_a_controller_file_without_an_axis_of_the_arm_is_reported(
    write: Write, tmp_path: Path
) -> None:
    xml = (PROTOCOL_DATA / "rsi_joints.xml").read_text(encoding="utf-8")
    assert "DEF_EIPos" in xml
    assert "EK.E1" in xml
    bare = xml.replace("DEF_EIPos", "DEF_EPos9").replace("EK.E1", "Spare")
    (tmp_path / "rsi.xml").write_text(bare, encoding="utf-8")
    text = "task: wheel.yaml\nrsi: {config: rsi.xml, constants: {Spare: 0}}\n"
    (line,) = errors(write(text))
    assert line == "2:15: rsi.config: the task's arm needs SEND DEF_EIPos, RECEIVE EK.E1"


def test_axes_that_would_be_read_in_the_wrong_unit_are_reported(write: Write) -> None:
    (line,) = errors(write("task: wheel.yaml\nrsi: {linear_axes: [E2]}\n"))
    assert line == "2:20: rsi.linear_axes: the task's arm stands on E1, which is linear"
    (line,) = errors(write("task: wheel.yaml\nrsi: {linear_axes: [E1, Q1]}\n"))
    assert line.startswith("2:25: rsi.linear_axes[1]: ")


def test_what_a_dbc_lacks_is_reported_at_the_key_that_names_it(
    write: Write, tmp_path: Path
) -> None:
    (tmp_path / "bad.dbc").write_text("BO_ nonsense\n")
    text = "task: wheel.yaml\ndistance: {{can: {{interface: slcan, channel: tty}}, {}}}\n"
    for named, key in (
        ("dbc: bad.dbc", "dbc"),
        ("message: Nope", "message"),
        ("signal: Nope", "message"),
        ("strength: Nope", "strength"),
        ("message: Nope, strength: Nope", "message"),
    ):
        (line,) = errors(write(text.format(named)))
        assert f": distance.{key}: distance: " in line
    (tmp_path / "line.dbc").write_text("other.dbc")
    (line,) = errors(write(text.format("dbc: line.dbc")))
    assert line.endswith("distance.dbc: not a DBC: a single line")


def test_frames_by_multicast_must_not_leave_the_host(write: Write) -> None:
    text = "task: wheel.yaml\ndistance: {{can: {{interface: udp_multicast{}}}}}\n"
    for hops in ("", ", hop_limit: 1", ", hop_limit: '0'"):
        (line,) = errors(write(text.format(hops)))
        assert line.startswith("2:17: distance.can: udp_multicast needs hop_limit: 0")
    assert config.load(write(text.format(", hop_limit: 0"))).config.distance is not None


def test_a_key_given_twice_does_not_hide_what_is_wrong_with_its_value(write: Write) -> None:
    first, second = errors(write("task: wheel.yaml\nrsi: {bind: here, bind: there}\n"))
    assert first.startswith("2:13: rsi.bind: 'here' ")
    assert second.startswith("2:19: rsi.bind: given twice")


def test_directories_that_are_not_there_are_reported(write: Write) -> None:
    text = "task: wheel.yaml\nrecording: {directory: none}\nrealtime: {incidents: none}\n"
    lines = [line.split(": ")[1] for line in errors(write(text))]
    assert lines == ["recording.directory", "realtime.incidents"]


def test_groups_that_are_not_there_are_reported(write: Write) -> None:
    text = "task: wheel.yaml\ncommand: {{view_groups: [{}], operate_groups: [{}]}}\n"
    viewers, operators = errors(write(text.format("root, no-group-has-this", "or-this")))
    assert "command.operate_groups: no such group: or-this" in operators
    assert "command.view_groups: no such group: no-group-has-this" in viewers
    command = config.load(write(text.format('root, "77"', '"5"'))).config.command
    assert (command.view_groups, command.operate_groups) == (("root", "77"), ("5",))
    assert group_ids(command.view_groups) == {0, 77}


def test_a_camera_peer_that_is_no_address_is_reported(write: Write) -> None:
    for peer in ("camera.local", "10.0.0.1:0", "10.0.0.1:99999", "10.0.0.1:x", "[::1]5", "[::1"):
        (line,) = errors(write(f'task: wheel.yaml\ncamera: {{peer: "{peer}"}}\n'))
        assert "camera.peer: " in line, peer
    text = 'task: wheel.yaml\ncamera: {bind: 10.0.0.2, peer: "10.0.0.1:5"}\n'
    camera = CameraSettings(bind="10.0.0.2", peer="10.0.0.1:5")
    assert config.load(write(text)).config.camera == camera


def test_keys_that_others_can_read_are_refused(write: Write, tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    keys.write_text(KEY)
    keys.chmod(0o644)
    (line,) = errors(write("task: wheel.yaml\ncommand: {udp: {keys: keys}}\n"))
    assert "command.udp.keys" in line
    assert "0644" in line
    keys.chmod(0o600)
    keys.write_text("# none\n")
    (line,) = errors(write("task: wheel.yaml\ncommand: {udp: {keys: keys}}\n"))
    assert "holds no key" in line


def test_every_bad_line_of_a_key_file_is_reported_at_the_key_that_names_it(
    write: Write, tmp_path: Path
) -> None:
    keys = tmp_path / "keys"
    keys.write_text(f"{KEY}panel operate\n{KEY}")
    keys.chmod(0o400)
    lines = errors(write("task: wheel.yaml\ncommand: {udp: {keys: keys}}\n"))
    where = f"2:23: command.udp.keys: {keys}"
    assert [line.removeprefix(where)[:3] for line in lines] == [":2:", ":3:"]


def test_keys_can_be_a_credential_of_systemd(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "task: wheel.yaml\ncommand: {udp: {keys: 'credential:link.key'}}\n"
    monkeypatch.delenv("CREDENTIALS_DIRECTORY", raising=False)
    (line,) = errors(write(text))
    assert "LoadCredential" in line
    (tmp_path / "credentials").mkdir()
    key = tmp_path / "credentials" / "link.key"
    key.write_text(KEY)
    key.chmod(0o400)
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(key.parent))
    assert config.load(write(text)).keys[0].name == "panel"


def test_a_remote_command_port_needs_consent(write: Write, tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    keys.write_text(KEY)
    keys.chmod(0o400)
    section = "command: {{udp: {{keys: keys, bind: 0.0.0.0, allow_remote: {}}}}}"
    (line,) = errors(write("task: wheel.yaml\n" + section.format("false")))
    assert "allow_remote" in line
    assert config.load(write("task: wheel.yaml\n" + section.format("true"))).keys


@pytest.mark.parametrize(
    "text",
    [
        "",
        "task:",
        "task: 3",
        "task: {}",
        "task: ''",
        "[]",
        "rsi: 3",
        "distance: []",
        "command: {udp: 1}",
        "camera: null",
    ],
)
def test_sections_of_any_kind_are_reported_and_nothing_else_happens(
    write: Write, text: str
) -> None:
    assert errors(write(text))


def test_the_schema_covers_every_section() -> None:
    schema = config.schema()
    assert {"rsi", "distance", "camera", "tracking", "control"} <= set(schema["properties"])
    assert schema["required"] == ["task"]


def test_two_links_on_one_port_are_reported_where_their_addresses_meet(write: Write) -> None:
    text = "task: wheel.yaml\nrsi: {{bind: {}}}\ncamera: {{port: 49152, bind: {}}}\n"
    for robot, camera, clash in (
        ("127.0.0.1", "127.0.0.1", True),
        ("0.0.0.0", "127.0.0.1", True),
        ("127.0.0.2", "127.0.0.1", False),
    ):
        path = write(text.format(robot, camera))
        if clash:
            assert "camera.port: 49152 is rsi.port's already" in errors(path)[0]
        else:
            assert config.load(path).robot.port == 49152


def test_limits_wider_than_the_urdfs_are_reported_at_their_place(write: Write) -> None:
    rows = [
        f"{{lower: -0.1, upper: {upper}, speed: {speed}, acceleration: 40, jerk: 15000}}"
        for upper, speed in ((0.1, 1.0), (-0.08, 1.0), *[(0.1, 1.0)] * 4, (0.1, 1.6))
    ]
    first, second = errors(write(f"task: wheel.yaml\ncontrol: {{limits: [{', '.join(rows)}]}}\n"))
    assert "control.limits[1].upper: -0.08 is wider than the URDF's for A2: -0.08726" in first
    assert "control.limits[6].speed: 1.6 is wider than the URDF's for E1: 1.5" in second


def test_an_abb_controller_needs_no_file_and_has_its_own_period_and_port(write: Write) -> None:
    loaded = config.load(write("task: wheel.yaml\ncontroller: {kind: egm}\n"))
    assert loaded.controller_file is None
    assert loaded.cycle_s == 0.004
    assert (loaded.robot.bind, loaded.robot.port, loaded.robot.peer) == ("127.0.0.1", 6510, None)
    assert "rsi" not in loaded.texts


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("egm: {robotware: 6}", "egm.robotware: waypoints[5] waits for screws_fixed: signals need"),
        ("egm: {signals: false}", "egm.signals: waypoints[5] waits for screws_fixed"),
        ("egm: {bind: here}", "egm.bind"),
        ("egm: {cycle_ms: 25}", "egm.cycle_ms"),
        ("egm: {robotware: 5}", "egm.robotware"),
        ("egm: {linear_axes: [E2]}", "egm.linear_axes: the task's arm stands on E1"),
        ("camera: {port: 6510}", "camera.port: 6510 is egm.port's already"),
        ("egm: {cycle_ms: 24}\nwatch: {missed_s: 0.02}", "watch.missed_s"),
    ],
)
def test_what_an_abb_controller_cannot_do_is_refused_with_its_place(
    write: Write, text: str, complaint: str
) -> None:
    lines = errors(write(f"task: wheel.yaml\ncontroller: {{kind: egm}}\n{text}\n"))
    assert any(complaint in line for line in lines), lines


def test_a_dead_time_that_drifts_and_servos_that_are_learned_contradict_each_other(
    write: Write,
) -> None:
    drift = "task: wheel.yaml\ncontrol: {drift: {longer: 0.1}}\n"
    assert config.load(write(drift)).config.control.drift.longer == 0.1
    lines = errors(write(f"{drift}learning: {{}}\n"))
    assert any("learning: control.drift is set" in line for line in lines), lines


def test_an_overlay_says_where_camera_and_sensor_are(write: Write, tmp_path: Path) -> None:
    (tmp_path / "tool.yaml").write_text(
        "task: {arm: {camera_in_tcp: {position: [0.1, 0.2, 0.3]}, sensor_sign: -1}}\n"
        "tracking: {distance: {deviation: 0.002}}\n"
    )
    station = config.load(write("task: wheel.yaml\noverlays: [tool.yaml]\n"))
    assert station.task.file.arm.camera_in_tcp.position == (0.1, 0.2, 0.3)
    assert station.config.tracking.distance.deviation == 0.002
    assert station.config.task == "wheel.yaml"
    assert "sensor_sign: -1" in station.texts["task"]


def test_an_overlay_that_names_another_arm_is_refused_at_its_place(
    write: Write, tmp_path: Path
) -> None:
    (tmp_path / "tool.yaml").write_text("task:\n  arm: {urdf: other.urdf}\n")
    with pytest.raises(FileError) as caught:
        config.load(write("task: wheel.yaml\noverlays: [tool.yaml]\n"))
    assert caught.value.lines[0].startswith(f"{tmp_path}/tool.yaml:2:9: arm.urdf: an overlay")
