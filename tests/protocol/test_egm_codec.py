import contextlib
import math
import struct
from dataclasses import dataclass
from typing import Any

import egm_witness as witness
import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linemate.protocol.egm import messages
from linemate.protocol.egm.egm_codec import EgmCodec
from linemate.protocol.egm.message_fields import MAX_MESSAGE_BYTES
from linemate.protocol.egm.protobuf_wire import (
    EgmError,
    bytes_field,
    double_field,
    doubles_field,
    number_field,
    read_fields,
    varint,
)

CODEC = EgmCodec()
SIX = tuple(math.radians(10.0 * n) for n in range(6))
HEADER = bytes_field(1, number_field(1, 5) + number_field(3, 2))
FEEDBACK = bytes_field(2, bytes_field(1, doubles_field(1, (0.0,) * 6)))
LEAST = HEADER + FEEDBACK

angles = st.floats(-6.3, 6.3)
sixes = st.tuples(*[angles] * 6)
axes = st.lists(st.floats(-10.0, 10.0), max_size=6).map(tuple)


@dataclass(frozen=True)
class Bad:
    """A message that is refused, and the words of its refusal."""

    data: bytes
    why: str


def with_feedback(body: bytes) -> bytes:
    return HEADER + bytes_field(2, body)


@pytest.mark.parametrize("robotware", [6, 7])
def test_a_message_of_the_protobuf_runtime_is_read_in_si_units(robotware: int) -> None:
    message = CODEC.parse_robot(witness.robot_message(robotware).SerializeToString())
    assert (message.sequence, message.time_ms) == (4711, 123456)
    feedback = message.feedback
    assert feedback.joints == pytest.approx(SIX)
    assert feedback.external == pytest.approx((1.5,))
    assert feedback.tcp_position == pytest.approx((0.1, 0.2, 0.3))
    assert feedback.tcp_quaternion == (1.0, 0.0, 0.0, 0.0)
    assert feedback.clock_us == 1_700_000_000_250_000
    assert message.planned.joints is not None
    assert message.planned.joints[0] == pytest.approx(math.radians(0.5))
    assert message.motors is messages.MotorState.ON
    assert message.guidance is messages.GuidanceState.RUNNING
    assert message.rapid is messages.RapidState.RUNNING
    assert message.is_converged is True
    assert message.utilization == 42.0


def test_the_measured_force_is_read_in_both_generations_without_a_setting() -> None:
    old = CODEC.parse_robot(witness.robot_message(6).SerializeToString())
    new = CODEC.parse_robot(witness.robot_message(7).SerializeToString())
    assert old.force == new.force == (1.0, 2.0, 3.0, 0.1, 0.2, 0.3)
    assert (old.is_force_active, new.is_force_active) == (None, True)
    assert (old.robotware, new.robotware) == (6, 7)


@pytest.mark.parametrize(("sent", "wanted"), [(6, 7), (7, 6)])
def test_the_other_generation_is_refused_with_both_named(sent: int, wanted: Any) -> None:
    data = witness.robot_message(sent).SerializeToString()
    with pytest.raises(EgmError, match=f"RobotWare {sent}: configured is {wanted}"):
        EgmCodec(robotware=wanted).parse_robot(data)
    assert EgmCodec(robotware=sent).parse_robot(data).robotware == sent  # type: ignore[arg-type]


def test_a_correction_of_the_protobuf_runtime_is_read_in_si_units() -> None:
    message = CODEC.parse_correction(witness.sensor_message().SerializeToString())
    assert message.sequence == 7
    assert message.joints == pytest.approx(tuple(math.radians(n) for n in range(1, 7)))
    assert message.external == pytest.approx((0.25,))
    assert message.joint_speeds is not None
    assert message.joint_speeds[5] == pytest.approx(math.radians(0.6))
    assert message.external_speeds == pytest.approx((0.08,))


def test_the_protobuf_runtime_reads_a_written_correction() -> None:
    sent = witness.sensor_message()
    back = witness.parse_sensor(
        CODEC.format_correction(CODEC.parse_correction(sent.SerializeToString()))
    )
    for kind in ("planned", "speedRef"):
        for axes_name in ("joints", "externalJoints"):
            written, wanted = (
                list(getattr(getattr(one, kind), axes_name).joints) for one in (back, sent)
            )
            assert written == pytest.approx(wanted)
    assert (back.header.seqno, back.header.tm, back.header.mtype) == (7, 99, 3)


