"""Bytes come out of the read-ahead as they went into the port."""

import os
import pty
import random
import select
import socket
import tty
from collections.abc import Iterator

import pytest
import serial

from linemate.drivers.read_ahead import MOST_BYTES, ReadAhead


@pytest.fixture
def ends() -> Iterator[tuple[int, serial.Serial]]:
    master, slave = pty.openpty()
    tty.setraw(slave)
    with serial.Serial(os.ttyname(slave), timeout=0) as port:
        yield master, port
    os.close(slave)
    os.close(master)


def test_the_same_bytes_come_in_the_same_order(ends: tuple[int, serial.Serial]) -> None:
    master, port = ends
    ahead = ReadAhead(port)
    draw = random.Random(4)
    sent = draw.randbytes(2000)
    received = b""
    for at in range(0, len(sent), 250):
        os.write(master, sent[at : at + 250])
        while len(received) < at + 250:
            received += ahead.read(draw.randint(1, 40))
    assert received == sent
    assert ahead.in_waiting == 0
    assert ahead.read(1) == b""


def test_no_more_is_kept_than_a_wake_takes(ends: tuple[int, serial.Serial]) -> None:
    master, port = ends
    ahead = ReadAhead(port)
    os.write(master, bytes(1000))
    while port.in_waiting < 1000:
        pass  # the kernel hands a pty's bytes over by and by
    assert ahead.read(1) == b"\0"
    assert ahead.in_waiting == MOST_BYTES - 1
    assert port.in_waiting == 1000 - MOST_BYTES


def test_what_is_forgotten_is_forgotten_in_both(ends: tuple[int, serial.Serial]) -> None:
    master, port = ends
    ahead = ReadAhead(port)
    os.write(master, bytes(500))
    while port.in_waiting < 500:
        pass
    ahead.read(1)
    ahead.reset_input_buffer()
    assert (ahead.in_waiting, port.in_waiting) == (0, 0)
    assert ahead.fileno() == port.fileno()


def test_a_socket_is_read_in_portions_too() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        where = "socket://{}:{}".format(*server.getsockname())
        with serial.serial_for_url(where, timeout=0) as port:
            line, _ = server.accept()
            ahead = ReadAhead(port)
            assert ahead.in_waiting == 0
            line.sendall(bytes(range(100)))
            select.select([port.fileno()], [], [], 5.0)
            assert ahead.in_waiting == 100
            assert b"".join(ahead.read(1) for _ in range(100)) == bytes(range(100))
            assert ahead.in_waiting == 0
            line.close()
            select.select([port.fileno()], [], [], 5.0)
            with pytest.raises(serial.SerialException, match="disconnected"):
                _ = ahead.in_waiting
