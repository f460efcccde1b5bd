"""The edges of the wires' windows, tried on both sides, and the numbers that the manuals give.

Numbers are written out: a test that takes a constant from the module says nothing of its value.
"""

import struct
from pathlib import Path

import msgpack
import pytest
from msgspec.structs import replace

from linemate.protocol.command import frame_codec, payloads, requests
from linemate.protocol.command.frame_codec import CommandError
from linemate.protocol.rsi.codec import RobotTelegram, RsiCodec, RsiError, parse_config
from linemate.protocol.rsi.telegram_layout import robot_layout
from linemate.protocol.rsi.xml_scan import scan
from linemate.protocol.sensors import slcan
from linemate.protocol.sensors.distance import DistanceDecoder, DistanceEncoder, DistanceError
from linemate.protocol.sensors.ft300 import Ft300Device, Ft300Host, Robotiq300Decoder, ft300_frame
from linemate.protocol.sensors.slcan import CanFrame, CommandDecoder, LineDecoder, SlcanError
from linemate.protocol.units import DEG

SHIPPED = (Path(__file__).resolve().parents[2] / "protocol/data/rsi_joints.xml").read_bytes()
ZEROS = (0.0,) * 6
MS = 1_000_000


# The robot.


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_that_is_as_far_as_it_may_be_is_not_expected(axis: int, sign: float) -> None:
    codec = RsiCodec(parse_config(SHIPPED))
    plain = RobotTelegram(12, joints=ZEROS, external=ZEROS, tcp=ZEROS, delay=0)
    codec.parse_robot(codec.format_robot(plain))
    telegram = codec.robot_reader.expect(24, 0, ZEROS, DEG)
    assert telegram is not None
    for degrees, expected in ((1.0, False), (0.999999, True)):
        joints = [0.0] * 6
        joints[axis] = sign * degrees * DEG
        data = codec.format_robot(replace(plain, ipoc=24, joints=tuple(joints)))
        assert telegram.matches(data) is expected


def test_more_or_fewer_joints_than_there_are_cannot_be_expected() -> None:
    codec = RsiCodec(parse_config(SHIPPED))
    for joints in (ZEROS[:5], (*ZEROS, 0.0)):
        with pytest.raises(ValueError, match="zip"):
            codec.robot_reader.expect(24, 0, joints, DEG)  # type: ignore[arg-type]


def test_a_configuration_of_256_kib_is_read_and_a_byte_more_is_not() -> None:
    padding = 262_144 - len(SHIPPED)
    assert parse_config(SHIPPED + b"\n" * padding) == parse_config(SHIPPED)
    with pytest.raises(RsiError, match="262145 bytes, at most 262144"):
        parse_config(SHIPPED + b"\n" * (padding + 1))


@pytest.mark.parametrize("place", ["IP_NUMBER", "PORT", "ONLYSEND"])
def test_of_a_wrong_setting_32_characters_are_shown(place: str) -> None:
    text = SHIPPED.decode()
    begin = text.index(f"<{place}>") + len(place) + 2
    wrong = text[:begin] + "x" * 40 + text[text.index(f"</{place}>") :]
    with pytest.raises(RsiError) as caught:
        parse_config(wrong.encode())
    assert "'" + "x" * 32 + "'" in str(caught.value)


