"""Stream link: a robot link whose controller must be asked to send telegrams.

Invariants:
- Bytes in, bytes out. What is asked, and when, is the handshake's.
- Datagrams of other senders than the controller never reach the handshake.
- At the end the controller gets the last reply marked as such, and the packet that stops it.
"""

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable
from typing import Any

from linemate.drivers.datagrams import Address, Datagram, DatagramSocket
from linemate.drivers.udp.robot_udp import OnTelegram, RobotLink
from linemate.protocol.controller_link import Handshake, ReadyReply

ASK_S = 0.05  # the handshake is asked so often what is due [s]
END_S = 0.2  # longest wait for the last reply [s]

log = logging.getLogger(__name__)


class StreamLink(RobotLink):
    """Asks a controller for its telegrams and answers them."""

    def __init__(
        self,
        on_telegram: OnTelegram,
        host: str,
        port: int,
        target: Address,
        handshake: Handshake,
        *,
        ready_reply: Callable[[], ReadyReply | None] = lambda: None,
        on_open: Callable[[int], None] = lambda _: None,
        on_start: Callable[[], None] = lambda: None,
    ) -> None:
        """Prepare the link; ``open`` opens the socket.

        Args:
            target: the controller's numeric address and port.
            on_start: called when a stream begins; its counter may begin anywhere.
        """
        super().__init__(on_telegram, host, port, ready_reply=ready_reply, on_open=on_open)
        self._target = target
        self._handshake = handshake
        self._on_start = on_start
        self._starts = handshake.starts
        self._timer: asyncio.TimerHandle | None = None
        self._refusal: str | None = None
        self._ended = asyncio.Event()

    def open(self) -> None:
        """Bind and ask the controller; if that fails, try again with back-off."""
        super().open()
        if self._socket is not None and self._timer is None:
            self._ask()

    async def end_stream(self) -> None:
        """Let the next reply be the last one, and stop the controller's stream."""
        self._handshake.end()
        if not self._handshake.is_ended:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._ended.wait(), END_S)
        self._transmit(self._handshake.farewell())

    def _ask(self) -> None:
        """Send what the handshake has to say, and look again soon."""
        self._timer = asyncio.get_running_loop().call_later(ASK_S, self._ask)
        self._transmit(self._handshake.due(time.monotonic_ns()))
        if self._socket is not None:
            self.status.reason = self._refusal or self._handshake.waits_for

    def _transmit(self, datagrams: list[bytes]) -> None:
        transport = self._socket
        if transport is None:
            return
        for data in datagrams:
            try:
                transport.endpoint.sendto(data, self._target)
            except OSError as error:
                self.counters["send_errors"] += 1
                log.debug("%s: not sent: %s", self.status.name, error)

    def _answer(self, transport: DatagramSocket, datagram: Datagram, sent: bytes | None) -> bool:
        if datagram.source != self._target:
            self.counters["foreign"] += 1
            return False
        if self._handshake.on_datagram(datagram.data, datagram.stamp_ns):
            self._note_handshake()
            return False
        return super()._answer(transport, datagram, sent)

    def _note_handshake(self) -> None:
        """Follow the handshake: send its answer, note a new stream, report a refusal once."""
        if self._handshake.starts != self._starts:
            self._starts = self._handshake.starts
            self._on_start()
        if self._handshake.refusal != self._refusal:
            self._refusal = self._handshake.refusal
            if self._refusal is not None:
                log.error("%s: no stream: %s", self.status.name, self._refusal)
        self._transmit(self._handshake.due(time.monotonic_ns()))

    def _send(self, transport: DatagramSocket, reply: bytes, source: Any) -> None:
        super()._send(transport, self._handshake.outgoing(reply), source)
        if self._handshake.is_ended:
            self._ended.set()

    def _release(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        super()._release()
