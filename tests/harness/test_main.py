"""The command line: what it accepts, what it refuses and with which code."""

import argparse
import json
import subprocess
import sys

import pytest

from linemate.simulators.harness import main as command_line
from linemate.simulators.harness.main import main


@pytest.mark.parametrize(("text", "expected"), [("3", (3,)), ("0..2", (0, 1, 2)), ("5..5", (5,))])
def test_seeds_are_one_or_a_range_with_both_ends(text: str, expected: tuple[int, ...]) -> None:
    assert command_line.seeds(text) == expected


@pytest.mark.parametrize("text", ["", "a", "3..1", "-1", "1..", "0..10000000", "1..2..3"])
def test_no_other_seeds_are_accepted(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError):
        command_line.seeds(text)


@pytest.mark.parametrize("text", ["", "default,luck", ","])
def test_unknown_variants_are_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError):
        command_line.variants(text)


@pytest.mark.parametrize("kind", ["scenario", "task", "emulator"])
def test_a_schema_is_json(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema", kind]) == 0
    assert json.loads(capsys.readouterr().out)["type"] == "object"


@pytest.mark.parametrize(
    "arguments", ["", "fly", "run --seed x", "run --variant luck", "campaign --seeds 0"]
)
def test_wrong_usage_ends_with_2(arguments: str) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments.split())
    assert caught.value.code == 2


def test_a_bad_file_ends_with_78_and_its_place(
    tmp_path: object, capsys: pytest.CaptureFixture[str]
) -> None:
    path = f"{tmp_path}/bad.yaml"
    with open(path, "w", encoding="utf-8") as file:  # noqa: PTH123
        file.write("conveyr: 1\n")
    assert main(["run", "--scenario", path]) == 78
    assert capsys.readouterr().err.strip() == f"{path}:1:1: conveyr: unknown key; near is conveyor"


def test_a_bad_override_ends_with_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--set", "tracking.rule.tentative=-1"]) == 2
    assert "--set tracking.rule.tentative" in capsys.readouterr().err


def test_settings_that_do_not_fit_together_end_with_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--set", "task.arm.flange=no_such_frame"]) == 2
    assert "linemate-sim: " in capsys.readouterr().err


def test_help_does_not_load_the_numeric_libraries() -> None:
    script = (
        "import sys\n"
        "from linemate.simulators.harness.main import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "assert not {'numpy', 'scipy', 'pinocchio', 'matplotlib'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)
