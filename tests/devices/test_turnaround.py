"""Percentiles of reply times."""

import pytest

from linemate.simulators.devices import turnaround
from linemate.simulators.devices.turnaround import TurnAround


def test_percentiles_are_values_that_occurred() -> None:
    times = TurnAround()
    for value in range(1000, 0, -1):
        times.add(value * 1000)
    summary = times.summary_us()
    assert summary == {"p50": 501.0, "p99": 991.0, "p999": 1000.0, "max": 1000.0}
    assert times.summary_us(10) == {"p50": 6.0, "p99": 10.0, "p999": 10.0, "max": 10.0}


def test_before_the_first_reply_there_is_nothing_to_tell() -> None:
    times = TurnAround()
    assert times.summary_us() is None
    times.add(1)
    times.clear()
    assert times.summary_us() is None


def test_memory_is_bounded_and_the_longest_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(turnaround, "KEEP", 5)
    times = TurnAround()
    for value in (1, 2, 3, 4, 5, 9000):
        times.add(value)
    assert len(times) == 5
    assert times.forgotten == 1
    summary = times.summary_us()
    assert summary is not None
    assert summary["max"] == 9.0
