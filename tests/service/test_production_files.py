"""Record files: whole lines, one pair a day, bounded in number and size."""

import asyncio
import csv
import json
from pathlib import Path
from typing import Any

import pytest

from linemate.daemon.production import record as records
from linemate.daemon.production.object_queue import AnnouncedPart
from linemate.daemon.service.production import record_files
from linemate.daemon.service.production.record_files import MOST_WAITING, RecordFiles, write


def record(day: str = "2026-11-23", part: str = "P1", reason: str = "late") -> dict[str, Any]:
    announced = AnnouncedPart(part, "sedan", 0.0)
    return records.missed(announced, f"{day}T08:00:00Z", "left", reason)


async def written(files: RecordFiles, count: int) -> None:
    """Wait until so many records are written or failed."""
    for _ in range(5000):
        if files.written + files.failed >= count:
            return
        await asyncio.sleep(0.001)
    raise AssertionError("the records were never written")


def test_a_record_is_a_line_of_json_and_a_row_of_csv(tmp_path: Path) -> None:
    for part in ("P1", "P2"):
        write(tmp_path, record(part=part, reason='a "reason", with\nall'), 3)
    lines = (tmp_path / "parts-2026-11-23.jsonl").read_text().splitlines()
    assert [json.loads(line)["part"] for line in lines] == ["P1", "P2"]
    with (tmp_path / "parts-2026-11-23.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["part"] for row in rows] == ["P1", "P2"]
    assert rows[0]["reason"] == 'a "reason", with\nall'
    assert rows[0]["ok"] == "False"


def test_days_beyond_the_limit_are_removed(tmp_path: Path) -> None:
    for day in range(1, 8):
        write(tmp_path, record(f"2026-11-{day:02d}"), 3)
    kept = sorted(path.name for path in tmp_path.iterdir())
    assert kept == [
        f"parts-2026-11-{day:02d}.{suffix}" for day in (5, 6, 7) for suffix in ("csv", "jsonl")
    ]


def test_a_day_that_is_full_takes_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(record_files, "MOST_BYTES", 1500)
    write(tmp_path, record(part="P1"), 3)
    with pytest.raises(OSError, match="has grown to 1500 bytes"):
        write(tmp_path, record(part="P2", reason="x" * 1500), 3)
    assert (tmp_path / "parts-2026-11-23.jsonl").stat().st_size <= 1500


def test_records_are_written_one_after_the_other_outside_the_loop(tmp_path: Path) -> None:
    async def add() -> RecordFiles:
        files = RecordFiles(tmp_path, 3)
        for number in range(20):
            files.add(record(part=f"P{number}"))
        await written(files, 20)
        return files

    files = asyncio.run(add())
    assert (files.written, files.failed, files.dropped) == (20, 0, 0)
    lines = (tmp_path / "parts-2026-11-23.jsonl").read_text().splitlines()
    assert [json.loads(line)["part"] for line in lines] == [f"P{n}" for n in range(20)]


def test_a_disk_that_is_slow_drops_records_and_counts_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def add() -> RecordFiles:
        gate = asyncio.Event()
        files = RecordFiles(tmp_path, 3)

        async def never() -> None:
            await gate.wait()

        loop = asyncio.get_running_loop()
        monkeypatch.setattr(
            loop, "run_in_executor", lambda *_arguments: asyncio.ensure_future(never())
        )
        for number in range(MOST_WAITING + 11):
            files.add(record(part=f"P{number}"))
        gate.set()
        return files

    assert asyncio.run(add()).dropped == 10


def test_a_directory_that_is_gone_fails_the_record_and_not_the_daemon(tmp_path: Path) -> None:
    async def add() -> RecordFiles:
        files = RecordFiles(tmp_path / "gone", 3)
        files.add(record())
        await written(files, 1)
        return files

    assert asyncio.run(add()).written == 0
