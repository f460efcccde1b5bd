"""Distance sensor link: any python-can bus, by configuration.

python-can's Notifier is not used: it spins on a broken bus and loses exceptions.

Invariants:
    A bus is opened and shut down in a thread, because both may block.
    The loop reads a bus that has a descriptor. A thread with a bounded queue reads any other.
    An slcan adapter with a descriptor is read by ``SlcanReader``.
    An exception of a plug-in ends the bus, not the loop. The bus is opened again with back-off.
"""

import asyncio
import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Protocol, TypeVar

import can

from linemate.drivers.backoff import Backoff
from linemate.drivers.datagrams import ArrivalClock, paired_clocks
from linemate.drivers.kept_link import KeptLink
from linemate.drivers.link import describe_error
from linemate.drivers.read_ahead import ReadAhead
from linemate.drivers.slcan_reader import SlcanReader
from linemate.protocol.errors import ProtocolError
from linemate.protocol.stamped_samples import DistanceSample

T = TypeVar("T")

BUDGET = 32  # frames read at one wake
QUEUE = 256  # frames that wait for the loop
WAKES_WITHOUT_FRAME = 500  # in a row; then the bus is opened again
NO_FRAMES = "bytes come, but no frames"
THREAD_RECV_S = 0.2

# Otherwise python-can sleeps 2 s when it opens and blocks 1 ms at each read.
SLCAN_DEFAULTS = {"sleep_after_open": 0, "timeout": 0}
SERIAL_PORT = "serialPortOrig"  # attribute of python-can's slcan bus that holds its port

log = logging.getLogger(__name__)

OnDistance = Callable[[DistanceSample], None]
Received = tuple[can.Message, int]


class CanDecoder(Protocol):
    """What the link needs of a distance codec."""

    def decode(
        self, can_id: int, data: bytes, stamp_ns: int, extended: bool = False
    ) -> DistanceSample | None:
        """Decode one frame; None for a frame of another device."""


