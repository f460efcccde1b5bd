"""The reader of an slcan adapter: frames in one call, and lines that are none."""

import os
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass

import pytest

from linemate.drivers.slcan_reader import READ_BYTES, SlcanReader
from linemate.protocol.sensors.slcan import CanFrame, format_frame


@dataclass
class Line:
    """A pipe whose far end is written by the test."""

    reader: SlcanReader
    far: int

    def close(self) -> None:
        os.close(self.far)
        os.close(self.reader._descriptor)


@pytest.fixture
def line() -> Iterator[Line]:
    near, far = os.pipe()
    os.set_blocking(near, False)
    with closing(Line(SlcanReader(near), far)) as made:
        yield made


def test_all_frames_of_a_wake_come_by_one_system_call(
    line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent = [CanFrame(0x183, bytes((number, 2, 3, 4))) for number in range(20)]
    os.write(line.far, b"".join(map(format_frame, sent)))
    calls, read = [], os.read
    monkeypatch.setattr(os, "read", lambda *args: calls.append(args) or read(*args))
    assert line.reader.read() == sent
    assert len(calls) == 1
    assert line.reader.read() == []


def test_a_frame_in_two_portions_is_one_frame(line: Line) -> None:
    frame = CanFrame(0x1ABCDEF, b"\x01\x02", extended=True)
    data = format_frame(frame)
    os.write(line.far, data[:7])
    assert line.reader.read() == []
    os.write(line.far, data[7:])
    assert line.reader.read() == [frame]


def test_no_frame_is_lost_to_the_limit_of_a_wake(line: Line) -> None:
    sent = [CanFrame(0x183, bytes(8)) for _ in range(100)]
    os.write(line.far, b"".join(map(format_frame, sent)))
    assert 100 * len(format_frame(sent[0])) > 2 * READ_BYTES
    found = [line.reader.read() for _ in range(4)]
    assert [frame for frames in found for frame in frames] == sent
    assert len(found[0]) <= 34


@pytest.mark.parametrize(
    ("junk", "garbage", "refused", "others"),
    [
        (b"\xff\xfe\r", 1, 0, 0),
        (b"t183\xff\r", 1, 0, 0),
        (b"tXYZ4zz\r", 1, 0, 0),
        (b"t18340102\r", 0, 1, 0),
        (b"x\r", 1, 0, 0),
        (b"t1832" + 60 * b"0" + b"\r", 0, 1, 0),
        (b"d1832010200\r", 0, 0, 1),
        (b"\a", 0, 0, 0),
        (b"z\r\r\nV1013\r", 0, 0, 0),
    ],
)
def test_a_line_that_is_no_frame_costs_itself_alone(
    line: Line, junk: bytes, garbage: int, refused: int, others: int
) -> None:
    frame = CanFrame(0x183, b"\x01")
    os.write(line.far, junk + format_frame(frame))
    assert line.reader.read() == [frame]
    reader = line.reader
    assert (reader.garbage, reader.refused, reader.others) == (garbage, refused, others)


def test_the_extended_frame_of_a_candapter_is_read(line: Line) -> None:
    os.write(line.far, b"x0000018320102\r")
    assert line.reader.read() == [CanFrame(0x183, b"\x01\x02", extended=True)]


def test_a_line_that_has_ended_is_an_error(line: Line) -> None:
    os.close(line.far)
    with pytest.raises(OSError, match="Could not read"):
        line.reader.read()
    near, line.far = os.pipe()
    os.close(near)
