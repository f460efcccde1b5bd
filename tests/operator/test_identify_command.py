"""``linemate identify``: exit codes, reasons, and an overlay that is whole or absent."""

import io
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest
import yaml

from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.config.task_file import geometry_text
from linemate.daemon.core.control.settings import AxisGeometry
from linemate.daemon.identification.outcome import Estimate, Refusal, ReportLine
from linemate.daemon.identification.pipeline import Identified
from linemate.daemon.operator import identify_command
from linemate.daemon.operator import main as tool
from linemate.daemon.recording import reader
from linemate.daemon.recording.format import UnreadableRecordingError
from linemate.daemon.recording.step_file import StepFile
from linemate.daemon.recording.step_items import metadata_of

TEXTS = {
    "task": (DAEMON_DATA / "wheel.yaml").read_text(),
    "urdf": (DAEMON_DATA / "arm.urdf").read_text(),
}


def run(*words: str | Path) -> int:
    return tool.main(["identify", *map(str, words)])


def recording(path: Path, texts: Mapping[str, str] = TEXTS, steps: int = 0) -> Path:
    file = StepFile(path.open("wb"), metadata_of(texts))
    for _ in range(steps):
        file.write(1, b"\x00")
    file.close()
    return path


def test_a_missing_file_is_a_reason_and_exit_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path / "none.mcap", "--out", tmp_path / "o.yaml") == 1
    assert "none.mcap: No such file" in capsys.readouterr().err


@pytest.mark.parametrize("content", [b"", b"nothing of the kind", b"\x89MCAP0\r\n"])
def test_what_is_no_recording_is_refused(
    content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    assert run(path, "--out", tmp_path / "o.yaml") == 1
    assert "not a linemate recording" in capsys.readouterr().err
    assert not (tmp_path / "o.yaml").exists()


def test_a_recording_without_steps_or_texts_identifies_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(recording(tmp_path / "a.mcap"), "--out", tmp_path / "o.yaml") == 1
    assert "too short" in capsys.readouterr().err
    assert run(recording(tmp_path / "b.mcap", {}), "--out", tmp_path / "o.yaml") == 1
    assert "holds no task and no urdf" in capsys.readouterr().err


def test_recordings_of_two_arms_are_not_mixed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = {**TEXTS, "urdf": TEXTS["urdf"].replace("1.150", "1.250")}
    files = recording(tmp_path / "a.mcap"), recording(tmp_path / "b.mcap", other)
    assert run(*files, "--out", tmp_path / "o.yaml") == 1
    assert "b.mcap: another arm" in capsys.readouterr().err


def test_recordings_of_two_geometries_of_an_arm_are_not_mixed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = {**TEXTS, **geometry_text([AxisGeometry(turn=(0.0, 0.0, 1e-3))])}
    files = recording(tmp_path / "a.mcap"), recording(tmp_path / "b.mcap", other)
    assert run(*files, "--out", tmp_path / "o.yaml") == 1
    assert "b.mcap: another arm" in capsys.readouterr().err


def test_bytes_that_are_no_step_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnreadableRecordingError, match="not a step"):
        reader.read(recording(tmp_path / "a.mcap", steps=1))


def test_a_file_that_breaks_off_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    whole = recording(tmp_path / "a.mcap")
    assert reader.read(whole).whole
    cut = tmp_path / "b.mcap"
    cut.write_bytes(whole.read_bytes()[:-40])
    read = reader.read(cut)
    assert not read.whole
    assert read.texts["urdf"] == TEXTS["urdf"]


FOUND = Identified(
    findings=(
        ReportLine(
            "servo A1 frequency", "Hz", 1.0, Estimate(4.0123, 0.004, "700 answers"), in_overlay=True
        ),
        ReportLine("servo A2 frequency", "Hz", 1.0, Refusal("the axis hardly moved")),
        ReportLine("dead time", "ms", 1e3, Estimate(0.036, 0.0001, "them"), in_overlay=True),
    ),
    overlay={"control": {"servos": [{"frequency_hz": 4.0123, "damping": 0.75}]}},
    kept=("control.servos.1",),
)


def test_the_table_shows_deviations_marks_and_reasons() -> None:
    lines = identify_command.table(FOUND.findings).splitlines()
    assert lines[1].split()[:6] == ["servo", "A1", "frequency", "4.0123", "0.0040", "Hz"]
    assert "*" in lines[1]
    assert "refused: the axis hardly moved" in lines[2]
    assert "36.00" in lines[3]
    plain = identify_command.as_plain(FOUND)
    assert plain["findings"][1] == {
        "name": "servo A2 frequency", "told": False, "refused": "the axis hardly moved",
    }  # fmt: skip


def test_the_overlay_is_yaml_with_its_origin() -> None:
    text = identify_command.overlay_text(FOUND, ["a.mcap"])
    assert yaml.safe_load(io.StringIO(text)) == FOUND.overlay
    assert "# from a.mcap" in text
    assert "# kept as configured: control.servos.1" in text


def test_an_overlay_replaces_the_old_one_whole_and_leaves_no_other_file(tmp_path: Path) -> None:
    path = tmp_path / "o.yaml"
    path.write_text("old")
    identify_command.write(path, "new")
    assert path.read_text() == "new"
    assert [file.name for file in tmp_path.iterdir()] == ["o.yaml"]
    with pytest.raises(OSError, match="No such file"):
        identify_command.write(tmp_path / "gone" / "o.yaml", "new")


def test_the_command_line_stays_light() -> None:
    code = (
        "import sys; from linemate.daemon.operator import identify_command; "
        "from linemate.daemon.recording import reader; "
        "print([m for m in ('numpy', 'scipy', 'pinocchio', 'mcap', 'yaml', 'pydantic') "
        "if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
