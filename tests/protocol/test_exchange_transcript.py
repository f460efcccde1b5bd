"""Both roles of the exchange in long random conversations that go to the edges of every window.

The edges are numbers of this file: 100 cycles, 2 s, 100 ms, 4 cycles of tolerance.
"""

from dataclasses import astuple

import pytest
from msgspec import structs
from transcripts import Chance, Transcript

from linemate.protocol.exchange import Exchange, ExchangeState
from linemate.protocol.exchange_controller import ControllerExchange

EVENTS = 60
SCRIPTS = 500
AHEAD = (2, 3, 4, 5, 6, 7, 16, 50, 98, 99, 100, 101, 102)
MS = 1_000_000
S = 1_000 * MS


class Controller:
    """Somebody who counts, by chance as he should."""

    def __init__(self, chance: Chance) -> None:
        self.chance = chance
        self.cycle_ns = chance.pick((12, 4)) * MS
        self.step = chance.pick((12, 4, 1, 7))
        self.ipoc = chance.pick((0, 5000, 4208163634))
        self.now_ns = 10 * S
        self.peer = "first"
        self.exchange = Exchange(self.cycle_ns * 1e-9)
        self.transcript = Transcript()

    def send(self, ipoc: int, peer: str | None = None) -> None:
        exchange = self.exchange
        foreseen = exchange.foreseen()
        decision = exchange.on_telegram(ipoc, self.now_ns, peer or self.peer)
        self.transcript.say(
            ipoc, foreseen, structs.astuple(decision), exchange.state, exchange.step
        )
        is_open = exchange.state is not ExchangeState.IDLE
        self.transcript.say(
            exchange.session, self.now_ns + 1 - exchange._last_ns if is_open else None
        )

    def next(self, cycles: int = 1, passed: float | None = None) -> None:
        self.ipoc += cycles * self.step
        self.now_ns += round((cycles if passed is None else passed) * self.cycle_ns)
        self.send(self.ipoc)

    def event(self) -> None:  # noqa: PLR0912 - a case for each event
        chance = self.chance
        what = int(chance.between(0, 30))
        match what:
            case 0:
                self.next(chance.pick(AHEAD))
            case 1:  # too far ahead of the time that passed, by chance just so
                cycles = chance.pick(AHEAD)
                self.next(cycles, cycles - chance.pick((3, 4, 4.001, 5, 5.001, 6)))
            case 2:
                self.send(self.ipoc)
            case 3:
                self.send(self.ipoc - chance.pick((1, 2, 3, 99, 100, 101)) * self.step)
            case 4:  # a hole, and what was in it comes late, perhaps twice
                self.next(chance.pick((2, 3, 4)))
                for back in (1, 2, 1):
                    self.send(self.ipoc - back * self.step)
            case 5:
                for _ in range(chance.pick((1, 1, 2, 3, 5, 98, 99, 100, 101, 150))):
                    self.exchange.on_missing()
            case 6:
                self.send(self.ipoc + chance.pick((1, 2, 3, 5)))
            case 7:
                self.now_ns += chance.pick((S // 10 - 1, S // 10, S // 10 + 1, 50 * MS))
                self.send(chance.pick((7, self.ipoc + self.step)), "second")
                if chance.happens(0.3):
                    self.peer = "second" if self.peer == "first" else "first"
            case 8:
                self.now_ns += chance.pick((2 * S - 1, 2 * S, 2 * S + 1, S))
                self.send(self.ipoc + chance.pick((1, 2, 100)) * self.step)
            case 9:  # another programme, or one that counts otherwise
                self.ipoc = chance.pick((0, 3, 10**6, self.ipoc + 10**5))
                self.step = chance.pick((self.step, self.step, 5, 13))
            case 10:  # some steps elsewhere, then on as before, or not
                there = self.ipoc
                for n in range(chance.pick((1, 2, 3, 4))):
                    self.now_ns += self.cycle_ns
                    self.send(there + 10**6 + n * self.step)
                if chance.happens(0.7):
                    self.next(chance.pick((1, 2, 3, 4, 5, 99, 100, 101)))
            case 11:  # a line that goes on from before the jump, in or out of its time
                self.next(chance.pick((101, 102, 50)), 0.5)
                back = chance.pick((1, 2, 3, 40, 97, 98, 99, 100))
                self.ipoc -= 60 * self.step
                for _ in range(4):
                    self.next(1, chance.pick((1, 1, 1, back, 2.5)))
            case 12:
                self.exchange.reset()
            case 13:
                self.next(1, chance.pick((0.0, 0.2, 0.99, 1.01, 1.5, 4.0)))
            case _:
                self.next()


@pytest.mark.parametrize(
    ("part", "digest"),
    [
        (0, "20453e3b782867b8"),
        (1, "11e5e5e42dea08f5"),
        (2, "68a03d804d1a4e1d"),
        (3, "00026c408554bb92"),
    ],
)
def test_the_daemons_role_answers_as_it_always_did(part: int, digest: str) -> None:
    transcript = Transcript()
    kinds: set[str] = set()
    for script in range(SCRIPTS // 4):
        controller = Controller(Chance(f"exchange/{part}/{script}"))
        for _ in range(EVENTS):
            controller.event()
        counters = controller.exchange.counters
        kinds.update(name for name, count in counters.items() if count)
        transcript.say(controller.transcript.digest, counters)
    assert len(kinds) == 11  # every kind of telegram and every counter
    assert transcript.digest == digest


def _converse(chance: Chance, transcript: Transcript) -> None:  # noqa: PLR0912 - as above
    step = chance.pick((1, 4, 12))
    exchange = ControllerExchange(
        step,
        chance.pick((0, 1, 3, 10, 100)),
        chance.pick(("total", "row")),  # type: ignore[arg-type]
        first_counter=chance.pick((0, 1, 500)),
        patient=chance.happens(0.5),
    )
    ipoc, deadline_ns = 0, 0
    for _ in range(EVENTS):
        match int(chance.between(0, 12)):
            case 0 | 1 | 2 | 3:
                ipoc, deadline_ns = exchange.next_counter(), deadline_ns + 12 * MS
                transcript.say(ipoc)
                if chance.happens(0.6):
                    transcript.say(exchange.on_reply(ipoc, deadline_ns - 1, deadline_ns))
            case 4:
                ipoc, deadline_ns = exchange.next_counter(), deadline_ns + 12 * MS
                after = chance.pick((-1, 0, 1))
                transcript.say(exchange.on_reply(ipoc, deadline_ns + after, deadline_ns))
            case 5:
                transcript.say(exchange.on_reply(ipoc - chance.pick((0, 1, 2, 3, 50)) * step))
            case 6:
                transcript.say(exchange.on_reply(ipoc + chance.pick((-1, 1, 2, step, -(10**4)))))
            case 7:
                transcript.say(exchange.on_unreadable())
            case 8:
                transcript.say(exchange.close_cycle())
            case 9:
                if chance.happens(0.2):
                    exchange.restart(chance.pick((0, 7, 10**6)))
                    ipoc = 0
            case 10:
                for _ in range(chance.pick((1, 2, 3, 130))):
                    ipoc = exchange.next_counter()
                    transcript.say(ipoc)
                for back in (1, 2, 97, 98, 99, 100, 101, 102):
                    transcript.say(exchange.on_reply(ipoc - back * step))
            case _:
                transcript.say(exchange.on_reply(ipoc))
        transcript.say(exchange.state, exchange.broken, exchange.delay, exchange.row)
        transcript.say(astuple(exchange.counts))


@pytest.mark.parametrize(("part", "digest"), [(0, "33d15a1fbaacba43"), (1, "2a37d667f55efcb7")])
def test_the_controllers_role_answers_as_it_always_did(part: int, digest: str) -> None:
    transcript = Transcript()
    for script in range(SCRIPTS // 2):
        _converse(Chance(f"controller/{part}/{script}"), transcript)
    assert transcript.digest == digest
