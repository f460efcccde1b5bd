"""Order of the time-outs."""

from dataclasses import replace

import pytest

from linemate.daemon.config.watch_settings import WatchSettings, timeout_error


@pytest.mark.parametrize("cycle_s", [0.001, 0.002, 0.004, 0.012])
def test_the_shipped_time_outs_can_all_act_at_any_cycle(cycle_s: float) -> None:
    assert timeout_error(WatchSettings(), cycle_s) is None


@pytest.mark.parametrize(
    ("changed", "name", "reason"),
    [
        ({"missed_s": 0.11}, "missed_s", "longer than watch.link_lost_s: 0.1 s"),
        ({"missed_s": 0.01}, "missed_s", "shorter than a cycle of 0.012 s"),
        ({"missed_in_contact_s": 0.4}, "missed_in_contact_s", "watch.link_lost_in_contact_s"),
        ({"missed_in_contact_s": 0.02}, "missed_s", "longer than watch.missed_in_contact_s"),
        ({"cycles_of_contact": 13}, "cycles_of_contact", "13 cycles are 0.156 s, at most 0.15 s"),
        ({"cycles_of_overload": 1000}, "cycles_of_overload", "1000 cycles are 12 s"),
        ({"link_lost_s": 0.5}, "link_lost_s", "longer than watch.link_lost_in_contact_s: 0.3 s"),
    ],
)
def test_a_time_out_that_never_acts_is_refused_with_both_values(
    changed: dict[str, float], name: str, reason: str
) -> None:
    error = timeout_error(replace(WatchSettings(), **changed), 0.012)
    assert error is not None
    assert error[0] == name
    assert reason in error[1]
