"""Telemetry and newest samples of a daemon, for programs that publish them.

Invariants:
    * It subscribes and asks at its own rate, and orders nothing. The daemon never waits for it.
    * A daemon that does not answer is asked again later.
    * Callbacks come from two threads, one at a time.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from linemate.daemon.transport.client import Client
from linemate.daemon.view.client_threads import ClientThreads

RATE_HZ: Final = 25.0
TIMEOUT_S: Final = 1.0
OFFSETS: Final = 250  # newest differences of two clocks, of which the smallest counts

Values = Mapping[str, Any]


class WallClock:
    """Offset from a daemon's monotonic stamps to the time since the epoch.

    The fastest of the last OFFSETS messages gives it: each is late by its time on the way.
    """

    def __init__(self) -> None:
        self._offsets: deque[int] = deque(maxlen=OFFSETS)

    def update(self, stamp_ns: int, wall_ns: int) -> None:
        """Note a message of ``stamp_ns`` that came at ``wall_ns``."""
        offset_ns = wall_ns - stamp_ns
        if self._offsets and abs(offset_ns - self._offsets[-1]) > 1_000_000_000:
            self._offsets.clear()  # another daemon, or one of both clocks was set
        self._offsets.append(offset_ns)

    def wall(self, stamp_ns: int) -> int | None:
        """Return the time since the epoch [ns], None before the first message."""
        return stamp_ns + min(self._offsets) if self._offsets else None


@dataclass(slots=True)
class DaemonFeed:
    """Feeds callbacks from one daemon.

    Attributes:
        connect: makes a client of the daemon, for each attempt.
        on_scene: called with the answer to ``scene`` at each new connection.
        on_moment: called with telemetry and its time since the epoch [ns].
        on_sensors: called with the answer to ``sensors`` and the clock.
        is_wanted: whether anyone wants samples; the daemon is not asked for them otherwise.
        on_trouble: called with the reason when the daemon does not answer.
        rate_hz: rate of telemetry and samples.
    """

    connect: Callable[[], Client]
    on_scene: Callable[[Values], None]
    on_moment: Callable[[Values, int], None]
    on_sensors: Callable[[Values, WallClock], None]
    is_wanted: Callable[[], bool] = lambda: True
    on_trouble: Callable[[str], None] = lambda _: None
    rate_hz: float = RATE_HZ
    _clock: WallClock = field(default_factory=WallClock)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _threads: ClientThreads = field(init=False)

    def __post_init__(self) -> None:
        loops = (self._subscribe, self._ask_sensors)
        self._threads = ClientThreads(self.connect, loops, self._report_trouble)

    def start(self) -> None:
        """Start the threads."""
        self._threads.start()

    def end(self) -> None:
        """Ask the threads to end, and wait a moment for them."""
        self._threads.end()

    def _report_trouble(self, reason: str) -> None:
        with self._lock:
            self.on_trouble(reason)

    def _subscribe(self, client: Client) -> None:
        scene = client.call("scene", timeout_s=TIMEOUT_S)
        with self._lock:
            self.on_scene(scene)
        for telemetry in client.telemetry(self.rate_hz):
            stamp_ns = telemetry.get("stamp_ns")
            if isinstance(stamp_ns, int):
                with self._lock:
                    self._clock.update(stamp_ns, time.time_ns())
                    self.on_moment(telemetry, self._clock.wall(stamp_ns) or 0)
            if self._threads.is_ending:
                return

    def _ask_sensors(self, client: Client) -> None:
        while not self._threads.is_ending:
            if self.is_wanted():
                answer = client.call("sensors", timeout_s=TIMEOUT_S)
                with self._lock:
                    self.on_sensors(answer, self._clock)
            self._threads.pause(1.0 / self.rate_hz)
