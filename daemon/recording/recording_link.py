"""The daemon's end of the process that writes recordings.

Law of this file: nothing here waits, but ``close``. What the kernel has no room for stays with
the caller; that the process is gone is a sentence, never an exception.
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

WRITER: Final = "linemate.daemon.recording.recording_writer"
BUFFER: Final = 1_048_576
ANSWER: Final = 65_536


class WriterLink:
    """One process that writes, and the socket to it.

    Attributes:
        lost: why the process is gone, empty while it is there.
    """

    def __init__(self) -> None:
        """Start the process.

        Raises:
            OSError: it cannot be started.
        """
        self.lost = ""
        self._rest = b""
        self._unpacker = msgpack.Unpacker()
        self._packer = msgpack.Packer()
        ours, theirs = socket.socketpair()
        with theirs:
            ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
            command = [sys.executable, "-m", WRITER, str(theirs.fileno())]
            # Wherever the daemon was found, by whatever means, the writer is found as well.
            found = os.pathsep.join(path for path in sys.path if path)
            try:
                # Not our standard input; its complaints go where ours go.
                self._process = Spawned(
                    command, {**os.environ, "PYTHONPATH": found}, theirs.fileno()
                )
            except OSError:
                ours.close()
                raise
        ours.setblocking(False)
        self._socket = ours

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def send(self, message: Any) -> bool:
        """Send a message, if the one before is out.

        Returns:
            Whether it was taken; False if it was not and never will be by itself.
        """
        if not self.flush():
            return False
        self._rest = self._packer.pack(message)
        self.flush()
        return True

    def flush(self) -> bool:
        """Hand on what is left of the last message; True if nothing is."""
        try:
            while self._rest:
                self._rest = self._rest[self._socket.send(self._rest) :]
        except BlockingIOError:
            return False
        except OSError as error:
            self._lose(error)
            return False
        return True

    def hear(self) -> list[dict[str, Any]]:
        """Return what it has told since, oldest first."""
        try:
            while data := self._socket.recv(ANSWER):
                self._unpacker.feed(data)
            self._lose(None)
        except BlockingIOError:
            pass
        except OSError as error:
            self._lose(error)
        return list(self._unpacker)

    def close(self, patience_s: float, last: Any = None) -> list[dict[str, Any]]:
        """Let it finish, and end it.

        Args:
            patience_s: until it is killed [s].
            last: a message that it gets before.

        Returns:
            What it told at the end.
        """
        end = time.monotonic() + patience_s
        told = self.hear()
        with contextlib.suppress(OSError):
            self._socket.settimeout(patience_s)
            self._socket.sendall(self._rest + (b"" if last is None else msgpack.packb(last)))
            self._socket.shutdown(socket.SHUT_WR)
        try:
            self._process.wait(max(0.0, end - time.monotonic()))
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._socket.setblocking(False)
        told += self.hear()
        self._socket.close()
        return told

    def _lose(self, error: OSError | None) -> None:
        """Note that the process is gone, and how it ended as far as that is known yet."""
        if self.lost:
            return
        code = self._process.poll()
        how = "" if code is None else f" (exit {code})" if code >= 0 else f" (signal {-code})"
        why = f": {os.strerror(error.errno)}" if error is not None and error.errno else ""
        self.lost = f"the process that writes recordings has ended{how}{why}"
        self._rest = b""
