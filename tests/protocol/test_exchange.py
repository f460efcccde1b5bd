"""The cyclic exchange in the daemon's role."""

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from linemate.protocol.exchange import (
    CONSISTENT,
    TABLE,
    WINDOW,
    Exchange,
    ExchangeState,
    TelegramDecision,
    TelegramKind,
)

CYCLE_S = 0.012
CYCLE_NS = 12_000_000
STEP = 12
FIRST = 4208163634


class Feed:
    """An exchange that is fed telegrams by cycle number: IPOC and stamp agree by default."""

    def __init__(self, step: int = STEP, cycle_s: float = CYCLE_S) -> None:
        self.exchange = Exchange(cycle_s)
        self.step = step
        self.cycle_ns = round(cycle_s * 1e9)

    def __call__(
        self, cycle: float, ipoc_cycle: float | None = None, peer: object = None
    ) -> TelegramDecision:
        at = cycle if ipoc_cycle is None else ipoc_cycle
        ipoc = FIRST + round(at * self.step)
        return self.exchange.on_telegram(ipoc, round(cycle * self.cycle_ns), peer)

    def kinds(self, *cycles: float) -> list[str]:
        return [self(cycle).kind.value for cycle in cycles]

    def kinds_of(self, *telegrams: tuple[float, float]) -> list[str]:
        """Kinds of telegrams that come in one cycle with the counter of another."""
        return [self(cycle, counter).kind.value for cycle, counter in telegrams]


def running(step: int = STEP) -> Feed:
    """A session whose step is settled; the last telegram is that of cycle 4."""
    feed = Feed(step)
    assert feed.kinds(0, 1, 2, 3, 4) == ["first", "normal", "normal", "normal", "normal"]
    assert feed.exchange.state is ExchangeState.RUNNING
    return feed


def test_a_counter_that_jumped_goes_on_from_there() -> None:
    feed = running()
    gap = feed(5, 8)
    assert (gap.missed, gap.steps) == (3, 4)
    feed.exchange.note_jump(3)
    normal = feed(6, 9)
    assert (normal.kind, normal.missed, normal.steps) == (TelegramKind.NORMAL, 0, 1)


@pytest.mark.parametrize("lost", [False, True])
def test_a_counter_of_32_bits_goes_on_from_zero(*, lost: bool) -> None:
    """A controller that counts each cycle stopped the robot as its counter began again."""
    exchange, first = Exchange(CYCLE_S), 2**32 - 4
    cycles = [cycle for cycle in range(9) if not (lost and cycle in {3, 4})]
    decisions = {
        cycle: exchange.on_telegram((first + cycle) % 2**32, cycle * CYCLE_NS) for cycle in cycles
    }
    assert {decision.session for decision in decisions.values()} == {1}
    assert sum(decision.steps for decision in decisions.values()) == 9
    # One that was missed before the end, and an older one, come after it.
    late = [exchange.on_telegram(first + n, 9 * CYCLE_NS + n).kind.value for n in (3, 2)]
    assert late == ["late" if lost else "backward", "backward"]
    assert exchange.on_telegram(5, 9 * CYCLE_NS + 9).kind is TelegramKind.NORMAL


def test_another_sender_turns_no_counter_over() -> None:
    feed = running()
    before = feed.exchange.foreseen()
    assert before is not None
    decision = feed.exchange.on_telegram(before[0] + 2**32, 5 * CYCLE_NS, "another")
    assert decision.kind is TelegramKind.REFUSED
    assert feed.exchange.foreseen() == before


@pytest.mark.parametrize(("ahead", "kind"), [(WINDOW, "gap"), (WINDOW + 1, "backward")])
def test_a_counter_goes_on_from_zero_within_the_window(ahead: int, kind: str) -> None:
    exchange, first = Exchange(CYCLE_S), 2**32 - 12 * 4
    for cycle in range(4):
        exchange.on_telegram(first + 12 * cycle, cycle * CYCLE_NS)
    decision = exchange.on_telegram(12 * (ahead - 1), (3 + ahead) * CYCLE_NS)
    assert decision.kind.value == kind


@pytest.mark.parametrize(("unmade", "made"), [(3, 1), (0, 0)])
def test_a_flipped_counter_gets_its_steps_as_their_cycles_pass(unmade: int, made: int) -> None:
    feed = running()
    feed(5, 8)
    feed.exchange.note_jump(unmade)
    for _ in (6, 7, 8):
        feed.exchange.on_missing()
    assert feed(9, 9).steps == made


