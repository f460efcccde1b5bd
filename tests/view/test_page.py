"""The page in a real browser: what it shows of a daemon and of recordings, at which sizes."""

import time
import urllib.request
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import browser
import pytest
from browser import Browser
from rerun import GOLDEN, Rerun, rerun, viewing

pytestmark = pytest.mark.skipif(
    browser.path() is None, reason="no Chromium here (Debian: apt-get install chromium)"
)
SOCKET = "command.sock"
ROOT = "document.documentElement.dataset"
TEXT = "document.getElementById('{}').textContent"
CLASS = TEXT.format("class-name")
BANNER = "document.getElementById('banner')"
KINDS = "['state', 'banner'].map((id) => document.getElementById(id).dataset.kind)"


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("browser")) as one:
        yield one


@pytest.fixture
def chromium(opened: Browser) -> Iterator[Browser]:
    yield opened
    assert opened.errors == []


@contextmanager
def shown(chromium: Browser, *words: str | Path) -> Iterator[str]:
    """A view's address; the page is left before its view ends, or it would complain."""
    with viewing(*words) as address:
        yield address
        chromium.open("about:blank")


def colours(png: bytes) -> int:
    """Return how much a picture shows: bytes of its rows, compressed."""
    data, at = b"", 8
    while at < len(png):
        size = int.from_bytes(png[at : at + 4], "big")
        if png[at + 4 : at + 8] == b"IDAT":
            data += png[at + 8 : at + 8 + size]
        at += size + 12
    return len(zlib.compress(zlib.decompress(data)))


def test_a_daemon_is_shown_as_it_goes(chromium: Browser, tmp_path: Path) -> None:
    with rerun(tmp_path, Rerun(2.0)), shown(chromium, "--socket", tmp_path / SOCKET) as address:
        chromium.open(address)
        chromium.until(f"Number({ROOT}.frames) > 5 && {ROOT}.tcp")
        assert chromium.value(TEXT.format("health-name")) == "✓ healthy"
        chromium.until(f"{CLASS} === 'running'")
        before = chromium.value(f"{ROOT}.tcp")
        chromium.until(f"{ROOT}.tcp !== '{before}' && {TEXT.format('state-name')} === 'track'")
        chromium.until(f"{CLASS} === 'stopping' || {CLASS} === 'stopping?'")
        chromium.until(f"{TEXT.format('state-name')} === 'contact'")
        chromium.until(f"{CLASS} === 'standing'")
        assert float(chromium.value(TEXT.format("err-gap"))) < 5.0
        rows = chromium.value("[...document.querySelectorAll('#links tr')].length")
        assert rows == 2
        assert colours(chromium.picture(tmp_path / "page.png")) > 30_000


def test_a_page_waits_for_its_first_message_and_shows_a_daemon_that_ends_or_comes_back(
    chromium: Browser, tmp_path: Path
) -> None:
    with shown(chromium, "--socket", tmp_path / SOCKET) as address:
        chromium.open(address)
        chromium.until(f"{BANNER}.textContent.startsWith('Waiting for the daemon')")
        assert chromium.value(KINDS) == ["unknown", ""]
        for _ in range(2):
            with rerun(tmp_path, Rerun(1.0, 4.0)):
                chromium.until(f"{BANNER}.hidden && {TEXT.format('state-name')} === 'track'")
            chromium.until(f"{BANNER}.textContent.startsWith('No daemon')")
            assert chromium.value(KINDS) == ["bad", "bad"]