@pytest.mark.parametrize(
    "tags",
    [
        ("AIPos", "EIPos", "RIst", "Delay"),
        ("AIPos", "Delay", "EIPos", "RIst"),
        ("Delay", "RIst", "AIPos", "EIPos"),
        ("EIPos", "RIst", "Delay", "AIPos"),
        ("EIPos", "AIPos"),
        ("RIst", "Delay"),
    ],
)
def test_elements_may_stand_in_any_order(tags: tuple[str, ...]) -> None:
    text = SHIPPED.decode()
    begin, end = text.index("<ELEMENTS>") + len("<ELEMENTS>"), text.index("</ELEMENTS>")
    kinds = {"Delay": "LONG"}
    elements = "".join(
        f'<ELEMENT TAG="DEF_{tag}" TYPE="{kinds.get(tag, "DOUBLE")}" INDX="INTERNAL"/>'
        for tag in tags
    )
    codec = RsiCodec(parse_config((text[:begin] + elements + text[end:]).encode()))
    six = tuple(0.1 * n for n in range(1, 7))
    telegram = RobotTelegram(
        24,
        joints=six if "AIPos" in tags else None,
        external=six[::-1] if "EIPos" in tags else None,
        tcp=(1.0, 2.0, 3.0, *six[:3]) if "RIst" in tags else None,
        delay=7 if "Delay" in tags else None,
    )
    read = codec.parse_robot(codec.format_robot(telegram))
    assert (read.ipoc, read.delay) == (24, telegram.delay)
    for name in ("joints", "external", "tcp"):
        assert getattr(read, name) == pytest.approx(getattr(telegram, name), abs=1e-9)


def test_a_number_has_one_to_sixteen_decimals() -> None:
    telegram = RobotTelegram(24, joints=ZEROS, external=ZEROS, tcp=ZEROS, delay=0)
    for decimals in (1, 16):
        codec = RsiCodec(parse_config(SHIPPED), decimals=decimals)
        assert codec.parse_robot(codec.format_robot(telegram)).joints == ZEROS
    for decimals in (0, 17):
        with pytest.raises(RsiError, match=f"{decimals} decimals, not 1..16"):
            RsiCodec(parse_config(SHIPPED), decimals=decimals)


@pytest.mark.parametrize(
    ("port", "is_one"), [("0", False), ("1", True), ("65535", True), ("65536", False)]
)
def test_a_port_is_one_to_65535(port: str, is_one: bool) -> None:
    text = SHIPPED.decode()
    begin, end = text.index("<PORT>") + 6, text.index("</PORT>")
    changed = (text[:begin] + port + text[end:]).encode()
    if is_one:
        assert parse_config(changed).port == int(port)
    else:
        with pytest.raises(RsiError, match=f"'{port}' is not a number in 1..65535"):
            parse_config(changed)


@pytest.mark.parametrize("generator", ["C1", "C2", "T1", "T2"])
def test_a_function_generator_has_ten_parameters_from_one_on(generator: str) -> None:
    element = f'<ELEMENT TAG="DEF_Tech.{generator}" TYPE="DOUBLE" INDX="INTERNAL"/>'.encode()
    plain = parse_config(SHIPPED)
    more = parse_config(SHIPPED.replace(b"</ELEMENTS>", element + b"</ELEMENTS>", 1))
    channels = robot_layout(more, ()).channels.keys() - robot_layout(plain, ()).channels.keys()
    assert channels == {f"Tech.{generator}{n}" for n in range(1, 11)}


@pytest.mark.parametrize(
    ("body", "is_flat"),
    [("<A/>", True), ("<A>1</A>", True), ("<A x='1'/>", True), ("<A><B/></A>", False)],
)
def test_a_document_is_flat_unless_a_child_has_children(body: str, is_flat: bool) -> None:
    assert scan(f"<Rob>{body}<IPOC>1</IPOC></Rob>").flat is is_flat


# The distance.

DBC = """VERSION ""
BS_:
BU_: S H
BO_ 100 Muxed: 6 S
 SG_ Which M : 0|8@1+ (1,0) [0|9] "" H
 SG_ Gap m2 : 8|32@1- (1,0) [0|0] "{unit}" H
"""


@pytest.mark.parametrize(
    ("unit", "metres"),
    [("m", 1.0), ("", 1.0), ("dm", 0.1), ("cm", 0.01), ("mm", 0.001), ("um", 0.000_001)],
)
def test_every_unit_of_length_becomes_metres(unit: str, metres: float) -> None:
    dbc = DBC.format(unit=unit)
    frame = (100, b"\x02" + struct.pack("<i", 12_000) + b"\0")
    assert DistanceEncoder(dbc, "Muxed", "Gap").encode(12_000 * metres) == frame
    sample = DistanceDecoder(dbc, "Muxed", "Gap").decode(*frame, 7)
    assert sample is not None
    assert sample.position == pytest.approx(12_000 * metres, rel=1e-12)


