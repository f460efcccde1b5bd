"""Rehearsals that a start leaves out: only those of exactly the same, and only if sure."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from linemate.daemon.commissioning import kept_rehearsals, whole_check
from linemate.daemon.commissioning.kept_rehearsals import MOST, NAME, KeptRehearsals
from linemate.daemon.config import config
from linemate.daemon.config.documents import FileError
from linemate.daemon.config.files import DAEMON_DATA


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A site of files with a state directory."""
    for name in ("wheel.yaml", "arm.urdf"):
        shutil.copy(DAEMON_DATA / name, tmp_path)
    path = tmp_path / "linemated.yaml"
    path.write_text("task: wheel.yaml\nstate: .\n")
    return path


def started(path: Path) -> KeptRehearsals:
    """Check as a start does."""
    kept = whole_check.check(path, keeps=True).kept
    kept.keep()
    return kept


def test_a_start_leaves_out_the_rehearsal_of_the_start_before(site: Path) -> None:
    assert started(site).left_out == []
    assert (site.parent / NAME).stat().st_mode & 0o777 == 0o600
    assert started(site).left_out == ["wheel"]


def test_a_check_by_itself_neither_uses_nor_writes_them(site: Path) -> None:
    whole_check.check(site).kept.keep()
    assert not (site.parent / NAME).exists()
    started(site)
    checked = whole_check.check(site)
    assert checked.peaks
    assert checked.kept.left_out == []


def replaced(old: str, new: str, name: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        path = folder / name
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    return change


@pytest.mark.parametrize(
    "change",
    [
        replaced("nominal_speed: 0.106", "nominal_speed: 0.107", "wheel.yaml"),
        replaced("state: .", "state: .\nrsi: {cycle_ms: 4}", "linemated.yaml"),
        replaced("state: .", "state: .\ncontrol: {tcp_speed: 0.45}", "linemated.yaml"),
        replaced(
            "state: .", "state: .\ntracking: {distance: {deviation: 0.002}}", "linemated.yaml"
        ),
        replaced("<robot ", "<robot  ", "arm.urdf"),
    ],
)
def test_anything_else_is_rehearsed(site: Path, change: Callable[[Path], None]) -> None:
    started(site)
    change(site.parent)
    station = config.load(site)
    assert not KeptRehearsals(station.state).is_known(station, station.task)


def test_another_program_rehearses_again(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = site.parent / "sources" / "part.py"
    source.parent.mkdir()
    source.write_text("a = 1\n")
    monkeypatch.setattr(kept_rehearsals, "_SOURCES", (source.parent,))
    started(site)
    assert started(site).left_out == ["wheel"]
    os.utime(source, ns=(1, 1))
    assert started(site).left_out == []


def test_a_task_that_is_not_good_is_not_kept(site: Path) -> None:
    started(site)
    before = (site.parent / NAME).read_text()
    replaced("position: [1.80, 0.0, 1.10]", "position: [1.80, 0.0, 9.10]", "wheel.yaml")(
        site.parent
    )
    for _ in range(2):
        with pytest.raises(FileError):
            started(site)
    assert (site.parent / NAME).read_text() == before


@pytest.mark.parametrize(
    "text", ["x\n", "0" * 64, "0" * 63 + "\n", "\u00e9" * 64 + "\n", "0" * 9999]
)
def test_a_damaged_file_counts_as_none_and_is_written_again(site: Path, text: str) -> None:
    path = site.parent / NAME
    path.write_text(text)
    path.chmod(0o600)
    kept = started(site)
    assert (kept.left_out, kept.unusable) == ([], 1)
    assert str(path) in kept.trouble
    assert started(site).left_out == ["wheel"]


def test_a_file_that_others_may_read_or_write_counts_as_none(site: Path) -> None:
    started(site)
    (site.parent / NAME).chmod(0o620)
    kept = started(site)
    assert (kept.left_out, kept.unusable) == ([], 1)


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a file away")
def test_a_file_of_another_user_counts_as_none(site: Path) -> None:
    started(site)
    os.chown(site.parent / NAME, 12345, -1)
    kept = started(site)
    assert (kept.left_out, kept.unusable) == ([], 1)


def test_the_oldest_are_forgotten(site: Path) -> None:
    path = site.parent / NAME
    old = [f"{number:064x}" for number in range(MOST)]
    path.write_text("".join(f"{line}\n" for line in old))
    path.chmod(0o600)
    started(site)
    lines = path.read_text().split()
    assert lines[:-1] == old[1:]
    assert len(lines) == MOST


def test_without_a_state_directory_nothing_is_kept(site: Path) -> None:
    site.write_text("task: wheel.yaml\n")
    assert started(site).left_out == []
    assert not (site.parent / NAME).exists()
