"""The service under a real systemd: from its start to its end, killed, stopped and starved between.

The shipped unit as ``make install`` lays it out, in namespaces that are thrown
away; what differs is a drop-in. A robot stands next to it and judges: it notes where each reply
sends it. Skipped with a reason where rights or tools are missing.
"""

import json
import re
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from systemd_machine import CHECKOUT, INTERPRETER, OUT, PACKAGES, PROGRAM, Machine, lacking

from linemate.protocol.command.frame_codec import Role
from linemate.protocol.command.preshared_keys import key_line, make_key

REASON = lacking()
pytestmark = pytest.mark.skipif(REASON is not None, reason=f"no systemd to be booted: {REASON}")

UNIT = "linemated.service"
READY_S = 3.0
WATCHDOG_S = 2.0
POSTURE = (0.1, -1.5, 1.4, 0.05, 0.3, -0.2, 0.25)
"""Where the robot stands: A1..A6 [rad], E1 [m]."""

STILL = 1e-7
"""What eight decimals of a degree leave of a posture [rad, m]."""

KEY = key_line(make_key("panel", Role.OPERATE, bytes(range(32))))
OTHER = key_line(make_key("office", Role.VIEW, bytes(range(1, 33))))

CONFIG = """\
task: wheel.yaml
rsi: {config: rsi_joints.xml, bind: 127.0.0.1}
command:
  socket: /run/linemate/command.sock
  udp: {port: 49160, keys: "credential:link.key"}
recording: {directory: /var/lib/linemate, at_start: true}
realtime: {lock_memory: true, incidents: /var/log/linemate}
"""

DROP_IN = f"""\
[Service]
LoadCredential=link.key:/etc/linemate/link.key
CPUAffinity=0
StandardError=append:{OUT}/linemated.log
"""


ROBOT = f"""\
[Service]
Environment=PYTHONPATH={PROGRAM}/lib:{PACKAGES}
ExecStart={INTERPRETER} /opt/robot.py \\
    {PROGRAM}/lib/linemate/protocol/data/rsi_joints.xml {" ".join(map(str, POSTURE))}
StandardOutput=truncate:{OUT}/robot.jsonl
StandardError=append:{OUT}/robot.log
"""


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    scratch = tmp_path_factory.mktemp("machine")
    made = Machine(scratch)
    subprocess.run(
        ["make", "-s", "-C", str(CHECKOUT), "install-files", f"DESTDIR={made.tree}"],
        check=True,
        capture_output=True,
    )
    made.file("etc/linemate/linemated.yaml", CONFIG)
    made.file("etc/linemate/link.key", KEY + "\n", 0o600)
    made.file("etc/systemd/system/linemated.service.d/site.conf", DROP_IN)
    made.file("etc/systemd/system/robot.service", ROBOT)
    made.file("opt/probe.py", Path(__file__).parents[1].joinpath("systemd_probe.py").read_text())
    made.file("opt/robot.py", Path(__file__).parents[1].joinpath("systemd_robot.py").read_text())
    with made:
        made.run("systemd-sysusers", "/etc/sysusers.d/linemate.conf")
        made.run("systemd-tmpfiles", "--create", "/etc/tmpfiles.d/linemate.conf")
        yield made


