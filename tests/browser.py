"""A headless Chromium, spoken to in its own protocol over two pipes: no web socket, no driver."""

import base64
import json
import os
import select
import shutil
import signal
import subprocess
import time
from pathlib import Path
from typing import Any, Self

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
)
ANSWER_S = 60.0


def path() -> str | None:
    """Return the path of a Chromium, None if there is none."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """One page of one Chromium; the end of the ``with`` block ends it."""

    def __init__(self, folder: Path, width: int = 1280, height: int = 800) -> None:
        self._folder = folder
        self._size = (width, height)
        self._number = 0
        self._session: str | None = None
        self._rest = b""
        self.errors: list[str] = []
        """Errors and warnings of the page."""

    def __enter__(self) -> Self:
        found = path()
        assert found is not None
        read_by_it, self._to = os.pipe()
        self._from, written_by_it = os.pipe()
        home = self._folder / "chromium"
        home.mkdir()

        def numbered() -> None:
            # The protocol's descriptors are 3 and 4; neither of ours may be in the way.
            first, second = os.dup(read_by_it), os.dup(written_by_it)
            high = os.dup2(first, 60), os.dup2(second, 61)
            os.dup2(high[0], 3)
            os.dup2(high[1], 4)

        self._process = subprocess.Popen(
            [found, *FLAGS, f"--user-data-dir={home}",
             f"--window-size={self._size[0]},{self._size[1]}", "about:blank"],
            preexec_fn=numbered,  # noqa: PLW1509 - three calls of the kernel, no lock
            close_fds=False,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "HOME": str(home)},
        )  # fmt: skip
        os.close(read_by_it)
        os.close(written_by_it)
        try:
            targets = self._ask("Target.getTargets")["targetInfos"]
            page = next(one["targetId"] for one in targets if one["type"] == "page")
            joined = self._ask("Target.attachToTarget", targetId=page, flatten=True)
            self._session = joined["sessionId"]
            self._ask("Runtime.enable")
            self._ask("Log.enable")
            self._ask(
                "Emulation.setDeviceMetricsOverride",
                width=self._size[0], height=self._size[1], deviceScaleFactor=1, mobile=False,
            )  # fmt: skip
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def open(self, address: str) -> None:
        """Go to an address."""
        self._ask("Page.navigate", url=address)

    def value(self, expression: str) -> Any:
        """Return the value of an expression on the page."""
        message = self._ask(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in message, message
        return message["result"].get("value")

    def until(self, expression: str, timeout_s: float = 60.0) -> Any:
        """Wait until an expression is true; return its value."""
        end = time.monotonic() + timeout_s
        # Between two pages there is nothing to evaluate on.
        guarded = f"(() => {{ try {{ return {expression} }} catch {{ return null }} }})()"
        while not (value := self.value(guarded)):
            assert time.monotonic() < end, f"never: {expression}; errors of the page: {self.errors}"
            time.sleep(0.05)
        return value

    def picture(self, file: Path) -> bytes:
        """Save what is seen, as PNG."""
        data = base64.b64decode(self._ask("Page.captureScreenshot", format="png")["data"])
        file.write_bytes(data)
        return data

    def _ask(self, method: str, **params: Any) -> dict[str, Any]:
        self._number += 1
        asked: dict[str, Any] = {"id": self._number, "method": method, "params": params}
        if self._session is not None:
            asked["sessionId"] = self._session
        os.write(self._to, json.dumps(asked).encode() + b"\0")
        end = time.monotonic() + ANSWER_S
        while True:
            message = self._next(end)
            if message.get("id") == self._number:
                assert "error" not in message, message
                result: dict[str, Any] = message["result"]
                return result
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        params = message.get("params", {})
        if message.get("method") == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(params["exceptionDetails"])[:500])
        if message.get("method") == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.errors.append(f"{params['entry']['text']} {params['entry'].get('url', '')}")

    def _next(self, end: float) -> dict[str, Any]:
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._from], [], [], max(0.0, end - time.monotonic()))
            data = os.read(self._from, 1 << 20) if ready else b""
            assert data, "Chromium does not answer"
            self._rest += data
        data, _, self._rest = self._rest.partition(b"\0")
        message: dict[str, Any] = json.loads(data)
        return message

    def _end(self) -> None:
        os.close(self._to)
        os.close(self._from)
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
