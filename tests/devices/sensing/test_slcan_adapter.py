"""The adapter's answers, and when it lets frames through."""

from hypothesis import given
from hypothesis import strategies as st

from linemate.protocol.sensors.slcan import CanFrame
from linemate.simulators.devices.sensing.slcan_adapter import SlcanAdapter

FRAME = CanFrame(0x183, b"\x01\x02\x03\x04")


def test_frames_pass_only_while_the_channel_is_open() -> None:
    adapter = SlcanAdapter()
    assert adapter.forward(FRAME) == b""
    assert adapter.feed(b"S6\rO\r") == b"\r\r"
    assert adapter.forward(FRAME) == b"t183401020304\r"
    assert adapter.feed(b"C\r") == b"\r"
    assert adapter.forward(FRAME) == b""
    assert (adapter.forwarded, adapter.withheld) == (1, 2)


def test_commands_out_of_order_are_refused_and_counted() -> None:
    adapter = SlcanAdapter()
    assert adapter.feed(b"t1230\r") == b"\a"
    assert adapter.feed(b"O\rO\rS6\rnonsense\r") == b"\r\a\a\a"
    assert adapter.refused == 4


def test_what_the_host_sends_reaches_the_bus_unless_listening() -> None:
    adapter = SlcanAdapter()
    adapter.feed(b"O\r")
    assert adapter.feed(b"t12321122\rT0000012310A\r") == b"z\rZ\r"
    assert [frame.data for frame in adapter.received] == [b"\x11\x22", b"\x0a"]
    adapter.feed(b"C\rL\r")
    assert adapter.feed(b"t12321122\r") == b"\a"


def test_version_serial_number_and_flags_are_reported() -> None:
    assert SlcanAdapter().feed(b"V\rN\rF\r\r") == b"V1013\rNLM01\rF00\r\r"


def test_stamps_are_reported_when_asked_for() -> None:
    adapter = SlcanAdapter()
    adapter.feed(b"Z1\rO\r")
    assert adapter.forward(FRAME, time_ms=61_000) == b"t18340102030403E8\r"


def test_power_off_closes_the_channel() -> None:
    adapter = SlcanAdapter()
    adapter.feed(b"S6\rO\r")
    adapter.reset()
    assert not adapter.is_open
    assert adapter.bitrate_code is None


@given(st.lists(st.binary(max_size=40), max_size=20))
def test_any_bytes_are_answered_line_by_line(pieces: list[bytes]) -> None:
    adapter = SlcanAdapter()
    answers = b"".join(adapter.feed(piece) for piece in pieces)
    lines = b"".join(pieces).count(b"\r")
    assert answers.count(b"\r") + answers.count(b"\a") == lines
