"""The daemon as a process of its own: started with a file, asked over its socket, ended."""

import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

from linemate.daemon.transport.client import Client

LINEMATED = (sys.executable, "-m", "linemate.daemon.service.main")
LINEMATE = (sys.executable, "-m", "linemate.daemon.operator.main")
START_S = 60.0
TIMEOUT_S = 4.5  # a request may lie 5 s ahead at most


class DaemonProcess:
    """A running ``linemated``; the end of the ``with`` block ends it.

    Attributes:
        listening: its own word of its ports.
    """

    def __init__(self, folder: Path, text: str) -> None:
        """Write its configuration.

        Args:
            text: of the configuration, without ``command``, which is added.
        """
        self.folder = folder
        self.log = folder / "linemated.log"
        self.config = folder / "linemated.yaml"
        self.config.write_text(text, encoding="utf-8")
        self.listening: dict[str, Any] = {}
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        reading, writing = os.pipe()
        with self.log.open("wb") as log:
            self._process = subprocess.Popen(
                [*LINEMATED, "--config", str(self.config), "--ready-fd", str(writing)],
                pass_fds=[writing],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        os.close(writing)
        with os.fdopen(reading, "rb") as pipe:
            ready, _, _ = select.select([pipe], [], [], START_S)
            line = pipe.readline() if ready else b""
        if not line:
            self._kill()
            raise AssertionError(f"the daemon did not start:\n{self.log_text()}")
        self.listening = json.loads(line)
        return self

    def __exit__(self, *_: object) -> None:
        self._kill()

    @property
    def process(self) -> subprocess.Popen[bytes]:
        """The process itself."""
        assert self._process is not None
        return self._process

    def robot(self) -> tuple[str, int]:
        """Where it takes telegrams."""
        host, port = self.listening["robot"]
        return host, port

    def log_text(self) -> str:
        """What it logged so far."""
        return self.log.read_text(encoding="utf-8", errors="replace")

    def status(self) -> dict[str, Any]:
        """Its status, over its socket."""
        with Client.local(self.listening["command"]["socket"]) as client:
            return client.call("status", None, TIMEOUT_S)

    def status_by_tool(self) -> tuple[int, dict[str, Any]]:
        """Exit code and output of ``linemate status --json``."""
        path = self.listening["command"]["socket"]
        done = subprocess.run(
            [*LINEMATE, "status", "--json", "--socket", path, "--timeout", str(TIMEOUT_S)],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.stdout, done.stderr
        return done.returncode, json.loads(done.stdout)

    def status_once(
        self, condition: Callable[[dict[str, Any]], bool], timeout_s: float = 20.0
    ) -> dict[str, Any]:
        """The first status that meets a condition; fails if none does within the bound."""
        end = time.monotonic() + timeout_s
        while not condition(status := self.status()):
            assert time.monotonic() < end, f"it did not happen in time: {status}"
            time.sleep(0.01)
        return status

    def end(self) -> tuple[int, float]:
        """Send SIGTERM; the exit code, and how long the end took [s]."""
        began = time.monotonic()
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(20.0), time.monotonic() - began

    def _kill(self) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(10.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