class CanLink(KeptLink):
    """Delivers distance samples to a callback.

    Attributes:
        status: the link's visible state. Counters: ``frames``, ``samples``, ``other`` (not this
            sensor's frame), ``refused``, ``garbage`` (not a frame at all), ``error_frames``,
            ``remote_frames``, ``dropped`` (queue full), ``callback_errors``,
            ``stamps_refused``, ``opened``, ``lost``.
    """

    def __init__(
        self,
        can_config: Mapping[str, object],
        decoder: CanDecoder,
        on_sample: OnDistance,
        *,
        backoff: Backoff | None = None,
    ) -> None:
        super().__init__("distance", backoff)
        self._config = _with_defaults(can_config)
        self._decoder = decoder
        self._on_sample = on_sample
        self._clock = ArrivalClock()
        self._empty_wakes = 0

    async def _run_once(self) -> str:
        try:
            bus = await _in_thread(lambda: _opened(self._config), leftover=_shut_down)
        except Exception as error:  # noqa: BLE001 - a plug-in may raise anything
            return describe_error(error)
        try:
            self.status.mark_up()
            self._clock = ArrivalClock()
            self._empty_wakes = 0
            descriptor = _descriptor(bus)
            if descriptor is not None:
                return await self._watch(bus, descriptor)
            return await self._read_in_thread(bus)
        finally:
            await asyncio.shield(_in_thread(lambda: _shut_down(bus)))

    async def _watch(self, bus: can.BusABC, descriptor: int) -> str:
        loop = asyncio.get_running_loop()
        broken: asyncio.Future[str] = loop.create_future()
        drain = partial(self._drain, bus)
        if hasattr(bus, SERIAL_PORT):
            drain = partial(self._drain_lines, SlcanReader(descriptor))
        loop.add_reader(descriptor, self._readable, drain, broken)
        try:
            return await broken
        finally:
            loop.remove_reader(descriptor)

    def _readable(self, drain: Callable[[], str | None], broken: "asyncio.Future[str]") -> None:
        if broken.done():
            return
        reason = drain()
        if reason is not None:
            broken.set_result(reason)

    def _drain(self, bus: can.BusABC) -> str | None:
        """Read what waits, within the budget; return why the bus has ended, None if it has not."""
        self._empty_wakes += 1
        for _ in range(BUDGET):
            try:
                message = bus.recv(0)
            except Exception as error:  # noqa: BLE001 - a plug-in may raise anything
                if not _is_garbage(bus, error):
                    return describe_error(error)
                self.counters["garbage"] += 1
                continue
            if message is None:
                self._clock.drained(time.monotonic_ns())
                break
            self._empty_wakes = 0
            self._handle(message, _arrival(self._clock, message))
        self.counters["stamps_refused"] = self._clock.refused
        return None if self._empty_wakes < WAKES_WITHOUT_FRAME else NO_FRAMES

    def _drain_lines(self, reader: SlcanReader) -> str | None:
        """Read what waits, at most 32 frames; return why the adapter has ended, None if not."""
        self._empty_wakes += 1
        garbage, refused, others = reader.garbage, reader.refused, reader.others
        try:
            frames = reader.read()
        except OSError as error:
            return describe_error(error)
        stamp_ns = time.monotonic_ns()
        if frames or reader.others > others:
            self._empty_wakes = 0
        for frame in frames:
            self._handle_frame(frame.can_id, frame.data, stamp_ns, frame.extended, frame.remote)
        if reader.garbage > garbage:
            self.counters["garbage"] += reader.garbage - garbage
        if reader.refused > refused:
            self.counters["refused"] += reader.refused - refused
        if reader.others > others:
            self.counters["frames"] += reader.others - others
            self.counters["other"] += reader.others - others
        return None if self._empty_wakes < WAKES_WITHOUT_FRAME else NO_FRAMES

    async def _read_in_thread(self, bus: can.BusABC) -> str:
        loop = asyncio.get_running_loop()
        pump = _Pump(bus, loop, self._handle_queued)
        thread = threading.Thread(target=pump.run, name=f"can-{self.status.name}", daemon=True)
        thread.start()
        try:
            return await pump.broken
        finally:
            pump.stop.set()
            await asyncio.shield(_in_thread(thread.join))

    def _handle_queued(self, pump: "_Pump") -> None:
        for message, stamp_ns in pump.drain():
            self._handle(message, stamp_ns)
        self.counters["dropped"] += pump.drain_dropped()
        self.counters["garbage"] += pump.drain_garbage()

    def _handle(self, message: can.Message, stamp_ns: int) -> None:
        if message.is_error_frame:
            self.counters["frames"] += 1
            self.counters["error_frames"] += 1
            self._backoff.reset()
            return
        can_id, data, extended = message.arbitration_id, message.data, message.is_extended_id
        self._handle_frame(can_id, bytes(data or b""), stamp_ns, extended, message.is_remote_frame)

    def _handle_frame(
        self, can_id: int, data: bytes, stamp_ns: int, is_extended: bool, is_remote: bool
    ) -> None:
        self.counters["frames"] += 1
        self._backoff.reset()
        if is_remote:
            self.counters["remote_frames"] += 1
            return
        try:
            sample = self._decoder.decode(can_id, data, stamp_ns, extended=is_extended)
        except ProtocolError as error:
            self.counters["refused"] += 1
            log.debug("%s: %s", self.status.name, error)
            return
        if sample is None:
            self.counters["other"] += 1
            return
        self.counters["samples"] += 1
        self.status.last_sample_stamp_ns = sample.stamp_ns
        self._deliver(sample)

    def _deliver(self, sample: DistanceSample) -> None:
        try:
            self._on_sample(sample)
        except Exception:
            self.counters["callback_errors"] += 1
            log.exception("%s: a sample's receiver failed", self.status.name)


