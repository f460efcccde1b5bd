"""Event loop whose select advances a clock.

Invariants:
    Nothing sleeps, no thread starts.
"""

import asyncio
import math
import selectors
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from typing import Any, TypeVar

from linemate.simulators.harness.virtual.virtual_time import DeadlockError, VirtualTime

T = TypeVar("T")


class _Selector(selectors.BaseSelector):
    """Waits by letting time pass."""

    def __init__(self, world: VirtualTime) -> None:
        self._world = world
        self._keys: dict[int, selectors.SelectorKey] = {}
        self.has_work: Callable[[], bool] = lambda: False

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        descriptor = fileobj if isinstance(fileobj, int) else fileobj.fileno()
        key = selectors.SelectorKey(fileobj, descriptor, events, data)
        self._keys[descriptor] = key
        return key

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        descriptor = fileobj if isinstance(fileobj, int) else fileobj.fileno()
        return self._keys.pop(descriptor)

    def modify(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        return self.register(fileobj, events, data)

    def get_map(self) -> Mapping[Any, selectors.SelectorKey]:
        return self._keys

    def get_key(self, fileobj: Any) -> selectors.SelectorKey:
        return self._keys[fileobj if isinstance(fileobj, int) else fileobj.fileno()]

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        world = self._world
        end_ns = None if timeout is None else world.now_ns + math.ceil(max(timeout, 0.0) * 1e9)
        while True:
            if world.stalled_until_ns > world.now_ns:
                world.pass_until(world.stalled_until_ns)
            if world.filled or world.unplugged:
                ready = self._ready()
                if ready:
                    return ready
            if self.has_work():
                return []
            next_ns = world.next_ns
            if next_ns is None and end_ns is None:
                raise DeadlockError("everybody waits and nothing is to come")
            if end_ns is not None and (next_ns is None or next_ns > end_ns):
                world.now_ns = max(world.now_ns, end_ns)
                return []
            world.happen()

    def _ready(self) -> list[tuple[selectors.SelectorKey, int]]:
        filled, ports = self._world.filled, self._world.ports
        if self._world.unplugged:
            filled = {descriptor for descriptor, port in ports.items() if port.is_ready}
        return [
            (key, selectors.EVENT_READ)
            for descriptor, key in self._keys.items()
            if descriptor in filled
        ]


class VirtualLoop(asyncio.SelectorEventLoop):
    """asyncio's own loop on virtual time."""

    def __init__(self, world: VirtualTime) -> None:
        selector = _Selector(world)
        super().__init__(selector)
        self.world = world
        # Seconds in a float are no finer this long after the epoch.
        self._clock_resolution = 1e-7
        selector.has_work = lambda: bool(self._ready)  # type: ignore[attr-defined]

    def time(self) -> float:
        """Monotonic [s]."""
        return self.world.host_ns * 1e-9

    def run_in_executor(  # type: ignore[override]
        self, executor: Executor | None, func: Callable[..., T], *args: Any
    ) -> "asyncio.Future[T]":
        """There are no threads here: done at once."""
        del executor
        future: asyncio.Future[T] = self.create_future()
        try:
            future.set_result(func(*args))
        except Exception as error:  # noqa: BLE001 - the waiting caller gets it
            future.set_exception(error)
        return future

    def add_signal_handler(  # type: ignore[override]
        self, sig: int, callback: Callable[..., Any], *args: Any
    ) -> None:
        """A simulated process gets no signals from the host."""

    def remove_signal_handler(self, sig: int) -> bool:
        """A simulated process gets no signals from the host."""
        del sig
        return False