@pytest.mark.parametrize("last", [{"phase": "done"}, {"state": "idle", "phase": "wait"}, {}])
def test_a_daemon_that_ends_after_its_task_is_no_alarm(
    chromium: Browser, tmp_path: Path, last: dict[str, str]
) -> None:
    class Finishing(Rerun):
        frames = 0

        def telemetry(self) -> dict[str, Any]:
            self.frames += 1
            return super().telemetry() | {"state": "retreat"} | (last if self.frames > 25 else {})

    with shown(chromium, "--socket", tmp_path / SOCKET) as address:
        chromium.open(address)
        rerunning = Finishing(0.1, 4.0)
        if not last:  # The last frames did not arrive, but a status did.
            rerunning.status |= {"state": "idle", "because": "retreated"}
        with rerun(tmp_path, rerunning):
            name, value = next(iter(last.items()), ("state", "retreat"))
            chromium.until(f"{TEXT.format({'state': 'state-name'}.get(name, name))} === '{value}'")
            chromium.until(f"{TEXT.format('health-name')} === '✓ healthy'")
        chromium.until(f"{TEXT.format('state-name')} === 'ended'")
        assert chromium.value(KINDS) == ["unknown", ""]
        assert "Its task was done" in chromium.value(f"{BANNER}.textContent")


def test_a_fault_is_shown_by_more_than_its_colour(chromium: Browser, tmp_path: Path) -> None:
    rerunning = Rerun(0.0, 4.0)
    rerunning.status |= {"health": "degraded", "complaints": ["link camera is down: gone"]}
    rerunning.status["links"] = {"camera": {**rerunning.status["links"]["camera"], "up": False}}
    with rerun(tmp_path, rerunning), shown(chromium, "--socket", tmp_path / SOCKET) as address:
        chromium.open(address)
        chromium.until(f"{TEXT.format('health-name')} === '▲ degraded'")
        chromium.until(f"{TEXT.format('health-note')} === 'link camera is down: gone'")
        assert "✕ down" in chromium.value(TEXT.format("links"))


def test_a_recording_is_played_paused_and_sought(chromium: Browser, tmp_path: Path) -> None:
    with shown(chromium, GOLDEN) as address:
        chromium.open(address)
        chromium.until(f"{ROOT}.tcp")
        chromium.value("document.getElementById('speed').value = '4';"
                       "document.getElementById('speed').onchange()")  # fmt: skip
        before = chromium.value(f"{ROOT}.tcp")
        chromium.until(f"{CLASS} === 'running'")
        chromium.until(f"{ROOT}.tcp !== '{before}'")
        chromium.until(f"{CLASS} === 'stopping'")
        chromium.value("document.getElementById('play').click()")
        chromium.until(f"{TEXT.format('play')} === '▶ play'")
        seek = "document.getElementById('seek')"
        stands = chromium.value(TEXT.format("time"))
        assert chromium.value(TEXT.format("time")) == stands
        chromium.value(f"{seek}.value = '0'; {seek}.oninput()")
        chromium.until(f"{TEXT.format('time')}.startsWith('0.00')")
        # Horizons are computed again while the page is open.
        chromium.value(f"{seek}.value = '0.5'; {seek}.oninput()")
        chromium.until(f"Number({ROOT}.foreseen) > 2", 120.0)
        assert colours(chromium.picture(tmp_path / "page.png")) > 30_000


def test_what_happens_again_and_again_is_one_line(chromium: Browser, tmp_path: Path) -> None:
    class Refusing(Rerun):
        def telemetry(self) -> dict[str, Any]:
            whole = super().telemetry()
            texts = ("state: idle", "refused", "refused", "refused", "link robot is up")
            n = min(len(texts), 1 + int(4.0 * (time.monotonic() - self._began)))
            return whole | {"happened": [[i + 1, whole["stamp_ns"], texts[i]] for i in range(n)]}

    with rerun(tmp_path, Refusing()), shown(chromium, "--socket", tmp_path / SOCKET) as address:
        chromium.open(address)
        lines = "[...document.querySelectorAll('#events span')].map((at) => at.textContent)"
        chromium.until(f"{lines}[0] === 'link robot is up'")
        assert chromium.value(lines) == ["link robot is up", "refused ×3", "state: idle"]


