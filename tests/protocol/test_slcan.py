import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from linemate.protocol.sensors.distance import DistanceDecoder
from linemate.protocol.sensors.slcan import (
    BITRATES,
    MAX_LINE_BYTES,
    CanFrame,
    Command,
    CommandDecoder,
    CommandKind,
    LineDecoder,
    SlcanError,
    format_frame,
    parse_command,
    parse_frame,
)


@st.composite
def frames(draw: st.DrawFn) -> CanFrame:
    extended, remote = draw(st.booleans()), draw(st.booleans())
    can_id = draw(st.integers(0, (1 << (29 if extended else 11)) - 1))
    if remote:
        return CanFrame(can_id, b"", extended, remote, draw(st.integers(0, 8)))
    return CanFrame(can_id, draw(st.binary(max_size=8)), extended)


def test_a_frame_is_written_as_the_manual_writes_it() -> None:
    assert format_frame(CanFrame(0x183, bytes.fromhex("a05b0000"))) == b"t1834A05B0000\r"
    assert format_frame(CanFrame(0x90002, b"\x01", extended=True)) == b"T00090002101\r"
    assert format_frame(CanFrame(0x7FF, remote=True, length=8)) == b"r7FF8\r"
    assert format_frame(CanFrame(1, extended=True, remote=True)) == b"R000000010\r"
    assert format_frame(CanFrame(0x10, b"\xff"), stamp_ms=60_001) == b"t0101FF0001\r"


def test_a_distance_goes_from_the_line_through_the_dbc() -> None:
    frame = parse_frame(b"t1834A05B0000")
    sample = DistanceDecoder().decode(frame.can_id, frame.data, 5, frame.extended)
    assert sample is not None
    assert sample.position == pytest.approx(2.3456)


@given(frames(), st.sampled_from([None, 0, 59_999]))
def test_a_frame_survives_the_line(frame: CanFrame, stamp_ms: int | None) -> None:
    line = format_frame(frame, stamp_ms)
    assert len(line) <= MAX_LINE_BYTES + 1
    assert line.endswith(b"\r")
    assert parse_frame(line[:-1]) == frame
    assert parse_command(line[:-1]) == Command(CommandKind.TRANSMIT, line[:-1], frame=frame)


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"t",
        b"t18",
        b"t183",
        b"t1839",
        b"t183A",
        b"t8000",
        b"t1831",
        b"t1831A",
        b"t1831A0B",
        b"t1831A0123",
        b"t18310x",
        b"r1834A05B0000",
        b"r1839",
        b"T200000000",
        b"T1834A05B0000",
        b"x1830",
        b"t1831\xc3\xa9",
    ],
)
def test_what_is_no_frame_is_refused_with_its_line(line: bytes) -> None:
    with pytest.raises(SlcanError):
        parse_frame(line)


@pytest.mark.parametrize(
    "arguments",
    [
        {"can_id": 0x800},
        {"can_id": -1},
        {"can_id": 1 << 29, "extended": True},
        {"can_id": 1, "data": bytes(9)},
        {"can_id": 1, "data": b"\x01", "length": 2},
        {"can_id": 1, "data": b"\x01", "remote": True},
        {"can_id": 1, "remote": True, "length": 9},
    ],
)
def test_what_no_bus_carries_is_no_frame(arguments: dict[str, int]) -> None:
    with pytest.raises(SlcanError):
        CanFrame(**arguments)  # type: ignore[arg-type]


def test_what_python_can_writes_to_open_at_500_kbit_is_understood() -> None:
    commands = CommandDecoder().feed(b"C\rS6\r\rO\rt0030\rV\rN\rF\rZ1\rs031C\rL\r")
    kinds = [command.kind for command in commands]
    assert kinds == [
        CommandKind.CLOSE,
        CommandKind.BITRATE,
        CommandKind.EMPTY,
        CommandKind.OPEN,
        CommandKind.TRANSMIT,
        CommandKind.VERSION,
        CommandKind.SERIAL,
        CommandKind.FLAGS,
        CommandKind.STAMPS,
        CommandKind.BIT_TIMING,
        CommandKind.LISTEN,
    ]
    assert commands[1].value is not None
    assert BITRATES[commands[1].value] == 500_000
    assert commands[4].frame == CanFrame(3)
    assert commands[9].value == 0x031C


@pytest.mark.parametrize(
    "line", [b"O1", b"S", b"S9", b"S66", b"Sx", b"Z2", b"s03", b"Q", b"t003", b"\0", b"\xff"]
)
def test_what_is_no_command_is_invalid_and_counted(line: bytes) -> None:
    decoder = CommandDecoder()
    assert decoder.feed(line + b"\rO\r") == [
        Command(CommandKind.INVALID, line),
        Command(CommandKind.OPEN, b"O"),
    ]
    assert decoder.invalid == 1


def test_a_line_without_end_is_bounded_refused_and_followed_by_the_next() -> None:
    decoder = LineDecoder()
    for _ in range(1000):
        assert decoder.feed(b"t0030" * 20) == []
    assert len(decoder._buffer) <= MAX_LINE_BYTES + 1
    (overlong, following) = decoder.feed(b"\rO\r")
    assert parse_command(overlong).kind is CommandKind.INVALID
    assert following == b"O"
    assert decoder.overlong == 1


@given(
    st.lists(st.one_of(frames().map(format_frame), st.binary(max_size=45)), max_size=6), st.data()
)
@example([b"\n" * 50 + b"O\r"], None)
def test_a_stream_cut_anywhere_gives_the_same_commands(
    parts: list[bytes], data: st.DataObject | None
) -> None:
    wire = b"".join(parts)
    whole, cut, single = CommandDecoder(), CommandDecoder(), CommandDecoder()
    expected = whole.feed(wire)
    middle = data.draw(st.integers(0, len(wire))) if data is not None else len(wire) // 2
    assert cut.feed(wire[:middle]) + cut.feed(wire[middle:]) == expected
    assert [c for i in range(len(wire)) for c in single.feed(wire[i : i + 1])] == expected
    assert whole.invalid == cut.invalid == single.invalid


@given(st.binary(max_size=40))
def test_any_line_is_a_frame_or_an_slcan_error_and_always_a_command(line: bytes) -> None:
    command = parse_command(line)
    try:
        frame = parse_frame(line)
    except SlcanError:
        assert command.kind is not CommandKind.TRANSMIT
    else:
        assert command.frame == frame
