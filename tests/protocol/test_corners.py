"""Branches of the codecs that everyday telegrams never take."""

import math
import struct
from collections import Counter
from pathlib import Path

import cantools
import pytest
from command_ends import MS, START_NS, World, client_address, key_of

from linemate.protocol.command.authenticated import CommandClient
from linemate.protocol.command.client_core import Answer
from linemate.protocol.command.conversation import CommandOrder, ControlLease, Conversation
from linemate.protocol.command.frame_codec import (
    CommandError,
    FrameType,
    Role,
    cut_local,
    frame_body,
    local_body,
)
from linemate.protocol.command.local_server import LocalServer
from linemate.protocol.command.payloads import decode_reply
from linemate.protocol.command.preshared_keys import cookie_tagger
from linemate.protocol.command.requests import encode_request
from linemate.protocol.exchange import Exchange
from linemate.protocol.rsi.codec import (
    RobotTelegram,
    RsiCodec,
    RsiError,
    SensorTelegram,
    parse_config,
)
from linemate.protocol.sensors.distance import (
    DistanceDecoder,
    DistanceEncoder,
    DistanceError,
    message_names,
)
from linemate.protocol.sensors.distance_bits import find

SHIPPED = (Path(__file__).resolve().parents[2] / "protocol/data/rsi_joints.xml").read_bytes()
SIX = (0.1, -0.2, 0.3, -0.4, 0.5, -0.6)


def test_more_senders_than_are_remembered_are_written_all_the_same() -> None:
    codec = RsiCodec(parse_config(SHIPPED))
    for n in range(20):
        data = codec.format_sensor(
            SensorTelegram(7, sentype=f"S{n}", joints=SIX, external=(0.1,), channels={"DiO": 0})
        )
        assert data.startswith(b'<Sen Type="S%d">' % n)
        assert data == codec.format_sensor(
            SensorTelegram(7, sentype=f"S{n}", joints=SIX, external=(0.1,), channels={"DiO": 0})
        )


@pytest.mark.parametrize("wild", [math.nan, math.inf, -math.inf, 1e13])
@pytest.mark.parametrize("spare", [(), (0.0,), (0.5,)])
def test_a_correction_that_the_wire_cannot_carry_is_refused_next_to_any_other(
    wild: float, spare: tuple[float, ...]
) -> None:
    codec = RsiCodec(parse_config(SHIPPED))
    with pytest.raises(RsiError):
        codec.format_sensor(SensorTelegram(7, joints=SIX, external=(wild, *spare)))
    with pytest.raises(RsiError):
        codec.format_sensor(SensorTelegram(7, joints=(wild, *SIX[1:]), external=(0.0,)))


def test_axes_without_an_element_may_be_zero_and_nothing_else() -> None:
    codec = RsiCodec(parse_config(SHIPPED))
    codec.format_sensor(SensorTelegram(7, joints=SIX, external=(0.1, 0.0, 0.0)))
    with pytest.raises(RsiError, match="not in the configuration"):
        codec.format_sensor(SensorTelegram(7, joints=SIX, external=(0.1, 0.0, 0.2)))


def test_nothing_is_expected_of_a_delay_that_is_not_known() -> None:
    codec = RsiCodec(parse_config(SHIPPED))
    codec.parse_robot(
        codec.format_robot(RobotTelegram(12, joints=SIX, external=SIX, tcp=SIX, delay=0))
    )
    assert codec.robot_reader.expect(24, None, SIX, 0.05) is None
    assert codec.robot_reader.expect(24, 0, SIX, 0.05) is not None


def test_a_distance_beyond_its_place_is_refused() -> None:
    for value in (1e6, -1.0, math.nan):
        with pytest.raises(DistanceError):
            DistanceEncoder().encode(value)
    with pytest.raises(DistanceError):
        DistanceEncoder(message="TF03", signal="Distance", strength="Strength").encode(1.0, 1e6)


def test_the_telegram_that_is_foreseen_is_the_one_that_comes() -> None:
    exchange = Exchange(0.012)
    assert exchange.foreseen() is None
    for k in range(5):
        exchange.on_telegram(1000 + 12 * k, k * 12_000_000, "robot")
    assert exchange.foreseen() == (1060, "robot")
    exchange.on_missing()
    assert exchange.foreseen() is None
    assert exchange.on_telegram(1060, 60_000_000, "robot").answer


# What the daemon answers in haste.


def _foreseen(**changed: object) -> bool:
    """Whether a telegram with something else in it is still the one that was foreseen."""
    codec = RsiCodec(parse_config(SHIPPED))
    plain = {"joints": SIX, "external": SIX, "tcp": SIX, "delay": 0, "channels": {"DiL": 0}}
    codec.parse_robot(codec.format_robot(RobotTelegram(12, **plain)))  # type: ignore[arg-type]
    expected = codec.robot_reader.expect(24, 0, SIX, 0.05)
    assert expected is not None
    values = {"ipoc": 24, **plain, **changed}
    return expected.matches(codec.format_robot(RobotTelegram(**values)))  # type: ignore[arg-type]