@pytest.mark.parametrize("unit", ["mm", "cm"])
def test_a_step_is_in_metres_whatever_unit_the_dbc_has(unit: str) -> None:
    dbc = DBC.format(unit=unit)
    sample = DistanceDecoder(dbc, "Muxed", "Gap", step=0.002).decode(
        100, b"\x02" + struct.pack("<i", 500) + b"\0", 7
    )
    assert sample is not None
    assert sample.position == pytest.approx(1.0, rel=1e-12)


def test_a_refusal_shows_sixteen_bytes_and_a_dash_for_none() -> None:
    assert str(DistanceError("no", 0x1A, bytes(range(20)))).endswith(
        "(id 0x1A, data 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f)"
    )
    assert str(DistanceError("no", 0x1A)).endswith("(id 0x1A, data -)")
    assert str(DistanceError("no")) == "distance: no"


def test_a_frame_of_64_bytes_is_read_and_a_longer_one_is_not() -> None:
    decoder = DistanceDecoder()
    assert decoder.decode(0x183, bytes(64), 7) is not None
    with pytest.raises(DistanceError, match="65 bytes instead of 4"):
        decoder.decode(0x183, bytes(65), 7)


# The CAN adapter.


def test_the_nine_bit_rates_are_those_of_the_manual() -> None:
    assert slcan.BITRATES == (
        10_000,
        20_000,
        50_000,
        100_000,
        125_000,
        250_000,
        500_000,
        800_000,
        1_000_000,
    )


@pytest.mark.parametrize(
    ("line", "value"),
    [
        (b"S0", 0),
        (b"S8", 8),
        (b"Z0", 0),
        (b"Z1", 1),
        (b"sFFFF", 0xFFFF),
        (b"MFFFFFFFF", 0xFFFFFFFF),
        (b"mFFFFFFFF", 0xFFFFFFFF),
        (b"m00000000", 0),
    ],
)
def test_a_value_is_taken_to_the_end_of_its_range(line: bytes, value: int) -> None:
    assert slcan.parse_command(line).value == value
    assert slcan.parse_command(line).kind is not slcan.CommandKind.INVALID


def test_identifiers_reach_to_11_and_29_bits_and_a_length_to_eight() -> None:
    assert CanFrame(0x7FF).length == CanFrame(0x1FFFFFFF, extended=True).length == 0
    assert CanFrame(0, bytes(8)).length == 8
    assert CanFrame(0, bytes(0), length=0).length == 0
    for bad in ({"can_id": 0x800}, {"can_id": 0x20000000, "extended": True}):
        with pytest.raises(SlcanError, match=f"identifier {bad['can_id']:#x} is out of range"):
            CanFrame(**bad)  # type: ignore[arg-type]
    with pytest.raises(SlcanError, match="length 9 does not fit"):
        CanFrame(0, bytes(9))
    with pytest.raises(SlcanError, match="length 0 does not fit"):
        CanFrame(0, b"\x01", length=0)


def test_a_stamp_is_that_of_a_minute() -> None:
    assert slcan.format_frame(CanFrame(0), 59_999) == b"t0000EA5F\r"
    assert slcan.format_frame(CanFrame(0), 60_000) == b"t00000000\r"


def test_a_refused_line_is_shown_to_its_32nd_byte() -> None:
    with pytest.raises(SlcanError) as caught:
        slcan.parse_frame(b"y" * 40)
    assert str(caught.value) == f"slcan: no frame: {b'y' * 32!r}"
    assert caught.value.line == b"y" * 40


def test_the_longest_line_is_whole_and_the_next_longer_one_is_counted() -> None:
    longest = b"T1FFFFFFF8" + b"0" * 16 + b"EA5F"
    assert len(longest) == 30
    lines = LineDecoder()
    assert lines.feed(longest + b"\r") == [longest]
    assert lines.overlong == 0
    assert slcan.parse_frame(longest).data == bytes(8)
    assert lines.feed(longest + b"0\r" + longest + b"00000\r") == [longest + b"0"] * 2
    assert lines.overlong == 2
    assert lines.feed(b"\n" + longest + b"\r\n") == [longest]
    assert lines.feed(longest + b"0") == []
    assert lines.feed(b"0\r") == [longest + b"0"]
    assert lines.overlong == 3