def test_several_recordings_are_compared_and_chosen_from(chromium: Browser, tmp_path: Path) -> None:
    other = tmp_path / "another-car-seed7-12ms.mcap"
    other.write_bytes(GOLDEN.read_bytes())
    with shown(chromium, GOLDEN, other) as address:
        chromium.open(address + "?paused&t=5")
        chromium.until(f"{ROOT}.tcp && !document.getElementById('compare').hidden")
        names = "[...document.querySelectorAll('#compare-rows th')].map((at) => at.textContent)"
        assert chromium.value(names) == ["wheel", "anot…ed7-12ms"]
        chromium.value("document.querySelectorAll('#compare-rows th')[1].click()")
        chromium.until(f"{TEXT.format('source')} === 'recording another-car-seed7-12ms.mcap'")
        chosen = "document.querySelector('#compare-rows [aria-current]').rowIndex"
        assert chromium.value(chosen) == 2
        aside = "document.querySelector('aside')"
        assert chromium.value(f"{aside}.scrollHeight <= {aside}.clientHeight + 1")


def test_dark_and_light_differ_and_are_kept(chromium: Browser) -> None:
    with shown(chromium, GOLDEN) as address:
        chromium.open(address + "?paused&t=1")
        first = chromium.until(f"{ROOT}.tcp && {ROOT}.theme")
        colour = "getComputedStyle(document.body).backgroundColor"
        back = chromium.value(colour)
        chromium.value("document.getElementById('theme').click()")
        assert chromium.value(f"{ROOT}.theme") != first
        assert chromium.value(colour) != back
        chromium.open(address + "?paused&t=1")
        chromium.until(f"{ROOT}.tcp && {ROOT}.theme && {ROOT}.theme !== '{first}'")


def test_everything_has_its_place_on_a_small_screen(chromium: Browser) -> None:
    with shown(chromium, GOLDEN) as address:
        chromium.open(address + "?paused&t=9")
        chromium.until(f"{ROOT}.tcp")
        fits = "document.documentElement.scrollWidth <= 1280 && document.body.scrollHeight <= 800"
        assert chromium.value(fits)
        overflowing = (
            "[...document.querySelectorAll('header .big, header h1, #margin-note')]"
            ".filter((at) => at.scrollWidth > at.clientWidth + 1).map((at) => at.id)"
        )
        assert chromium.value(overflowing) == []


CUT = """[...document.querySelectorAll('table, aside section, header > *, .tools select')]
    .concat(document.querySelector('aside'))
    .filter((at) => at.scrollWidth > at.clientWidth + 1 || at.scrollHeight > at.clientHeight + 1)
    .map((at) => at.id || at.className || at.tagName)"""


def test_no_table_is_cut_off_on_a_small_screen(chromium: Browser, tmp_path: Path) -> None:
    other = tmp_path / "another-car-with-a-long-name-seed7-12ms.mcap"
    other.write_bytes(GOLDEN.read_bytes())
    with shown(chromium, GOLDEN, other) as address:
        chromium.open(address + "?paused&t=9")
        chromium.until(f"{ROOT}.tcp && !document.getElementById('summary').hidden")
        assert chromium.value(CUT) == []


def test_a_narrow_window_shows_everything_in_one_column(tmp_path: Path) -> None:
    with Browser(tmp_path, 700, 900) as narrow, viewing(GOLDEN) as address:
        narrow.open(address + "?paused&t=9")
        narrow.until(f"{ROOT}.tcp")
        assert narrow.value("document.documentElement.scrollWidth") <= 700
        assert narrow.value(CUT) == []
        sizes = (
            "[...document.querySelectorAll('canvas')].map((at) => at.clientWidth * at.clientHeight)"
        )
        assert min(narrow.value(sizes)) > 50_000
        narrow.open("about:blank")
        assert narrow.errors == []


def test_the_page_asks_only_the_view_itself(chromium: Browser) -> None:
    with shown(chromium, GOLDEN) as address:
        chromium.open(address)
        chromium.until(f"{ROOT}.tcp")
        asked = chromium.value("performance.getEntriesByType('resource').map((one) => one.name)")
        assert len(asked) > 5
        assert all(name.startswith(address) for name in asked), asked
        with urllib.request.urlopen(address, timeout=10.0) as page:
            assert "default-src 'self'" in page.headers["Content-Security-Policy"]
