"""What a session remembers of a controller's program, telegram by telegram."""

import pytest

from linemate.daemon.cycle.session import Axes, Session
from linemate.daemon.cycle.setpoint_reference import Proof
from linemate.protocol.controller_link import ExchangeRules, SetpointKind
from linemate.protocol.stamped_samples import RobotSample

OFFSETS = ExchangeRules()
INCREMENTS = ExchangeRules(SetpointKind.INCREMENTS)
POSITIONS = ExchangeRules(SetpointKind.POSITIONS, accounted_s=0.12)

CYCLE_S, STEP = 0.012, 12
START: Axes = (0.0, -1.4, 1.6, 0.0, 1.3, 0.0, 0.0)
BEFORE: Axes = (-0.019, -1.4, 1.6, 0.0, 1.3, 0.0, 0.09)
SENT: Axes = (-0.02, -1.4, 1.6, 0.0, 1.3, 0.0, 0.1)
THERE: Axes = (-0.0125, -1.4, 1.6, 0.0, 1.3, 0.0, 0.08)


def telegram(ipoc: int, at_s: float, delay: int | None, axes: Axes) -> RobotSample:
    return RobotSample(round(at_s * 1e9), ipoc, axes[:6], (axes[6],), delay)  # type: ignore[arg-type]


def running(rules: ExchangeRules = OFFSETS) -> Session:
    """Served up to counter 1200 at 12 s with Delay 4, the reply to it still open."""
    session = Session(CYCLE_S, rules)
    session.listen(0)
    first = telegram(1188, 11.988, 0, BEFORE)
    session.note_telegram(first.stamp_ns)
    assert session.prove(first, START, None, "robot") == (START, START)
    session.open(START, START, 0)
    session.note_reply(BEFORE, first, "robot", STEP)
    session.note_telegram(12_000_000_000)
    session.settle(0, 1, 12_000_000_000)
    session.note_reply(SENT, telegram(1200, 12.0, 4, SENT), "robot", STEP)
    return session


def proven(
    session: Session, robot: RobotSample, peer: str = "robot", programmed: Axes | None = None
) -> tuple[Axes, Axes] | None:
    session.note_telegram(robot.stamp_ns)
    return session.prove(robot, THERE, programmed, peer)


@pytest.mark.parametrize(
    ("cycles", "delay"), [(-3, 2), (-1, 4), (-6, 0), (-3, 7), (-3, None), (0, 4)]
)
def test_a_telegram_of_the_programs_past_does_not_move_its_reference(
    cycles: int, delay: int | None
) -> None:
    late = telegram(1200 + cycles * STEP, 12.03, delay, THERE)
    assert proven(running(), late) == (START, SENT)


@pytest.mark.parametrize(
    ("cycles", "delay", "held"),
    [(10, 13, SENT), (10, 14, BEFORE), (10, 9, SENT), (60, 63, SENT), (60, 64, BEFORE)],
)
def test_cycles_that_delay_has_counted_continue_the_program_whatever_the_clock_says(
    cycles: int, delay: int, held: Axes
) -> None:
    for passed_s in (0.012, cycles * CYCLE_S):
        session = running()
        back = telegram(1200 + cycles * STEP, 12.0 + passed_s, delay, THERE)
        assert proven(session, back) == (START, held)
        assert session.proof is Proof.CONTINUED


@pytest.mark.parametrize(
    ("ipoc", "at_s", "delay"),
    [
        (1200 + 10 * STEP, 12.12, 0),  # restarted in between: Delay counts from zero
        (1200 + 10 * STEP, 12.12, 11),
        (1200 + 10 * STEP, 12.12, None),
        (1200 - 3 * STEP, 12.6, 40),  # of a past that is too long ago
        (77, 12.6, 40),
    ],
)
def test_a_program_that_cannot_be_proven_to_go_on_is_refused_with_what_to_do(
    ipoc: int, at_s: float, delay: int | None
) -> None:
    session = running()
    assert proven(session, telegram(ipoc, at_s, delay, THERE)) is None
    assert session.unproven is not None
    assert "Restart the controller's program" in session.unproven
    # The same stays so: bare replies may have been applied since, or not.
    assert proven(session, telegram(ipoc + STEP, at_s + CYCLE_S, delay, THERE)) is None


def test_cycles_without_a_setpoint_are_counted_though_the_clock_stood_still_with_the_process() -> (
    None
):
    session = running()
    back = telegram(1200 + 8 * STEP, 12.012, 11, THERE)
    session.cycles_since_command += 8
    assert proven(session, back) == (START, SENT)
    session.resume(SENT, 11)
    assert session.unled == 7  # the first of the eight had the reply to 1200
    session.settle(11, 8, back.stamp_ns)
    session.note_reply(SENT, back, "robot", STEP)
    session.settle(11, 1, 12_024_000_000)
    assert session.unled == 0


@pytest.mark.parametrize(("delays", "unled"), [((1, 2), 2), ((1, 1), 0), ((0, 1), 1)])
def test_replies_that_were_not_applied_are_cycles_without_a_setpoint(
    delays: tuple[int, ...], unled: int
) -> None:
    session = running()
    for n, delay in enumerate(delays, start=1):
        robot = telegram(1200 + n * STEP, 12.0 + n * CYCLE_S, delay, SENT)
        session.settle(delay, 1, robot.stamp_ns)
        session.note_reply(SENT, robot, "robot", STEP)
    assert session.unled == unled


