"""Deflection that grows to one side: what of it the guide takes up."""

import math
from collections.abc import Iterable

import pytest

from linemate.daemon.core.tracking.classifiers import felt_drift
from linemate.daemon.core.tracking.classifiers.felt_drift import UNFELT, FeltDrift

DT = 0.012


def after(deflections: Iterable[float], dt: float = DT) -> FeltDrift:
    """What is known after deflections, each after the other."""
    felt = UNFELT
    for off in deflections:
        felt = felt_drift.observed(felt, off, dt)
    return felt


def stop(seconds: float, dt: float = DT) -> list[float]:
    """Deflections on an object that stops, without a tool that follows."""
    return [-0.052 * (k * dt) ** 2 for k in range(round(seconds / dt) + 1)]


def shares(deflections: list[float], dt: float = DT) -> list[float]:
    """Share that is taken up at each of some deflections, if none is."""
    count = range(1, len(deflections) + 1)
    return [felt_drift.share_taken(after(deflections[:k], dt)) for k in count]


def test_a_stop_is_taken_up_before_its_force_is_100_n() -> None:
    taken = shares(stop(0.19))
    assert taken[-1] == 1.0
    assert next(k for k, share in enumerate(taken) if share) * DT < 0.15


@pytest.mark.parametrize("dt", [0.004, 0.012])
def test_nothing_is_taken_up_in_the_first_tenth_of_a_second(dt: float) -> None:
    assert not any(shares(stop(0.09, dt), dt))


@pytest.mark.parametrize("frequency_hz", [1.0, 3.0, 5.0, 8.0])
def test_a_body_that_swings_to_both_sides_is_not_taken_up(frequency_hz: float) -> None:
    swing = [0.0015 * math.sin(math.tau * frequency_hz * k * DT) for k in range(200)]
    turned = math.ceil(0.5 / frequency_hz / DT) + 2
    assert not any(shares(swing)[turned:])


@pytest.mark.parametrize("frequency_hz", [3.0, 5.0, 8.0])
def test_the_first_quarter_of_a_quick_swing_is_not_taken_up(frequency_hz: float) -> None:
    swing = [0.003 * math.sin(math.tau * frequency_hz * k * DT) for k in range(30)]
    assert not any(shares(swing))


def test_a_large_deflection_that_does_not_grow_is_not_taken_up() -> None:
    assert felt_drift.share_taken(after([0.004] * 40)) == 0.0


def test_what_is_taken_up_is_not_taken_up_again() -> None:
    felt = after(stop(0.19))
    left = felt_drift.taken(felt, 1.0)
    assert left.off == left.speed == 0.0
    assert felt_drift.taken(felt, 0.0) is felt
    assert felt_drift.taken(UNFELT, 0.5) is UNFELT
    assert not felt_drift.share_taken(left)


def test_a_swing_is_known_by_how_far_it_was_on_the_side_before() -> None:
    swing = [0.0015 * math.sin(math.tau * 3.0 * k * DT) + 0.0005 for k in range(60)]
    assert after(swing[:10]).reach == math.inf
    turned = next(k for k in range(20, 60) if after(swing[: k + 1]).side < 0)
    assert after(swing[: turned + 1]).reach == pytest.approx(0.002, abs=1e-4)


def test_a_new_class_keeps_the_side_alone() -> None:
    felt = after(stop(0.19))
    assert felt_drift.moved(felt) == FeltDrift(side=-1, kept_s=felt.kept_s)


@pytest.mark.parametrize(
    ("frequency_hz", "expected"), [(0.6, False), (0.9, False), (2.7, True), (4.0, True)]
)
@pytest.mark.parametrize("dt", [0.004, 0.012])
def test_a_swing_is_quick_if_half_of_it_is_no_longer_than_twice_the_delay(
    frequency_hz: float, dt: float, *, expected: bool
) -> None:
    swing = [0.003 * math.sin(math.tau * frequency_hz * k * dt) for k in range(round(3.0 / dt))]
    assert after(swing, dt).is_quick is expected


def test_a_quick_swing_that_becomes_a_deflection_to_one_side_is_no_more_quick() -> None:
    swing = [0.003 * math.sin(math.tau * 2.7 * k * DT) for k in range(84)]
    assert after(swing).is_quick
    assert not after([*swing, *[-0.004] * 30]).is_quick


def test_the_mean_of_a_ring_is_a_quarter_of_it_and_that_of_a_lasting_deflection_all_of_it() -> None:
    ring = [0.002 * math.sin(math.tau * 6.0 * k * DT) for k in range(100)]
    means = [after(ring[:count]).mean for count in range(60, 100)]
    assert max(map(abs, means)) < 0.3 * 0.002
    assert after([0.002] * 40).mean == pytest.approx(0.002)


@pytest.mark.parametrize(("mean", "drift"), [(0.0002, 0.0024), (-0.0002, 0.0)])
def test_a_ring_that_has_come_from_the_other_side_drifts_nowhere(mean: float, drift: float) -> None:
    felt = FeltDrift(off=0.0005, mean=mean, speed=0.02)
    assert felt_drift.drift_ahead(felt) == pytest.approx(drift)


def test_by_how_much_the_guide_was_drawn_is_forgotten_within_a_second() -> None:
    felt = felt_drift.taken(after(stop(0.19)), 0.5)
    drawn, off = felt.drawn, felt.off
    assert off is not None
    assert drawn == pytest.approx(off)
    for _ in range(round(1.0 / DT)):
        felt = felt_drift.observed(felt, off, DT)
    assert felt.drawn == pytest.approx(drawn / math.e, rel=0.01)
    assert felt_drift.moved(felt).drawn == 0.0
