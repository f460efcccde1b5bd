"""Setpoints that did not arrive, by where the controller sends its servos."""

import math
from collections.abc import Iterable, Iterator

import pytest

from linemate.daemon.cycle.session import Session
from linemate.daemon.cycle.setpoint_delivery import DeliveryCheck
from linemate.protocol.controller_link import ExchangeRules, SetpointKind

CYCLE_S = 0.004
SPEED = 0.106  # of the line [m/s]


def filtered(setpoints: Iterable[float], lag_s: float) -> Iterator[tuple[float, float]]:
    """Each setpoint, and where a filter of the first order has sent the servos a cycle later."""
    share = -math.expm1(-CYCLE_S / lag_s)
    sent_to: float | None = None
    for setpoint in setpoints:
        sent_to = setpoint if sent_to is None else sent_to + share * (setpoint - sent_to)
        yield setpoint, sent_to


def ramp(seconds: float) -> list[float]:
    return [SPEED * CYCLE_S * n for n in range(round(seconds / CYCLE_S))]


def follow(check: DeliveryCheck, ways: Iterable[tuple[float, float]]) -> None:
    for setpoint, sent_to in ways:
        check.add((0.0, setpoint), (0.0, sent_to))


@pytest.mark.parametrize("lag_s", [1e-3, 8e-3, 0.05])
@pytest.mark.parametrize("motion", ["ramp", "brake", "reversal", "swing"])
def test_no_motion_that_arrives_is_lost(lag_s: float, motion: str) -> None:
    way = [0.0] * 20 + ramp(0.3)
    end = way[-1]
    way += {
        "ramp": [end + SPEED * CYCLE_S * n for n in range(50)],
        "brake": [end] * 50,
        "reversal": [end - 3.0 * SPEED * CYCLE_S * n for n in range(50)],
        "swing": [end + 0.01 * math.sin(2.0 * math.pi * 1.2 * CYCLE_S * n) for n in range(500)],
    }[motion]
    check = DeliveryCheck(CYCLE_S)
    for setpoint, sent_to in filtered(way, lag_s):
        check.add((0.0, setpoint), (0.0, sent_to))
        assert not check.is_lost


def lost_after(check: DeliveryCheck, lag_s: float) -> float:
    """Time from the first setpoint that does not arrive until it counts as lost [s]."""
    ways = list(filtered(ramp(0.2), lag_s))
    follow(check, ways)
    setpoint, sent_to = ways[-1]
    held = setpoint
    share = -math.expm1(-CYCLE_S / lag_s)
    for n in range(1, 50):
        setpoint += SPEED * CYCLE_S
        sent_to += share * (held - sent_to)
        check.add((0.0, setpoint), (0.0, sent_to))
        if check.is_lost:
            return n * CYCLE_S
    return math.inf


@pytest.mark.parametrize(("lag_s", "limit_s"), [(1e-3, 0.025), (8e-3, 0.037)])
def test_setpoints_that_do_not_arrive_are_seen_after_the_filters_lag(
    lag_s: float, limit_s: float
) -> None:
    assert lost_after(DeliveryCheck(CYCLE_S), lag_s) <= limit_s


def lost() -> tuple[DeliveryCheck, float]:
    """A check that has seen a loss, and where the servos stand."""
    check = DeliveryCheck(CYCLE_S)
    lost_after(check, 1e-3)
    return check, ramp(0.2)[-1]


def test_a_loss_ends_as_the_servos_follow_each_setpoint_again() -> None:
    check, place = lost()
    for n in range(3):
        assert check.is_lost, n
        check.add((0.0, place + 1e-4), (0.0, place + 5e-5))
        place += 5e-5
    assert not check.is_lost
    assert check.is_doubtful


def test_an_older_setpoint_that_comes_late_ends_no_loss() -> None:
    check, place = lost()
    for _ in range(5):
        check.add((0.0, place + 1e-4), (0.0, place + 2e-3))
        place += 2e-3
    assert check.is_lost


def test_the_way_is_doubtful_until_setpoints_have_arrived_for_a_tenth_of_a_second() -> None:
    check, place = lost()
    for n in range(25):
        assert check.is_doubtful, n
        check.add((0.0, place + 1e-4), (0.0, place + 5e-5))
        place += 5e-5
    assert not check.is_doubtful


def test_a_session_holds_where_the_servos_are_sent_after_a_loss() -> None:
    rules = ExchangeRules(SetpointKind.POSITIONS)
    session = Session(CYCLE_S, rules)
    for n, setpoint in enumerate(ramp(0.2), 1):
        session.pending = (0.0, setpoint)
        assert not session.settle(None, 1, n, (0.0, setpoint))
    stands = session.applied
    for n, way in enumerate(ramp(0.05)):
        session.pending = (0.0, stands[1] + way)
        if session.settle(None, 1, n, stands):
            break
    assert session.was_lost
    assert session.held == stands
    assert not session.moves


def test_a_cycle_without_a_telegram_begins_again() -> None:
    rules = ExchangeRules(SetpointKind.POSITIONS)
    session = Session(CYCLE_S, rules)
    for n, setpoint in enumerate(ramp(0.2), 1):
        session.pending = (0.0, setpoint)
        session.settle(None, 2, n, (0.0, 0.0))
        assert not session.was_lost


def test_a_loss_ends_at_rest_where_the_servos_are_sent_to_the_setpoint() -> None:
    check, place = lost()
    for n in range(30):
        check.add((0.0, place), (0.0, place + 1e-7 * 0.5**n))
    assert not check.is_lost
    assert not check.is_doubtful
