"""Counts of telegrams that last as long at any cycle."""

import pytest

from linemate.daemon.service.watch import WatchSettings
from linemate.simulators.harness.patience import patience


@pytest.mark.parametrize("cycle_s", [0.004, 0.012])
def test_as_much_time_is_borne_as_the_daemon_itself_bears_at_12_ms(cycle_s: float) -> None:
    own = WatchSettings()
    for name, count in patience(cycle_s).items():
        assert count * cycle_s == pytest.approx(0.012 * getattr(own, name))


def test_no_cycle_is_so_long_that_less_is_borne_than_the_daemon_itself_does() -> None:
    assert patience(0.05) == patience(0.012)
