"""``linemate commission``: exit codes, files of a site, and overlays that are checked first."""

from pathlib import Path

import pytest
import yaml

from linemate.daemon.commissioning import walk
from linemate.daemon.commissioning.walk import SiteState, StepName, StepOutcome, StepRecordOfSite
from linemate.daemon.config.documents import FileError
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.operator import console
from linemate.daemon.operator import main as tool
from linemate.daemon.operator.commissioning import site_files
from linemate.daemon.recording.step_file import StepFile
from linemate.daemon.recording.step_items import metadata_of


@pytest.fixture
def site(tmp_path: Path) -> Path:
    (tmp_path / "linemated.yaml").write_text("task: wheel.yaml\n")
    return tmp_path


def run(*words: object) -> int:
    return tool.main(["commission", *map(str, words)])


def test_a_directory_without_a_configuration_is_a_usage_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path, "--list") == 2
    assert "linemated.yaml: no such file" in capsys.readouterr().err


def test_the_limits_need_no_recording_and_show_the_margins(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(site, "--step", "limits") == 0
    shown = capsys.readouterr().out
    assert "A2 margin" in shown
    assert "tcp speed" in shown
    state = walk.from_text((site / "commission" / "progress.json").read_text())
    assert state.of(StepName.LIMITS).outcome is StepOutcome.MEASURED


def test_a_configuration_that_the_daemon_refuses_is_refused_here(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (site / "linemated.yaml").write_text("task: wheel.yaml\nwatch: {missed_s: 0.001}\n")
    assert run(site, "--step", "limits") == 1
    assert "shorter than a cycle" in capsys.readouterr().err


def test_a_step_can_be_left_out_with_a_reason(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(site, "--step", "force", "--skip", "no such sensor") == 0
    assert run(site, "--list") == 0
    assert "no such sensor" in capsys.readouterr().out
    assert run(site, "--skip", "no such sensor") == 2
    assert "--skip needs --step" in capsys.readouterr().err
    assert run(site, "--step", "force", "--skip", " ") == 2
    assert "--skip needs a reason" in capsys.readouterr().err


def test_the_list_shows_how_long_a_step_took(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = StepRecordOfSite(StepOutcome.MEASURED, took_s=75.0)
    opened = site_files.open_site(site, "linemated.yaml")
    site_files.write_state(opened, SiteState({StepName.LINKS: record}))
    assert run(site, "--list") == 0
    assert "1 min 15 s" in capsys.readouterr().out


def test_a_step_says_what_it_builds_on_and_goes_on(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(site, "--step", "signs", "--skip", "no arm") == 0
    assert "links, which has no result yet. It goes on without" in capsys.readouterr().err


def test_the_page_says_what_is_not_measured(site: Path) -> None:
    run(site, "--step", "force", "--skip", "no such sensor")
    assert run(site, "--step", "page") == 0
    text = (site / "commission" / "page.md").read_text()
    assert "- **force**" in text
    assert "NOT measured: skipped" in text


def test_an_overlay_that_the_daemon_would_refuse_is_not_written(site: Path) -> None:
    opened = site_files.open_site(site, "linemated.yaml")
    with pytest.raises(FileError, match=r"tactile.deflection: should be greater"):
        site_files.write_overlay(
            opened, SiteState(), StepName.SERVOS, {"tracking": {"tactile": {"deflection": 6e-6}}}
        )
    assert list(opened.folder.iterdir()) == []


def test_an_overlay_is_checked_with_those_of_the_other_steps(site: Path) -> None:
    opened = site_files.open_site(site, "linemated.yaml")
    camera = {"task": {"arm": {"camera_in_tcp": {"position": [0.1, 0.0, 0.0]}}}}
    name = site_files.write_overlay(opened, SiteState(), StepName.CAMERA, camera)
    record = StepRecordOfSite(StepOutcome.MEASURED, overlay=name)
    state = SiteState({StepName.CAMERA: record})
    assert yaml.safe_load(opened.overlay(name).read_text()) == camera
    checked = site_files.checked(opened, state)
    assert checked.station.task.file.arm.camera_in_tcp.position == (0.1, 0.0, 0.0)
    assert site_files.unlisted(opened, state) == ("commission/camera.yaml",)
    opened.overlay(name).write_text("tracking: {nonsense: 1}\n")
    with pytest.raises(FileError, match="nonsense"):
        site_files.write_overlay(opened, state, StepName.FORCE, {"control": {"damping": True}})


def test_a_damaged_state_is_refused_and_kept(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (site / "commission").mkdir()
    path = site / "commission" / "progress.json"
    path.write_text("{")
    assert run(site, "--step", "limits") == 2
    assert "Move it away to begin again" in capsys.readouterr().err
    assert path.read_text() == "{"


def test_recordings_need_a_step_and_must_be_recordings(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (site / "x.mcap").write_bytes(b"nothing")
    assert run(site, "--from", site / "x.mcap") == 2
    assert run(site, "--step", "camera", "--from", site / "x.mcap") == 1
    assert "not a linemate recording" in capsys.readouterr().err


def test_without_a_daemon_there_is_no_recording(site: Path) -> None:
    assert run(site, "--step", "camera", "--socket", site / "none.sock", "--record", "0.1") == 3


class RecordingDaemon:
    """A daemon whose writer needs a moment to end the file."""

    def __init__(self, file: Path) -> None:
        self.file, self.writes = file, 2
        self.calls: list[tuple[str, str | None]] = []

    def __enter__(self) -> "RecordingDaemon":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def call(self, op: str, params: dict[str, str], _: float) -> dict[str, object]:
        self.calls.append((op, params.get("action")))
        if op != "status":
            return {}
        self.writes -= 1
        return {"recording": {"file": str(self.file), "recording": self.writes > 0}}


def test_the_daemon_records_for_a_step_and_its_file_is_read_when_it_is_whole(
    site: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    task = (DAEMON_DATA / "wheel.yaml").read_text()
    urdf = (DAEMON_DATA / "arm.urdf").read_text()
    with (site / "live.mcap").open("wb") as stream:
        StepFile(stream, metadata_of({"task": task, "urdf": urdf})).close()
    daemon = RecordingDaemon(site / "live.mcap")
    monkeypatch.setattr(console, "connect", lambda _: daemon)
    assert run(site, "--step", "camera", "--record", "0.01") == 1
    assert daemon.calls == [
        ("record", "start"), ("record", "stop"), ("status", None), ("status", None),
    ]  # fmt: skip
    assert "0 postures with images, at least 15 are needed" in capsys.readouterr().err
    state = walk.from_text((site / "commission" / "progress.json").read_text())
    assert state.of(StepName.CAMERA).recordings == ("live.mcap",)
    assert 0.01 < state.of(StepName.CAMERA).took_s < 60.0