def test_a_counter_that_jumped_at_its_pace_continues_the_program() -> None:
    session = running()
    for n, delay in ((1, 5), (2, 6)):
        session.note_telegram(round((12.0 + n * CYCLE_S) * 1e9))
        assert delay
    assert proven(session, telegram(77, 12.036, 6, THERE)) == (START, SENT)


def test_another_address_continues_the_program_if_its_cycles_are_accounted_for() -> None:
    assert proven(running(), telegram(1200 + 9 * STEP, 12.108, 12, THERE), "relay") == (START, SENT)
    assert proven(running(), telegram(1200 + 9 * STEP, 12.108, 0, THERE), "relay") is None


def test_a_programmed_position_gives_the_correction_once_the_axes_rest() -> None:
    session = Session(CYCLE_S)
    for n in range(9):
        robot = telegram(STEP * n, 1.0 + n * CYCLE_S, 40 + n, THERE)
        assert proven(session, robot, programmed=START) is None
    robot = telegram(STEP * 9, 1.0 + 9 * CYCLE_S, 49, THERE)
    assert proven(session, robot, programmed=START) == (START, THERE)
    assert session.proof is Proof.COMPUTED


def test_a_programmed_position_equal_to_the_actual_one_proves_nothing() -> None:
    """It may have the correction in it: no source says that it does not on every controller."""
    session = Session(CYCLE_S)
    for n in range(50):
        robot = telegram(STEP * n, 1.0 + n * CYCLE_S, 40 + n, THERE)
        assert proven(session, robot, programmed=THERE) is None


def test_a_programmed_position_elsewhere_refutes_a_program_that_seems_to_go_on() -> None:
    moved = (0.5, *START[1:])
    back = telegram(1200 + 10 * STEP, 12.12, 13, THERE)
    assert proven(running(), back, programmed=START) == (START, SENT)
    assert proven(running(), back, programmed=moved) is None


def test_increments_need_no_reference() -> None:
    session = Session(CYCLE_S, INCREMENTS)
    assert proven(session, telegram(9, 1.0, 40, THERE)) == (THERE, THERE)


def test_the_first_position_is_the_reported_one() -> None:
    session = Session(CYCLE_S, POSITIONS)
    session.listen(0)
    assert proven(session, telegram(1, 12.0, None, THERE)) == (THERE, THERE)
    assert session.proof is Proof.REPORTED


def test_a_daemon_that_hears_telegrams_at_once_waits_until_the_robot_rests() -> None:
    session = Session(CYCLE_S, POSITIONS)
    session.listen(12_000_000_000)
    waits = 0
    for k in range(40):
        moving = (0.001 * min(k, 20), *THERE[1:])
        robot = telegram(1 + k, 12.01 + 0.012 * k, None, moving)
        session.note_telegram(robot.stamp_ns)
        if session.prove(robot, moving, None, "robot") is not None:
            break
        waits = k
    assert waits == 20 + 9 - 1
    assert session.proof is Proof.REPORTED


@pytest.mark.parametrize(("apart_ms", "is_lost"), [(0.1, True), (1.0, False), (12.0, False)])
def test_a_reply_just_before_the_next_telegram_never_acts_where_the_newest_does(
    apart_ms: float, is_lost: bool
) -> None:
    session = Session(CYCLE_S, ExchangeRules(SetpointKind.POSITIONS, newest_acts=True))
    session.open(THERE, THERE, None)
    session.note_reply(SENT, telegram(1, 12.0, None, THERE), "robot", STEP)
    assert session.settle(None, 1, 12_000_000_000 + round(1e6 * apart_ms)) is is_lost
    assert session.held == (THERE if is_lost else SENT)


def test_positions_need_a_proof_after_a_silence_that_the_rules_do_not_account_for() -> None:
    session = running(POSITIONS)
    assert not session.needs_proof(telegram(1308, 12.108, None, SENT), 8)
    assert session.needs_proof(telegram(1320, 12.12, None, SENT), 0)
    assert session.needs_proof(telegram(1320, 12.05, None, SENT), 10)


def test_a_moved_robot_gets_no_position_after_a_gap_before_it_rests() -> None:
    session = running(POSITIONS)
    rested = 0
    for k in range(40):
        moving = (0.001 * min(k, 20), *THERE[1:])
        robot = telegram(1400 + 12 * k, 12.2 + 0.012 * k, None, moving)
        found = session.prove(robot, moving, None, "robot")
        if found is not None:
            assert found == (moving, moving)
            break
        assert session.unproven is not None
        assert "still moves" in session.unproven
        rested = k
    assert rested == 20 + 9 - 1


@pytest.mark.parametrize(("away", "waits"), [(0.0, False), (0.001, True)])
def test_a_robot_that_its_own_program_led_elsewhere_gets_no_position_before_it_rests(
    away: float, waits: bool
) -> None:
    session = Session(CYCLE_S, POSITIONS)
    session.listen(0)
    assert proven(session, telegram(1, 12.0, None, THERE)) == (THERE, THERE)
    session.open(THERE, THERE, None)
    session.note_reply(THERE, telegram(1, 12.0, None, THERE), "robot", STEP)
    elsewhere = (THERE[0] + away, *THERE[1:])
    found = session.prove(telegram(60, 12.7, None, elsewhere), elsewhere, None, "robot")
    assert (found is None) is waits


def test_a_controller_that_takes_no_setpoint_needs_a_proof_once_it_does() -> None:
    session = running(POSITIONS)
    session.decline("the controller takes no setpoints: E-stop.", SENT, "robot")
    assert session.unproven == "the controller takes no setpoints: E-stop."
    assert session.is_interrupted
    assert session.needs_proof(telegram(1212, 12.012, None, SENT), 0)
