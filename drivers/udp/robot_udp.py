"""Robot link: a UDP socket that answers the robot controller's telegrams.

One reply path: a telegram that equals the expected one gets the ready reply at once. Then every
telegram goes the ordinary way, ``on_telegram``, which returns the reply to those that got none.

Invariants:
- Bytes in, bytes out. The link sends nothing unasked.
- After a stall only the newest telegram of each sender is answered. Older ones are counted: an
  answer to them would be late. If the newest gets no answer, the one before it is tried.
- While a controller is answered, the kernel drops what others send.
"""

import logging
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from linemate.drivers.backoff import Backoff
from linemate.drivers.datagrams import Address, Datagram, DatagramSocket
from linemate.drivers.link import describe_error
from linemate.drivers.udp.datagram_link import DatagramLink
from linemate.drivers.udp.sole_sender import SoleSender
from linemate.protocol.controller_link import ReadyReply

BUDGET = 64  # datagrams read at once
SENDERS = 4  # distinguished in one read
LOOK_BACK = 4  # datagrams of one sender that may be tried
WARM_UP_NS = 150_000  # a comparison before the telegram comes takes less than this
FRESH_NS = 500_000  # after it has come, no newer telegram can wait behind a telegram [ns]
SILENCE_S = 0.1  # of the controller, before the exchange accepts another one

log = logging.getLogger(__name__)


class OnTelegram(Protocol):
    """The ordinary way of a telegram."""

    def __call__(
        self, data: bytes, stamp_ns: int, source: Address, /, *, is_answered: bool
    ) -> bytes | None:
        """Return the reply; empty: the telegram counts and gets none; None: it does not count.

        Args:
            stamp_ns: arrival on the monotonic clock [ns].
            is_answered: the ready reply has been sent. The same reply is to be returned.
        """