@pytest.mark.parametrize("step", [12, 4, 1, 7])
def test_the_ipoc_step_is_learned(step: int) -> None:
    feed = Feed(step)
    first = feed(0)
    assert first == TelegramDecision(
        TelegramKind.FIRST, answer=True, missed=0, steps=1, session=1, step=None
    )
    assert feed(1).step == step
    assert feed(2) == TelegramDecision(
        TelegramKind.NORMAL, answer=True, missed=0, steps=1, session=1, step=step
    )
    assert feed.exchange.step == step
    assert feed.exchange.session == 1


@pytest.mark.parametrize(
    ("cycles", "kinds"),
    [
        ((0, 1, 3, 4, 5), ["first", "normal", "gap", "normal", "normal"]),
        ((0, 2, 3, 4, 5), ["first", "normal", "normal", "normal", "normal"]),
        ((0, 2, 4, 5, 6, 7), ["first", "normal", "normal", "refused", "normal", "new_session"]),
    ],
)
def test_telegrams_lost_while_learning_do_not_fix_a_wrong_step(
    cycles: tuple[int, ...], kinds: list[str]
) -> None:
    feed = Feed()
    assert feed.kinds(*cycles) == kinds
    assert feed.exchange.step == STEP
    assert feed(cycles[-1] + 1).kind is TelegramKind.NORMAL


def test_a_known_step_needs_no_learning() -> None:
    feed = Feed()
    feed(0)
    assert feed.exchange.state is ExchangeState.LEARNING
    feed.exchange.resume(STEP)
    assert (feed.exchange.state, feed.exchange.step) == (ExchangeState.RUNNING, STEP)
    assert feed(1).kind is TelegramKind.NORMAL


def test_a_session_is_opened_by_the_first_telegram_another_peer_or_after_silence() -> None:
    feed = Feed()
    assert feed.exchange.would_open(0, None)
    feed(0)
    assert not feed.exchange.would_open(CYCLE_NS, None)
    assert feed.exchange.would_open(CYCLE_NS, "other")
    assert feed.exchange.would_open(2_000_000_000, None)


def test_a_gap_says_how_many_cycles_passed() -> None:
    feed = running()
    decision = feed(8)
    assert (decision.kind, decision.answer, decision.missed, decision.steps) == (
        TelegramKind.GAP,
        True,
        3,
        4,
    )
    assert feed(9).kind is TelegramKind.NORMAL
    assert feed.exchange.counters["missed"] == 3
    assert feed.exchange.counters["gap"] == 1


def test_the_same_telegram_twice_is_answered_once() -> None:
    feed = running()
    decision = feed(4.1, 4)
    assert (decision.kind, decision.answer, decision.steps) == (TelegramKind.DUPLICATE, False, 0)
    assert feed(5).kind is TelegramKind.NORMAL


def test_a_telegram_after_its_successor_is_late_and_not_answered() -> None:
    feed = running()
    assert feed(6).kind is TelegramKind.GAP
    late = feed(6.1, 5)
    assert (late.kind, late.answer, late.steps) == (TelegramKind.LATE, False, 0)
    assert feed(6.2, 5).kind is TelegramKind.BACKWARD
    assert feed(7).kind is TelegramKind.NORMAL


def test_a_telegram_seen_long_ago_is_backward() -> None:
    feed = running()
    decision = feed(4.5, 2)
    assert (decision.kind, decision.answer) == (TelegramKind.BACKWARD, False)
    assert feed(5).kind is TelegramKind.NORMAL


def test_a_telegram_whose_step_the_clock_made_is_late_but_answered() -> None:
    feed = running()
    feed.exchange.on_missing()
    late = feed(5.7, 5)
    assert (late.kind, late.answer, late.steps, late.missed) == (TelegramKind.LATE, True, 0, 0)
    assert feed(6).steps == 1
    assert feed.exchange.counters["overdue"] == 1


def test_steps_of_the_clock_beyond_a_late_telegram_are_counted() -> None:
    feed = running()
    for _ in range(3):
        feed.exchange.on_missing()
    assert feed.exchange.ahead == 3
    for counter, ahead in ((5, 2), (7, 0), (8, 0)):
        feed(8, counter)
        assert feed.exchange.ahead == ahead


def test_steps_of_the_clock_are_taken_off_a_gap() -> None:
    feed = running()
    feed.exchange.on_missing()
    feed.exchange.on_missing()
    decision = feed(8)
    assert (decision.kind, decision.missed, decision.steps) == (TelegramKind.GAP, 3, 2)
    assert feed(9).steps == 1


def test_steps_that_the_clock_made_too_many_are_made_good() -> None:
    feed = running()
    for _ in range(3):
        feed.exchange.on_missing()
    assert feed(7, 5).steps == 0
    assert feed(7.1, 6).steps == 0
    assert feed(7.2, 7).steps == 0
    assert feed(8).steps == 1


