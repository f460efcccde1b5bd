"""A gentle stop: its own acceleration and jerk, once a harder motion's own is let go."""

from dataclasses import replace

import numpy as np
import pytest

from linemate.daemon.core.control import limits
from linemate.daemon.core.control.limits import Limits

HARD = Limits(
    np.array((-10.0,)), np.array((10.0,)), np.array((2.0,)), np.array((8.0,)), np.array((200.0,)),
    ("A1",),
)  # fmt: skip
GENTLE = replace(HARD, acceleration=np.array((1.0,)), jerk=np.array((20.0,)))


@pytest.mark.parametrize("period", [0.004, 0.012])
def test_a_gentle_stop_lets_a_hard_acceleration_go_at_once_and_ends_gently(period: float) -> None:
    state, rows = limits.at_rest(np.array((0.0,))), []
    for k in range(20):
        state, _ = limits.admit(state, np.array((0.02 * k * k,)), HARD, period)
    assert abs(state.acceleration[0]) > GENTLE.acceleration[0]
    letting_go = True
    for _ in range(2000):
        before = state
        state = limits.brake(state, HARD, period, GENTLE)
        change = abs(float(state.acceleration[0] - before.acceleration[0])) / period
        letting_go = letting_go and abs(float(before.acceleration[0])) > 1.0
        assert change <= (HARD if letting_go else GENTLE).jerk[0] * 1.0001
        rows.append(abs(float(state.acceleration[0])))
    assert limits.stands(state)
    assert max(rows[100:]) <= 1.0001
