"""The reader of telegrams: garbage, and the fast way, which decides as the tolerant one."""

import re
from importlib.resources import files

from hypothesis import example, given, settings
from hypothesis import strategies as st
from rsi_layout import KUKA_SDK, PLAIN, config

from linemate.protocol.rsi.codec import (
    MAX_TELEGRAM_BYTES,
    RobotTelegram,
    RsiCodec,
    RsiError,
    SensorTelegram,
    parse_config,
)

DATA = files("linemate.protocol") / "data"
SETPOINTS = parse_config((DATA / "rsi_joints_setpoints.xml").read_bytes())

ROUND_TRIP = RsiCodec(SETPOINTS)
SAMPLE = ROUND_TRIP.format_robot(
    RobotTelegram(
        123456,
        b"0000123456",
        joints=(0.1, -1.5, 1.5, 0.0, 0.7, 0.0),
        joint_setpoints=(0.1, -1.5, 1.5, 0.0, 0.7, 0.0),
        external=(1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        tcp=(1.0, 2.0, 3.0, 0.1, 0.2, 0.3),
        tcp_setpoint=(1.0, 2.0, 3.0, 0.1, 0.2, 0.3),
        delay=3,
        channels={"DiL": 2},
    )
)
REPLY = ROUND_TRIP.format_sensor(
    SensorTelegram(7, joints=(0.1,) * 6, external=(0.2,), channels={"DiO": 1})
)
FRAGMENTS = st.sampled_from(
    [
        *b"< > / </ /> = \" ' & &lt; <Rob> </Rob> <IPOC> </IPOC> 1 - . e5 nan AIPos <!".split(),
        *(b' A1="1"', b"\0", b" ", b"\r\n", b"\xff"),
    ]
)


def outcome(read, data: bytes) -> object:
    try:
        return read(data)
    except RsiError as error:
        return None if error.reason else error


@given(st.one_of(st.binary(max_size=300), st.lists(FRAGMENTS, max_size=40).map(b"".join)))
@example(b"")
@example(b"<")
@example(b"<a")
@example(b"<?xml")
@example(b"</a>")
@example(b"<Rob/>")
def test_any_bytes_give_a_telegram_or_the_one_error(data: bytes) -> None:
    for read in (ROUND_TRIP.parse_robot, ROUND_TRIP.parse_sensor, parse_config):
        outcome(read, data)
        outcome(read, b"<Rob>" + data + b"</Rob>")


def test_a_telegram_cut_anywhere_is_refused() -> None:
    for data, read in ((SAMPLE, ROUND_TRIP.parse_robot), (REPLY, ROUND_TRIP.parse_sensor)):
        assert outcome(read, data) is not None
        for cut in range(len(data)):
            assert outcome(read, data[:cut]) is None
            outcome(read, data[cut:])


def test_a_configuration_cut_anywhere_is_refused() -> None:
    data = (DATA / "rsi_joints.xml").read_bytes().rstrip()
    for cut in range(len(data)):
        assert outcome(parse_config, data[:cut]) is None


@st.composite
def mutated(draw: st.DrawFn, original: bytes) -> bytes:
    data = bytearray(original)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(data) - 1))
        match draw(st.integers(0, 3)):
            case 0:
                data[at] ^= 1 << draw(st.integers(0, 7))
            case 1:
                data[at:at] = draw(FRAGMENTS)
            case 2:
                del data[at : at + draw(st.integers(1, 20))]
            case _:
                data[at:at] = data[at : at + draw(st.integers(1, 60))]
    return bytes(data)


@settings(max_examples=300)
@given(mutated(SAMPLE), mutated(REPLY))
def test_the_fast_way_never_decides_otherwise_than_the_tolerant(
    robot: bytes, sensor: bytes
) -> None:
    for reader, data in ((ROUND_TRIP.robot_reader, robot), (ROUND_TRIP.sensor_reader, sensor)):

        def tolerant(data: bytes, reader=reader) -> object:
            return reader._read_tolerantly(data)

        by_either = outcome(reader.read, data)
        if len(data) <= MAX_TELEGRAM_BYTES and b"<!" not in data:
            assert by_either == outcome(tolerant, data)