@pytest.mark.parametrize("robotware", [6, 7])
def test_the_protobuf_runtime_reads_a_written_robot_message(robotware: int) -> None:
    sent = witness.robot_message(robotware)
    sent.ClearField("testSignals")
    written = CODEC.format_robot(CODEC.parse_robot(sent.SerializeToString()))
    back = witness.parse_robot(written, robotware)
    assert back.measuredForce == sent.measuredForce
    assert list(back.feedBack.joints.joints) == pytest.approx(list(sent.feedBack.joints.joints))
    assert back.feedBack.cartesian == sent.feedBack.cartesian
    assert back.planned.time == sent.planned.time
    assert (back.motorState.state, back.mciState.state, back.rapidExecState.state) == (1, 3, 2)
    assert back.mciConvergenceMet
    assert back.utilizationRate == 42.0


def test_a_force_without_values_is_written_and_read_as_such() -> None:
    feedback = messages.EgmPosition((0.0,) * 6)
    message = messages.RobotMessage(1, 2, feedback, is_force_active=False, robotware=7)
    back = CODEC.parse_robot(CODEC.format_robot(message))
    assert (back.force, back.is_force_active, back.robotware) == (None, False, 7)
    forces = msgspec.structs.replace(message, force=(1.0,), is_force_active=None, robotware=None)
    assert CODEC.parse_robot(CODEC.format_robot(forces)).robotware == 6


@given(sixes, axes, st.integers(0, 2**32 - 1), st.none() | sixes)
def test_a_correction_comes_back_from_its_bytes(
    joints: Any, external: tuple[float, ...], sequence: int, speeds: Any
) -> None:
    message = messages.CorrectionMessage(sequence, 3, joints, external, speeds, external)
    back = CODEC.parse_correction(CODEC.format_correction(message))
    assert back.sequence == sequence
    assert back.joints == pytest.approx(joints, abs=1e-12)
    assert back.external == pytest.approx(external, abs=1e-12)
    assert (back.joint_speeds is None) == (speeds is None)
    assert witness.parse_sensor(CODEC.format_correction(message)).header.seqno == sequence


@given(
    sixes, axes, sixes, st.sampled_from(messages.MotorState), st.sampled_from(messages.RapidState)
)
def test_a_robot_message_comes_back_from_its_bytes(
    joints: Any,
    external: tuple[float, ...],
    planned: Any,
    motors: messages.MotorState,
    rapid: messages.RapidState,
) -> None:
    message = messages.RobotMessage(
        1,
        2,
        messages.EgmPosition(joints, external),
        messages.EgmPosition(planned),
        motors,
        rapid=rapid,
    )
    back = CODEC.parse_robot(CODEC.format_robot(message))
    assert back.feedback.joints == pytest.approx(joints, abs=1e-12)
    assert back.planned.joints == pytest.approx(planned, abs=1e-12)
    assert (back.motors, back.rapid) == (motors, rapid)


@pytest.mark.parametrize("robotware", [6, 7])
def test_a_message_cut_anywhere_is_refused_or_whole(robotware: int) -> None:
    data = witness.robot_message(robotware).SerializeToString()
    whole = CODEC.parse_robot(data)
    for n in range(len(data)):
        try:
            cut = CODEC.parse_robot(data[:n])
        except EgmError:
            continue
        # Cut at the end of a field: what is there is right, what is missing is missing.
        assert cut.feedback == whole.feedback
        assert cut.force in {None, whole.force}


def test_unknown_fields_are_skipped_at_every_level() -> None:
    unknown = number_field(900, 5) + bytes_field(901, b"x") + double_field(902, 1.0)
    unknown += varint(903 << 3 | 5) + b"abcd"
    body = bytes_field(1, doubles_field(1, (0.0,) * 6) + unknown) + unknown
    message = CODEC.parse_robot(HEADER + bytes_field(2, body) + unknown)
    assert message.feedback.joints == (0.0,) * 6


