"""The camera's wire: pose datagrams on a UDP port.

Law of this file: at most a few datagrams a wake, so that a flood on this port never delays the
robot's; what a datagram means is the decoder's affair, and so is counting what it refuses.
While one sender's poses come the kernel drops what others send.
Source: reference/reliability.md, 0 (findings 2 to 4).
"""

import logging
from collections.abc import Callable
from typing import Protocol

from linemate.drivers.backoff import Backoff
from linemate.drivers.datagrams import Datagram, DatagramLink, DatagramSocket
from linemate.drivers.sole_sender import SoleSender
from linemate.protocol.errors import ProtocolError
from linemate.protocol.samples import CameraSample

BUDGET = 8

SILENCE_S = 0.25
"""Ten images: after that another camera may come [s]."""

IN_A_ROW = 5
"""Poses from one port before strangers are kept off; whoever changes it each time is none."""

log = logging.getLogger(__name__)

OnCamera = Callable[[CameraSample], None]


class Decoder(Protocol):
    """What the link needs of a camera codec."""

    def feed(self, data: bytes, stamp_ns: int) -> CameraSample | None:
        """Decode one datagram; None for one that is well-formed but not wanted."""


class CameraLink(DatagramLink):
    """Hands camera samples to a callback.

    Attributes:
        status: the link's visible state. Counters: ``received``, ``samples``, ``ignored``,
            ``refused``, ``oversize``, ``callback_errors``, ``kernel_drops`` (found no room, or
            came from others while a camera sent), ``stamps_refused``.
    """

    def __init__(
        self,
        decoder: Decoder,
        on_sample: OnCamera,
        host: str = "127.0.0.1",
        port: int = 0,
        *,
        name: str = "camera",
        budget: int = BUDGET,
        backoff: Backoff | None = None,
    ) -> None:
        super().__init__(name, host, port, backoff)
        self._decoder = decoder
        self._on_sample = on_sample
        self._budget = budget
        self._sole = SoleSender(SILENCE_S, IN_A_ROW, lambda: self.status.last_sample_stamp_ns)

    def _read(self, transport: DatagramSocket) -> None:
        for _ in range(self._budget):
            datagram = transport.read()
            if datagram is None:
                break
            self._take(transport, datagram)

    def _release(self) -> None:
        self._sole.forget()
        super()._release()

    def _take(self, transport: DatagramSocket, datagram: Datagram) -> None:
        self.counters["received"] += 1
        if datagram.oversize:
            self.counters["oversize"] += 1
            return
        try:
            sample = self._decoder.feed(datagram.data, datagram.stamp_ns)
        except ProtocolError as error:
            self.counters["refused"] += 1
            log.debug("%s: %s", self.status.name, error)
            return
        if sample is None:
            self.counters["ignored"] += 1
            return
        self.counters["samples"] += 1
        self.status.last_sample_stamp_ns = sample.stamp_ns
        self._sole.good(transport, datagram.source)
        self._deliver(sample)

    def _deliver(self, sample: CameraSample) -> None:
        try:
            self._on_sample(sample)
        except Exception:
            self.counters["callback_errors"] += 1
            log.exception("%s: a sample's receiver failed", self.status.name)
