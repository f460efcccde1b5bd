"""Waiting in tests of asyncio code: for a condition, with a bound, never for a time."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

T = TypeVar("T")


def run(main: Coroutine[Any, Any, T], timeout_s: float = 20.0) -> T:
    """Run a test's coroutine, bounded; an exception that reaches the loop fails the test."""
    escaped: list[dict[str, Any]] = []

    async def bounded() -> T:
        asyncio.get_running_loop().set_exception_handler(lambda _, what: escaped.append(what))
        return await asyncio.wait_for(main, timeout_s)

    result = asyncio.run(bounded())
    assert not escaped, escaped
    return result


async def until(condition: Callable[[], bool], timeout_s: float = 10.0) -> None:
    """Wait until a condition holds; fail if it does not within the bound."""
    loop = asyncio.get_running_loop()
    deadline = loop.time() + timeout_s
    while not condition():
        assert loop.time() < deadline, "it did not happen in time"
        await asyncio.sleep(0.002)
