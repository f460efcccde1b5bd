from typing import Any, cast

import pytest

from linemate.protocol.egm import messages
from linemate.protocol.egm.egm_codec import EgmCodec
from linemate.protocol.egm.protobuf_wire import bytes_field, number_field
from linemate.protocol.exchange_controller import Judgement
from linemate.protocol.stamped_samples import Vector6
from linemate.simulators.devices.egm.egm_controller import EgmConfig, EgmController
from linemate.simulators.devices.rsi_controller import Applied, RobotReading, Seven

START: Seven = (0.0, -1.5, 1.5, 0.0, 0.0, 0.0, 1.0)
CODEC = EgmCodec()


class Cell:
    """A controller and a robot that is where it is sent, a cycle later."""

    def __init__(self, **values: Any) -> None:
        self.axes = START
        self.controller = EgmController(self.read, START, EgmConfig(**values))
        self.sequence = 0

    def read(self) -> RobotReading:
        return RobotReading(self.axes, (0.0,) * 6)

    def cycle(self, message: messages.CorrectionMessage | bytes | None = None) -> Applied:
        """Play one cycle with one reply."""
        assert self.telegram() is not None
        if message is not None:
            data = message if isinstance(message, bytes) else CODEC.format_correction(message)
            self.controller.on_reply(data)
        applied = self.controller.end_of_cycle()
        assert applied.motion is not None
        self.axes = applied.motion
        return applied

    def telegram(self) -> messages.RobotMessage | None:
        data = self.controller.telegram()
        return None if data is None else CODEC.parse_robot(data)

    def setpoint(self, axes: Seven, speeds: tuple[float, ...] = ()) -> messages.CorrectionMessage:
        """Return a correction with the sender's next sequence number."""
        self.sequence += 1
        six = cast("Vector6", speeds[:6]) if speeds else None
        return messages.CorrectionMessage(self.sequence, 0, axes[:6], axes[6:], six, speeds[6:])


def moved(by: float) -> Seven:
    return (START[0] + by, *START[1:])


def test_a_cycle_has_the_number_of_its_message() -> None:
    cell = Cell(first_sequence=2**32 - 1)
    numbers = []
    for _ in range(3):
        message = cell.telegram()
        assert message is not None
        numbers.append((message.sequence, cell.controller.end_of_cycle().ipoc))
    assert numbers == [(2**32 - 1, 2**32 - 1), (0, 0), (1, 1)]


def test_a_message_says_where_the_robot_is_and_that_it_is_ready() -> None:
    message = Cell().telegram()
    assert message is not None
    assert message.feedback.joints == pytest.approx(START[:6])
    assert message.feedback.external == pytest.approx(START[6:])
    assert (message.sequence, message.time_ms) == (0, 4)
    assert message.motors is messages.MotorState.ON
    assert message.guidance is messages.GuidanceState.RUNNING
    assert message.rapid is messages.RapidState.RUNNING
    assert message.is_converged is True


def test_the_robot_reaches_a_setpoint_and_says_when() -> None:
    cell = Cell()
    first = cell.cycle(cell.setpoint(moved(0.02)))
    assert first.answered
    assert first.setpoints[0] == pytest.approx(0.02)
    assert first.motion is not None
    assert 0.0 < first.motion[0] < 0.002
    for _ in range(200):
        cell.cycle(cell.setpoint(moved(0.02)))
    assert cell.axes[0] == pytest.approx(0.02, abs=1e-4)


def test_the_external_axis_stays_where_it_is_if_a_message_does_not_name_it() -> None:
    cell = Cell()
    applied = cell.cycle(messages.CorrectionMessage(1, 0, moved(0.01)[:6]))
    assert applied.setpoints[6] == START[6]
    applied = cell.cycle(messages.CorrectionMessage(2, 0, moved(0.01)[:6], (1.1,)))
    assert applied.setpoints[6] == pytest.approx(1.1)


def test_without_a_message_the_setpoint_holds_at_speed_zero() -> None:
    cell = Cell()
    cell.cycle(cell.setpoint(moved(0.01), (0.1,) * 7))
    for _ in range(240):
        applied = cell.cycle()
        assert applied.outcome is Judgement.MISSING
    assert applied.setpoints[0] == pytest.approx(0.01)
    assert cell.axes[0] == pytest.approx(0.01, abs=1e-4)
    assert cell.axes[1] == pytest.approx(START[1], abs=1e-4)


def test_the_instruction_ends_after_the_communication_timeout_and_not_before() -> None:
    cell = Cell(comm_timeout_s=0.1)
    cell.cycle(cell.setpoint(START))
    for _ in range(25):
        cell.cycle()
        assert cell.controller.broken is None
    cell.cycle()
    assert cell.controller.broken is not None
    assert "ERR_UDPUC_COMM" in cell.controller.broken
    assert cell.controller.telegram() is None


