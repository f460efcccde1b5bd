"""Messages to systemd: ready, stopping, reloading, status line, watchdog. See sd_notify(3).

Invariants:
- Without $NOTIFY_SOCKET nothing is sent. A message never blocks and never raises.
"""

import os
import socket
import time
from dataclasses import dataclass


@dataclass(slots=True)
class Notifier:
    """The service manager, if there is one.

    Attributes:
        address: of its socket, empty if there is none.
        watchdog_s: period of the watchdog [s], None without one.
    """

    address: str = ""
    watchdog_s: float | None = None
    _fed_ns: int = 0

    @classmethod
    def from_environment(cls) -> "Notifier":
        """Return the service manager that the environment names."""
        address = os.environ.get("NOTIFY_SOCKET", "")
        usec = os.environ.get("WATCHDOG_USEC", "")
        pid = os.environ.get("WATCHDOG_PID", str(os.getpid()))
        watched = usec.isdigit() and int(usec) > 0 and pid == str(os.getpid())
        return cls(address, int(usec) / 1e6 if watched else None)

    def send(self, *lines: str) -> bool:
        """Send assignments such as ``READY=1``.

        Returns:
            Whether they were sent.
        """
        if not self.address:
            return False
        # An abstract socket is written with @ and addressed with a zero byte.
        address = "\0" + self.address[1:] if self.address[0] == "@" else self.address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as manager:
                manager.setblocking(False)
                manager.sendto("\n".join(lines).encode(), address)
        except OSError:
            return False
        return True

    def ready(self, status: str) -> None:
        """Send that the ports are open."""
        self.send("READY=1", f"STATUS={status}")

    def reloading(self) -> None:
        """Send that a reload begins; ``ready`` ends it."""
        self.send("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """Send that the daemon ends."""
        self.send("STOPPING=1")

    def alive(self, now_ns: int) -> None:
        """Feed the watchdog after a cycle, three times in its period."""
        if self.watchdog_s is not None and now_ns - self._fed_ns >= self.watchdog_s / 3.0 * 1e9:
            self._fed_ns = now_ns
            self.send("WATCHDOG=1")
