"""The force-torque sensor's wire: a serial line by URL.

Law of this file: a tty, a pty and a socket are the same to it. Bytes go to a decoder that finds
frames in them by itself; a device that must be talked to first brings its dialogue along, and
the line counts as up when the dialogue is over. A line that ends, fails or falls silent is
opened again with back-off. Source: reference/sensors-and-tools.md, 1b.
"""

import asyncio
import logging
import time
from collections.abc import Callable
from typing import Protocol

import serialx

from linemate.drivers.backoff import Backoff
from linemate.drivers.kept_link import KeptLink
from linemate.drivers.link import why
from linemate.protocol.errors import ProtocolError
from linemate.protocol.samples import WrenchSample

READ_BYTES = 4096
OPEN_S = 5.0
SILENCE_S = 2.0
LOOK_S = 0.1

log = logging.getLogger(__name__)

OnWrench = Callable[[WrenchSample], None]


class Decoder(Protocol):
    """What the link needs of a wrench codec."""

    def feed(self, data: bytes, stamp_ns: int) -> list[WrenchSample]:
        """Decode what a read gave; an incomplete frame waits for the next one."""

    def reset(self) -> None:
        """Forget an incomplete frame."""

    def counters(self) -> dict[str, int]:
        """What was refused, by name."""


class HostOutput(Protocol):
    """What a dialogue gives after some bytes or some time."""

    @property
    def send(self) -> bytes:
        """For the device."""

    @property
    def stream(self) -> bytes:
        """For the decoder."""


class Host(Protocol):
    """What a device wants to be told before it streams, from the host's side."""

    @property
    def running(self) -> bool:
        """The device streams."""

    @property
    def failure(self) -> str | None:
        """Why the dialogue was given up."""

    def begin(self, now_ns: int) -> HostOutput:
        """Begin, whatever the device is doing."""

    def feed(self, data: bytes, now_ns: int) -> HostOutput:
        """Take what the port gave."""

    def on_time(self, now_ns: int) -> HostOutput:
        """Notice overdue answers."""


class SerialLink(KeptLink):
    """Hands wrench samples to a callback.

    Attributes:
        status: the link's visible state. Counters: ``bytes``, ``samples``, ``refused``,
            ``silences``, ``dialogue_failures``, ``callback_errors``, ``opened``, ``lost`` and
            the decoder's own (``bad_crc``, ``garbage_bytes``, ``resyncs``, ...).
    """

    def __init__(
        self,
        url: str,
        decoder: Decoder,
        on_sample: OnWrench,
        *,
        baudrate: int = 460_800,
        host: Callable[[], Host] | None = None,
        name: str = "force_torque",
        silence_s: float = SILENCE_S,
        backoff: Backoff | None = None,
    ) -> None:
        super().__init__(name, backoff)
        self._url = url
        self._baudrate = baudrate
        self._decoder = decoder
        self._on_sample = on_sample
        self._new_host = host
        self._host: Host | None = None
        self._heard_ns = 0
        self._seen: dict[str, int] = {}
        self._silence_s = silence_s
        self._transport: asyncio.WriteTransport | None = None

    async def _live_once(self) -> str:
        line = _SerialProtocol(self._received)
        try:
            transport = await self._connect(line)
        except Exception as error:  # noqa: BLE001 - a transport plug-in may raise anything
            return why(error)
        self._transport = transport
        try:
            self._begin()
            return await self._watch(line)
        finally:
            self._transport = None
            transport.abort()
            await asyncio.wait([line.lost], timeout=OPEN_S)

    async def _connect(self, line: "_SerialProtocol") -> asyncio.WriteTransport:
        loop = asyncio.get_running_loop()
        connecting = serialx.create_serial_connection(
            loop, lambda: line, self._url, baudrate=self._baudrate
        )
        transport, _ = await asyncio.wait_for(connecting, OPEN_S)
        if hasattr(transport, "max_size"):
            transport.max_size = READ_BYTES  # 256 KiB allocated a read otherwise
        return transport

    def _begin(self) -> None:
        self._heard_ns = now_ns = time.monotonic_ns()
        self._decoder.reset()
        self._host = self._new_host() if self._new_host is not None else None
        if self._host is None:
            self.status.mark_up()
        else:
            self._send(self._host.begin(now_ns).send)

    async def _watch(self, line: "_SerialProtocol") -> str:
        """Wait for the end of the line; look after silence meanwhile."""
        while True:
            await asyncio.wait([line.lost], timeout=LOOK_S)
            if line.lost.done():
                return line.lost.result()
            reason = self._complaint(time.monotonic_ns())
            if reason is not None:
                return reason

    def _complaint(self, now_ns: int) -> str | None:
        host = self._host
        if host is not None and not host.running:
            self._send(host.on_time(now_ns).send)
            if host.failure is not None:
                self.counters["dialogue_failures"] += 1
            return host.failure
        if now_ns - self._heard_ns > self._silence_s * 1e9:
            self.counters["silences"] += 1
            return f"no sample for {self._silence_s:g} s"
        return None

    def _send(self, data: bytes) -> None:
        if not data or self._transport is None:
            return
        try:
            self._transport.write(data)
        except (OSError, serialx.SerialException) as error:
            self.counters["send_errors"] += 1
            log.debug("%s: not sent: %s", self.status.name, error)

    def _received(self, data: bytes) -> None:
        stamp_ns = time.monotonic_ns()
        self.counters["bytes"] += len(data)
        try:
            stream = data if self._host is None else self._converse(self._host, data, stamp_ns)
            self._decode(stream, stamp_ns)
        except ProtocolError as error:
            self.counters["refused"] += 1
            log.debug("%s: %s", self.status.name, error)

    def _converse(self, host: Host, data: bytes, now_ns: int) -> bytes:
        was_running = host.running
        output = host.feed(data, now_ns)
        self._send(output.send)
        if host.running and not was_running:
            self._heard_ns = now_ns
            self.status.mark_up()
        return output.stream

    def _decode(self, data: bytes, stamp_ns: int) -> None:
        if not data:
            return
        samples = self._decoder.feed(data, stamp_ns)
        self._count_decoded()
        for sample in samples:
            self.counters["samples"] += 1
            self.status.last_sample_stamp_ns = sample.stamp_ns
            self._deliver(sample)
        if samples:
            self._heard_ns = stamp_ns
            self._backoff.reset()

    def _count_decoded(self) -> None:
        """Add what the decoder has counted since the last read, so that it stands beside ours."""
        counts = self._decoder.counters()
        for name, count in counts.items():
            seen = self._seen.get(name)
            if count != seen:
                self.counters[name] += count - (seen or 0)
        self._seen = counts

    def _deliver(self, sample: WrenchSample) -> None:
        try:
            self._on_sample(sample)
        except Exception:
            self.counters["callback_errors"] += 1
            log.exception("%s: a sample's receiver failed", self.status.name)


class _SerialProtocol(asyncio.Protocol):
    """The asyncio side of one opening of the line."""

    def __init__(self, on_data: Callable[[bytes], None]) -> None:
        self.lost: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._on_data = on_data

    def data_received(self, data: bytes) -> None:
        """Pass what was read."""
        if not self.lost.done():
            self._on_data(data)

    def eof_received(self) -> bool:
        """A line has no half-open state: close it."""
        return False

    def connection_lost(self, exc: Exception | None) -> None:
        """Tell the keeper that this opening is over."""
        if not self.lost.done():
            self.lost.set_result("the line ended" if exc is None else why(exc))