class RobotLink(DatagramLink):
    """Answers telegrams.

    Attributes:
        status: the link's visible state. Counters: ``received``, ``answered``, ``unanswered``
            (no reply), ``stale`` (a newer one waited), ``oversize``, ``crowded`` (too many
            senders at once), ``send_errors``, ``callback_errors``, ``express`` (answered with
            the ready reply), ``hasty`` (of these, those with another reply in the ordinary way),
            ``silent`` (they count, and nothing was to be sent), ``kernel_drops`` (queue full, or
            other senders while a controller was answered), ``stamps_refused``.
        turnaround_ns: from the arrival of the last answered telegram to its reply [ns].
    """

    def __init__(
        self,
        on_telegram: OnTelegram,
        host: str = "127.0.0.1",
        port: int = 49152,
        *,
        ready_reply: Callable[[], ReadyReply | None] = lambda: None,
        on_open: Callable[[int], None] = lambda _: None,
        newest_acts: bool = False,
        backoff: Backoff | None = None,
    ) -> None:
        """Wait for ``open``.

        Args:
            newest_acts: a late reply acts as well, so no telegram of the past may be answered.
        """
        super().__init__("robot", host, port, backoff)
        self.turnaround_ns: int | None = None
        self._on_telegram = on_telegram
        self._ready_reply = ready_reply
        self._on_open = on_open
        self._newest_acts = newest_acts
        self._last = b""
        self._sent_ns = 0
        self._sole_sender = SoleSender(SILENCE_S, 1, lambda: self.status.last_sample_stamp_ns)

    def open(self) -> None:
        """Bind and listen on the running loop; if that fails, try again with back-off."""
        super().open()
        if self._socket is not None:
            self._on_open(self.opened_ns)

    async def end_stream(self) -> None:
        """End a stream that the daemon has asked for; here it has not."""

    def attend(self, until_ns: int) -> bool:
        """Sleep until a telegram comes, answer it, and return whether one came.

        The telegram wakes the process directly. Through the event loop it takes longer.

        Args:
            until_ns: when to give up [ns].
        """
        transport = self._socket
        if transport is None or not transport.is_selectable:
            return False
        try:
            ready = self._valid_ready_reply()
            if ready is not None:
                until_ns = min(until_ns, ready.until_ns)
                if until_ns - time.monotonic_ns() > WARM_UP_NS:
                    # The comparison's code and data are in the processor's caches when it counts.
                    ready.telegram.matches(self._last)
            raw = transport.wait(until_ns - time.monotonic_ns())
            if raw is None:
                return False
            self.counters["received"] += 1
            # The process was stopped as it slept, and its clock perhaps with it: newer telegrams
            # wait behind this one. A controller that knows late replies refuses one to the past.
            if time.monotonic_ns() > until_ns or (self._newest_acts and transport.has_more()):
                self._read(transport, transport.stamped(raw))
                return True
            sent = self._send_ready(transport, ready, raw[0], raw[3])
            if not self._answer(transport, transport.stamped(raw), sent):
                self._read(transport)
        except OSError as error:
            self._down(describe_error(error))
        return True

    def _read(self, transport: DatagramSocket, first: Datagram | None = None) -> None:
        if first is None:
            first = transport.read()
            if first is None:
                return
            self.counters["received"] += 1
            if self._answer_fresh(transport, first):
                return
        waiting: dict[Address, deque[Datagram]] = {}
        self._queue(waiting, first)
        for _ in range(BUDGET):
            datagram = transport.read()
            if datagram is None:
                break
            self.counters["received"] += 1
            self._queue(waiting, datagram)
        for datagrams in waiting.values():
            while datagrams:
                newest = datagrams.pop()
                ready = self._valid_ready_reply()
                sent = self._send_ready(transport, ready, newest.data, newest.source)
                if self._answer(transport, newest, sent):
                    break
            self.counters["stale"] += len(datagrams)

    def _answer_fresh(self, transport: DatagramSocket, datagram: Datagram) -> bool:
        """Answer the expected telegram that has just come; False: look for newer ones first.

        To look for a newer one costs a system call, and none of the controller can be there yet.
        """
        is_old = time.monotonic_ns() - datagram.stamp_ns > FRESH_NS
        if is_old or self._newest_acts or datagram.oversize:
            return False
        ready = self._valid_ready_reply()
        sent = self._send_ready(transport, ready, datagram.data, datagram.source)
        return sent is not None and self._answer(transport, datagram, sent)

    def _queue(self, waiting: dict[Address, deque[Datagram]], datagram: Datagram) -> None:
        if datagram.oversize:
            self.counters["oversize"] += 1
            return
        datagrams = waiting.get(datagram.source)
        if datagrams is None:
            if len(waiting) >= SENDERS:
                self.counters["crowded"] += 1
                return
            datagrams = waiting[datagram.source] = deque()
        elif len(datagrams) >= LOOK_BACK:
            datagrams.popleft()
            self.counters["stale"] += 1
        datagrams.append(datagram)

    def _valid_ready_reply(self) -> ReadyReply | None:
        ready = self._ready_reply()
        return None if ready is None or time.monotonic_ns() > ready.until_ns else ready

    def _send_ready(
        self, transport: DatagramSocket, ready: ReadyReply | None, data: bytes, source: Any
    ) -> bytes | None:
        """Send the ready reply to the telegram that it was made for, and return it."""
        if ready is None or source != ready.peer or not ready.telegram.matches(data):
            return None
        self._send(transport, ready.data, source)
        return ready.data

    def _answer(self, transport: DatagramSocket, datagram: Datagram, sent: bytes | None) -> bool:
        """Hand a telegram on, send its reply unless one is out, and return whether it has one."""
        if datagram.oversize:
            self.counters["oversize"] += 1
            return False
        source = datagram.source
        reply = self._call_cycle(datagram, is_answered=sent is not None)
        if sent is not None:
            self.counters["express"] += 1
            if reply != sent:
                self.counters["hasty"] += 1
        elif reply is None:
            self.counters["unanswered"] += 1
            return False
        elif reply:
            self._send(transport, reply, source)
        else:
            self.counters["silent"] += 1
            self._sent_ns = datagram.stamp_ns
        self._last = datagram.data
        self.status.last_sample_stamp_ns = datagram.stamp_ns
        self.turnaround_ns = self._sent_ns - datagram.stamp_ns
        if source != self._sole_sender.kept:
            self._sole_sender.note_good(transport, source)
        return True

    def _send(self, transport: DatagramSocket, reply: bytes, source: Any) -> None:
        try:
            transport.endpoint.sendto(reply, source)
        except OSError as error:
            self.counters["send_errors"] += 1
            log.debug("%s: reply not sent: %s", self.status.name, error)
        else:
            self._sent_ns = time.monotonic_ns()
            self.counters["answered"] += 1

    def _release(self) -> None:
        self._sole_sender.forget()
        super()._release()

    def _call_cycle(self, datagram: Datagram, *, is_answered: bool) -> bytes | None:
        try:
            return self._on_telegram(
                datagram.data, datagram.stamp_ns, datagram.source, is_answered=is_answered
            )
        except Exception:
            # The loop must outlive a fault in the cycle. Silence makes the controller stop.
            self.counters["callback_errors"] += 1
            log.exception("%s: the cycle failed on a telegram", self.status.name)
            return None