def test_a_good_message_begins_the_timeout_again() -> None:
    cell = Cell(comm_timeout_s=0.1)
    for _ in range(10):
        for _ in range(20):
            cell.cycle()
        cell.cycle(cell.setpoint(START))
    assert cell.controller.broken is None
    assert cell.controller.counts.lost == 200


def test_before_the_first_message_a_patient_controller_waits() -> None:
    cell = Cell(comm_timeout_s=0.1, patient=True)
    for _ in range(100):
        cell.cycle()
    assert cell.controller.broken is None
    strict = Cell(comm_timeout_s=0.1)
    for _ in range(26):
        strict.cycle()
    assert strict.controller.broken is not None


def test_a_restart_guides_from_where_the_robot_stands() -> None:
    cell = Cell(comm_timeout_s=0.02)
    for _ in range(100):
        cell.cycle(cell.setpoint(moved(0.02)))
    for _ in range(6):
        cell.cycle()
    assert cell.controller.broken is not None
    cell.controller.restart()
    message = cell.telegram()
    assert message is not None
    assert message.sequence == 0
    assert cell.controller.setpoints[0] == pytest.approx(0.02, abs=1e-3)


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (b"", "malformed"),
        (b"<Sen Type='ImFree'></Sen>", "malformed"),
        (CODEC.format_correction(messages.CorrectionMessage(1)), "setpoint"),
        (bytes_field(1, number_field(1, 1) + number_field(3, 4)), "malformed"),
    ],
)
def test_a_message_without_joints_is_refused_and_counted(data: bytes, kind: str) -> None:
    cell = Cell()
    applied = cell.cycle(data)
    assert applied.outcome is Judgement.REFUSED
    assert cell.controller.refusals == {kind: 1}
    assert (cell.controller.counts.refused, cell.controller.counts.answered) == (1, 0)
    assert applied.motion == START


def test_a_repeated_sequence_number_is_refused_and_the_counter_may_wrap() -> None:
    cell = Cell()
    cell.sequence = 2**32 - 3
    for _ in range(2):
        assert cell.cycle(cell.setpoint(START)).answered
    assert (
        cell.cycle(messages.CorrectionMessage(2**32 - 1, 0, START[:6])).outcome is Judgement.MISSING
    )
    assert cell.cycle(messages.CorrectionMessage(3, 0, START[:6])).answered
    assert cell.controller.counts.duplicate == 1


def test_the_newest_message_of_a_cycle_is_applied() -> None:
    cell = Cell()
    assert cell.telegram() is not None
    for by in (0.01, 0.02):
        cell.controller.on_reply(CODEC.format_correction(cell.setpoint(moved(by))))
    assert cell.controller.end_of_cycle().setpoints[0] == pytest.approx(0.02)
    assert cell.controller.counts.answered == 1


def test_a_setpoint_beyond_a_software_limit_ends_the_instruction() -> None:
    cell = Cell()
    applied = cell.cycle(cell.setpoint(moved(10.0)))
    assert applied.motion == START
    assert cell.controller.broken is not None
    assert "axis 1 at 10.0000" in cell.controller.broken


@pytest.mark.parametrize("name", ["is_motors_on", "is_rapid_running"])
def test_nothing_moves_while_the_controller_is_not_ready(name: str) -> None:
    cell = Cell()
    cell.cycle(cell.setpoint(moved(0.02)))
    setattr(cell.controller, name, False)
    before = cell.axes
    for _ in range(20):
        applied = cell.cycle(cell.setpoint(moved(0.05)))
    assert applied.motion == before
    message = cell.telegram()
    assert message is not None
    assert message.guidance is messages.GuidanceState.STOPPED
    cell.controller.end_of_cycle()
    setattr(cell.controller, name, True)
    assert cell.cycle().motion == before


def test_counting_begins_again_in_the_same_run() -> None:
    cell = Cell(patient=True)
    cell.cycle(b"x")
    cell.cycle(cell.setpoint(moved(0.01)))
    cell.controller.begin()
    assert (cell.controller.counts.sent, cell.controller.refusals) == (0, {})
    applied = cell.cycle(cell.setpoint(moved(0.01)))
    assert (applied.cycle, cell.controller.counts.answered) == (0, 1)


def test_setpoints_beyond_the_axis_limits_are_judged_as_they_came() -> None:
    cell = Cell()
    for by in (0.0, 0.0, 0.2, 0.0):
        cell.cycle(cell.setpoint(moved(by)))
    assert cell.controller.judge.violations > 0
