"""Status of a link: facts that its driver counts.

Invariants:
    Stamps are monotonic nanoseconds.
    A driver writes its status from the event loop alone.
"""

import time
from collections import Counter
from dataclasses import dataclass, field

NOT_OPENED = "not opened"  # reason of a link before the first try


@dataclass(slots=True)
class LinkStatus:
    """The visible state of one link.

    Attributes:
        name: the link's name in status and logs.
        up: the transport is open; samples need not arrive.
        since_ns: monotonic time of the last change of ``up`` [ns].
        last_sample_stamp_ns: arrival of the newest good sample [ns], None before the first.
        reason: why the link is down, or what its device does not answer; else empty.
        counters: events by name; every drop, refusal and reopening is one of them.
    """

    name: str
    up: bool = False
    since_ns: int = field(default_factory=time.monotonic_ns)
    last_sample_stamp_ns: int | None = None
    reason: str = NOT_OPENED
    counters: Counter[str] = field(default_factory=Counter)

    def mark_up(self) -> None:
        """Note that the transport is open now."""
        self.counters["opened"] += 1
        self._change(up=True, reason="")

    def mark_down(self, reason: str) -> None:
        """Note that the transport is closed, with a reason for the operator."""
        if self.up:
            self.counters["lost"] += 1
        self._change(up=False, reason=reason)

    def mark_closed(self) -> None:
        """Note that the link was closed on purpose."""
        self._change(up=False, reason="closed")

    def _change(self, *, up: bool, reason: str) -> None:
        if up != self.up:
            self.since_ns = time.monotonic_ns()
        self.up = up
        self.reason = reason


def describe_error(error: BaseException) -> str:
    """Return an exception's class and text in one line."""
    text = str(error).strip()
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