# --- the fast way --------------------------------------------------------------------------


def test_the_codecs_own_writing_is_read_fast_from_the_first_telegram() -> None:
    codec = RsiCodec(SETPOINTS)
    for _ in range(5):
        codec.parse_robot(SAMPLE)
        codec.parse_sensor(REPLY)
    assert (codec.robot_reader.fast, codec.robot_reader.tolerant) == (5, 0)
    assert (codec.sensor_reader.fast, codec.sensor_reader.tolerant) == (5, 0)


def test_a_foreign_shape_is_learned_after_some_telegrams() -> None:
    codec = RsiCodec(PLAIN)
    foreign = KUKA_SDK.replace(b"/>", b" />").replace(b"<RIst", b'<New a="1">x</New><RIst')
    other = foreign.replace(b'a="1">x', b'a="2">yy').replace(b'D="15"', b'D="-3.00"')
    for _ in range(3):
        codec.parse_robot(foreign)
    assert codec.robot_reader.tolerant == 3
    assert codec.parse_robot(other).delay == -3
    assert codec.robot_reader.fast == 1


def test_shapes_that_alternate_are_learned_ever_more_rarely() -> None:
    codec = RsiCodec(PLAIN)
    patterns = set()
    for n in range(400):
        codec.parse_robot(KUKA_SDK.replace(b"<RIst", b"<N%d/><RIst" % n))
        codec.parse_robot(KUKA_SDK.replace(b"<RIst", b'<N a%d="1"/><RIst' % n))
        patterns.add(codec.robot_reader._pattern.pattern)
    assert len(patterns) <= 10


def test_only_a_telegram_with_the_next_counter_and_joints_in_reach_is_expected() -> None:
    codec = RsiCodec(config("DEF_AIPos DOUBLE INTERNAL"))
    joints = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
    expected = codec.robot_reader.expect(12, None, joints, 0.05)
    assert expected is not None
    for ipoc, moved, matches in ((12, 0.04, True), (13, 0.04, False), (12, 0.06, False)):
        telegram = RobotTelegram(ipoc, joints=(moved, *joints[1:]))
        assert expected.matches(codec.format_robot(telegram)) is matches


def test_a_robot_at_rest_is_expected_where_it_is_with_each_further_counter() -> None:
    codec = RsiCodec(config("DEF_AIPos DOUBLE INTERNAL"))
    joints = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
    for ipoc, reach in ((12, 0.05), (24, 0.05), (36, 0.01)):
        expected = codec.robot_reader.expect(ipoc, None, joints, reach)
        assert expected is not None
        for moved in (0.04, 0.06):
            telegram = RobotTelegram(ipoc, joints=(moved, *joints[1:]))
            assert expected.matches(codec.format_robot(telegram)) is (moved < reach)


def test_nothing_is_expected_without_joints_in_the_telegram() -> None:
    codec = RsiCodec(config("DEF_Delay LONG INTERNAL"))
    assert codec.robot_reader.expect(12, 0, (0.0,) * 6, 0.05) is None


def test_a_telegram_that_was_compared_before_its_reply_is_not_matched_again() -> None:
    reader = RsiCodec(SETPOINTS).robot_reader
    wanted = reader.parse(SAMPLE)
    assert wanted.joints is not None
    expected = reader.expect(wanted.ipoc, wanted.delay, wanted.joints, 0.05)
    assert expected is not None
    expected.matches(SAMPLE)
    reader._pattern = re.compile(b"of no telegram")
    tolerant = reader.tolerant
    assert reader.parse(SAMPLE) == wanted
    assert reader.tolerant == tolerant
    assert reader.parse(SAMPLE + b" ") == wanted
    assert reader.tolerant == tolerant + 1
