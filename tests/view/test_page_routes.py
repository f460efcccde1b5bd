"""What is at which path: recordings as they are read, portions of them, and nothing else."""

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from linemate.daemon.recording.format import UnreadableRecordingError
from linemate.daemon.transport.http_server import NoPageError, Page
from linemate.daemon.view.page_routes import RecordingRoutes

GOLDEN = Path(__file__).parents[1] / "system" / "golden" / "wheel.mcap"


def ask_json(routes: RecordingRoutes, path: str, **query: str) -> Any:
    page = routes.ask(path, query)
    assert isinstance(page, Page)
    assert page.kind == "application/json"
    return json.loads(page.body)


@pytest.fixture(scope="module")
def read() -> RecordingRoutes:
    routes = RecordingRoutes([GOLDEN])
    asyncio.run(routes.read())
    return routes


def test_the_share_that_has_been_read_is_shown() -> None:
    routes = RecordingRoutes([GOLDEN, GOLDEN])
    shares = []

    async def main() -> None:
        reading = asyncio.ensure_future(routes.read())
        while not reading.done():
            mode = ask_json(routes, "/mode")
            if mode["mode"] == "reading":
                shares.append(mode["share"])
            await asyncio.sleep(0.005)
        await reading

    asyncio.run(main())
    assert shares == sorted(shares)
    assert 0.0 <= shares[0] < shares[-1] <= 1.0
    assert [run["name"] for run in ask_json(routes, "/mode")["runs"]] == ["wheel.mcap"] * 2


def test_what_is_no_recording_ends_the_reading(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(b"x")
    with pytest.raises(UnreadableRecordingError):
        asyncio.run(RecordingRoutes([GOLDEN, tmp_path / "x.mcap"]).read())


def test_a_recording_is_served_whole_and_in_portions(read: RecordingRoutes) -> None:
    whole = ask_json(read, "/run", i="0")
    assert whole["name"] == "wheel.mcap"
    frames = ask_json(read, "/frames", i="0", **{"from": "10", "to": "13"})
    assert [frame["t"] for frame in frames] == whole["times"][10:13]
    assert ask_json(read, "/frames", i="0", **{"from": "13", "to": "10"}) == []
    assert ask_json(read, "/progress", i="0") == {"k": -1, "done": False, "inexact": 0, "count": 0}


@pytest.mark.parametrize(
    ("path", "query"),
    [
        ("/run", {"i": "1"}),
        ("/run", {"i": "-1"}),
        ("/run", {"i": "0x0"}),
        ("/frames", {"from": "1" * 20}),
        ("/frames", {"to": "٣"}),
        ("/none", {}),
        ("/../page_routes.py", {}),
        ("/__init__.py", {}),
    ],
)
def test_there_is_nothing_else(read: RecordingRoutes, path: str, query: dict[str, str]) -> None:
    with pytest.raises(NoPageError):
        read.ask(path, query)


def test_horizons_are_computed_by_a_process_that_ends_with_its_task() -> None:
    routes = RecordingRoutes([GOLDEN])

    async def main() -> None:
        await routes.read()
        work = asyncio.ensure_future(routes.compute_horizons())
        async with asyncio.timeout(60):
            while ask_json(routes, "/progress")["count"] < 3:
                assert not work.done()
                await asyncio.sleep(0.05)
        work.cancel()
        await asyncio.gather(work, return_exceptions=True)

    asyncio.run(main())
    frames = ask_json(routes, "/frames", i="0", **{"from": "0", "to": "400"})
    assert sum("foreseen" in frame for frame in frames) >= 1