def test_a_clock_before_the_first_telegram_owes_nothing() -> None:
    feed = Feed()
    feed.exchange.on_missing()
    assert feed.exchange.counters["overdue"] == 0
    assert feed(0).steps == 1


@pytest.mark.parametrize("ahead", [1e6 / STEP, WINDOW + 1, 2.5, -1e6, -FIRST / STEP, 50])
def test_a_counter_that_jumps_for_good_is_a_new_session_at_the_third_telegram(ahead: float) -> None:
    feed = running()
    decisions = [feed(5 + n, 5 + n + ahead) for n in range(5)]
    assert [v.answer for v in decisions] == [False, False, True, True, True]
    assert [v.kind for v in decisions[2:]] == [
        TelegramKind.NEW_SESSION,
        TelegramKind.NORMAL,
        TelegramKind.NORMAL,
    ]
    assert {v.session for v in decisions[2:]} == {2}
    assert decisions[2].steps == 1
    assert feed.exchange.state is ExchangeState.RUNNING


def test_a_new_session_may_have_another_step() -> None:
    feed = running()
    kinds = [feed.exchange.on_telegram(n, (5 + n) * CYCLE_NS).kind for n in range(5)]
    assert kinds[2:] == [TelegramKind.NEW_SESSION, TelegramKind.NORMAL, TelegramKind.NORMAL]
    assert feed.exchange.step == 1


def test_a_gap_may_be_as_wide_as_the_window_and_no_wider() -> None:
    feed = running()
    assert feed(4 + WINDOW).kind is TelegramKind.GAP
    assert feed(4 + 2 * WINDOW + 1).kind is TelegramKind.REFUSED


def test_a_line_goes_on_from_the_next_cycle_to_the_end_of_the_window() -> None:
    feed = running()
    assert feed(5, 9).kind is TelegramKind.GAP  # a flipped bit
    assert feed.kinds_of((6, 3), (7, 4), (8, 5)) == ["backward", "backward", "gap"]
    assert feed.exchange.session == 1
    feed = running()
    assert feed(4 + 96, 4 + WINDOW).kind is TelegramKind.GAP  # another
    assert feed.kinds_of((102, 102), (103, 103), (104, 104)) == ["late", "late", "gap"]
    assert feed.exchange.session == 1


@pytest.mark.parametrize(("apart", "in_line"), [(1, True), (1200, True), (1201, False)])
def test_telegrams_further_apart_than_the_window_are_no_line(apart: int, in_line: bool) -> None:
    feed = running()
    kinds = [feed.exchange.on_telegram(apart * n, (5 + n) * CYCLE_NS).kind for n in range(3)]
    assert (kinds[-1] is TelegramKind.NEW_SESSION) == in_line


@pytest.mark.parametrize(("cycle_s", "reach"), [(0.012, 1200), (0.004, 400), (0.0004, 100)])
def test_the_second_telegram_may_be_a_window_of_milliseconds_ahead(
    cycle_s: float, reach: int
) -> None:
    for ahead, kind in ((reach, TelegramKind.NORMAL), (reach + 1, TelegramKind.REFUSED)):
        exchange = Exchange(cycle_s)
        assert exchange.on_telegram(0, 0).kind is TelegramKind.FIRST
        assert exchange.on_telegram(ahead, round(cycle_s * 1e9)).kind is kind


@pytest.mark.parametrize(("at", "kind"), [(9.0, "gap"), (9.01, "late"), (5.5, "gap")])
def test_a_line_goes_on_only_in_its_time(at: float, kind: str) -> None:
    feed = running()
    assert feed(5, 9).kind is TelegramKind.GAP  # a flipped bit
    assert feed.kinds_of((5.1, 3), (5.2, 4), (at, 5)) == ["backward", "backward", kind]


def test_a_line_that_goes_on_makes_as_many_steps_as_cycles_have_passed() -> None:
    feed = running()
    ahead = feed(5, 9)  # a flipped bit
    assert ahead.steps == 5
    line = [feed(cycle) for cycle in range(6, 9)]
    assert [decision.kind for decision in line] == [
        TelegramKind.LATE,
        TelegramKind.LATE,
        TelegramKind.GAP,
    ]
    assert line[-1].missed == 3
    after = [feed(cycle) for cycle in range(9, 12)]
    assert [decision.steps for decision in (*line, *after)] == [0, 0, 0, 0, 1, 1]


