"""The view's process: a browser that it opens runs after everything else of the machine."""

import asyncio
import os
import subprocess
import sys
import webbrowser
from collections.abc import Callable

import pytest

from linemate.daemon.view import view_process


def test_a_browser_that_is_opened_gives_way_and_the_server_does_not(
    monkeypatch: pytest.MonkeyPatch, nice: Callable[[int], int]
) -> None:
    opened: list[tuple[str, int]] = []

    def pretend(address: str) -> bool:
        code = "import os; print(os.nice(0))"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
        opened.append((address, int(done.stdout)))
        return True

    monkeypatch.setattr(webbrowser, "open", pretend)
    monkeypatch.setattr(os, "nice", nice)
    before = nice(0)
    asyncio.run(asyncio.to_thread(view_process._open, "http://127.0.0.1:1/"))  # type: ignore[arg-type]
    assert opened == [("http://127.0.0.1:1/", 19)]
    assert nice(0) == before