def test_only_lines_that_are_no_command_are_counted() -> None:
    commands = CommandDecoder()
    commands.feed(b"O\rS6\r\rV\rt0010\r")
    assert commands.invalid == 0
    commands.feed(b"x\rO\r?\r")
    assert commands.invalid == 2


# The force-torque sensor.


def test_a_wrench_saturates_at_the_ends_of_sixteen_bits() -> None:
    (sample,) = Robotiq300Decoder().feed(
        ft300_frame((400.0, -400.0, 327.67), (40.0, -40.0, -32.768)), 7
    )
    assert sample.force == pytest.approx((327.67, -327.68, 327.67), abs=1e-12)
    assert sample.torque == pytest.approx((32.767, -32.768, -32.768), abs=1e-12)


def test_the_ft300_host_waits_for_700_ms_and_asks_ten_times() -> None:
    host, now_ns, asked = Ft300Host(), 5 * MS, 1
    request = host.begin(now_ns).send
    assert request == b"\xff" * 50 + bytes.fromhex("0910019a00010202 00cdca")
    while host.failure is None:
        assert host.on_time(now_ns + 700 * MS - 1).send == b""
        assert host.failure is None
        now_ns += 700 * MS
        asked += host.on_time(now_ns).send == request
    assert asked == 10
    assert host.failure == "ft300: no answer after 10 attempts"
    assert host.begin(now_ns).send == request
    assert (host.failure, host.running) == (None, False)


def test_the_ft300_device_is_silent_again_after_its_boot() -> None:
    device = Ft300Device()
    start = bytes.fromhex("0910019a0001020200cdca")
    assert device.feed(start).startswith(bytes.fromhex("0910019a0001"))
    assert device.streaming
    assert device.feed(start) == b""
    assert device.feed(b"\xff" * 49 + b"\0") == b""
    assert device.streaming
    assert device.boot() == b""
    assert not device.streaming
    device.feed(b"\xff" * 30)
    device.boot()
    device.feed(start)
    assert device.feed(b"\xff" * 20) == b""
    assert device.streaming
    assert device.feed(b"\xff" * 30) == b""
    assert not device.streaming


# The commands.


def test_a_frame_is_cut_from_38_to_1200_bytes() -> None:
    head = struct.pack(">2sBBHQQ", b"LM", 1, 3, 7, 8, 9)
    assert len(head) == 22
    for size, is_cut in ((37, False), (38, True), (1200, True), (1201, False)):
        data = head + bytes(size - 22)
        if is_cut:
            frame = frame_codec.cut_frame(data)
            assert (len(frame.payload), frame.tag) == (size - 38, bytes(16))
            assert (frame.key_id, frame.session, frame.sequence) == (7, 8, 9)
        else:
            with pytest.raises(CommandError, match=f"length: {size} bytes"):
                frame_codec.cut_frame(data)
    for size, is_cut in ((21, False), (22, True), (1200, True), (1201, False)):
        data = head + bytes(max(0, size - 22)) if size >= 22 else head[:size]
        if is_cut:
            assert frame_codec.cut_local(data).tag == b""
        else:
            with pytest.raises(CommandError, match=f"length: {size} bytes"):
                frame_codec.cut_local(data)


@pytest.mark.parametrize(
    ("head", "what"),
    [
        ((b"ML", 1, 3), "magic: 4d4c"),
        ((b"LM", 2, 3), "version: 2"),
        ((b"LM", 0, 3), "version: 0"),
        ((b"LM", 1, 0), "type: 0"),
        ((b"LM", 1, 7), "type: 7"),
    ],
)
def test_a_foreign_head_is_named(head: tuple[bytes, int, int], what: str) -> None:
    with pytest.raises(CommandError) as caught:
        frame_codec.cut_frame(struct.pack(">2sBBHQQ", *head, 7, 8, 9) + bytes(16))
    assert str(caught.value) == what