def test_a_line_that_ends_at_the_last_telegram_does_not_continue() -> None:
    feed = running()
    assert feed(5, 9).kind is TelegramKind.GAP  # a flipped bit
    kinds = feed.kinds_of((6, 2), (7, 3), (8, 4))
    assert kinds == ["backward", "backward", "new_session"]


def test_a_burst_of_telegrams_in_one_line_begins_no_session() -> None:
    feed = running()
    kinds = feed.kinds_of((5.1, 10**6), (5.2, 10**6 + 1), (5.3, 10**6 + 2), (5.4, 10**6 + 3))
    assert kinds == ["refused"] * 4
    assert feed(6).kind is TelegramKind.GAP
    assert feed.exchange.session == 1


def test_forged_telegrams_between_those_of_the_controller_begin_no_session() -> None:
    feed = running()
    for k in range(5, 15):
        assert feed(k).kind is TelegramKind.NORMAL
        assert feed(k + 0.5, 10**6 + k).kind is TelegramKind.REFUSED
    assert feed.exchange.session == 1


def test_missed_telegrams_that_come_at_last_and_in_line_are_late_and_no_new_session() -> None:
    feed = running()
    assert feed.kinds_of((9, 9), (10, 10)) == ["gap", "normal"]
    assert feed.kinds_of((10.1, 5), (10.2, 6), (10.3, 7), (10.4, 8)) == ["late"] * 4
    assert feed(11).kind is TelegramKind.NORMAL
    assert feed.exchange.session == 1


@pytest.mark.parametrize("delayed", [(5, 6, 7), (6, 7, 8), (7, 8, 9)])
def test_delayed_telegrams_do_not_overrule_the_one_that_agrees_with_the_clock(
    delayed: tuple[int, int, int],
) -> None:
    feed = running()
    # No one has confirmed it yet, but counter and clock agree on it.
    assert feed(10).kind is TelegramKind.GAP
    arrivals = [(10.3 + 0.7 * n, cycle) for n, cycle in enumerate(delayed)]
    assert feed.kinds_of(*arrivals) == ["late"] * 3
    decision = feed(12)
    assert decision.kind is TelegramKind.GAP
    assert decision.missed == 1


@pytest.mark.parametrize(("ahead", "refused"), [(1, 1), (2, 2), (3, 2), (4, 2)])
def test_a_counter_that_was_flipped_ahead_is_caught_up_with_or_outvoted(
    ahead: int, refused: int
) -> None:
    feed = running()
    assert feed(5, 5 + ahead).answer
    answers = [feed(cycle).answer for cycle in range(6, 16)]
    assert answers == [False] * refused + [True] * (10 - refused)
    assert feed.exchange.session == 1


@pytest.mark.parametrize("late", [0.01, 0.3, 0.9])
@pytest.mark.parametrize("ahead", [1, 2, 3, 4])
def test_a_counter_that_was_flipped_ahead_in_a_late_telegram_begins_no_session(
    ahead: int, late: float
) -> None:
    feed = running()
    assert feed(5 + late, 5 + ahead).answer
    answers = [feed(cycle).answer for cycle in range(6, 16)]
    assert answers.count(False) <= 3
    assert all(answers[4:])
    assert feed.exchange.session == 1


def test_a_gap_without_the_time_for_it_is_a_flipped_bit() -> None:
    feed = running()
    assert feed(5, 5 + 16).kind is TelegramKind.REFUSED
    assert feed(6).kind is TelegramKind.GAP


@pytest.mark.parametrize(
    ("silence_s", "kind"),
    [(1.0, TelegramKind.GAP), (1.99, TelegramKind.REFUSED), (2.0, TelegramKind.NEW_SESSION)],
)
def test_silence_ends_a_session(silence_s: float, kind: TelegramKind) -> None:
    feed = running()
    cycles = round(silence_s / CYCLE_S)
    ipoc = FIRST + STEP * (4 + cycles)
    decision = feed.exchange.on_telegram(ipoc, 4 * CYCLE_NS + round(silence_s * 1e9))
    assert decision.kind is kind
    assert decision.session == (2 if kind is TelegramKind.NEW_SESSION else 1)


def test_a_counter_that_stands_still_is_a_new_session_after_the_silence() -> None:
    feed = running()
    answered = [n for n in range(5, 500) if feed(n, 4).answer]
    assert answered == [4 + 167, 4 + 2 * 167]


