"""How long a free tool is committed, against where whole runs measured the least error."""

from dataclasses import replace

import pytest

from linemate.daemon.core import commitment
from linemate.daemon.core.control.settings import ControlSettings, ServoModel
from linemate.daemon.core.tracking.settings import MergeSettings


def margin(cycle_s: float, delay_s: float, settings: ControlSettings) -> float:
    return commitment.free_margin(MergeSettings(), settings, delay_s, cycle_s)


@pytest.mark.parametrize(
    ("cycle_s", "delay_s", "least_s"),
    # The least control error of whole runs: at 4 ms 8 of 0, 2, 4, 8, 12 and 18 ms; at 12 ms 9 of
    # 0, 3, 4.5, 6, 9 and 12; at 8 ms 6 of 0, 2, 4 and 6; at 2 ms 4 of 0, 4 and 8.
    [(0.002, 0.039, 0.004), (0.004, 0.036, 0.008), (0.008, 0.040, 0.006), (0.012, 0.036, 0.008)],
)
def test_the_margin_is_where_the_control_error_is_least(
    cycle_s: float, delay_s: float, least_s: float
) -> None:
    assert margin(cycle_s, delay_s, ControlSettings()) == pytest.approx(least_s)


def test_quick_servos_read_little_and_need_no_more() -> None:
    quick = replace(ControlSettings(), servos=(ServoModel(7.6, 0.81, 0.02),) * 7)
    # At 4 ms the error grew from 0: 0.0047, 0.0080, 0.015 mm with 0, 3 and 8 ms.
    assert margin(0.004, 0.024, quick) == 0.0


def test_without_a_feed_forward_nothing_is_read() -> None:
    assert margin(0.004, 0.036, replace(ControlSettings(), feed_forward=False)) == 0.0