def test_packed_doubles_are_read_like_unpacked_ones() -> None:
    packed = bytes_field(1, struct.pack("<6d", *range(6)))
    message = CODEC.parse_robot(with_feedback(bytes_field(1, packed)))
    assert message.feedback.joints == pytest.approx(tuple(map(math.radians, range(6))))


def test_an_unknown_state_is_undefined_and_a_missing_one_too() -> None:
    assert CODEC.parse_robot(LEAST).motors is messages.MotorState.UNDEFINED
    message = CODEC.parse_robot(LEAST + bytes_field(4, number_field(1, 9)))
    assert message.motors is messages.MotorState.UNDEFINED


def test_external_axes_are_read_in_the_units_of_the_set_up() -> None:
    body = bytes_field(1, doubles_field(1, (0.0,) * 6)) + bytes_field(
        3, doubles_field(1, (180.0, 2000.0))
    )
    message = EgmCodec(linear_external=("E2",)).parse_robot(with_feedback(body))
    assert message.feedback.external == pytest.approx((math.pi, 2.0))


@pytest.mark.parametrize(
    "bad",
    [
        Bad(b"", "0 bytes"),
        Bad(b"<Rob Type='KUKA'>", "field"),
        Bad(struct.pack(">3I", 202, 3, 1).ljust(388, b"\0"), "field number out of range"),
        Bad(LEAST + bytes(MAX_MESSAGE_BYTES), "bytes: limit"),
        Bad(FEEDBACK, "without a header"),
        Bad(HEADER, "without feedBack.joints"),
        Bad(HEADER + HEADER + FEEDBACK, "field 1 stands twice"),
        Bad(LEAST + FEEDBACK, "field 2 stands twice"),
        Bad(bytes_field(1, number_field(3, 2)) + FEEDBACK, "without seqno"),
        Bad(bytes_field(1, number_field(1, 5)) + FEEDBACK, "mtype is 0: expected 2"),
        Bad(bytes_field(1, number_field(1, 5) + number_field(3, 3)) + FEEDBACK, "mtype is 3"),
        Bad(bytes_field(1, number_field(1, 2**32) + number_field(3, 2)) + FEEDBACK, "seqno out"),
        Bad(number_field(1, 5) + FEEDBACK, "field 1 has wire type 0: expected 2"),
        Bad(with_feedback(bytes_field(1, doubles_field(1, (0.0,) * 5))), "has 5 values: 6"),
        Bad(with_feedback(bytes_field(1, doubles_field(1, (0.0,) * 7))), "has 7 values: limit 6"),
        Bad(with_feedback(bytes_field(1, doubles_field(1, (0.0,) * 5 + (math.nan,)))), "nan"),
        Bad(with_feedback(bytes_field(1, doubles_field(1, (math.inf,) * 6))), "inf"),
        Bad(with_feedback(bytes_field(1, doubles_field(1, (2e6,) * 6))), "limit 1e"),
        Bad(with_feedback(bytes_field(1, number_field(1, 5))), "no list of doubles"),
        Bad(with_feedback(bytes_field(1, bytes_field(1, b"abc"))), "no list of doubles"),
        Bad(LEAST + bytes_field(4, b""), "motorState without its state"),
        Bad(LEAST + double_field(10, math.nan), "utilizationRate out of range"),
        Bad(LEAST + bytes_field(9, double_field(1, 1.0) + number_field(1, 1)), "mixes RobotWare"),
        Bad(LEAST + bytes_field(9, double_field(1, 1.0)) + number_field(11, 3), "mixes RobotWare"),
        Bad(LEAST + bytes_field(9, doubles_field(2, (1.0,) * 7)), "7 values: limit 6"),
        Bad(LEAST + b"\x0b", "wire type 3"),
        Bad(LEAST + b"\x00", "field number out of range: 0"),
        Bad(LEAST + b"\x30" + b"\xff" * 10 + b"\x01", "varint too long"),
        Bad(LEAST + b"\x30" + b"\xff" * 9 + b"\x7f", "varint too large"),
        Bad(LEAST + b"\x30\x80", "varint cut short"),
        Bad(LEAST + b"\x12\xff\x01", "cut short"),
        Bad(LEAST + number_field(900, 0) * 300, "over 256 fields"),
    ],
    ids=lambda bad: bad.why,
)
def test_a_bad_message_is_refused_with_its_reason(bad: Bad) -> None:
    with pytest.raises(EgmError, match=bad.why):
        CODEC.parse_robot(bad.data)