def test_the_expected_telegram_is_known_by_counter_delay_and_place() -> None:
    assert _foreseen()
    assert _foreseen(external=(9.0,) * 6, tcp=(1.0,) * 6, channels={"DiL": 3})
    assert not _foreseen(ipoc=25)
    assert not _foreseen(ipoc=12)
    assert not _foreseen(delay=1)


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_a_telegram_is_expected_within_reach_of_each_joint_and_no_further(
    axis: int, way: float
) -> None:
    for share, expected in ((0.98, True), (1.02, False)):
        joints = list(SIX)
        joints[axis] += way * share * 0.05
        assert _foreseen(joints=tuple(joints)) is expected


def test_what_is_no_telegram_or_too_long_a_one_is_not_expected() -> None:
    codec = RsiCodec(parse_config(SHIPPED))
    telegram = RobotTelegram(12, joints=SIX, external=SIX, tcp=SIX, delay=0)
    codec.parse_robot(codec.format_robot(telegram))
    expected = codec.robot_reader.expect(24, 0, SIX, 0.05)
    assert expected is not None
    data = codec.format_robot(
        RobotTelegram(24, joints=SIX, external=SIX, tcp=SIX, delay=0, channels={})
    )
    assert expected.matches(data)
    assert not expected.matches(data[:-1])
    assert not expected.matches(b"")
    assert not expected.matches(data.replace(b"<IPOC>", b" " * 2048 + b"<IPOC>"))


# Sensors of other sites.

ODD_DBC = """VERSION ""
BS_:
BU_: S H
BO_ 100 Plain: 8 S
 SG_ Gap : 0|32@1- (1,0) [0|0] "m" H
 SG_ Echo : 32|32@1- (1,0) [0|0] "" H
BO_ 101 Encoder: 5 S
 SG_ Travel : 0|32@1- (0.5,-1000) [0|0] "mm" H
BO_ 102 Beyond: 2 S
 SG_ Low : 8|16@1+ (1,0) [0|0] "mm" H
 SG_ High : 0|16@0+ (1,0) [0|0] "mm" H
SIG_VALTYPE_ 100 Gap : 1;
SIG_VALTYPE_ 100 Echo : 1;
"""
SANE_DBC = ODD_DBC.partition("BO_ 102")[0] + ODD_DBC[ODD_DBC.index("SIG_VALTYPE_") :]


def test_a_dbc_tells_what_it_describes() -> None:
    assert message_names(SANE_DBC) == ("Plain", "Encoder")


def test_a_strength_that_is_not_finite_is_refused() -> None:
    decoder = DistanceDecoder(SANE_DBC, "Plain", "Gap", strength="Echo")
    good = decoder.decode(100, struct.pack("<ff", 2.0, 3.0), 7)
    assert good is not None
    assert (good.position, good.strength) == (2.0, 3.0)
    for wild in (math.nan, math.inf, -math.inf):
        with pytest.raises(DistanceError, match="Echo"):
            decoder.decode(100, struct.pack("<ff", 2.0, wild), 7)


def test_a_number_without_a_range_that_does_not_fit_is_refused() -> None:
    encoder = DistanceEncoder(SANE_DBC, "Encoder", "Travel")
    assert encoder.encode(1.0) == (101, struct.pack("<ib", 4000, 0))
    with pytest.raises(DistanceError, match="does not fit"):
        encoder.encode(1e9)


def test_places_are_found_for_whole_numbers_inside_their_message_only() -> None:
    dbc = cantools.database.load_string(ODD_DBC, "dbc", strict=False)
    assert find(dbc.get_message_by_name("Plain"), ["Gap"]) is None
    assert find(dbc.get_message_by_name("Encoder"), ["Travel"]) is not None
    assert find(dbc.get_message_by_name("Encoder"), ["Nothing"]) is None
    for name in ("Low", "High"):
        assert find(dbc.get_message_by_name("Beyond"), [name]) is None


# Operators.


def _local(counters: Counter[str] | None = None) -> LocalServer:
    return LocalServer("uid:1", Role.OPERATE, ControlLease(), counters or Counter())