class Robot:
    """The robot next to the daemon, and what it noted."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._path = machine.out / "robot.jsonl"
        machine.run("systemctl", "start", "robot.service")

    def notes(self) -> list[dict[str, Any]]:
        # A robot that has only just been started has written nothing yet.
        lines = self._path.read_text().splitlines() if self._path.exists() else []
        return [json.loads(line) for line in lines if line.endswith("}")]

    def answered(self) -> int:
        return sum(note["axes"] is not None for note in self.notes())

    def until_answered(self, more: int, timeout_s: float = 15.0) -> list[dict[str, Any]]:
        """Wait for so many more replies; all notes since."""
        before = len(self.notes())
        first, end = self.answered(), time.monotonic() + timeout_s
        while self.answered() < first + more:
            assert time.monotonic() < end, self.notes()[-3:]
            time.sleep(0.05)
        return self.notes()[before:]

    def end(self) -> None:
        self._machine.run("systemctl", "stop", "robot.service")


@pytest.fixture
def robot(service: Machine) -> Iterator[Robot]:
    made = Robot(service)
    try:
        made.until_answered(30)
        yield made
    finally:
        made.end()


@pytest.fixture
def service(machine: Machine) -> Machine:
    """The service, running."""
    machine.run("systemctl", "reset-failed", UNIT, check=False)
    machine.run("systemctl", "start", UNIT)
    return machine


def main_pid(machine: Machine) -> int:
    return int(machine.show(UNIT, "MainPID")["MainPID"])


def status(machine: Machine) -> dict[str, Any]:
    done = machine.run("linemate", "status", "--json", "--timeout", "4", check=False)
    assert done.stdout, done.stderr
    shown: dict[str, Any] = json.loads(done.stdout)
    return shown


def until_restarted(machine: Machine, pid: int, within_s: float) -> float:
    """Wait until systemd calls another process READY; how long the service was not [s]."""
    end = time.monotonic() + within_s
    names = ("ActiveState", "MainPID", "ActiveExitTimestampMonotonic")
    while True:
        shown = machine.show(UNIT, *names, "ActiveEnterTimestampMonotonic")
        if shown["ActiveState"] == "active" and int(shown["MainPID"]) not in {0, pid}:
            entered = int(shown["ActiveEnterTimestampMonotonic"])
            return (entered - int(shown["ActiveExitTimestampMonotonic"])) * 1e-6
        assert time.monotonic() < end, (shown, machine.log_text()[-2000:])
        time.sleep(0.05)


def journal(machine: Machine) -> str:
    return (machine.out / "linemated.log").read_text(encoding="utf-8")


def assert_still(notes: list[dict[str, Any]]) -> None:
    """Wherever a reply sent the robot is where it stood."""
    sent = [note["axes"] for note in notes if note["axes"] is not None]
    assert sent
    worst = max(abs(q - p) for axes in sent for q, p in zip(axes, POSTURE, strict=True))
    assert worst < STILL


def test_it_starts_to_ready_and_the_tool_of_an_operator_finds_it(service: Machine) -> None:
    shown = service.show(UNIT, "ActiveState", "StatusText", "User", "NRestarts")
    assert (shown["ActiveState"], shown["User"], shown["NRestarts"]) == ("active", "linemate", "0")
    assert re.match(r"INIT .* steps", shown["StatusText"])
    assert status(service)["state"] == "init"


def test_anyone_who_broke_into_it_could_not_get_out(service: Machine) -> None:
    shipped = service.run("cat", f"/etc/systemd/system/{UNIT}").stdout
    probe = re.sub(r"ExecStart=.*", f"ExecStart={INTERPRETER} /opt/probe.py", shipped)
    # The unit as it is, but for the program and for who starts it again.
    probe = re.sub(r"(?m)^(Type|NotifyAccess|WatchdogSec|Restart)=.*\n", "", probe)
    probe = probe.replace("Directory=linemate", "Directory=probe")
    probe = probe.replace("[Service]", f"[Service]\nStandardOutput=truncate:{OUT}/probe.json")
    lines = probe.replace("'", "'\\''")
    service.run("sh", "-c", f"printf %s '{lines}' >/etc/systemd/system/probe.service")
    service.run("systemctl", "daemon-reload")
    service.run("systemctl", "start", "probe.service")
    end = time.monotonic() + 10.0
    path, shown = service.out / "probe.json", ""
    while not shown.endswith("}\n"):
        assert time.monotonic() < end, service.log_text()[-2000:]
        time.sleep(0.05)
        shown = path.read_text() if path.exists() else ""
    outcomes = json.loads(shown)
    assert outcomes.pop("its own directory") == "done"
    assert outcomes.pop("loopback") == "done"
    assert len(outcomes) == 13
    assert {name: how for name, how in outcomes.items() if how == "done"} == {}


def test_it_runs_with_the_rights_of_its_unit_and_no_others(service: Machine) -> None:
    pid = main_pid(service)
    facts = service.run("cat", f"/proc/{pid}/status").stdout
    # Scheduling class and affinity from the unit, no capability, a seccomp filter.
    stat = service.run("cat", f"/proc/{pid}/stat").stdout.rpartition(")")[2].split()
    priority, policy = int(stat[37]), int(stat[38])
    assert (priority, policy) == (60, 1)
    # Its other threads come above every ordinary program and below the loop, within a second.
    end, others = time.monotonic() + 4.0, {"0"}
    while "0" in others and time.monotonic() < end:
        lines = service.run("sh", "-c", f"cat /proc/{pid}/task/*/stat").stdout.splitlines()
        others = {line.rpartition(")")[2].split()[37] for line in lines}
    limits = service.run("cat", f"/proc/{pid}/limits").stdout
    may = re.search(r"^Max realtime priority\s+70 ", limits, re.MULTILINE)
    assert "60" in others
    assert others <= ({"60", "1"} if may else {"60", "0"})
    assert re.search(r"^Cpus_allowed_list:\s+0$", facts, re.MULTILINE)
    assert re.search(r"^CapEff:\s+0+$", facts, re.MULTILINE)
    assert re.search(r"^CapBnd:\s+0+$", facts, re.MULTILINE)
    assert re.search(r"^Seccomp:\s+2$", facts, re.MULTILINE)
    assert re.search(r"^NoNewPrivs:\s+1$", facts, re.MULTILINE)
    # Where these namespaces may not lock memory the daemon goes on, and says so.
    locked = re.search(r"^VmLck:\s+[1-9]\d* kB$", facts, re.MULTILINE)
    host = status(service)["host"]
    assert [line.partition(" ")[0] for line in host] == ([] if locked else ["realtime.lock_memory"])
    for path in ("/run/linemate", "/var/lib/linemate", "/var/log/linemate"):
        owner = service.run("stat", "--format=%U:%G", path).stdout.strip()
        assert owner == "linemate:linemate"


def test_a_stranger_of_this_host_is_refused_and_a_member_of_the_group_is_not(
    service: Machine,
) -> None:
    ask = ("linemate", "status", "--timeout", "4")
    drop = ("setpriv", "--reuid=daemon", "--regid=daemon", "--clear-groups")
    refused = service.run(*drop, "env", f"PATH={PROGRAM}/bin:/usr/bin", *ask, check=False)
    assert refused.returncode == 3, refused.stderr
    assert refused.stderr.count("\n") == 1
    member = ("setpriv", "--reuid=daemon", "--regid=daemon", "--groups=linemate")
    welcome = service.run(*member, "env", f"PATH={PROGRAM}/bin:/usr/bin", *ask, check=False)
    assert welcome.returncode in {0, 1}, welcome.stderr


def asked_with(machine: Machine, key: str) -> int:
    """Exit code of a status over UDP with a key of the operator's own."""
    path = machine.out / "key"
    path.touch()
    path.chmod(0o600)
    path.write_text(key + "\n")
    ask = ("linemate", "status", "--udp", "127.0.0.1", "--timeout", "2", "--key", f"{OUT}/key")
    return machine.run(*ask, check=False).returncode


