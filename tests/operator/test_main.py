"""``linemate``: its command line, what it prints and its exit codes, with a real server."""

import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_ends import key_of, open_port, served

from linemate.daemon.operator import render
from linemate.daemon.operator.main import main
from linemate.daemon.operator.param_command import description
from linemate.daemon.service.command_server import CommandPort
from linemate.protocol.command.frame_codec import Role
from linemate.protocol.command.preshared_keys import key_line, parse_keys

ALICE = key_of("alice", Role.OPERATE, 1)


class Daemon:
    """A handler with parameters and a state."""

    def __init__(self) -> None:
        self.health = "healthy"
        self.values: dict[str, Any] = {"approach.speed": 0.1, "swing.enabled": True}
        self.defaults = dict(self.values)
        self.done: list[str] = []
        self.settles_s = 0.0
        self.refuse_once: dict[str, str] = {}

    def respond(self, op: str, params: dict[str, Any], role: str, who: str) -> dict[str, Any]:
        answer, reason = self.handle(op, params, role, who), self.refuse_once.pop(op, None)
        return answer if reason is None else {"refused": reason}

    def handle(self, op: str, params: dict[str, Any], role: str, who: str) -> dict[str, Any]:
        self.done.append(op)
        if op == "status":
            return {
                "health": self.health,
                "state": "idle",
                **({"settles_s": self.settles_s} if self.settles_s else {}),
                "age": {"camera_s": math.nan},
            }
        if op == "params":
            return {"params": self.described(params.get("prefix", ""))}
        if op == "get":
            return self.get(params["names"])
        if op == "set":
            return self.set(params["values"])
        if op in {"save", "record"}:
            return {"path": "/x"}
        return {"refused": "not armed"} if op == "start" else {}

    def get(self, names: list[str]) -> dict[str, Any]:
        unknown = [name for name in names if name not in self.values]
        if unknown:
            return {"refused": f"no parameter {unknown[0]}"}
        return {"values": {name: self.values[name] for name in names}}

    def set(self, values: dict[str, Any]) -> dict[str, Any]:
        for name, value in values.items():
            if isinstance(value, str):
                return {"refused": f"{name}: should be a number, not {value!r:.9}"}
        if values.get("approach.speed", 0.0) > 0.2:
            return {"refused": "approach.speed: at most 0.2"}
        old = {name: self.values[name] for name in values}
        self.values |= values
        return {"changed": {n: {"old": old[n], "new": values[n]} for n in values}}

    def described(self, prefix: str) -> list[dict[str, Any]]:
        return [
            {
                "name": name,
                "value": value,
                "default": self.defaults[name],
                "unit": "m/s" if name.endswith("speed") else "",
                "min": 0.0 if name.endswith("speed") else None,
                "max": 0.2 if name.endswith("speed") else None,
                "change": "live" if name.endswith("speed") else "idle",
                "describe": f"what {name} is",
            }
            for name, value in self.values.items()
            if name.startswith(prefix)
        ]


@pytest.fixture
def daemon() -> Daemon:
    return Daemon()


