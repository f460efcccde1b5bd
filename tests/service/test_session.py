"""Where a programme's corrections count from, from its first telegram and from the past's."""

import pytest

from linemate.daemon.service.session import Axes, Session
from linemate.protocol.samples import RobotSample

CYCLE_S, STEP = 0.012, 12
START: Axes = (0.0, -1.4, 1.6, 0.0, 1.3, 0.0, 0.0)
SENT: Axes = (-0.02, -1.4, 1.6, 0.0, 1.3, 0.0, 0.1)
THERE: Axes = (-0.0125, -1.4, 1.6, 0.0, 1.3, 0.0, 0.08)


def telegram(ipoc: int, at_s: float, delay: int | None, axes: Axes) -> RobotSample:
    return RobotSample(round(at_s * 1e9), ipoc, axes[:6], (axes[6],), delay)  # type: ignore[arg-type]


def under_way() -> Session:
    """Served up to counter 1200 at 12 s, the reply to it still open."""
    session = Session(CYCLE_S)
    session.open(START, START, 0)
    session.give(SENT)
    session.remember(telegram(1200, 12.0, 4, SENT), "robot", STEP)
    return session


@pytest.mark.parametrize(
    ("cycles", "delay"), [(-3, 2), (-1, 4), (-6, 0), (-3, 7), (-3, None), (0, 4)]
)
def test_a_telegram_of_a_programmes_past_does_not_move_where_its_corrections_count_from(
    cycles: int, delay: int | None
) -> None:
    late = telegram(1200 + cycles * STEP, 12.03, delay, THERE)
    assert under_way().meet(late, THERE, "robot", absolute=True) == (START, SENT)


@pytest.mark.parametrize(
    ("ipoc", "at_s"), [(1200 - 3 * STEP, 12.6), (1200 - 3 * STEP + 1, 12.03), (77, 12.03)]
)
def test_a_counter_that_is_off_the_programmes_past_begins_another_where_the_robot_stands(
    ipoc: int, at_s: float
) -> None:
    fresh = telegram(ipoc, at_s, 0, THERE)
    assert under_way().meet(fresh, THERE, "robot", absolute=True) == (THERE, THERE)
