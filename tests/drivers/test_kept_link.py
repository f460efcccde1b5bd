"""A link that is lived with again and again, whatever its transport."""

import asyncio
from collections.abc import Awaitable, Callable

from linemate.drivers.backoff import Backoff
from linemate.drivers.kept_link import KeptLink

QUICK = 1e-4, 2e-4


class Scripted(KeptLink):
    """Each life is the next of some; the last one lasts."""

    def __init__(self, *lives: Callable[[KeptLink], Awaitable[str]]) -> None:
        super().__init__("scripted", Backoff(*QUICK))
        self.lives = list(lives)
        self.reasons: list[str] = []
        self.settled = asyncio.Event()

    async def _run_once(self) -> str:
        self.reasons.append(self.status.reason)
        if not self.lives:
            self.status.mark_up()
            self.settled.set()
            await asyncio.Event().wait()
        return await self.lives.pop(0)(self)


async def refused(_: KeptLink) -> str:
    return "no such port"


async def lost(link: KeptLink) -> str:
    link.status.mark_up()
    return "unplugged"


async def settled(link: Scripted) -> None:
    link.open()
    await asyncio.wait_for(link.settled.wait(), 10.0)


def test_a_life_that_ends_is_a_reason_and_the_next_one_begins() -> None:
    async def main() -> None:
        link = Scripted(refused, lost)
        await settled(link)
        assert link.reasons == ["not opened", "no such port", "unplugged"]
        assert link.status.up
        assert link.counters == {"opened": 2, "lost": 1}
        link.close()
        await link.wait_closed()

    asyncio.run(main())


def test_what_is_open_is_not_opened_twice_and_what_is_closed_may_be_opened_again() -> None:
    async def main() -> None:
        link = Scripted()
        await settled(link)
        link.open()
        await asyncio.sleep(0)
        assert link.counters == {"opened": 1}
        link.close()
        await link.wait_closed()
        assert (link.status.up, link.status.reason) == (False, "closed")
        assert "lost" not in link.counters
        link.settled.clear()
        await settled(link)
        assert link.counters == {"opened": 2}
        link.close()
        await link.wait_closed()

    asyncio.run(main())


def test_one_that_was_never_opened_closes() -> None:
    async def main() -> None:
        link = Scripted()
        link.close()
        await link.wait_closed()

    asyncio.run(main())
