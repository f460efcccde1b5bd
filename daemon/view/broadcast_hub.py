"""Server-sent-event hub: the newest of a daemon for every subscriber.

Invariants:
    * A slow client drops its oldest messages, which are counted. The producer never blocks.
    * A message is encoded once, whatever the number of subscribers.
    * All calls come from one event loop.
"""

import asyncio
import json
import math
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

from linemate.daemon.view.frames import Frame

QUEUE_LENGTH: Final = 64  # messages for one subscriber: two seconds
HISTORY: Final = 1000  # frames for a new subscriber: 40 s
MAX_EVENTS: Final = 100  # lines of the log for a new subscriber
MAX_SUBSCRIBERS: Final = 8


class FullError(Exception):
    """There are MAX_SUBSCRIBERS already."""


class Subscriber:
    """The queue of one page.

    Attributes:
        dropped: Messages that the page did not take in time.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._queue: deque[bytes] = deque()
        self._filled = asyncio.Event()

    def push(self, message: bytes) -> None:
        """Append a message; the oldest one is dropped from a full queue."""
        if len(self._queue) >= QUEUE_LENGTH:
            self._queue.popleft()
            self.dropped += 1
        self._queue.append(message)
        self._filled.set()

    async def drain(self) -> bytes:
        """Return all messages, as soon as there is one."""
        await self._filled.wait()
        self._filled.clear()
        messages = b"".join(self._queue)
        self._queue.clear()
        return messages


class BroadcastHub:
    """The newest of a daemon, and its subscribers.

    Attributes:
        frames: Number of all frames so far.
    """

    def __init__(self) -> None:
        self.frames = 0
        self._dropped = 0
        self._subscribers: set[Subscriber] = set()
        self._history: deque[bytes] = deque(maxlen=HISTORY)
        self._events: deque[bytes] = deque(maxlen=MAX_EVENTS)
        self._newest: dict[str, bytes] = {}
        self._event_number = 0

    @contextmanager
    def subscribe(self) -> Iterator[Subscriber]:
        """Yield a new subscriber; everything that is known is in its queue already.

        Raises:
            FullError: There are too many.
        """
        if len(self._subscribers) >= MAX_SUBSCRIBERS:
            raise FullError
        subscriber = Subscriber()
        subscriber.push(self._known())
        self._subscribers.add(subscriber)
        try:
            yield subscriber
        finally:
            self._subscribers.discard(subscriber)
            self._dropped += subscriber.dropped

    def push_frame(self, frame: Frame) -> None:
        """Send a frame and keep it for new subscribers."""
        data = _encode(frame)
        self.frames += 1
        self._history.append(data)
        self._send(encode_event("frame", data))

    def push_events(self, newest: object) -> None:
        """Send those of a telemetry's last events that were not sent yet."""
        for number, stamp_ns, text in newest if isinstance(newest, (list, tuple)) else ():
            if number > self._event_number:
                missed = number - self._event_number - 1 if self._event_number else 0
                self._event_number = number
                data = _encode({"t": round(stamp_ns * 1e-9, 3), "text": text, "missed": missed})
                self._events.append(data)
                self._send(encode_event("happened", data))

    def restart(self) -> None:
        """Forget the frames of a daemon that another one has replaced."""
        self._history.clear()
        self._event_number = 0

    def publish(self, name: str, data: Mapping[str, Any]) -> None:
        """Send something of which only the newest counts: ``scene``, ``status`` or ``link``."""
        message = encode_event(name, _encode(data))
        self._newest[name] = message
        self._send(message)

    @property
    def subscribers(self) -> int:
        """Number of subscribers."""
        return len(self._subscribers)

    @property
    def dropped(self) -> int:
        """Messages that subscribers did not take, those of former ones included."""
        return self._dropped + sum(subscriber.dropped for subscriber in self._subscribers)

    def _send(self, message: bytes) -> None:
        for subscriber in self._subscribers:
            subscriber.push(message)

    def _known(self) -> bytes:
        parts = [self._newest[name] for name in ("scene", "link", "status") if name in self._newest]
        parts.append(encode_event("history", b"[" + b",".join(self._history) + b"]"))
        parts += [encode_event("happened", data) for data in self._events]
        return b"".join(parts)


def encode_event(name: str, data: bytes) -> bytes:
    """Return a server-sent event; ``data`` has no line breaks."""
    return b"event: %b\ndata: %b\n\n" % (name.encode(), data)


def _encode(data: Mapping[str, Any]) -> bytes:
    try:
        return json.dumps(data, separators=(",", ":"), allow_nan=False).encode()
    except (TypeError, ValueError):
        return json.dumps(_json_value(data), separators=(",", ":")).encode()


def _json_value(value: Any) -> Any:
    """Return a value with null for what JSON does not have: NaN, infinity, bytes."""
    if isinstance(value, Mapping):
        return {str(name): _json_value(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_json_value(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if isinstance(value, (str, int, type(None))) else None