def test_what_all_messages_share_is_as_specified() -> None:
    assert {kind.name: int(kind) for kind in frame_codec.FrameType} == {
        "HELLO": 1,
        "COOKIE": 2,
        "REQUEST": 3,
        "REPLY": 4,
        "EVENT": 5,
        "CLOSE": 6,
    }
    assert (frame_codec.TAG_BYTES, frame_codec.COOKIE_BYTES, frame_codec.HANDSHAKE_BYTES) == (
        16,
        16,
        54,
    )
    assert (frame_codec.MAX_FRAME_BYTES, frame_codec.PAYLOAD_BYTES) == (1200, 1162)
    assert (frame_codec.MAX_RESULT_BYTES, frame_codec.PAGE_BYTES, frame_codec.MAX_PAGES) == (
        65536,
        1024,
        64,
    )
    assert (frame_codec.LOCAL_PAYLOAD_BYTES, frame_codec.LOCAL_LIMIT_BYTES) == (65792, 65814)
    assert (frame_codec.NS_PER_MS, frame_codec.MAX_AHEAD_MS) == (1_000_000, 5000)


def test_an_event_is_a_map_of_its_time_and_its_data() -> None:
    data = payloads.encode_result({"a": 1, "b": "x"})
    event = payloads.encode_event(2**40, data)
    assert event == msgpack.packb({"t": 2**40, "d": {"a": 1, "b": "x"}})
    assert payloads.decode_event(event) == (2**40, {"a": 1, "b": "x"})


@pytest.mark.parametrize(
    ("time_ms", "is_one"), [(-1, False), (0, True), (2**63 - 1, True), (2**63, False), (1.0, False)]
)
def test_a_time_is_a_whole_number_of_63_bits(time_ms: float, is_one: bool) -> None:
    event = msgpack.packb({"t": time_ms, "d": {}})
    reply = msgpack.packb({"ok": True, "t": time_ms})
    request = msgpack.packb({"op": "status", "t": time_ms})
    if is_one:
        assert payloads.decode_event(event) == (time_ms, {})
        assert payloads.decode_reply(reply).t == time_ms
        assert requests.decode_request(request).deadline_ms == time_ms
    else:
        for decode, payload in (
            (payloads.decode_event, event),
            (payloads.decode_reply, reply),
            (requests.decode_request, request),
        ):
            with pytest.raises(CommandError, match="malformed: "):
                decode(payload)


ROW = [0.5, 1.0, 2.0, 0.5, 1.0, 0.0, 0.0, 0.0]
NAN = float("nan")


@pytest.mark.parametrize("op", sorted(requests.OPERATIONS))
def test_a_deadline_before_the_servers_beginning_is_its_beginning(op: str) -> None:
    params: dict[str, object] = {
        "get": {"names": ["a"]},
        "set": {"values": {"a": 1}},
        "record": {"action": "start"},
        "subscribe": {"rate_hz": 1.0},
        "page": {"of": 1, "page": 1},
        "announce": {"part": "P1", "variant": "sedan"},
        "follow": {"begin_ns": 7, "poses": []},
    }.get(op, {})  # type: ignore[assignment]
    for asked_ms, deadline_ms in ((-5, 0), (0, 0), (7, 7)):
        payload = requests.encode_request(op, params, asked_ms)
        assert requests.decode_request(payload) == (op, deadline_ms, params)


