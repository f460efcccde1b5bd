"""The waits between two openings of a lost link."""

import pytest

from linemate.drivers.backoff import Backoff


def test_delays_double_up_to_the_longest() -> None:
    backoff = Backoff(0.1, 0.5)
    assert [backoff.next_delay() for _ in range(5)] == pytest.approx([0.1, 0.2, 0.4, 0.5, 0.5])


def test_a_link_that_lived_starts_afresh() -> None:
    backoff = Backoff(0.1, 2.0)
    for _ in range(4):
        backoff.next_delay()
    backoff.reset()
    assert backoff.next_delay() == pytest.approx(0.1)


@pytest.mark.parametrize(("first_s", "longest_s"), [(0.0, 1.0), (-1.0, 1.0), (2.0, 1.0)])
def test_delays_that_would_spin_are_refused(first_s: float, longest_s: float) -> None:
    with pytest.raises(ValueError, match="need 0 <"):
        Backoff(first_s, longest_s)
