"""An order is answered with the state after it, or with why it led nowhere."""

import asyncio
from dataclasses import replace

import pytest
from loops import run

from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.cycle import watch
from linemate.daemon.cycle.operating import Operating, Situation
from linemate.daemon.cycle.sensing.samples import SensorQueues
from linemate.daemon.cycle.states import Link, Machine, Signals, State
from linemate.daemon.service.order_answers import CYCLES, Answers

CYCLE_S = 0.012
FIT = Signals(Link.HEALTHY, True, True, True)
SITUATION = Situation(None, None, None, False, True)


def operating(state: State) -> Operating:
    made = Operating(WatchSettings(), CYCLE_S, wrench_expected=False)
    made.machine, made.signals = Machine(state), FIT
    return made


def decide(made: Operating, monkeypatch: pytest.MonkeyPatch, **changes: bool) -> None:
    """One decision that sees the orders given, and else the given facts."""
    orders = dict.fromkeys(made._orders, True)
    seen = replace(FIT, **orders, **changes)
    monkeypatch.setattr(watch, "observe", lambda before, *_: (before, seen))
    made.decide(1, SensorQueues(), SITUATION, telegram=True)


@pytest.mark.parametrize(
    ("op", "before", "after"),
    [
        ("arm", State.IDLE, "armed"),
        ("start", State.ARMED, "track"),
        ("start", State.HOLD, "track"),
        ("stop", State.TRACK, "hold"),
        ("ack", State.FAULT, "idle"),
    ],
)
def test_the_answer_is_the_state_after_the_order(
    op: str, before: State, after: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        made = operating(before)
        answers = Answers(made, CYCLE_S)
        assert made.order(op, SITUATION, "alice") is None
        promise = answers.promise(op)
        answers.keep()
        assert not promise.done()
        decide(made, monkeypatch)
        answers.keep()
        assert promise.result() == {"state": after}

    run(main())


def test_an_order_that_was_overtaken_is_refused_with_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def main() -> None:
        made = operating(State.ARMED)
        answers = Answers(made, CYCLE_S)
        assert made.order("start", SITUATION) is None
        promise = answers.promise("start")
        decide(made, monkeypatch, position_fresh=False)
        answers.keep()
        refused = promise.result()["refused"]
        assert refused == "start: the state is IDLE: no fresh position of the object"

    run(main())


def test_without_a_decision_the_answer_comes_after_a_few_cycles() -> None:
    async def main() -> None:
        made = operating(State.INIT)
        answers = Answers(made, CYCLE_S)
        loop = asyncio.get_running_loop()
        began = loop.time()
        assert await answers.promise("stop") == {"state": "init"}
        assert loop.time() - began >= CYCLES * CYCLE_S - 0.002

    run(main())


def test_an_answer_that_no_one_waits_for_any_more_hurts_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def main() -> None:
        made = operating(State.IDLE)
        answers = Answers(made, CYCLE_S)
        made.order("arm", SITUATION)
        answers.promise("arm").cancel()
        decide(made, monkeypatch)
        answers.keep()
        await asyncio.sleep(2 * CYCLES * CYCLE_S)
        assert answers._waiting == []

    run(main())
