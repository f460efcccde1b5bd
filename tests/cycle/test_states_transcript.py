"""States and watch as they always answered: the whole table, and long random days at its edges.

The time-outs stand here as numbers of their own; see ``transcripts`` for what a digest says.
"""

import itertools
from dataclasses import astuple, fields, replace

import pytest
from msgspec import structs
from transcripts import Chance, Transcript

from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.cycle.states import (
    Link,
    Machine,
    Signals,
    State,
    fit,
    order,
    refusal,
    transition,
    unfit,
)
from linemate.daemon.cycle.watch import Facts, Watch, observe

# Younger than the transcripts: the orders home and follow, the last flags, and their states.
FLAGS = len(fields(Signals)) - 3
STATES = tuple(state for state in State if state not in {State.HOME, State.FOLLOW})
OPS = ("arm", "start", "stop", "retreat", "ack", "status")
MS = 1_000_000
EDGES = (0.0, 0.0999, 0.1, 0.1001, 0.14, 0.16, 0.161, 0.25, 0.3, 0.301, 0.999, 1.0, 1.001, 60.0)


def _text(machine: Machine) -> tuple[object, ...]:
    return str(machine.state), machine.latched, machine.programmed, machine.because


def _without_home(reason: str | None) -> str | None:
    """A refusal as it was before a retreat was taken on the way home and while following."""
    if reason is None:
        return None
    return reason.replace("FOLLOW, HOLD, HOME, RETREAT", "HOLD, RETREAT")


@pytest.mark.parametrize(
    ("state", "digest"),
    [
        (State.INIT, "4756bd6e3ac3bda7"),
        (State.IDLE, "89bb798f535ccdc7"),
        (State.ARMED, "0ed8c3cf07fc1c1b"),
        (State.TRACK, "14a5c27554575547"),
        (State.CONTACT, "2925cce02d2abe47"),
        (State.RETREAT, "cfc8b552d5cf00ab"),
        (State.HOLD, "e3a8a0a388594a92"),
        (State.FAULT, "b009407c152ccc10"),
    ],
)
def test_the_whole_table_decides_as_it_always_did(state: State, digest: str) -> None:
    transcript = Transcript()
    machines = [Machine(state, *bits) for bits in itertools.product((False, True), repeat=2)]
    chance = Chance(f"states/{state}")
    for link in Link:
        for bits in itertools.product((False, True), repeat=FLAGS):
            if not chance.happens(0.05):
                continue
            signals = Signals(link, *bits)
            transcript.say(fit(signals), unfit(signals))
            for machine in machines:
                transcript.say(_text(transition(machine, signals)))
                refusals = [refusal(machine, signals, op) for op in OPS]
                transcript.say([_without_home(reason) for reason in refusals])
    transcript.say([str(order(machine)) for machine in machines])
    assert transcript.digest == digest


SMALL = WatchSettings(healthy_cycles=7, missed_s=0.03, missed_in_contact_s=0.055, leak_s=0.1)
SHIPPED = WatchSettings()


def _day(settings: WatchSettings, chance: Chance, transcript: Transcript) -> None:
    """Cycles with and without telegrams, sensors of every age, in every state."""
    watch, machine, now_ns = Watch(), Machine(), 10_000 * MS
    weather = 0.99
    for _ in range(150):
        now_ns += chance.pick((12, 12, 12, 12, 50, 100, 101)) * MS
        if chance.happens(0.1):
            weather = chance.pick((1.0, 0.9, 0.6, 0.0))
        if chance.happens(0.1):
            machine = Machine(chance.pick(STATES))

        def aged(now_ns: int = now_ns) -> int | None:
            age_s = chance.pick(EDGES) if chance.happens(0.3) else 0.01
            return None if chance.happens(0.03) else now_ns - round(age_s * 1e9)

        def seldom(share: float = 0.05) -> bool:
            return chance.happens(share)

        facts = Facts(
            now_ns,
            chance.happens(weather),
            new_session=seldom(0.02),
            position_ns=aged(),
            slower_ns=None if seldom(0.3) else aged(),
            wrench_ns=aged(),
            wrench_expected=not seldom(),
            contradicted=seldom(),
            gap_m=chance.pick((None, 0.0, 0.0299, 0.03, 0.0301, 1.0)),
            following_error=chance.happens(0.6),
            ready=not seldom(),
            object_left=seldom(),
            contact=seldom(0.5),
            overload=seldom(0.3),
            done=seldom(),
            clear=seldom(),
            fault=seldom(),
            orders=frozenset(op for op in OPS[:5] if seldom()),
        )
        watch, signals = observe(watch, facts, machine, settings)
        transcript.say(str(watch.link), str(watch.state), [str(v) for v in structs.astuple(watch)])
        transcript.say([str(v) for v in astuple(signals)[:-2]])


@pytest.mark.parametrize(
    ("settings", "digest"),
    [
        (SMALL, "224902c97fbf8dc4"),
        (SHIPPED, "ec7cc44d2cd0f279"),
        (replace(SHIPPED, healthy_cycles=1, leak_s=0.02), "2061fa5ad6b8ebac"),
    ],
    ids=["small", "shipped", "least"],
)
def test_the_watch_sees_as_it_always_did(settings: WatchSettings, digest: str) -> None:
    transcript = Transcript()
    for day in range(60):
        _day(settings, Chance(f"watch/{day}"), transcript)
    assert transcript.digest == digest


@pytest.mark.parametrize(
    ("state", "longest_s"),
    [(State.HOLD, 60.0), (State.RETREAT, 20.0), (State.HOME, 60.0), (State.TRACK, 1e9)],
)
def test_a_state_may_last_to_the_nanosecond(state: State, longest_s: float) -> None:
    begun_ns = 5_000 * MS
    watch, _ = observe(Watch(), Facts(begun_ns, telegram=True), Machine(state), SHIPPED)
    for beyond, expired in ((0, False), (200, state is not State.TRACK)):
        at_ns = begun_ns + round(longest_s * 1e9) + beyond
        _, signals = observe(watch, Facts(at_ns, telegram=True), Machine(state), SHIPPED)
        assert signals.expired is expired