@pytest.fixture
def port(daemon: Daemon, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[CommandPort]:
    monkeypatch.setenv("LINEMATE_SOCKET", str(tmp_path / "command.sock"))
    with open_port(tmp_path, (ALICE,), daemon.respond) as port, served(port):
        yield port


pytestmark = pytest.mark.usefixtures("port")
Out = pytest.CaptureFixture[str]


@pytest.mark.parametrize(("health", "code"), [("healthy", 0), ("degraded", 1), ("fault", 1)])
def test_status_exits_by_health(daemon: Daemon, capsys: Out, health: str, code: int) -> None:
    daemon.health = health
    assert main(["status"]) == code
    out = capsys.readouterr().out
    assert health in out
    assert "age.camera_s" in out


def test_status_prints_json_that_every_parser_reads(capsys: Out) -> None:
    assert main(["status", "--json"]) == 0
    read = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert read == {"version": 1, "health": "healthy", "state": "idle", "age": {"camera_s": None}}


def test_status_without_a_daemon_exits_3(capsys: Out, tmp_path: Path) -> None:
    assert main(["status", "--socket", str(tmp_path / "none")]) == 3
    assert "no answer" in capsys.readouterr().err


@pytest.mark.parametrize("words", [[], ["stat"], ["status", "--udp", "x:y"], ["param", "set", "a"]])
def test_a_wrong_command_line_is_one_line(words: list[str], capsys: Out) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    shown = capsys.readouterr()
    assert (ended.value.code, shown.out) == (2, "")
    assert shown.err.startswith("linemate")
    assert shown.err.count("\n") == 1


@pytest.mark.parametrize("op", ["arm", "stop", "retreat", "ack"])
def test_operating_does_what_it_says(daemon: Daemon, op: str) -> None:
    assert main([op]) == 0
    assert daemon.done == [op]


def test_a_refusal_exits_1_with_the_reason(capsys: Out) -> None:
    assert main(["start"]) == 1
    assert capsys.readouterr().err == "linemate: refused: not armed\n"


@pytest.mark.parametrize(("settles_s", "code"), [(0.05, 0), (0.0, 1)])
def test_an_arm_that_meets_a_rest_is_ordered_again_after_it(
    daemon: Daemon, capsys: Out, settles_s: float, code: int
) -> None:
    daemon.refuse_once["arm"] = "not settled"
    daemon.settles_s = settles_s
    assert main(["arm"]) == code
    assert daemon.done == ["arm", "status", "arm"][: 2 + (code == 0)]
    shown = capsys.readouterr().err
    assert ("the daemon rested: waiting 0.1 s" in shown) == (code == 0)


def test_recordings_are_begun_and_ended(daemon: Daemon, capsys: Out) -> None:
    assert main(["record", "start"]) == 0
    assert capsys.readouterr().out == "path  /x\n"
    assert main(["record", "stop", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"version": 1, "path": "/x"}
    assert daemon.done == ["record", "record"]


def test_parameters_are_listed_described_and_compared(daemon: Daemon, capsys: Out) -> None:
    assert main(["param", "list"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in listed] == ["name", "approach.speed", "swing.enabled"]
    assert main(["param", "list", "swing"]) == 0
    assert "approach" not in capsys.readouterr().out
    assert main(["param", "describe", "approach.speed"]) == 0
    described = capsys.readouterr().out
    assert all(word in described for word in ("0.1 m/s", "0 .. 0.2", "at once", "what approach"))
    assert main(["param", "diff", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"version": 1, "params": []}
    daemon.values["swing.enabled"] = False
    assert main(["param", "diff"]) == 0
    assert "swing.enabled  no" in capsys.readouterr().out


def test_a_bound_that_is_not_allowed_itself_is_described_so() -> None:
    item = {"name": "a", "min": 0.0, "max": 1.0, "excluded": ["min"]}
    assert "  range    above 0 .. 1\n" in description(item)
    assert "  range    above 0 .. below 1\n" in description({**item, "excluded": ["min", "max"]})


def test_a_parameter_that_is_not_there_exits_1(capsys: Out) -> None:
    assert main(["param", "describe", "approach"]) == 1
    assert main(["param", "get", "approach"]) == 1
    assert capsys.readouterr().err.count("no parameter approach") == 2


def test_parameters_are_got_and_set(daemon: Daemon, capsys: Out) -> None:
    assert main(["param", "get", "approach.speed"]) == 0
    assert capsys.readouterr().out == "0.1\n"
    assert main(["param", "set", "approach.speed=0.15", "swing.enabled=false"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "approach.speed: 0.1 -> 0.15",
        "swing.enabled: yes -> no",
    ]
    assert daemon.values == {"approach.speed": 0.15, "swing.enabled": False}
    assert main(["param", "get", "approach.speed", "swing.enabled", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"version": 1, "values": daemon.values}
    assert main(["param", "save"]) == 0
    assert "/x" in capsys.readouterr().out


def test_what_is_learned_is_shown_and_taken_back(
    daemon: Daemon, capsys: Out, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, turn = "tracking.camera.felt", "tracking.camera.felt_turn"
    late = "tracking.distance.late"
    daemon.values[late] = daemon.defaults[late] = 0.0
    for learned in (name, turn):
        daemon.values[learned] = daemon.defaults[learned] = [0.0, 0.0]
    listed = daemon.described

    def described(prefix: str) -> list[dict[str, Any]]:
        return [{**item, "file": daemon.defaults[item["name"]]} for item in listed(prefix)]

    monkeypatch.setattr(daemon, "described", described)
    daemon.values["approach.speed"] = 0.15  # an operator's, which is not learned
    assert main(["learned", "show"]) == 0
    assert capsys.readouterr().out == "nothing is learned\n"
    daemon.values[name], daemon.values[turn] = [0.0004, 0.0], [0.0, 0.0006]
    daemon.values[late] = 0.006
    assert main(["learned", "show"]) == 0
    shown = [line.split()[0] for line in capsys.readouterr().out.splitlines()[1:]]
    assert shown == [name, turn, late]
    assert main(["learned", "reset"]) == 0
    assert daemon.values == {**daemon.defaults, "approach.speed": 0.15}
    capsys.readouterr()
    assert main(["learned", "show", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"version": 1, "params": []}


@pytest.mark.parametrize(
    "value",
    ["0.3", "NaN", "-Infinity", "1e999", "9" * 40, '{"a": 1}', "[[{}]]", "[" * 500, "9" * 500],
)
def test_nonsense_is_not_set_and_named(daemon: Daemon, value: str, capsys: Out) -> None:
    before = dict(daemon.values)
    assert main(["param", "set", f"approach.speed={value}"]) == 1
    shown = capsys.readouterr().err
    assert "approach.speed: " in shown or "at most" in shown
    assert daemon.values == before


def test_a_name_that_stands_twice_is_not_set(daemon: Daemon, capsys: Out) -> None:
    before = dict(daemon.values)
    assert main(["param", "set", "approach.speed=0.1", "approach.speed=0.15"]) == 2
    assert "given twice" in capsys.readouterr().err
    assert daemon.values == before


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["dance"],
        ["param"],
        ["param", "set", "novalue"],
        ["param", "set", "a=" + "[" * 100_000],
        ["record", "pause"],
        ["status", "--udp", "host:99999"],
        ["status", "--timeout", "-1"],
        ["keygen", "x", "root"],
    ],
)
def test_wrong_usage_exits_2(words: list[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(words)
    assert caught.value.code == 2


def test_the_tool_asks_over_udp_with_a_key(port: CommandPort, tmp_path: Path, capsys: Out) -> None:
    path = tmp_path / "key"
    assert main(["keygen", "bob", "view", "--out", str(path)]) == 0
    assert main(["keygen", "ann", "operate", "--out", str(path)]) == 0
    assert main(["keygen", "ann", "operate", "--out", str(path)]) == 2
    assert path.stat().st_mode & 0o777 == 0o600
    keys = parse_keys(path.read_text())
    assert [key.name for key in keys] == ["bob", "ann"]
    port.replace_keys(keys)
    address = "{}:{}".format(*(port.udp_address or ()))
    there = ["--udp", address, "--key", str(path)]
    assert main(["status", *there]) == 0
    assert main(["stop", *there]) == 1
    assert "may view" in capsys.readouterr().err
    assert main(["stop", *there, "--key-name", "ann"]) == 0
    assert main(["stop", *there, "--key-name", "eve"]) == 2


def test_a_key_can_be_printed(capsys: Out) -> None:
    assert main(["keygen", "bob", "view"]) == 0
    (key,) = parse_keys(capsys.readouterr().out)
    assert (key.name, key.role) == ("bob", Role.VIEW)


def test_a_key_is_not_written_where_others_can_read(tmp_path: Path) -> None:
    shared = tmp_path / "shared"
    shared.write_text(key_line(ALICE) + "\n")
    shared.chmod(0o644)
    assert main(["keygen", "bob", "view", "--out", str(shared)]) == 2
    assert shared.read_text() == key_line(ALICE) + "\n"
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "elsewhere")
    assert main(["keygen", "bob", "view", "--out", str(link)]) == 2
    assert not (tmp_path / "elsewhere").exists()


def test_a_key_has_a_line_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "keys"
    path.write_text(key_line(ALICE))
    path.chmod(0o600)
    assert main(["keygen", "bob", "view", "--out", str(path)]) == 0
    assert [key.name for key in parse_keys(path.read_text())] == ["alice", "bob"]


def test_a_status_imports_nothing_heavy(tmp_path: Path) -> None:
    code = (
        "import sys; from linemate.daemon.operator.main import main; code = main(['status']);"
        "heavy = {'numpy', 'scipy', 'asyncio', 'rich', 'pydantic', 'yaml', 'pinocchio'};"
        "print(heavy & set(sys.modules)); sys.exit(code)"
    )
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
        env=dict(os.environ),
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "set()"
    assert time.monotonic() - began < 10.0


FROZEN = """
import gc, sys
from linemate.daemon.operator.main import main
main(["status", "--socket", "/none"])
kept = gc.get_freeze_count()
sys.argv = ["linemate", "status", "--socket", "/none"]
main()
print(kept, gc.get_freeze_count() > 10_000)
"""


def test_a_program_that_ends_collects_no_modules() -> None:
    done = subprocess.run(
        [sys.executable, "-c", FROZEN], capture_output=True, text=True, check=True
    )
    assert done.stdout == "0 True\n"


def test_a_table_of_nothing_is_empty() -> None:
    assert render.table((), []) == ""
    assert render.rows({"a": {}, "b": {"c": [1, True, None]}}) == [
        ("a", "-"),
        ("b.c", "[1, yes, -]"),
    ]


def test_a_table_sends_a_terminal_no_control_characters() -> None:
    assert render.table((), [("task", "a\x1b[2J\n"), ("ü", "b")]) == "task  a?[2J?\nü     b"


LOADED = """
import sys
from linemate.daemon.operator.main import main
main(["status", "--socket", "/none"])
print(*sys.modules)
"""


def test_a_status_loads_nothing_that_it_does_not_need() -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOADED], capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.split())
    assert "linemate.protocol.command.local_client" in loaded
    modules = ("replay_command", "export_command", "param_command", "doctor")
    unwanted = {
        *(f"linemate.daemon.operator.{module}" for module in modules),
        "linemate.protocol.command.authenticated",
        "linemate.daemon.view",
    }
    heavy = [
        "numpy",
        "rich",
        "pydantic",
        "yaml",
        "asyncio",
        "secrets",
        "hashlib",
        "json",
        "msgspec",
        "difflib",
        "shutil",
    ]
    assert not loaded & {*unwanted, *heavy}
