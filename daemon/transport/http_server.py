"""Small HTTP/1.1 server for GET requests: whole pages and streams of server-sent events.

Invariants:
    * Connections, the length of a request, and the time to send and to read it are bounded.
    * It answers requests to its own host names alone (DNS rebinding).
"""

import asyncio
import contextlib
import ipaddress
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from typing import Final
from urllib.parse import parse_qsl, urlsplit

MAX_HEAD: Final = 8192
HEAD_S: Final = 5.0
WRITE_S: Final = 10.0
MAX_CONNECTIONS: Final = 32
HOSTS: Final = frozenset({"localhost", "127.0.0.1", "[::1]"})

HEADERS: Final = (
    "Cache-Control: no-store\r\n"
    "X-Content-Type-Options: nosniff\r\n"
    "Referrer-Policy: no-referrer\r\n"
    "Cross-Origin-Resource-Policy: same-origin\r\n"
    "Content-Security-Policy: default-src 'self'; img-src 'self' data:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'\r\n"
)


@dataclass(frozen=True, slots=True)
class Page:
    """A whole answer: media type and bytes."""

    kind: str
    body: bytes


class NoPageError(Exception):
    """There is no such page; the text says why."""


Answer = Page | AsyncIterator[bytes]  # a page, or a stream of server-sent events
# ask(path, query), called in the event loop: it must not block. It may raise NoPageError.
Ask = Callable[[str, Mapping[str, str]], Answer | Awaitable[Page]]


@dataclass(slots=True)
class Server:
    """The server.

    Attributes:
        ask: Returns what is at a path.
        head_s: Time for a whole request to arrive [s].
        names: Further host names of the server, in lower case.
        refused: Requests that were malformed or too many.
    """

    ask: Ask
    host: str = "127.0.0.1"
    port: int = 0
    head_s: float = HEAD_S
    names: frozenset[str] = frozenset()
    refused: int = 0
    _server: asyncio.Server | None = None
    _tasks: "set[asyncio.Task[None]]" = field(default_factory=set)

    async def open(self) -> None:
        """Listen.

        Raises:
            OSError: The port is taken.
        """
        self._server = await asyncio.start_server(self._serve, self.host, self.port, limit=MAX_HEAD)
        self.port = self._server.sockets[0].getsockname()[1]

    async def close(self) -> None:
        """Close the port and all connections."""
        if self._server is not None:
            self._server.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    @property
    def address(self) -> str:
        """URL for a browser."""
        name = self.host
        if ipaddress.ip_address(name).is_unspecified:
            name = "127.0.0.1"
        return f"http://{f'[{name}]' if ':' in name else name}:{self.port}/"

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        if task is not None:
            self._tasks.add(task)
        try:
            if len(self._tasks) <= MAX_CONNECTIONS:
                await self._answer(reader, writer)
            else:
                self.refused += 1
        except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass  # the client has gone, or does not read
        except asyncio.CancelledError:
            pass  # by ``close``, which waits for this task; asyncio would log it
        finally:
            if task is not None:
                self._tasks.discard(task)
            writer.transport.abort()

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        async with asyncio.timeout(self.head_s):
            head = await reader.readuntil(b"\r\n\r\n")
        try:
            path, query, host = _parse(head)
        except ValueError as error:
            self.refused += 1
            await _end(writer, _failure("400 Bad Request", str(error)))
            return
        if not self._is_ours(host):
            self.refused += 1
            await _end(writer, _failure("421 Misdirected Request", f"not {host!r}"))
            return
        try:
            answer = self.ask(path, query)
            if isinstance(answer, Awaitable):
                answer = await answer
        except NoPageError as error:
            await _end(writer, _failure("404 Not Found", str(error)))
            return
        if isinstance(answer, Page):
            await _end(writer, _head("200 OK", answer.kind, len(answer.body)) + answer.body)
            return
        await self._stream(answer, reader, writer)

    async def _stream(
        self,
        events: AsyncIterator[bytes],
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        await _write(writer, _head("200 OK", "text/event-stream", None))
        gone = asyncio.ensure_future(reader.read(1))
        try:
            async with contextlib.aclosing(events) as messages:  # type: ignore[type-var]
                async for data in messages:
                    if gone.done():
                        return
                    await _write(writer, data)
        finally:
            gone.cancel()
            await asyncio.gather(gone, return_exceptions=True)

    def _is_ours(self, host: str) -> bool:
        name = (host.rsplit(":", 1)[0] if not host.endswith("]") else host).lower()
        if name in HOSTS or name in self.names or name.strip("[]") == self.host:
            return True
        # It cannot know its names for other hosts, but a numeric address cannot be rebound.
        if not ipaddress.ip_address(self.host).is_loopback:
            with contextlib.suppress(ValueError):
                return ipaddress.ip_address(name.strip("[]")) is not None
        return False


def _parse(head: bytes) -> tuple[str, dict[str, str], str]:
    """Return path, query and host of a request's head.

    Raises:
        ValueError: It is not a GET request of HTTP/1.
    """
    first, *lines = head.decode("latin-1").split("\r\n")
    words = first.split(" ")
    if len(words) != 3 or not words[2].startswith("HTTP/1."):
        raise ValueError("not HTTP/1.1")
    if words[0] != "GET":
        raise ValueError("GET alone")
    fields = {
        name.strip().lower(): value.strip()
        for name, colon, value in (line.partition(":") for line in lines)
        if colon
    }
    parts = urlsplit(words[1])
    return parts.path, dict(parse_qsl(parts.query, max_num_fields=8)), fields.get("host", "")


def _head(status: str, kind: str, length: int | None) -> bytes:
    size = "" if length is None else f"Content-Length: {length}\r\n"
    text = f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\n{size}{HEADERS}Connection: close\r\n\r\n"
    return text.encode()


def _failure(status: str, text: str) -> bytes:
    body = f"{text}\n".encode()
    return _head(status, "text/plain; charset=utf-8", len(body)) + body


async def _write(writer: asyncio.StreamWriter, data: bytes) -> None:
    writer.write(data)
    async with asyncio.timeout(WRITE_S):
        await writer.drain()


async def _end(writer: asyncio.StreamWriter, data: bytes) -> None:
    await _write(writer, data)
    writer.close()
    async with asyncio.timeout(WRITE_S):
        await writer.wait_closed()
