"""Command lines of the three programs: version, errors, exit codes, output places, Ctrl-C."""

import importlib.metadata
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from linemate.daemon import command_line
from linemate.daemon.command_line import BadFileError, NegativeError, UsageError
from linemate.daemon.operator import main as operator
from linemate.daemon.service import main as service
from linemate.simulators.harness import main as harness

PROGRAMS = {"linemate": operator.main, "linemated": service.main, "linemate-sim": harness.main}
Capture = pytest.CaptureFixture[str]


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_program_prints_its_name_and_the_installed_version(program: str, capsys: Capture) -> None:
    with pytest.raises(SystemExit) as ended:
        PROGRAMS[program](["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.split() == [program, importlib.metadata.version("linemate")]


@pytest.mark.parametrize(
    ("program", "words", "near"),
    [
        ("linemate", "stats", "near are status, start"),
        ("linemate", "status --wach", "near is --watch"),
        ("linemate", "param gett x", "near is get"),
        ("linemated", "--config x --chek", "near are --check"),
        ("linemated", "--confg x", "near are --config"),
        ("linemate-sim", "demmo", "near is demo"),
        ("linemate-sim", "run --variant oracel", "near is oracle"),
        ("linemate-sim", "campaign --variants no-clases", "near is no-classes"),
        ("linemate-sim", "run --sed 1", "near are --seed"),
    ],
)
def test_a_wrong_word_is_one_line_with_the_names_near_it(
    program: str, words: str, near: str, capsys: Capture
) -> None:
    with pytest.raises(SystemExit) as ended:
        PROGRAMS[program](words.split())
    shown = capsys.readouterr()
    assert (ended.value.code, shown.out) == (2, "")
    assert shown.err.count("\n") == 1
    assert near in shown.err


def failing(error: BaseException) -> Callable[[], int]:
    def command() -> int:
        raise error

    return command


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (NegativeError("no"), 1),
        (UsageError("wrong"), 2),
        (BadFileError("x.yaml:1:1: key: what"), 78),
        (KeyboardInterrupt(), 130),
        (RuntimeError("a defect"), 70),
        (OSError("a defect"), 70),
    ],
)
def test_only_a_negative_answer_ends_with_1(
    error: BaseException, code: int, capsys: Capture
) -> None:
    assert command_line.run("x", failing(error)) == code
    assert ("Traceback" in capsys.readouterr().err) is (code == 70)


