"""The cyclic exchange in the controller's role: what it charges, and when it breaks off."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linemate.protocol.exchange_controller import (
    HISTORY,
    TABLE,
    ControllerExchange,
    ControllerState,
    Judgement,
    ReplyEvent,
)


def controller(**settings_: object) -> ControllerExchange:
    return ControllerExchange(**({"step": 4, "timeout": 3, "first_counter": 1000} | settings_))


def test_a_reply_in_time_with_its_ipoc_is_accepted() -> None:
    exchange = controller()
    for n in range(5):
        ipoc = exchange.next_counter()
        assert ipoc == 1000 + 4 * n
        assert exchange.on_reply(ipoc, stamp_ns=3, deadline_ns=4) is Judgement.ACCEPTED
        assert exchange.state is ControllerState.ANSWERED
        assert exchange.close_cycle() is Judgement.ACCEPTED
        assert exchange.close_cycle() is None
    assert exchange.delay == exchange.row == 0
    assert (exchange.counts.sent, exchange.counts.answered) == (5, 5)


def test_a_reply_at_the_deadline_is_late_and_its_cycle_is_charged() -> None:
    exchange = controller()
    ipoc = exchange.next_counter()
    assert exchange.on_reply(ipoc, stamp_ns=4, deadline_ns=4) is Judgement.LATE
    assert exchange.on_reply(ipoc, stamp_ns=3, deadline_ns=4) is Judgement.DUPLICATE
    assert exchange.close_cycle() is Judgement.LATE
    assert (exchange.delay, exchange.row) == (1, 1)
    assert exchange.counts.late == 1
    assert exchange.counts.lost == exchange.counts.answered == 0


def test_a_reply_in_the_next_cycle_is_late_and_charged_once() -> None:
    exchange = controller()
    old = exchange.next_counter()
    new = exchange.next_counter()
    assert (exchange.delay, exchange.counts.lost) == (1, 1)
    assert exchange.on_reply(old) is Judgement.LATE
    assert (exchange.delay, exchange.counts.lost, exchange.counts.late) == (1, 0, 1)
    assert exchange.on_reply(old) is Judgement.DUPLICATE
    assert exchange.on_reply(new) is Judgement.ACCEPTED
    exchange.close_cycle()
    assert exchange.on_reply(new) is Judgement.DUPLICATE
    assert (exchange.delay, exchange.row) == (1, 0)


def test_a_reply_between_cycles_is_late() -> None:
    exchange = controller()
    ipoc = exchange.next_counter()
    assert exchange.close_cycle() is Judgement.MISSING
    assert exchange.on_reply(ipoc) is Judgement.LATE


def test_a_second_reply_is_a_duplicate_and_costs_nothing() -> None:
    exchange = controller()
    ipoc = exchange.next_counter()
    exchange.on_reply(ipoc)
    assert exchange.on_reply(ipoc) is Judgement.DUPLICATE
    assert exchange.close_cycle() is Judgement.ACCEPTED
    assert exchange.delay == 0
    assert exchange.counts.duplicate == 1


@pytest.mark.parametrize("wrong", [1004, 1001, 996, 0, 10**9, -4])
def test_an_ipoc_never_sent_is_wrong_and_the_same_as_no_answer(wrong: int) -> None:
    exchange = controller()
    assert exchange.on_reply(wrong) is Judgement.WRONG_COUNTER
    assert exchange.delay == 0
    exchange.next_counter()
    assert exchange.on_reply(wrong) is Judgement.WRONG_COUNTER
    assert exchange.close_cycle() is Judgement.REFUSED
    assert (exchange.delay, exchange.counts.refused, exchange.counts.lost) == (1, 1, 0)
    assert exchange.counts.wrong_counter == 2


def test_an_unreadable_reply_is_the_same_as_no_answer() -> None:
    exchange = controller()
    exchange.next_counter()
    assert exchange.on_unreadable() is Judgement.REFUSED
    assert exchange.on_unreadable() is Judgement.REFUSED
    assert exchange.close_cycle() is Judgement.REFUSED
    assert (exchange.delay, exchange.counts.refused, exchange.counts.unreadable) == (1, 1, 2)


def test_a_bad_reply_after_a_good_one_is_charged_and_the_cycle_is_answered() -> None:
    exchange = controller()
    for first_bad in (True, False):
        ipoc = exchange.next_counter()
        if first_bad:
            exchange.on_unreadable()
        assert exchange.on_reply(ipoc) is Judgement.ACCEPTED
        if not first_bad:
            exchange.on_reply(5)
        assert exchange.close_cycle() is Judgement.ACCEPTED
    assert (exchange.delay, exchange.row, exchange.counts.answered) == (2, 0, 2)


def run(exchange: ControllerExchange, pattern: str) -> int:
    """Cycles that the pattern of answers (``.``) and silences (``x``) lasts."""
    for n, answer in enumerate(pattern):
        ipoc = exchange.next_counter()
        if exchange.broken:
            return n
        if answer == ".":
            exchange.on_reply(ipoc)
    exchange.close_cycle()
    return len(pattern)


@pytest.mark.parametrize(
    ("rule", "pattern", "lasts"),
    [
        ("total", "x.x.x.......", 12),
        ("total", "x.x.x..x.....", 8),
        ("total", "xxxx..", 4),
        ("row", "x.x.x.x.x.x.", 12),
        ("row", "xxx.xxx.xxx.", 12),
        ("row", "..xxxx.....", 6),
    ],
)
def test_the_timeout_breaks_off_by_its_rule(rule: str, pattern: str, lasts: int) -> None:
    exchange = controller(rule=rule)
    assert run(exchange, pattern) == lasts
    assert exchange.broken is (lasts < len(pattern))


def test_a_broken_exchange_stays_so_until_it_is_started_again() -> None:
    exchange = controller(timeout=0)
    last = exchange.next_counter()
    assert exchange.next_counter() == last
    assert exchange.broken
    assert exchange.next_counter() == last
    assert exchange.on_reply(last) is Judgement.LATE
    assert exchange.on_reply(last) is Judgement.DUPLICATE
    assert exchange.on_reply(last + 4) is Judgement.WRONG_COUNTER
    assert exchange.on_unreadable() is Judgement.REFUSED
    assert exchange.broken
    assert (exchange.counts.sent, exchange.delay) == (1, 1)
    exchange.restart(8)
    assert not exchange.broken
    assert (exchange.next_counter(), exchange.delay, exchange.row) == (8, 0, 0)
    assert exchange.counts.sent == 2


def test_a_patient_controller_charges_nothing_before_the_first_answer() -> None:
    exchange = controller(patient=True)
    assert run(exchange, "xxxxxxxx.xxx") == 12
    assert (exchange.delay, exchange.row, exchange.counts.lost) == (3, 3, 11)
    assert run(exchange, "xx") == 1
    assert exchange.broken


def test_a_very_old_reply_is_late_and_forgotten() -> None:
    exchange = controller(timeout=1000)
    first = exchange.next_counter()
    for _ in range(HISTORY + 5):
        exchange.next_counter()
    assert exchange.on_reply(first) is Judgement.LATE
    assert (exchange.counts.late, exchange.counts.lost) == (0, HISTORY + 5)


@pytest.mark.parametrize(
    "bad", [{"step": 0}, {"timeout": -1}, {"first_counter": -1}, {"rule": "sometimes"}]
)
def test_a_controller_that_cannot_be_is_refused(bad: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="="):
        controller(**bad)


@given(
    st.lists(
        st.one_of(
            st.sampled_from(["next", "close", "unreadable"]),
            st.tuples(st.integers(-3, 110), st.integers(0, 3), st.booleans()),
        ),
        max_size=150,
    )
)
def test_every_closed_cycle_is_counted_exactly_once(
    calls: list[str | tuple[int, int, bool]],
) -> None:
    exchange = controller(timeout=100, rule="row")
    for call in calls:
        match call:
            case "next":
                exchange.next_counter()
            case "close":
                exchange.close_cycle()
            case "unreadable":
                exchange.on_unreadable()
            case (behind, odd, late):
                newest = 1000 + 4 * (exchange.counts.sent - 1)
                exchange.on_reply(newest - 4 * behind + odd, 9, 5 if late else None)
        counts = exchange.counts
        is_open = exchange.state in {ControllerState.WAITING, ControllerState.ANSWERED}
        closed = counts.answered + counts.late + counts.refused + counts.lost
        assert closed + is_open == counts.sent
        assert exchange.delay <= counts.sent
        assert min(counts.answered, counts.late, counts.refused, counts.lost) >= 0


def test_a_cycle_is_opened_and_closed_only_where_it_can_be() -> None:
    for state, row in TABLE.items():
        is_open = state in {ControllerState.WAITING, ControllerState.ANSWERED}
        assert (ReplyEvent.CLOSE in row) is is_open
        assert (ReplyEvent.OPEN in row) is (state is ControllerState.BETWEEN)
        assert (ReplyEvent.GOOD in row) is (state is ControllerState.WAITING)