ANSWERED = {0, 1}
UNANSWERED = {3}


def test_its_credential_lets_an_operator_in_and_no_one_else(service: Machine) -> None:
    assert asked_with(service, KEY) in ANSWERED
    assert asked_with(service, OTHER) in UNANSWERED
    assert service.run("stat", "--format=%U %a", "/etc/linemate/link.key").stdout == "root 600\n"


def test_a_reload_takes_the_keys_as_they_are_now_without_a_restart(service: Machine) -> None:
    """Of a file: what systemd loads as a credential stays as it was until the restart."""
    path, keys = "/etc/linemate/linemated.yaml", "/etc/linemate/keys"

    def write(*lines: str) -> None:
        service.run("sh", "-c", f"printf '%s\\n' '{chr(10).join(lines)}' >{keys}")

    service.run("cp", path, "/etc/linemate/good.yaml")
    service.run("sed", "-i", "s|credential:link.key|keys|", path)
    service.run("install", "-o", "linemate", "-m", "0600", "/dev/null", keys)
    try:
        write(KEY)
        service.run("systemctl", "restart", UNIT)
        pid = main_pid(service)
        for lines, panel, office in (
            ([KEY], ANSWERED, UNANSWERED),
            ([KEY, OTHER], ANSWERED, ANSWERED),
            ([OTHER], UNANSWERED, ANSWERED),
            (["nonsense"], UNANSWERED, ANSWERED),
        ):
            write(*lines)
            before = journal(service)
            service.run("systemctl", "reload", UNIT)
            end = time.monotonic() + 5.0
            while "keys" not in journal(service)[len(before) :]:
                assert time.monotonic() < end, journal(service)
                time.sleep(0.05)
            assert asked_with(service, KEY) in panel
            assert asked_with(service, OTHER) in office
            shown = service.show(UNIT, "ActiveState", "MainPID")
            assert shown == {"ActiveState": "active", "MainPID": str(pid)}
    finally:
        service.run("mv", "/etc/linemate/good.yaml", path)
        service.run("systemctl", "restart", UNIT)


def test_a_robot_is_answered_and_stays_where_it_is(service: Machine, robot: Robot) -> None:
    notes = robot.until_answered(100)
    assert_still(notes)
    assert status(service)["state"] in {"init", "idle"}