class _Pump:
    """Reads a bus without a descriptor in a thread into a bounded queue for the loop."""

    def __init__(
        self, bus: can.BusABC, loop: asyncio.AbstractEventLoop, on_ready: Callable[["_Pump"], None]
    ) -> None:
        self.stop = threading.Event()
        self.broken: asyncio.Future[str] = loop.create_future()
        self._bus = bus
        self._loop = loop
        self._on_ready = on_ready
        self._lock = threading.Lock()
        self._queue: deque[Received] = deque()
        self._dropped = 0
        self._garbage = 0
        self._clock = ArrivalClock()

    def run(self) -> None:
        """Read until ``stop`` is set or the bus breaks."""
        empty_reads = 0
        while not self.stop.is_set() and empty_reads < WAKES_WITHOUT_FRAME:
            try:
                message = self._bus.recv(THREAD_RECV_S)
            except Exception as error:  # noqa: BLE001 - a plug-in may raise anything
                if not _is_garbage(self._bus, error):
                    self._call_soon(self._break, describe_error(error))
                    return
                empty_reads += 1
                with self._lock:
                    self._garbage += 1
                continue
            empty_reads = 0
            self._push(message)
        self._call_soon(self._break, NO_FRAMES)

    def drain(self) -> list[Received]:
        """Return the frames since the last call."""
        with self._lock:
            frames = list(self._queue)
            self._queue.clear()
        return frames

    def drain_dropped(self) -> int:
        """Return how many frames the full queue has dropped since the last call."""
        with self._lock:
            dropped, self._dropped = self._dropped, 0
        return dropped

    def drain_garbage(self) -> int:
        """Return how often the bus gave something other than a frame since the last call."""
        with self._lock:
            garbage, self._garbage = self._garbage, 0
        return garbage

    def _push(self, message: can.Message | None) -> None:
        if message is None:
            self._clock.drained(time.monotonic_ns())
            return
        stamp_ns = _arrival(self._clock, message)
        with self._lock:
            was_empty = not self._queue
            if len(self._queue) >= QUEUE:
                self._queue.popleft()
                self._dropped += 1
            self._queue.append((message, stamp_ns))
        if was_empty:
            self._call_soon(self._on_ready, self)

    def _break(self, reason: str) -> None:
        if not self.broken.done():
            self.broken.set_result(reason)

    def _call_soon(self, callback: Callable[[T], None], argument: T) -> None:
        try:
            self._loop.call_soon_threadsafe(callback, argument)
        except RuntimeError:  # the loop is closed
            self.stop.set()


def _with_defaults(can_config: Mapping[str, object]) -> dict[str, Any]:
    if can_config.get("interface") == "slcan":
        return {**SLCAN_DEFAULTS, **can_config}
    return dict(can_config)


def _opened(can_config: Mapping[str, Any]) -> can.BusABC:
    """Open a bus; one on a serial line reads in portions."""
    bus = can.Bus(**can_config)
    if hasattr(bus, SERIAL_PORT):
        setattr(bus, SERIAL_PORT, ReadAhead(getattr(bus, SERIAL_PORT)))
    return bus


def _descriptor(bus: can.BusABC) -> int | None:
    """Return the descriptor to watch, None if the interface has none."""
    try:
        descriptor = bus.fileno()
    except (NotImplementedError, can.CanError, OSError):
        return None
    return descriptor if descriptor >= 0 else None


def _is_garbage(bus: can.BusABC, error: Exception) -> bool:
    """Whether only a frame cannot be read: the bus still works."""
    kept = getattr(bus, "_buffer", None)
    if isinstance(error.__cause__, UnicodeDecodeError) and isinstance(kept, bytearray):
        kept.clear()  # slcan keeps a line that is no text, and would fail at each read
        return True
    return isinstance(error, (ValueError, LookupError))


def _arrival(clock: ArrivalClock, message: can.Message) -> int:
    now_ns, realtime_ns = paired_clocks()
    stamp_realtime_ns = int(message.timestamp * 1e9) if message.timestamp > 0.0 else None
    return clock.arrival(stamp_realtime_ns, now_ns, realtime_ns)


def _shut_down(bus: can.BusABC) -> None:
    try:
        bus.shutdown()
    except Exception as error:  # noqa: BLE001 - a dead bus may refuse to die
        log.debug("shutting a bus down: %s", error)
    port = getattr(bus, SERIAL_PORT, None)
    if isinstance(port, ReadAhead):
        # On a broken line slcan's shutdown fails before it closes the port.
        with contextlib.suppress(Exception):
            port.close()


async def _in_thread(work: Callable[[], T], leftover: Callable[[T], None] | None = None) -> T:
    """Run what may block in a thread; after a cancellation, release its result."""
    loop = asyncio.get_running_loop()
    future = loop.run_in_executor(None, work)

    def _clean(done: "asyncio.Future[T]") -> None:
        if leftover is not None and not done.cancelled() and done.exception() is None:
            loop.run_in_executor(None, leftover, done.result())

    try:
        return await asyncio.shield(future)
    except asyncio.CancelledError:
        future.add_done_callback(_clean)
        raise