def test_a_closed_pipe_ends_quietly_and_not_with_1() -> None:
    code = (
        "import sys; from linemate.daemon import command_line;"
        "sys.exit(command_line.run('x', lambda: print('y' * 1_000_000) or 0))"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 141


@pytest.mark.parametrize("size", [1, 1_000_000])
def test_a_full_disk_is_one_line(size: int) -> None:
    code = (
        "import sys; from linemate.daemon import command_line;"
        f"sys.exit(command_line.run('x', lambda: print('y' * {size}) or 0))"
    )
    with open("/dev/full", "w") as full:  # noqa: PTH123 - a device
        done = subprocess.run(
            [sys.executable, "-c", code],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    what = "x: the output: No space left on device. Free some space\n"
    assert (done.returncode, done.stderr) == (2, what)


def test_a_closed_output_is_no_error() -> None:
    code = (
        "import sys; from linemate.daemon import command_line;"
        "sys.exit(command_line.run('x', lambda: print('y') or 0))"
    )
    subprocess.run(["sh", "-c", '"$@" >&-', "sh", sys.executable, "-c", code], check=True)


def wrong_places(tmp_path: Path) -> list[Path]:
    (tmp_path / "file").write_text("")
    return [tmp_path / "file" / "x", Path("/proc/none/x"), Path("/dev/null/x")]


SIM = ("demo", "run", "campaign", "run --json", "campaign --detection 1")


@pytest.mark.parametrize("words", SIM)
def test_an_output_directory_in_a_wrong_place_is_one_line_before_any_work(
    words: str, tmp_path: Path, capsys: Capture
) -> None:
    for place in [*wrong_places(tmp_path), tmp_path / "file"]:
        began = time.monotonic()
        assert harness.main([*words.split(), "--out", str(place)]) == 2
        assert time.monotonic() - began < 5.0
        shown = capsys.readouterr()
        assert shown.err.startswith(f"linemate-sim: --out {place}: ")
        assert (shown.out, shown.err.count("\n")) == ("", 1)


@pytest.fixture
def stranger(tmp_path: Path) -> Iterator[Path]:
    """Another user, who may not enter the folder."""
    if os.getuid() != 0:
        pytest.skip("only root can become another user")
    tmp_path.chmod(0o700)
    os.seteuid(65534)
    try:
        yield tmp_path
    finally:
        os.seteuid(0)


@pytest.mark.parametrize(
    ("program", "words", "code"),
    [
        ("linemate-sim", "run --out", 2),
        ("linemate", "export", 2),
        ("linemate", "identify x --out", 2),
        ("linemate", "commission", 2),
        ("linemate", "rsi files kss-8.5", 2),
        ("linemated", "--check --config", 78),
    ],
)
def test_a_place_of_another_user_is_one_line(
    program: str, words: str, code: int, stranger: Path, capsys: Capture
) -> None:
    assert PROGRAMS[program]([*words.split(), str(stranger / "x")]) == code
    shown = capsys.readouterr()
    assert (shown.out, shown.err.count("\n")) == ("", 1)
    assert str(stranger / "x") in shown.err


def test_a_plot_in_a_wrong_place_is_one_line_before_any_work(
    tmp_path: Path, capsys: Capture
) -> None:
    assert harness.main(["bench", "--plot", str(tmp_path)]) == 2
    assert harness.main(["bench", "--plot", str(tmp_path / "none" / "x.png")]) == 2
    assert capsys.readouterr().err.count("\n") == 2


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("linemate", "replay x --tolerance nan"),
        ("linemate", "replay x --tolerance -1"),
        ("linemate", "commission x --sensor-at 0,nan,0"),
        ("linemate", "commission x --sensor-at 0,0"),
        ("linemated", "--config x --ready-fd 999"),
        *(("linemate-sim", f"run --cycle-ms {value}") for value in ("0", "nan", "25")),
    ],
)
def test_a_number_out_of_range_is_one_line_before_any_work(
    program: str, words: str, capsys: Capture
) -> None:
    with pytest.raises(SystemExit) as ended:
        PROGRAMS[program](words.split())
    shown = capsys.readouterr()
    assert (ended.value.code, shown.out, shown.err.count("\n")) == (2, "", 1)
    assert words.rpartition(" ")[2] in shown.err


@pytest.mark.parametrize("command", ["metrics", "bridge"])
def test_two_stations_of_one_name_are_refused(command: str, capsys: Capture) -> None:
    with pytest.raises(SystemExit) as ended:
        operator.main([command, "--station", "a=/x", "--station", "a=/y"])
    assert ended.value.code == 2
    assert "argument --station: the name 'a' is given twice" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "what"),
    [
        ("status --udp 127.0.0.1 --key none", "none: No such file or directory"),
        ("view none --no-browser", "none: No such file or directory"),
        ("view none --no-browser --bind host", "'host' is not a numeric address"),
        ("plc --users none --bind 127.evil", "'127.evil' is not a numeric address"),
        ("plc --users none", "none: No such file or directory"),
        ("report 2026-02-30", "'2026-02-30' should be a day, YYYY-MM-DD"),
        ("export .", ".: Is a directory"),
        ("recover .", ".: Is a directory"),
    ],
)
def test_an_input_that_cannot_be_is_one_line_with_its_reason_once(
    words: str, what: str, capsys: Capture
) -> None:
    try:
        code = operator.main(words.split())
    except SystemExit as ended:
        code = int(ended.code or 0)
    shown = capsys.readouterr()
    assert (code, shown.out, shown.err.count("\n")) == (2, "", 1)
    assert what in shown.err
    assert "Errno" not in shown.err


@pytest.mark.parametrize("command", ["export", "recover", "identify", "keygen"])
def test_an_output_of_the_tool_in_a_wrong_place_is_one_line(
    command: str, tmp_path: Path, capsys: Capture
) -> None:
    from rerun import GOLDEN

    words = ["keygen", "eve", "view"] if command == "keygen" else [command, str(GOLDEN)]
    for place in wrong_places(tmp_path):
        assert operator.main([*words, "--out", str(place)]) == 2
        shown = capsys.readouterr()
        assert str(place) in shown.err
        assert (shown.out, shown.err.count("\n")) == ("", 1)
