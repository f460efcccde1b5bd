"""Force-torque sensor link: a serial line by URL (tty, pty or socket).

Invariants:
    The decoder finds the frames in the stream of bytes.
    A device with a start-up dialogue counts as up when the dialogue is over.
    A line that ends, fails or is silent is opened again with back-off.
"""

import asyncio
import logging
import time
from collections.abc import Callable

import serialx

from linemate.drivers.backoff import Backoff
from linemate.drivers.kept_link import KeptLink
from linemate.drivers.link import describe_error
from linemate.protocol.errors import ProtocolError
from linemate.protocol.sensors.wrench import WrenchHost
from linemate.protocol.sensors.wrench_stream import WrenchDecoder
from linemate.protocol.stamped_samples import WrenchSample

READ_BYTES = 4096
OPEN_S = 5.0  # longest time to open or close
SILENCE_S = 2.0  # without a sample, the line is opened again
CHECK_S = 0.1  # between two checks for silence and overdue answers

log = logging.getLogger(__name__)

OnWrench = Callable[[WrenchSample], None]


class SerialLink(KeptLink):
    """Delivers wrench samples to a callback.

    Attributes:
        status: the link's visible state. Counters: ``bytes``, ``samples``, ``refused``,
            ``silences``, ``dialogue_failures``, ``callback_errors``, ``opened``, ``lost`` and
            the decoder's own (``bad_crc``, ``garbage_bytes``, ``resyncs``, ...).
    """

    def __init__(
        self,
        url: str,
        decoder: WrenchDecoder,
        on_sample: OnWrench,
        *,
        baudrate: int = 460_800,
        host: Callable[[], WrenchHost] | None = None,
        silence_s: float = SILENCE_S,
        backoff: Backoff | None = None,
    ) -> None:
        super().__init__("force_torque", backoff)
        self._url = url
        self._baudrate = baudrate
        self._decoder = decoder
        self._on_sample = on_sample
        self._new_host = host
        self._host: WrenchHost | None = None
        self._last_ns = 0
        self._counted: dict[str, int] = {}
        self._silence_s = silence_s
        self._transport: asyncio.WriteTransport | None = None

    async def _run_once(self) -> str:
        line = _SerialProtocol(self._received)
        try:
            transport = await self._connect(line)
        except Exception as error:  # noqa: BLE001 - a transport plug-in may raise anything
            return describe_error(error)
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
            transport.max_size = READ_BYTES  # otherwise a read allocates 256 KiB
        return transport

    def _begin(self) -> None:
        self._last_ns = now_ns = time.monotonic_ns()
        self._decoder.reset()
        self._host = self._new_host() if self._new_host is not None else None
        if self._host is None:
            self.status.mark_up()
        else:
            self._send(self._host.begin(now_ns).send)

    async def _watch(self, line: "_SerialProtocol") -> str:
        """Wait for the end of the line; return its reason, or why it is to be opened again."""
        while True:
            await asyncio.wait([line.lost], timeout=CHECK_S)
            if line.lost.done():
                return line.lost.result()
            reason = self._failure(time.monotonic_ns())
            if reason is not None:
                return reason

    def _failure(self, now_ns: int) -> str | None:
        host = self._host
        if host is not None and not host.running:
            self._send(host.on_time(now_ns).send)
            if host.failure is not None:
                self.counters["dialogue_failures"] += 1
            return host.failure
        if now_ns - self._last_ns > self._silence_s * 1e9:
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
            stream = data if self._host is None else self._run_dialogue(self._host, data, stamp_ns)
            self._decode(stream, stamp_ns)
        except ProtocolError as error:
            self.counters["refused"] += 1
            log.debug("%s: %s", self.status.name, error)

    def _run_dialogue(self, host: WrenchHost, data: bytes, now_ns: int) -> bytes:
        was_running = host.running
        output = host.feed(data, now_ns)
        self._send(output.send)
        if host.running and not was_running:
            self._last_ns = now_ns
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
            # The dialogue is over, and so is the line end of its last answer.
            self._host = None
            self._last_ns = stamp_ns
            self._backoff.reset()

    def _count_decoded(self) -> None:
        """Add what the decoder has counted since the last read to the link's counters."""
        counts = self._decoder.counters()
        for name, count in counts.items():
            counted = self._counted.get(name)
            if count != counted:
                self.counters[name] += count - (counted or 0)
        self._counted = counts

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
        """Deliver what was read."""
        if not self.lost.done():
            self._on_data(data)

    def eof_received(self) -> bool:
        """Close the line: it has no half-open state."""
        return False

    def connection_lost(self, exc: Exception | None) -> None:
        """Report that the line has ended."""
        if not self.lost.done():
            self.lost.set_result("the line ended" if exc is None else describe_error(exc))
