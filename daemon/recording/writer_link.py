"""The daemon's end of the socket to the writer process.

Invariants:
- Only ``close`` waits. What the socket does not take stays with the caller.
- The end of the process is a text in ``lost``, never an exception.
"""

import contextlib
import os
import socket
import subprocess
import sys
import time
from typing import Any, Final

import msgpack

from linemate.daemon.recording.spawn import Spawned

WRITER: Final = "linemate.daemon.recording.writer_process"
SEND_BYTES: Final = 1_048_576
RECEIVE_BYTES: Final = 65_536
REAP_LOOKS: Final = 100  # at a closed socket, after which the process is given up without a code


class WriterLink:
    """One writer process and the socket to it.

    Attributes:
        lost: why the process has ended, empty while it runs.
    """

    def __init__(self) -> None:
        """Start the process.

        Raises:
            OSError: it cannot be started.
        """
        self.lost = ""
        self._closed = 0
        self._rest = b""
        self._unpacker = msgpack.Unpacker()
        self._packer = msgpack.Packer()
        ours, theirs = socket.socketpair()
        with theirs:
            ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
            command = [sys.executable, "-m", WRITER, str(theirs.fileno())]
            # The writer imports linemate from where the daemon has it.
            search_path = os.pathsep.join(path for path in sys.path if path)
            try:
                self._process = Spawned(
                    command, {**os.environ, "PYTHONPATH": search_path}, theirs.fileno()
                )
            except OSError:
                ours.close()
                raise
        ours.setblocking(False)
        self._socket = ours

    @property
    def pid(self) -> int:
        """Process id of the writer."""
        return self._process.pid

    def send(self, message: Any) -> bool:
        """Send a message if the one before is out; return False if it was not taken."""
        if not self.flush():
            return False
        self._rest = self._packer.pack(message)
        self.flush()
        return True

    def flush(self) -> bool:
        """Send the rest of the last message; return True if nothing is left."""
        try:
            while self._rest:
                self._rest = self._rest[self._socket.send(self._rest) :]
        except BlockingIOError:
            return False
        except OSError as error:
            self._mark_lost(error)
            return False
        return True

    def receive(self) -> list[dict[str, Any]]:
        """Return the reports that have come, oldest first."""
        try:
            while data := self._socket.recv(RECEIVE_BYTES):
                self._unpacker.feed(data)
            self._mark_lost(None)
        except BlockingIOError:
            pass
        except OSError as error:
            self._mark_lost(error)
        return list(self._unpacker)

    def close(self, timeout_s: float, last: Any = None) -> list[dict[str, Any]]:
        """End the process after a last message, and return its last reports.

        Args:
            timeout_s: it is killed after this [s].
        """
        end_s = time.monotonic() + timeout_s
        reports = self.receive()
        with contextlib.suppress(OSError):
            self._socket.settimeout(timeout_s)
            self._socket.sendall(self._rest + (b"" if last is None else msgpack.packb(last)))
            self._socket.shutdown(socket.SHUT_WR)
        try:
            self._process.wait(max(0.0, end_s - time.monotonic()))
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._socket.setblocking(False)
        reports += self.receive()
        self._socket.close()
        return reports

    def _mark_lost(self, error: OSError | None) -> None:
        if self.lost:
            return
        code = self._process.poll()
        self._closed += 1
        if code is None and self._closed < REAP_LOOKS:
            return  # its socket closes a moment before it has an exit code
        how = "" if code is None else f" (exit {code})" if code >= 0 else f" (signal {-code})"
        why = f": {os.strerror(error.errno)}" if error is not None and error.errno else ""
        self.lost = f"the process that writes recordings has ended{how}{why}"
        self._rest = b""
