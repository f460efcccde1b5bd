"""EGM behind the seam of controllers: positions, speeds, readiness, and the reply's header."""

import msgspec
import pytest

from linemate.protocol.controller_link import SetpointKind
from linemate.protocol.egm import messages
from linemate.protocol.egm.egm_codec import EgmCodec
from linemate.protocol.egm.egm_link import EgmLink, unready
from linemate.protocol.egm.protobuf_wire import EgmError

CYCLE_S = 0.004
JOINTS = (0.0, -1.5, 1.5, 0.0, 0.5, 0.0)
READY = messages.RobotMessage(
    41,
    164,
    messages.EgmPosition(JOINTS, (0.25,)),
    motors=messages.MotorState.ON,
    guidance=messages.GuidanceState.RUNNING,
    rapid=messages.RapidState.RUNNING,
    robotware=7,
    rapid_data=(2.0,),
)
CODEC = EgmCodec()


def link(*, on_rail: bool = True, signals: bool = True) -> EgmLink:
    return EgmLink(CODEC, CYCLE_S, on_rail=on_rail, signals=signals)


def telegram(**changes: object) -> bytes:
    return CODEC.format_robot(msgspec.structs.replace(READY, **changes))


def test_a_telegram_has_counter_axes_and_signals() -> None:
    read = link().read(telegram(), 7)
    assert (read.counter, read.unready, read.programmed) == (41, None, None)
    assert read.robot.joints == pytest.approx(JOINTS)
    assert read.robot.external == pytest.approx((0.25,))
    assert (read.robot.digital_in, read.robot.delay, read.robot.stamp_ns) == (2, None, 7)


def test_a_reply_has_the_counter_the_setpoint_and_its_speed() -> None:
    there = tuple(q + 0.002 for q in (*JOINTS, 0.25))
    egm = link()
    reply = egm.prepare(there, (*JOINTS, 0.25), 3).with_counter(egm.read(telegram(), 0).echo)
    message = CODEC.parse_correction(reply)
    assert message.sequence == 41
    assert message.joints == pytest.approx(there[:6])
    assert message.external == pytest.approx(there[6:])
    assert message.joint_speeds == pytest.approx((0.5,) * 6)
    assert message.external_speeds == pytest.approx((0.5,))
    assert message.rapid_data == (3.0,)


def test_an_unknown_setpoint_before_gives_no_speed() -> None:
    reply = link(on_rail=False, signals=False).prepare(JOINTS, (), 3)
    message = CODEC.parse_correction(CODEC.correction_header(1) + reply.tail)
    assert message.joint_speeds == (0.0,) * 6
    assert (message.external, message.rapid_data) == ((), ())


def test_silence_leaves_the_robot_as_it_is() -> None:
    assert link().without_setpoint(1) is None
    assert link().rules.setpoints is SetpointKind.POSITIONS


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"motors": messages.MotorState.OFF}, "motors are not on: motorState OFF"),
        ({"motors": messages.MotorState.UNDEFINED}, "motorState UNDEFINED"),
        ({"rapid": messages.RapidState.STOPPED}, "RAPID does not run: rapidExecState STOPPED"),
        ({"guidance": messages.GuidanceState.STOPPED}, "EGM does not run: mciState STOPPED"),
        ({"guidance": messages.GuidanceState.ERROR}, "mciState ERROR"),
    ],
)
def test_a_controller_that_is_not_ready_says_why(change: dict[str, object], why: str) -> None:
    read = link().read(telegram(**change), 0)
    assert read.unready is not None
    assert why in read.unready
    assert unready(READY) is None


def test_a_robot_without_the_linear_axis_of_the_task_is_refused() -> None:
    data = telegram(feedback=messages.EgmPosition(JOINTS))
    with pytest.raises(EgmError, match=r"without feedBack\.externalJoints"):
        link().read(data, 0)
    assert link(on_rail=False).read(data, 0).robot.external == ()


def test_what_is_no_message_of_any_family_is_refused_as_it_is() -> None:
    with pytest.raises(EgmError, match="field number out of range"):
        link().read(b"\x00\x01", 0)


@pytest.mark.parametrize("value", [0.5, -1.0, 256.0])
def test_a_number_that_is_no_signal_is_refused(value: float) -> None:
    with pytest.raises(EgmError, match=r"signals are 0\.\.255"):
        link().read(telegram(rapid_data=(value,)), 0)
    assert link(signals=False).read(telegram(rapid_data=(value,)), 0).robot.digital_in == 0


@pytest.mark.parametrize(
    ("change", "is_expected"),
    [
        ({}, True),
        ({"time_ms": 2**31}, True),
        ({"sequence": 42}, False),
        ({"motors": messages.MotorState.OFF}, False),
        ({"feedback": messages.EgmPosition((0.06, *JOINTS[1:]), (0.25,))}, False),
        ({"feedback": messages.EgmPosition((0.04, *JOINTS[1:]), (0.25,))}, True),
        ({"feedback": messages.EgmPosition(JOINTS)}, False),
    ],
)
def test_the_expected_message_is_the_next_one_of_a_ready_robot_nearby(
    change: dict[str, object], is_expected: bool
) -> None:
    egm = link()
    expected = egm.expect(41, None, JOINTS, 0.05)
    assert expected is not None
    pattern, echo = expected
    data = telegram(**change)
    assert pattern.matches(data) is is_expected
    if is_expected:
        assert egm.read(data, 0).echo == echo
        assert egm.read(data, 0).unready is None


def test_a_counter_beyond_32_bits_is_not_expected() -> None:
    assert link().expect(2**32, None, JOINTS, 0.05) is None
    expected = link().expect(41, None, JOINTS, 0.05)
    assert expected is not None
    assert not expected[0].matches(b"<Rob/>")


def test_a_run_that_ended_by_convergence_says_how_to_keep_it() -> None:
    stopped = {"guidance": messages.GuidanceState.STOPPED}
    for is_converged, word in ((True, "CondTime"), (False, "Execute EGMRunJoint")):
        read = link().read(telegram(is_converged=is_converged, **stopped), 0)
        assert read.unready is not None
        assert word in read.unready
    assert link().read(telegram(is_converged=True), 0).unready is None


@pytest.mark.parametrize(
    ("planned", "on_rail", "sent_to"),
    [
        (messages.EgmPosition(JOINTS, (0.25,)), True, (*JOINTS, 0.25)),
        (messages.EgmPosition(JOINTS, (0.25,)), False, JOINTS),
        (messages.EgmPosition(JOINTS), True, None),
        (messages.EgmPosition(), False, None),
    ],
)
def test_a_telegram_says_where_the_servos_of_the_arms_axes_are_sent(
    planned: messages.EgmPosition, on_rail: bool, sent_to: tuple[float, ...] | None
) -> None:
    read = link(on_rail=on_rail).read(telegram(planned=planned), 0)
    assert (read.sent_to is None) is (sent_to is None)
    if sent_to is not None:
        assert read.sent_to == pytest.approx(sent_to)


@pytest.mark.parametrize("is_lost", [False, True])
def test_a_message_that_shows_a_lost_setpoint_is_not_the_expected_one(is_lost: bool) -> None:
    seen: list[tuple[float, ...]] = []

    def judge(sent_to: tuple[float, ...]) -> bool:
        seen.append(sent_to)
        return is_lost

    expected = link().expect(41, None, JOINTS, 0.05, judge)
    assert expected is not None
    data = telegram(planned=messages.EgmPosition(JOINTS, (0.25,)))
    assert expected[0].matches(data) is not is_lost
    assert seen == [pytest.approx((*JOINTS, 0.25))]