def test_a_failed_handler_of_the_local_socket_is_answered() -> None:
    server = _local()
    payload = encode_request("arm", {}, START_NS // MS)
    order = server.on_message(local_body(FrameType.REQUEST, 0, 0, 1, payload), START_NS)
    assert isinstance(order, CommandOrder)
    reply = cut_local(server.fail(order, START_NS))
    assert reply.sequence == 1
    values = decode_reply(reply.payload)
    assert not values.ok
    assert values.e == "internal"


def test_local_telemetry_comes_when_it_is_due_and_to_those_who_want_it() -> None:
    counters: Counter[str] = Counter()
    server = LocalServer("uid:1", Role.VIEW, ControlLease(), counters)
    assert not server.subscribed
    assert server.event(START_NS, dict) is None
    payload = encode_request("subscribe", {"rate_hz": 50.0}, START_NS // MS)
    server.on_message(local_body(FrameType.REQUEST, 0, 0, 1, payload), START_NS)
    assert server.subscribed
    due = [server.event(START_NS + k * 10 * MS, lambda: {"a": 1}) is not None for k in range(10)]
    assert due == [True, False] * 5


def test_telemetry_that_does_not_fit_its_event_is_counted() -> None:
    counters: Counter[str] = Counter()
    server = LocalServer("uid:1", Role.VIEW, ControlLease(), counters)
    # A local message can hold the longest result: use a smaller limit.
    server._conversation = Conversation("uid:1", Role.VIEW, ControlLease(), 300, counters)
    payload = encode_request("subscribe", {"rate_hz": 50.0}, START_NS // MS)
    server.on_message(local_body(FrameType.REQUEST, 0, 0, 1, payload), START_NS)
    events = [
        server.event(START_NS + k * 20 * MS, lambda n=n: {"a": bytes(n)})  # type: ignore[misc]
        for k, n in enumerate(range(250, 310))
    ]
    fits = [one is not None for one in events]
    assert fits == sorted(fits, reverse=True)
    assert fits[0]
    assert not fits[-1]
    assert counters["events_too_long"] == events.count(None)
    assert all(len(cut_local(one).payload) <= 300 for one in events if one is not None)
    assert max(len(cut_local(one).payload) for one in events if one is not None) == 300


def test_nothing_is_sealed_before_the_handshake_is_answered() -> None:
    client = CommandClient(key_of(), 7)
    assert client.close() is None
    with pytest.raises(CommandError, match="no_session"):
        client.request("status", {}, 500 * MS)
    with pytest.raises(CommandError, match="no_session"):
        client._frame(FrameType.CLOSE, 1, b"")


def test_a_failed_handler_is_answered_while_its_session_lasts() -> None:
    world = World()
    client = world.client()
    sent = client.request("stop", {}, world.now_ns + 500 * MS)
    received = world.server.on_datagram(sent.frame, client_address(client), world.now_ns)
    assert received.request is not None
    values = world.server.fail(received.request, world.now_ns)
    assert values is not None
    answer = client.on_datagram(values, world.now_ns)
    assert isinstance(answer, Answer)
    assert answer.code == "internal"


def test_axes_in_another_order_are_written_at_their_places() -> None:
    swapped = SHIPPED.replace(b'"AK.A3"', b'"AK.X"').replace(b'"AK.A4"', b'"AK.A3"')
    codec = RsiCodec(parse_config(swapped.replace(b'"AK.X"', b'"AK.A4"')))
    reply = SensorTelegram(7, joints=SIX, external=(0.1,), channels={"DiO": 5})
    data = codec.format_sensor(reply)
    assert data.index(b"A4=") < data.index(b"A3=")
    values = codec.parse_sensor(data)
    assert values.joints == pytest.approx(SIX)
    assert values.channels["DiO"] == 5
    with pytest.raises(RsiError, match="too few"):
        codec.format_sensor(SensorTelegram(7, joints=SIX[:5], external=(0.1,)))  # type: ignore[arg-type]


def test_a_genuine_cookie_of_another_length_opens_no_session() -> None:
    key = key_of()
    client = CommandClient(key, 7)
    for length in (0, 1, 200):
        body = frame_body(FrameType.COOKIE, key.id, 7, 0, bytes(length))
        assert client.on_datagram(cookie_tagger(key).seal(body), 0) is None
    assert not client.ready
    assert client.counters["dropped_length"] == 3


def test_the_bits_of_a_botas_status_are_those_of_its_manual() -> None:
    from linemate.protocol.sensors import bota

    bits = bota.STATUS_SKIPPED, bota.STATUS_OVERRANGE, bota.STATUS_INVALID, bota.STATUS_RAW
    assert bits == (1, 2, 4, 8)


def test_frames_of_another_session_or_key_are_not_this_clients() -> None:
    key = key_of()
    client = CommandClient(key, 7)
    for other_key, session in ((key.id, 8), (key.id + 1, 7)):
        body = frame_body(FrameType.COOKIE, other_key, session, 0, bytes(24))
        assert client.on_datagram(cookie_tagger(key).seal(body), 0) is None
    assert not client.ready
    assert client.counters["dropped_session"] == 2
