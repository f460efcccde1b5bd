"""Where what comes in meets those who look on: the newest for everybody, and nobody waits.

Law of this file: no I/O; one event loop's. Every onlooker has a bounded queue; one that does not
take what it is sent loses the oldest of it, counted, and slows down neither the others nor,
least of all, the daemon. Messages are made into bytes once, whoever is to have them.
"""

import asyncio
import json
import math
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

from linemate.daemon.view.frames import Frame

WAITING: Final = 64
"""Messages that may wait for one onlooker: two seconds."""

REMEMBERED: Final = 1000  # frames for one who comes later: 40 s
HAPPENINGS: Final = 100
ONLOOKERS: Final = 8


class FullError(Exception):
    """As many look on as may."""


class Onlooker:
    """One page: what waits for it.

    Attributes:
        dropped: messages that it did not take in time.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._waiting: deque[bytes] = deque()
        self._some = asyncio.Event()

    def give(self, message: bytes) -> None:
        """Let a message wait for it; the oldest goes if there is no room."""
        if len(self._waiting) >= WAITING:
            self._waiting.popleft()
            self.dropped += 1
        self._waiting.append(message)
        self._some.set()

    async def take(self) -> bytes:
        """Return everything that waits, once something does."""
        await self._some.wait()
        self._some.clear()
        taken = b"".join(self._waiting)
        self._waiting.clear()
        return taken


class Board:
    """What is known of a daemon, and who looks on.

    Attributes:
        frames: that came, in all.
    """

    def __init__(self) -> None:
        self.frames = 0
        self._dropped = 0
        self._onlookers: set[Onlooker] = set()
        self._history: deque[bytes] = deque(maxlen=REMEMBERED)
        self._happened: deque[bytes] = deque(maxlen=HAPPENINGS)
        self._newest: dict[str, bytes] = {}
        self._number = 0

    @contextmanager
    def looking(self) -> Iterator[Onlooker]:
        """Look on; all that is known waits already.

        Raises:
            FullError: too many do.
        """
        if len(self._onlookers) >= ONLOOKERS:
            raise FullError
        onlooker = Onlooker()
        onlooker.give(self._known())
        self._onlookers.add(onlooker)
        try:
            yield onlooker
        finally:
            self._onlookers.discard(onlooker)
            self._dropped += onlooker.dropped

    def frame(self, frame: Frame) -> None:
        """Show a frame."""
        data = _bytes(frame)
        self.frames += 1
        self._history.append(data)
        self._give(event("frame", data))

    def happened(self, told: object) -> None:
        """Show what happened since, of a telemetry's last happenings; each one once."""
        for one in told if isinstance(told, (list, tuple)) else ():
            number, stamp_ns, text = one
            if number > self._number:
                missed = number - self._number - 1 if self._number else 0
                self._number = number
                data = _bytes({"t": round(stamp_ns * 1e-9, 3), "text": text, "missed": missed})
                self._happened.append(data)
                self._give(event("happened", data))

    def anew(self) -> None:
        """Forget a daemon that another has followed."""
        self._history.clear()
        self._number = 0

    def tell(self, name: str, told: Mapping[str, Any]) -> None:
        """Show something of which only the newest counts: ``scene``, ``status`` or ``link``."""
        message = event(name, _bytes(told))
        self._newest[name] = message
        self._give(message)

    @property
    def onlookers(self) -> int:
        """How many look on."""
        return len(self._onlookers)

    @property
    def dropped(self) -> int:
        """Messages that onlookers did not take, those of onlookers who have gone among them."""
        return self._dropped + sum(onlooker.dropped for onlooker in self._onlookers)

    def _give(self, message: bytes) -> None:
        for onlooker in self._onlookers:
            onlooker.give(message)

    def _known(self) -> bytes:
        parts = [self._newest[name] for name in ("scene", "link", "status") if name in self._newest]
        parts.append(event("history", b"[" + b",".join(self._history) + b"]"))
        parts += [event("happened", data) for data in self._happened]
        return b"".join(parts)


def event(name: str, data: bytes) -> bytes:
    """Return a server-sent event; ``data`` has no line breaks."""
    return b"event: %b\ndata: %b\n\n" % (name.encode(), data)


def _bytes(told: Mapping[str, Any]) -> bytes:
    try:
        return json.dumps(told, separators=(",", ":"), allow_nan=False).encode()
    except (TypeError, ValueError):
        return json.dumps(_numbers(told), separators=(",", ":")).encode()


def _numbers(told: Any) -> Any:
    """Leave out what JSON has no word for: numbers that are none, and bytes."""
    if isinstance(told, Mapping):
        return {str(name): _numbers(value) for name, value in told.items()}
    if isinstance(told, (list, tuple)):
        return [_numbers(value) for value in told]
    if isinstance(told, float):
        return told if math.isfinite(told) else None
    return told if isinstance(told, (str, int, type(None))) else None
