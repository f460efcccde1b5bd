"""``linemated`` as a process: exit codes, the line of JSON, a clean end."""

import ast
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from linemate.daemon.service import main as service
from linemate.protocol.stamped_samples import AXES

LINEMATED = [sys.executable, "-m", "linemate.daemon.service.main"]


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "linemated.yaml"
    path.write_text(text)
    return path


def test_a_good_configuration_is_called_good(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, "task: wheel.yaml\n")
    assert service.main(["--config", str(path), "--check"]) == 0
    first, *peaks = capsys.readouterr().out.splitlines()
    assert first == f"{path}: good"
    assert [line.partition(":")[0] for line in peaks] == ["tcp", *AXES]


def test_a_start_imports_no_library_that_it_does_not_need(tmp_path: Path) -> None:
    path = written(tmp_path, "task: wheel.yaml\n")
    code = (
        "import sys; from linemate.daemon.service import app, main; "
        f"code = main.main(['--config', {str(path)!r}, '--check']); "
        "needless = {'pydantic', 'importlib.metadata', 'can', 'serialx', 'mcap', 'scipy.linalg'}; "
        "sys.exit(str(needless & set(sys.modules)) if needless & set(sys.modules) else code)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


NO_GARBAGE = """
import gc, sys
from linemate.daemon.service import app, main
collections, listening = [], app.App.listening

def ready(self):
    print(len(collections))
    self.end()
    return listening(self)

app.App.listening = ready
gc.disable()
gc.callbacks.append(lambda phase, info: collections.append(info))
sys.exit(main.main(["--config", sys.argv[1]]))
"""


def test_no_garbage_is_looked_for_before_ready(tmp_path: Path) -> None:
    path = written(tmp_path, "task: wheel.yaml\nrsi: {port: 0}\n")
    run = [sys.executable, "-c", NO_GARBAGE, str(path)]
    counts = subprocess.run(run, check=True, stdout=subprocess.PIPE).stdout.split()
    assert set(counts) == {b"0"}


def test_a_start_says_which_tasks_it_did_not_rehearse_again(tmp_path: Path) -> None:
    path = written(tmp_path, "task: wheel.yaml\nrsi: {port: 0}\nstate: .\n")
    run = [sys.executable, "-c", NO_GARBAGE, str(path)]
    first, second = (subprocess.run(run, check=True, capture_output=True).stderr for _ in range(2))
    line = b"not rehearsed again, the same was good before: wheel"
    assert line not in first
    assert line in second


def test_every_error_of_a_bad_one_is_reported_and_the_code_is_78(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, "task: none.yaml\nrsi: {cycle_ms: fast}\ncamera: {speed: .nan}\n")
    assert service.main(["--config", str(path)]) == 78
    lines = capsys.readouterr().err.splitlines()
    assert [line.removeprefix(f"{path}:").split(": ")[1] for line in lines] == [
        "task",
        "rsi.cycle_ms",
        "camera.speed",
    ]


def test_settings_that_do_not_fit_the_arm_are_bad_configuration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    servo = "{frequency_hz: 4, damping: 0.7, dead_time: 0.02}"
    servos = ", ".join([servo] * 6)
    path = written(tmp_path, f"task: wheel.yaml\ncontrol: {{servos: [{servos}]}}\n")
    assert service.main(["--config", str(path), "--check"]) == 78
    assert "7 axes" in capsys.readouterr().err


def test_a_wrong_command_line_is_usage() -> None:
    with pytest.raises(SystemExit) as ended:
        service.main(["--conf"])
    assert ended.value.code == 2


def test_the_process_tells_its_ports_serves_and_ends_on_request(tmp_path: Path) -> None:
    path = written(
        tmp_path, "task: wheel.yaml\nrsi: {port: 0}\ncamera: {port: 0}\ncommand: {socket: s}\n"
    )
    reading, writing = os.pipe()
    with subprocess.Popen(
        [*LINEMATED, "--config", str(path), "--ready-fd", str(writing)],
        pass_fds=[writing],
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        os.close(writing)
        with os.fdopen(reading) as pipe:
            listening = json.loads(pipe.readline())
        assert listening["pid"] == process.pid
        assert listening["robot"][1] > 0
        assert (tmp_path / "s").is_socket()
        second = subprocess.run(
            [*LINEMATED, "--config", str(written(tmp_path, second_on(listening["robot"][1])))],
            capture_output=True,
            text=True,
            check=False,
        )
        assert second.returncode == 1
        assert "the robot's port cannot be opened" in second.stderr
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=10)
    assert process.returncode == 0, errors
    assert not (tmp_path / "s").exists()


def second_on(port: int) -> str:
    return f"task: wheel.yaml\nrsi: {{port: {port}}}\n"


def test_the_algebra_runs_in_one_thread() -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "import linemate.daemon.service.main, os, sys;"
            "print(os.environ['OPENBLAS_NUM_THREADS'], 'numpy' in sys.modules)",
        ],
        capture_output=True,
        text=True,
        check=True,
        env={k: v for k, v in os.environ.items() if "NUM_THREADS" not in k},
    )
    assert done.stdout.split() == ["1", "False"]


def test_the_start_imports_no_package_of_scipy_and_no_library_of_sensors() -> None:
    code = (
        "import linemate.daemon.commissioning.whole_check, linemate.daemon.service.app, sys;"
        "print(list(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    names = set(ast.literal_eval(done.stdout))
    # Imports of linalg, special or interpolate cost 0.3 s and 60 MiB that stay locked.
    assert names & {"scipy.linalg", "scipy.special", "scipy.optimize", "scipy.interpolate"} == set()
    # A fifth of the start. A station that has the sensor imports its library.
    assert names & {"can", "cantools", "mcap", "serialx"} == set()
