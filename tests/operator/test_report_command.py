"""``linemate report``: the page of a day from its files."""

import json
from pathlib import Path

import pytest

from linemate.daemon.operator.main import main
from linemate.daemon.operator.production import report_command
from linemate.daemon.production import record as records
from linemate.daemon.production.object_queue import AnnouncedPart


def line(part: str) -> str:
    announced = AnnouncedPart(part, "sedan", 0.0)
    return json.dumps(records.missed(announced, "2026-11-23T08:00:00Z", "left", "late"))


def test_a_page_is_made_and_damaged_lines_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = "\n".join([line("P1"), '{"half', "[1]", '{"part": "P2"}', line("P3")])
    (tmp_path / "parts-2026-11-23.jsonl").write_text(text)
    out = tmp_path / "page.html"
    words = ["report", "2026-11-23", "--records", str(tmp_path), "--out", str(out)]
    assert main(words) == 0
    assert capsys.readouterr().out == f"{out}: 2 parts, 3 damaged lines left out\n"
    assert "P3" in out.read_text()


def test_a_day_without_records_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", "2026-11-24", "--records", str(tmp_path)]) == 1
    assert "parts-2026-11-24.jsonl" in capsys.readouterr().err


def test_a_day_is_a_date() -> None:
    with pytest.raises(SystemExit) as ended:
        main(["report", "yesterday"])
    assert ended.value.code == 2
    assert report_command.read([]) == ([], 0)