def test_another_peer_is_refused_while_the_first_one_lives() -> None:
    feed = Feed()
    for n in range(5):
        assert feed(n, peer="first").answer
        assert feed(n + 0.5, n + 1000, peer="second").kind is TelegramKind.REFUSED
    assert feed(12, 1012, peer="second").kind is TelegramKind.REFUSED
    taken_over = feed(13, 1013, peer="second")
    assert (taken_over.kind, taken_over.session) == (TelegramKind.NEW_SESSION, 2)
    assert feed(13.5, 13, peer="first").kind is TelegramKind.REFUSED
    assert feed(14, 1014, peer="second").kind is TelegramKind.NORMAL


def test_a_reset_begins_with_a_first_telegram_again() -> None:
    feed = running()
    feed.exchange.reset()
    decision = feed(5)
    assert (decision.kind, decision.session) == (TelegramKind.FIRST, 2)
    assert feed.exchange.counters["first"] == 2


@pytest.mark.parametrize("step", [12, 4, 1])
@pytest.mark.parametrize("position", range(8))
def test_a_flipped_bit_costs_at_most_three_answers(step: int, position: int) -> None:
    for bit in range(40):
        feed = Feed(step)
        decisions = []
        for n in range(position + 10):
            flip = 1 << bit if n == position else 0
            decisions.append(feed.exchange.on_telegram((FIRST + n * step) ^ flip, n * CYCLE_NS))
        after = decisions[position:]
        assert [decision.answer for decision in after].count(False) <= 3
        # Late where a small flip looked like a gap, and its steps were made too early.
        assert {decision.kind for decision in after[4:]} <= {TelegramKind.NORMAL, TelegramKind.LATE}
        assert after[-1].kind is TelegramKind.NORMAL
        assert feed.exchange.step == step
        assert position < 4 or feed.exchange.session == 1


PEERS = st.sampled_from([None, "a"])
NOISE = st.lists(
    st.tuples(
        st.one_of(st.integers(-5, 40).map(lambda n: FIRST + 4 * n), st.integers(0, 2**40)),
        st.integers(0, 30_000_000),
        PEERS,
        st.booleans(),
    ),
    max_size=40,
)


@settings(max_examples=300)
@given(
    NOISE,
    st.one_of(st.integers(-8, 40).map(lambda n: FIRST + 4 * n), st.integers(0, 2**40)),
    st.one_of(st.just(4), st.integers(1, 1000)),
)
@example([(FIRST + 4 * n, 4_000_000, None, False) for n in (0, 2, 4)], FIRST + 20, 4)
@example([(2, 0, "a", False)], 0, 1)
@example([(FIRST + 4 * n, CYCLE_NS, "a", False) for n in range(6)], FIRST + 12, 4)
@example([(FIRST + 4 * n, CYCLE_NS, "a", False) for n in (0, 1, 2, 3, 7)], FIRST + 12, 4)
def test_whatever_came_before_a_clean_line_is_answered_from_its_third_telegram(
    noise: list[tuple[int, int, str | None, bool]], start: int, step: int
) -> None:
    exchange = Exchange(CYCLE_S)
    now = 0
    for ipoc, wait, peer, missing in noise:
        now += wait
        if missing:
            exchange.on_missing()
        decision = exchange.on_telegram(ipoc, now, peer)
        assert decision.missed >= 0
        assert decision.steps >= 0
        assert decision.answer or not decision.steps
    now += 150_000_000
    for n in range(12):
        now += CYCLE_NS
        decision = exchange.on_telegram(start + n * step, now, "a")
        assert decision.answer or n < CONSISTENT - 1


@given(st.lists(st.sampled_from(["ok", "lost", "lost and stepped", "late"]), max_size=60))
def test_steps_follow_the_controllers_cycles(deliveries: list[str]) -> None:
    """Steps by the clock or by telegrams: at each answer k is the controller's."""
    feed = running()
    made = 4
    lost = 0
    for cycle, delivery in enumerate(deliveries, start=5):
        if delivery == "lost" and lost < WINDOW - 2:
            lost += 1
            continue
        if delivery in {"late", "lost and stepped"}:
            feed.exchange.on_missing()
            made += 1
        if delivery == "lost and stepped":
            lost += 1
            continue
        decision = feed(cycle)
        lost = 0
        made += decision.steps
        assert decision.answer
        assert made == cycle


def test_every_state_knows_every_event_that_can_reach_it() -> None:
    in_session = set(TABLE[ExchangeState.RUNNING]) & set(TABLE[ExchangeState.LEARNING])
    assert len(in_session) == 10
    for row in TABLE.values():
        for transition in row.values():
            fresh = transition.kind in {
                TelegramKind.FIRST,
                TelegramKind.NORMAL,
                TelegramKind.GAP,
                TelegramKind.NEW_SESSION,
            }
            assert transition.answer is fresh or transition.kind is TelegramKind.LATE