def test_a_hung_daemon_is_killed_by_the_watchdog_and_the_next_one_moves_nothing(
    service: Machine, robot: Robot
) -> None:
    pid = main_pid(service)
    restarts = int(service.show(UNIT, "NRestarts")["NRestarts"])
    began = time.monotonic()
    service.run("kill", "-STOP", str(pid))
    until_restarted(service, pid, WATCHDOG_S + 10.0)
    assert time.monotonic() - began < WATCHDOG_S + READY_S + 2.0
    shown = service.show(UNIT, "NRestarts", "Result")
    assert int(shown["NRestarts"]) == restarts + 1
    assert "Watchdog timeout" in service.log_text()
    assert_still(robot.until_answered(100))


def test_a_killed_daemon_is_ready_again_in_three_seconds_and_moves_nothing(
    service: Machine, robot: Robot
) -> None:
    pid = main_pid(service)
    service.run("kill", "-KILL", str(pid))
    took_s = until_restarted(service, pid, 20.0)
    assert took_s < READY_S
    notes = robot.until_answered(100)
    first = next(note for note in notes if note["axes"] is not None)
    assert_still([first])
    assert_still(notes)
    # The programme that was running is over: the robot began another.
    assert first["programme"] > 1
    assert status(service)["state"] in {"init", "idle"}


def test_its_metrics_are_reported_next_to_it(service: Machine) -> None:
    service.run("systemctl", "start", "linemate-metrics.service")
    ask = (
        "from urllib.request import urlopen as u; print(u('http://127.0.0.1:9465/metrics').read())"
    )
    end, page = time.monotonic() + 10.0, ""
    while 'linemate_up{station="linemate"} 1' not in page:
        assert time.monotonic() < end, page
        page = service.run(INTERPRETER, "-c", ask, check=False).stdout
    service.run("systemctl", "stop", "linemate-metrics.service")


def test_a_bridge_carries_it_in_its_own_sandbox(service: Machine) -> None:
    pytest.importorskip("zenoh", reason="zenoh is in the extra fleet")
    service.run("systemctl", "start", "linemate-bridge.service")
    ask = (
        f"import sys; sys.path[:0] = ['{PROGRAM}/lib']; import site; site.addsitedir('{PACKAGES}');"
        "from linemate.daemon.operator.bridge_command import open_session;"
        "session = open_session([], ['tcp/127.0.0.1:7447']);"
        "print([r.ok.payload.to_string() for r in session.get('linemate/*/status') if r.ok])"
    )
    end, shown = time.monotonic() + 15.0, ""
    while '"health"' not in shown:
        assert time.monotonic() < end, shown
        shown = service.run(INTERPRETER, "-c", ask, check=False).stdout
    service.run("systemctl", "stop", "linemate-bridge.service")


def test_it_ends_on_order_and_leaves_a_recording_that_is_whole(service: Machine) -> None:
    began = time.monotonic()
    service.run("systemctl", "stop", UNIT)
    assert time.monotonic() - began < 6.0
    shown = service.show(UNIT, "ActiveState", "Result", "ExecMainCode", "ExecMainStatus")
    assert (shown["ActiveState"], shown["Result"]) == ("inactive", "success")
    assert (shown["ExecMainCode"], shown["ExecMainStatus"]) == ("1", "0")
    newest = service.run("sh", "-c", "ls -t /var/lib/linemate/*.mcap | head -1").stdout.strip()
    assert service.run("linemate", "export", newest, "--out", f"{OUT}/csv").returncode == 0
    listed = service.run("ls", "/run/linemate").stdout
    assert "command.sock" not in listed


def test_a_bad_configuration_is_reported_and_not_tried_again(machine: Machine) -> None:
    machine.run("systemctl", "stop", UNIT)
    path = "/etc/linemate/linemated.yaml"
    machine.run("cp", path, "/etc/linemate/good.yaml")
    machine.run("sh", "-c", f"echo 'rsi: {{cycle_ms: 25}}' >>{path}")
    try:
        machine.run("systemctl", "start", UNIT, check=False)
        # The reason why it stays failed, and not for a moment only until its restart.
        shown = machine.show(UNIT, "ActiveState", "SubState", "ExecMainStatus")
        assert shown == {"ActiveState": "failed", "SubState": "failed", "ExecMainStatus": "78"}
        assert f"{path}:" in journal(machine)
    finally:
        machine.run("mv", "/etc/linemate/good.yaml", path)
        machine.run("systemctl", "reset-failed", UNIT)