def test_a_pose_or_clock_that_lacks_a_required_value_is_refused() -> None:
    joints = bytes_field(1, doubles_field(1, (0.0,) * 6))
    pose = bytes_field(2, bytes_field(1, double_field(1, 1.0)))
    with pytest.raises(EgmError, match=r"cartesian\.pos has 1 values: 3"):
        CODEC.parse_robot(with_feedback(joints + pose))
    euler_only = bytes_field(2, bytes_field(3, b""))
    message = CODEC.parse_robot(with_feedback(joints + euler_only))
    assert (message.feedback.tcp_position, message.feedback.tcp_quaternion) == (None, None)
    with pytest.raises(EgmError, match="time without sec or usec"):
        CODEC.parse_robot(with_feedback(joints + bytes_field(4, number_field(1, 1))))


def test_the_measured_force_message_may_be_empty() -> None:
    message = CODEC.parse_robot(LEAST + bytes_field(9, b""))
    assert (message.force, message.is_force_active, message.robotware) == (None, None, None)


def test_a_cartesian_setpoint_is_refused() -> None:
    header = bytes_field(1, number_field(1, 5) + number_field(3, 3))
    with pytest.raises(EgmError, match="Cartesian setpoint"):
        CODEC.parse_correction(header + bytes_field(2, bytes_field(2, b"")))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"joints": (math.nan,) * 6}, "planned.joints out of range"),
        ({"joints": None}, "speed without its setpoint"),
        ({"external": (0.0,) * 7}, "has 7 values: limit 6"),
        ({"sequence": -1}, "seqno out of range"),
        ({"time_ms": 2**32}, "tm out of range"),
        ({"external": (), "external_speeds": (1.0,)}, "speed without its setpoint"),
    ],
)
def test_a_value_that_the_wire_cannot_carry_is_refused(change: Any, why: str) -> None:
    good = messages.CorrectionMessage(1, 2, (0.0,) * 6, (0.0,), (0.0,) * 6)
    with pytest.raises(EgmError, match=why):
        CODEC.format_correction(msgspec.structs.replace(good, **change))


def test_a_codec_for_what_is_not_known_is_refused() -> None:
    with pytest.raises(EgmError, match="RobotWare 8 unknown"):
        EgmCodec(robotware=8)  # type: ignore[arg-type]
    with pytest.raises(EgmError, match="E7"):
        EgmCodec(linear_external=("E7",))


def test_a_negative_number_is_not_written() -> None:
    with pytest.raises(EgmError, match="out of range: -1"):
        varint(-1)


@given(st.integers(0, 2**64 - 1))
def test_a_varint_comes_back_from_its_bytes(value: int) -> None:
    assert read_fields(number_field(7, value)) == [(7, 0, value)]


@given(st.binary(max_size=200))
def test_any_bytes_are_a_message_or_refused(data: bytes) -> None:
    for parse in (CODEC.parse_robot, CODEC.parse_correction):
        with contextlib.suppress(EgmError):
            parse(HEADER + data)


def test_numbers_of_the_rapid_program_come_back_and_are_bounded() -> None:
    message = messages.CorrectionMessage(1, 0, (0.0,) * 6, rapid_data=(3.0, -1.5))
    data = CODEC.format_correction(message)
    assert CODEC.parse_correction(data).rapid_data == (3.0, -1.5)
    with pytest.raises(EgmError, match="RAPIDtoRobot has 41 values: limit 40"):
        CODEC.format_correction(msgspec.structs.replace(message, rapid_data=(0.0,) * 41))
    with pytest.raises(EgmError, match=r"RAPIDfromRobot\.dnum has 41 values: limit 40"):
        CODEC.parse_robot(LEAST + bytes_field(13, doubles_field(2, (0.0,) * 41)))
