"""The robot controller's wire: a UDP socket that answers telegrams.

Law of this file: bytes in, bytes out. It never sends unasked, never waits, and knows no XML.
After a stall only the newest telegram of each sender is answered; the older ones are counted,
for an answer to them would be late. An older one is looked at only if what came after it was
not worth an answer, so that junk cannot push a telegram aside.
Source: reference/rsi.md, 1.1; reference/reliability.md, 0.
"""

import logging
import time
from collections import deque
from collections.abc import Callable

from linemate.drivers.backoff import Backoff
from linemate.drivers.datagrams import Address, Datagram, DatagramLink, DatagramSocket

BUDGET = 64
SENDERS = 4
LOOK_BACK = 4

log = logging.getLogger(__name__)

OnTelegram = Callable[[bytes, int, Address], bytes | None]


class RsiLink(DatagramLink):
    """Hands telegrams to a callback and sends what it returns, at once.

    Attributes:
        status: the link's visible state. Counters: ``received``, ``answered``, ``unanswered``
            (the callback gave no reply), ``stale`` (a newer one waited), ``oversize``,
            ``crowded`` (too many senders at once), ``send_errors``, ``callback_errors``,
            ``kernel_drops``, ``stamps_refused``.
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
        return True

    def _ask(self, datagram: Datagram) -> bytes | None:
        try:
            return self._on_telegram(datagram.data, datagram.stamp_ns, datagram.source)
        except Exception:
            # The loop must outlive a fault in the cycle; silence makes the controller stop.
            self.counters["callback_errors"] += 1
            log.exception("%s: the cycle failed on a telegram", self.status.name)
            return None
