"""A serial port behind a TCP server: it appears, is opened, closed and unplugged."""

import socket

from loops import run, until

from linemate.simulators.devices.links.tcp_port import TcpPort

LOOPBACK = ("127.0.0.1", 0)


def opened(port: TcpPort) -> socket.socket:
    host, _, number = port.path.removeprefix("socket://").partition(":")
    line = socket.create_connection((host, int(number)))
    line.setblocking(False)
    return line


def read(line: socket.socket) -> bytes:
    try:
        return line.recv(4096)
    except BlockingIOError:
        return b"-"


def test_nothing_waits_for_a_later_opener() -> None:
    async def main() -> None:
        port = TcpPort(lambda _: None, LOOPBACK)
        port.plug()
        assert not port.write(b"stale")
        assert port.dropped_bytes == 5
        line = opened(port)
        await until(lambda: port.attended)
        assert port.write(b"fresh")
        assert read(line) == b"fresh"
        line.close()
        await until(lambda: not port.attended)
        assert not port.write(b"stale")
        port.unplug()

    run(main())


def test_both_directions_carry_every_byte() -> None:
    async def main() -> None:
        heard = bytearray()
        port = TcpPort(heard.extend, LOOPBACK)
        port.plug()
        line = opened(port)
        await until(lambda: port.attended)
        line.send(bytes(range(256)))
        await until(lambda: len(heard) == 256)
        assert heard == bytes(range(256))
        assert port.write(bytes(range(255, -1, -1)))
        assert read(line) == bytes(range(255, -1, -1))
        line.close()
        port.unplug()

    run(main())


def test_a_second_client_is_turned_away_and_the_first_one_keeps_the_line() -> None:
    async def main() -> None:
        port = TcpPort(lambda _: None, LOOPBACK)
        port.plug()
        first = opened(port)
        await until(lambda: port.attended)
        second = opened(port)
        await until(lambda: read(second) == b"")
        assert port.write(b"for the first")
        assert read(first) == b"for the first"
        first.close()
        second.close()
        port.unplug()

    run(main())


def test_unplugging_ends_the_line_and_plugging_opens_the_same_port() -> None:
    async def main() -> None:
        port = TcpPort(lambda _: None, LOOPBACK)
        port.plug()
        where = port.path
        line = opened(port)
        await until(lambda: port.attended)
        port.unplug()
        assert (port.path, port.attended) == ("", False)
        assert read(line) == b""
        line.close()
        port.plug()
        assert port.path == where
        line = opened(port)
        await until(lambda: port.attended)
        line.close()
        port.unplug()

    run(main())


def test_what_a_client_does_not_read_is_dropped_and_counted() -> None:
    async def main() -> None:
        port = TcpPort(lambda _: None, LOOPBACK)
        port.plug()
        line = opened(port)
        await until(lambda: port.attended)
        lost = 0
        for _ in range(1000):
            lost += not port.write(bytes(65536))
        assert lost > 0
        assert port.dropped_bytes > 0
        line.close()
        port.unplug()

    run(main())
