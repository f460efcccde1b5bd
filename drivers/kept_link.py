"""A link whose life is one coroutine, and which is lived again when it ends.

Law of this file: whatever ends a life is a reason for the operator, never an exception for the
loop; the next one begins after the back-off. Closing is the only way to end for good.
"""

import asyncio
from abc import ABC, abstractmethod
from collections import Counter

from linemate.drivers.backoff import Backoff
from linemate.drivers.link import LinkStatus


class KeptLink(ABC):
    """A transport that is opened, lived with and opened again.

    Attributes:
        status: the link's visible state.
    """

    def __init__(self, name: str, backoff: Backoff | None = None) -> None:
        self.status = LinkStatus(name)
        self._backoff = backoff or Backoff()
        self._task: asyncio.Task[None] | None = None

    @property
    def counters(self) -> Counter[str]:
        """Events by name."""
        return self.status.counters

    def open(self) -> None:
        """Start to open the transport on the running loop, and to keep it open."""
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._keep_open())

    def close(self) -> None:
        """Stop; ``wait_closed`` returns when the transport is closed."""
        if self._task is not None:
            self._task.cancel()

    async def wait_closed(self) -> None:
        """Wait until nothing of the link is left."""
        if self._task is not None:
            await asyncio.wait([self._task])

    async def _keep_open(self) -> None:
        try:
            while True:
                self.status.mark_down(await self._live_once())
                await asyncio.sleep(self._backoff.next_delay())
        finally:
            self.status.mark_closed()

    @abstractmethod
    async def _live_once(self) -> str:
        """Open the transport and live with it until it ends; returns why it did.

        It calls ``status.mark_up`` once the link is there, and resets the back-off once the link
        has lived.
        """