@pytest.mark.parametrize(
    ("op", "good", "bad"),
    [
        ("params", {"prefix": ""}, {"prefix": "a", "more": 1}),
        ("params", {"prefix": "a" * 96}, {"prefix": "a" * 97}),
        ("get", {"names": ["a"]}, {"names": []}),
        ("get", {"names": ["a"] * 32}, {"names": ["a"] * 33}),
        ("get", {"names": ["a" * 96]}, {"names": ["a" * 97]}),
        ("get", {"names": ["a"]}, {"names": [""]}),
        ("get", {"names": ["a"]}, {"names": ["a"], "more": 1}),
        ("follow", {"begin_ns": 0, "poses": [ROW] * 12}, {"begin_ns": 0, "poses": [ROW] * 13}),
        ("follow", {"begin_ns": 0, "poses": [ROW]}, {"begin_ns": 0, "poses": [ROW[1:]]}),
        ("follow", {"begin_ns": 0, "poses": [ROW]}, {"begin_ns": 0, "poses": [[*ROW, 1.0]]}),
        ("follow", {"begin_ns": 2**63 - 1, "poses": []}, {"begin_ns": -1, "poses": []}),
        ("follow", {"begin_ns": 0, "poses": [ROW]}, {"begin_ns": 0, "poses": [[*ROW[1:], NAN]]}),
        ("set", {"values": {"a": "x" * 512}}, {"values": {"a": "x" * 513}}),
        ("set", {"values": {"a": [1] * 64}}, {"values": {"a": [1] * 65}}),
        ("set", {"values": {"a" * 96: 1}}, {"values": {"a" * 97: 1}}),
        ("set", {"values": {"a": None}}, {"values": {}}),
        ("set", {"values": {"a": [1.5, "b", True]}}, {"values": {"a": [None]}}),
        ("set", {"values": {"a": 1}}, {"values": {"a": 1}, "more": 1}),
        ("record", {"action": "stop"}, {"action": "pause"}),
        ("record", {"action": "start"}, {"action": "start", "more": 1}),
        ("subscribe", {"rate_hz": 0.0}, {"rate_hz": -1e-9}),
        ("subscribe", {"rate_hz": 50.0}, {"rate_hz": 50.001}),
        ("subscribe", {"rate_hz": 1.0, "duration_s": 30.0}, {"rate_hz": 1.0, "duration_s": 30.001}),
        ("subscribe", {"rate_hz": 1.0, "duration_s": 1e-9}, {"rate_hz": 1.0, "duration_s": 0.0}),
        ("subscribe", {"rate_hz": 1.0}, {"rate_hz": 1.0, "more": 1}),
        ("page", {"of": 1, "page": 1}, {"of": 0, "page": 1}),
        ("page", {"of": 2**63 - 1, "page": 1}, {"of": 2**63, "page": 1}),
        ("page", {"of": 1, "page": 63}, {"of": 1, "page": 64}),
        ("page", {"of": 1, "page": 1}, {"of": 1, "page": 0}),
        ("page", {"of": 1, "page": 1}, {"of": 1, "page": 1, "more": 1}),
        ("stop", {}, {"more": 1}),
    ],
)
def test_parameters_are_taken_to_their_ends_on_both_sides(
    op: str, good: dict[str, object], bad: dict[str, object]
) -> None:
    payload = requests.encode_request(op, good, 7)
    assert requests.decode_request(payload) == (op, 7, good)
    with pytest.raises(CommandError, match="malformed: "):
        requests.encode_request(op, bad, 7)
    with pytest.raises(CommandError, match="malformed: "):
        requests.decode_request(msgpack.packb({"op": op, "t": 7, "p": bad}))


def test_an_operation_has_a_name_of_sixteen_letters_at_most() -> None:
    for size, kind in ((16, "unknown"), (17, "malformed")):
        with pytest.raises(CommandError) as caught:
            requests.decode_request(msgpack.packb({"op": "x" * size, "t": 7}))
        assert caught.value.kind == kind


def test_only_stop_and_retreat_are_taken_in_any_order_and_without_the_lease() -> None:
    table = {
        op: (str(rule.role), rule.lease, rule.ordered) for op, rule in requests.OPERATIONS.items()
    }
    viewing = dict.fromkeys(
        ("status", "params", "get", "scene", "sensors", "subscribe", "page", "queue"),
        ("view", False, False),
    )
    setting = dict.fromkeys(("set", "save", "record", "announce", "skip"), ("operate", False, True))
    moving = dict.fromkeys(
        ("arm", "start", "ack", "home", "next", "follow"), ("operate", True, True)
    )
    resting = dict.fromkeys(("stop", "retreat", "hold"), ("operate", False, False))
    assert table == viewing | setting | moving | resting
