"""A serial port that appears, is opened, closed and unplugged."""

import os
import tty
from pathlib import Path

import pytest
from loops import run, until

from linemate.simulators.devices.links.pty_port import PtyPort


def _open(path: str | Path) -> int:
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    tty.setraw(descriptor)
    return descriptor


def _read(descriptor: int) -> bytes:
    try:
        return os.read(descriptor, 4096)
    except BlockingIOError:
        return b""


def test_nothing_waits_for_a_later_opener() -> None:
    async def main() -> None:
        port = PtyPort(lambda data: None)
        port.plug()
        assert not port.write(b"stale")
        assert port.dropped_bytes == 5
        host = _open(port.path)
        await until(lambda: port.attended)
        assert port.write(b"fresh")
        assert _read(host) == b"fresh"
        os.close(host)
        await until(lambda: not port.attended)
        assert not port.write(b"stale")
        host = _open(port.path)
        await until(lambda: port.attended)
        assert _read(host) == b""
        os.close(host)
        port.unplug()

    run(main())


def test_both_directions_carry_every_byte() -> None:
    async def main() -> None:
        heard = bytearray()
        opened: list[int] = []
        port = PtyPort(heard.extend, on_opened=lambda: opened.append(1))
        port.plug()
        host = _open(port.path)
        await until(lambda: bool(opened))
        every = bytes(range(256))
        os.write(host, every)
        await until(lambda: len(heard) == 256)
        assert bytes(heard) == every
        assert port.write(every)
        assert _read(host) == every
        os.close(host)
        port.unplug()

    run(main())


def test_a_reader_that_does_not_read_costs_bytes_and_not_time() -> None:
    async def main() -> None:
        port = PtyPort(lambda data: None)
        port.plug()
        host = _open(port.path)
        await until(lambda: port.attended)
        for _ in range(100):
            port.write(b"x" * 4096)
        assert port.dropped_bytes > 0
        os.close(host)
        port.unplug()

    run(main())


def test_unplugging_is_an_error_at_the_other_end(tmp_path: Path) -> None:
    async def main() -> None:
        link = tmp_path / "port"
        port = PtyPort(lambda data: None, link=link)
        port.plug()
        host = _open(link)
        await until(lambda: port.attended)
        port.unplug()
        assert not link.is_symlink()
        with pytest.raises(OSError, match="Input/output"):
            os.write(host, b"x")
        os.close(host)
        port.plug()
        host = _open(link)
        await until(lambda: port.attended)
        os.close(host)
        port.unplug()

    run(main())
