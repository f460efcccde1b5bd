"""A link whose transport is opened again whenever it ends.

Invariants:
    An end of the transport is a reason for the operator, never an exception for the loop.
    Only ``close`` ends the link for good.
"""

import asyncio
from abc import ABC, abstractmethod

from linemate.drivers.backoff import Backoff
from linemate.drivers.link import LinkStatus


class KeptLink(ABC):
    """Opens a transport, runs it until it ends, and opens it again after the back-off.

    Attributes:
        status: the link's visible state.
    """

    def __init__(self, name: str, backoff: Backoff | None = None) -> None:
        self.status = LinkStatus(name)
        self.counters = self.status.counters
        self._backoff = backoff or Backoff()
        self._task: asyncio.Task[None] | None = None

    def open(self) -> None:
        """Start to open the transport on the running loop, and to keep it open."""
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._keep_open())

    def close(self) -> None:
        """Begin to close; ``wait_closed`` returns when the transport is closed."""
        if self._task is not None:
            self._task.cancel()

    async def wait_closed(self) -> None:
        """Wait until the transport is closed."""
        if self._task is not None:
            await asyncio.wait([self._task])

    async def _keep_open(self) -> None:
        try:
            while True:
                self.status.mark_down(await self._run_once())
                await asyncio.sleep(self._backoff.next_delay())
        finally:
            self.status.mark_closed()

    @abstractmethod
    async def _run_once(self) -> str:
        """Open the transport, run it until it ends, and return why it ended.

        It calls ``status.mark_up`` when the transport is open, and resets the back-off when good
        data have arrived.
        """
