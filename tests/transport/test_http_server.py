"""HTTP server: what it answers and to whom, and that a slow client delays no other."""

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping

import pytest

from linemate.daemon.transport import http_server as serving
from linemate.daemon.transport.http_server import Answer, NoPageError, Page, Server
from linemate.daemon.view.broadcast_hub import MAX_SUBSCRIBERS, QUEUE_LENGTH, BroadcastHub
from linemate.daemon.view.page_routes import LiveRoutes, read_assets


def ask(path: str, query: Mapping[str, str]) -> Answer:
    if path == "/":
        return Page("text/plain", b"hello " + query.get("who", "you").encode())
    if path == "/stream":
        return endless()
    raise NoPageError(f"nothing at {path}")


async def endless() -> AsyncIterator[bytes]:
    while True:
        yield b"x" * 100_000
        await asyncio.sleep(0)


def opened(test: Callable[[Server], Awaitable[None]], host: str = "127.0.0.1") -> Server:
    server = Server(ask, host)

    async def main() -> None:
        await server.open()
        try:
            await test(server)
        finally:
            await server.close()

    asyncio.run(main())
    return server


async def exchange(server: Server, request: bytes) -> bytes:
    reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
    writer.write(request)
    try:
        async with asyncio.timeout(20):
            return await reader.read()
    finally:
        writer.close()


def get(path: str, host: str = "127.0.0.1:80") -> bytes:
    return f"GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n".encode()


def test_a_page_is_given_with_its_kind_and_length_and_closed() -> None:
    async def test(server: Server) -> None:
        page = await exchange(server, get("/?who=me"))
        head, _, body = page.partition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 200 OK")
        assert b"Content-Length: 8" in head
        assert b"default-src 'self'" in head
        assert body == b"hello me"

    opened(test)


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        (get("/none"), b"404"),
        (get("/../../etc/passwd"), b"404"),
        (b"POST / HTTP/1.1\r\nHost: localhost\r\n\r\n", b"400"),
        (b"\x00\xff\r\n\r\n", b"400"),
        (b"GET / HTTP/1.1\r\n\r\n", b"421"),
        (get("/", "evil.example"), b"421"),
        (get("/", "127.0.0.1.evil.example:80"), b"421"),
        (get("/", "localhost:9"), b"200"),
        (get("/", "LocalHost:9"), b"200"),
        (get("/", "[::1]:9"), b"200"),
        (get("http://[bad"), b"400"),
        (get("/?" + "&".join("a=1" for _ in range(20))), b"400"),
    ],
)
def test_only_what_is_meant_for_it_is_answered(request_: bytes, status: bytes) -> None:
    async def test(server: Server) -> None:
        page = await exchange(server, request_)
        assert page.split(b" ")[1] == status, page

    opened(test)


def test_a_request_without_an_end_is_hung_up_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "HEAD_S", 0.2)

    async def test(server: Server) -> None:
        assert await exchange(server, b"GET / HTTP/1.1\r\n") == b""
        with contextlib.suppress(ConnectionResetError):
            assert await exchange(server, b"GET /" + b"a" * 20_000) == b""

    opened(test)


def test_more_connections_than_may_be_are_hung_up_on_and_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(serving, "MAX_CONNECTIONS", 3)

    async def test(server: Server) -> None:
        idle = [await asyncio.open_connection("127.0.0.1", server.port) for _ in range(3)]
        await asyncio.sleep(0.05)
        with contextlib.suppress(ConnectionResetError):
            assert await exchange(server, get("/")) == b""
        for _, writer in idle:
            writer.close()
        await asyncio.sleep(0.05)
        assert b"200 OK" in await exchange(server, get("/"))

    assert opened(test).refused == 1


def test_a_browser_that_does_not_read_is_hung_up_on_and_others_are_served(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(serving, "WRITE_S", 0.3)

    async def test(server: Server) -> None:
        stuck, writer = await asyncio.open_connection("127.0.0.1", server.port, limit=1024)
        writer.write(get("/stream"))
        began = time.monotonic()
        while server._tasks or time.monotonic() - began < 0.1:
            assert b"200 OK" in await exchange(server, get("/"))
            assert time.monotonic() - began < 20.0
        writer.close()
        del stuck

    opened(test)


def test_the_stream_ends_with_its_browser_and_its_place_is_given_back() -> None:
    hub = BroadcastHub()
    routes = LiveRoutes(hub, "here")
    server = Server(routes.ask)

    async def main() -> None:
        await server.open()
        reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
        writer.write(get("/stream"))
        async with asyncio.timeout(10):
            assert b"text/event-stream" in await reader.readuntil(b"\r\n\r\n")
            await reader.readuntil(b"\n\n")
            hub.push_frame({"k": 1})
            assert b'"k":1' in await reader.readuntil(b"\n\n")
            assert hub.subscribers == 1
            writer.close()
            while hub.subscribers:
                hub.push_frame({"k": 2})
                await asyncio.sleep(0.01)
        await server.close()

    asyncio.run(main())


def test_every_file_of_the_page_is_there_and_asks_for_nothing_from_elsewhere() -> None:
    found = read_assets()
    assert {"/", "/index.html", "/main.js", "/view.css", "/picture.js"} <= set(found)
    for path, asset in found.items():
        page = asset.body.replace(b"http://www.w3.org/2000/svg", b"")
        assert b"http://" not in page, path
        assert b"https://" not in page, path
        assert b"//cdn" not in page, path


def test_a_page_too_many_is_refused_with_a_time_to_come_again() -> None:
    async def main() -> None:
        hub = BroadcastHub()
        routes = LiveRoutes(hub, "here")
        with contextlib.ExitStack() as stack:
            for _ in range(MAX_SUBSCRIBERS):
                stack.enter_context(hub.subscribe())
            stream = routes.ask("/stream", {})
            assert not isinstance(stream, Page)
            page = [part async for part in stream]
        assert len(page) == 1
        assert page[0].startswith(b"retry: 5000\nevent: link\n")
        assert b"pages are open" in page[0]

    asyncio.run(main())


def test_what_was_dropped_can_be_asked_for() -> None:
    hub = BroadcastHub()
    with hub.subscribe():
        for k in range(QUEUE_LENGTH + 1):
            hub.push_frame({"k": k})
    page = LiveRoutes(hub, "here").ask("/mode", {})
    assert isinstance(page, Page)
    assert json.loads(page.body) == {
        "mode": "live", "source": "here", "frames": QUEUE_LENGTH + 1, "dropped": 2,
    }  # fmt: skip
