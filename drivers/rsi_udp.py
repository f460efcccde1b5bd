"""The robot controller's wire: a UDP socket that answers telegrams.

Law of this file: bytes in, bytes out. It never sends unasked, never waits, and knows no XML.
After a stall only the newest telegram of each sender is answered; the older ones are counted,
for an answer to them would be late. An older one is looked at only if what came after it was
not worth an answer, so that junk cannot push a telegram aside. While a controller is answered the
kernel drops what others send; after its silence another one may come.
A reply that is ready beforehand may go out before the telegram is judged in full: whoever gives
it has looked at the telegram's counter and shape.
Source: reference/rsi.md, 1.1; reference/reliability.md, 0; reference/real-time.md, 5.
"""

import logging
import time
from collections import deque
from collections.abc import Callable

from linemate.drivers.backoff import Backoff
from linemate.drivers.datagrams import Address, Datagram, DatagramLink, DatagramSocket, Received
from linemate.drivers.link import why
from linemate.drivers.sole_sender import SoleSender

BUDGET = 64
SENDERS = 4
LOOK_BACK = 4
MOST_SELECTED = 1024
"""Descriptors from here on cannot be waited for with a resolution of microseconds."""

REHEARSAL_NS = 150_000
"""Less time than this before the telegram is not spent on rehearsing [ns]."""

SILENCE_S = 0.1
"""As long as the exchange believes in a controller of which it hears nothing [s]."""

log = logging.getLogger(__name__)

OnTelegram = Callable[[bytes, int, Address], bytes | None]
Express = Callable[[bytes, Address], bytes | None]


class RsiLink(DatagramLink):
    """Hands telegrams to a callback and sends what it returns, at once.

    Attributes:
        status: the link's visible state. Counters: ``received``, ``answered``, ``unanswered``
            (the callback gave no reply), ``stale`` (a newer one waited), ``oversize``,
            ``crowded`` (too many senders at once), ``send_errors``, ``callback_errors``,
            ``express`` (answered with what was ready), ``hasty`` (of these, what the callback
            would not have answered so),
            ``kernel_drops`` (found no room, or came from others while a controller was
            answered), ``stamps_refused``.
        turnaround_ns: from the arrival of the last answered telegram to its reply [ns].
    """

    def __init__(
        self,
        on_telegram: OnTelegram,
        host: str = "127.0.0.1",
        port: int = 49152,
        *,
        name: str = "robot",
        backoff: Backoff | None = None,
    ) -> None:
        super().__init__(name, host, port, backoff)
        self.turnaround_ns: int | None = None
        self._on_telegram = on_telegram
        self._last: tuple[bytes, Address] | None = None
        self._sole = SoleSender(SILENCE_S, 1, lambda: self.status.last_sample_stamp_ns)

    @property
    def kept(self) -> Address | None:
        """The controller that has the port for itself, None while anybody may come."""
        return self._sole.kept

    def attend(self, until_ns: int, express: Express) -> bool:
        """Wait for the one telegram that is about to come, and answer it with what is ready.

        The loop stands still meanwhile, asleep: the telegram wakes the process by itself and not
        by way of the loop. Afterwards the telegram takes its usual way, its reply being out.

        Args:
            until_ns: when to give up [ns].
            express: gives the reply that is ready for a telegram, None if it takes more; it must
                give none for a datagram of 2 KiB or more, for that may be incomplete.

        Returns:
            Whether a telegram came.
        """
        transport = self._socket
        if transport is None or transport.fileno() >= MOST_SELECTED:
            return False
        try:
            return self._attend(transport, until_ns, express)
        except OSError as error:
            self._down(why(error))
            return False

    def _attend(self, transport: DatagramSocket, until_ns: int, express: Express) -> bool:
        left_ns = until_ns - time.monotonic_ns()
        if left_ns > REHEARSAL_NS and self._last is not None:
            # Whatever the way to the reply needs is in the processor's caches when it counts.
            express(*self._last)
            left_ns = until_ns - time.monotonic_ns()
        raw = transport.wait(left_ns)
        if raw is None:
            return False
        data, source = raw[0], raw[3]
        reply = express(data, source)
        if reply is not None:
            transport.endpoint.sendto(reply, source)
            sent_ns = time.monotonic_ns()
        datagram = transport.stamped(Received(*raw))
        self.counters["received"] += 1
        if reply is None:
            self._take_first(transport, datagram)
            return True
        self._last = (data, source)
        self.counters["express"] += 1
        self.counters["answered"] += 1
        self.status.last_sample_stamp_ns = datagram.stamp_ns
        self.turnaround_ns = sent_ns - datagram.stamp_ns
        self._sole.good(transport, source)
        if self._ask(datagram) != reply:
            self.counters["hasty"] += 1
        return True

    def _read(self, transport: DatagramSocket) -> None:
        waiting: dict[Address, deque[Datagram]] = {}
        for _ in range(BUDGET):
            datagram = transport.read()
            if datagram is None:
                break
            self._keep(waiting, datagram)
        for datagrams in waiting.values():
            while datagrams and not self._answer(transport, datagrams.pop()):
                pass
            self.counters["stale"] += len(datagrams)

    def _take_first(self, transport: DatagramSocket, datagram: Datagram) -> None:
        """A telegram that takes more: the usual way, and what came with it."""
        if datagram.oversize:
            self.counters["oversize"] += 1
        elif not self._answer(transport, datagram):
            self._read(transport)

    def _keep(self, waiting: dict[Address, deque[Datagram]], datagram: Datagram) -> None:
        self.counters["received"] += 1
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

    def _answer(self, transport: DatagramSocket, datagram: Datagram) -> bool:
        """Whether the telegram was worth an answer."""
        reply = self._ask(datagram)
        if reply is None:
            self.counters["unanswered"] += 1
            return False
        try:
            transport.endpoint.sendto(reply, datagram.source)
        except OSError as error:
            self.counters["send_errors"] += 1
            log.debug("%s: reply not sent: %s", self.status.name, error)
            return True
        self.counters["answered"] += 1
        self.status.last_sample_stamp_ns = datagram.stamp_ns
        self.turnaround_ns = time.monotonic_ns() - datagram.stamp_ns
        self._sole.good(transport, datagram.source)
        return True

    def _release(self) -> None:
        self._sole.forget()
        super()._release()

    def _ask(self, datagram: Datagram) -> bytes | None:
        try:
            return self._on_telegram(datagram.data, datagram.stamp_ns, datagram.source)
        except Exception:
            # The loop must outlive a fault in the cycle; silence makes the controller stop.
            self.counters["callback_errors"] += 1
            log.exception("%s: the cycle failed on a telegram", self.status.name)
            return None
