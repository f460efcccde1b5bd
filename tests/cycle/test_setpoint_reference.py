"""Which correction is in force: every combination of evidence, and every short history."""

from dataclasses import dataclass, fields
from enum import Enum
from itertools import product
from random import Random
from typing import Any

import pytest

from linemate.daemon.cycle.session import Session
from linemate.daemon.cycle.setpoint_reference import (
    PROVEN,
    Known,
    Programmed,
    Proof,
    ProofEvidence,
    Start,
    decide,
    start_seen,
)
from linemate.protocol.exchange import Exchange, TelegramKind
from linemate.protocol.exchange import ExchangeState as Running
from linemate.protocol.stamped_samples import RobotSample

T = 0.012
T_NS = 12_000_000


def every_evidence() -> list[ProofEvidence]:
    values: list[Any] = [
        list(field.type)
        if isinstance(field.type, type) and issubclass(field.type, Enum)
        else [False, True]
        for field in fields(ProofEvidence)
    ]
    return [ProofEvidence(*combination) for combination in product(*values)]


EVERY = every_evidence()


def test_the_evidence_is_enumerated_whole() -> None:
    assert len(EVERY) == 3 * 2 * 2 * 3 * 2 * 3 * 2 * 2
    # A setpoint that is a position needs no evidence of a correction.
    assert {decide(e) for e in EVERY} == set(Proof) - {Proof.REPORTED}


def test_without_a_start_a_continuation_or_a_programmed_position_nothing_is_proven() -> None:
    for e in EVERY:
        has_start = e.start is Start.SEEN or e.confirmed
        has_zero = e.known is Known.UNMOVED
        has_position = e.programmed is Programmed.APART and e.at_rest
        if not (has_start or has_zero or has_position or e.goes_on):
            assert decide(e) not in PROVEN, e


def test_a_daemon_that_has_moved_the_robot_takes_no_single_telegram_for_a_start() -> None:
    for e in EVERY:
        if e.known is Known.MOVED and not e.confirmed:
            assert decide(e) not in {Proof.STARTED, Proof.UNMOVED}, e


def test_a_programmed_position_that_contradicts_is_never_overruled() -> None:
    for e in EVERY:
        if e.refuted:
            assert decide(e) is not Proof.CONTINUED, e
        if e.programmed is Programmed.APART:
            assert decide(e) not in {Proof.STARTED, Proof.UNMOVED}, e


def test_a_reply_that_may_have_been_applied_is_waited_for_until_the_axes_rest() -> None:
    for e in EVERY:
        if decide(e) is Proof.CONTINUED:
            assert e.held or e.at_rest, e


@pytest.mark.parametrize(
    ("delay", "silence_s", "since", "known", "start"),
    [
        (0, 1.0, 0, Known.NONE, Start.SEEN),
        (0, None, 1, Known.NONE, Start.NOT_SEEN),
        (None, 1.0, 1, Known.NONE, Start.NOT_SEEN),
        (0, 0.04, 1, Known.NONE, Start.NOT_SEEN),
        (0, 0.1, 1, Known.MOVED, Start.NOT_SEEN),
        (0, 0.2, 1, Known.MOVED, Start.SEEN),
        (2, 0.2, 2, Known.MOVED, Start.SEEN),
        (4, 0.2, 0, Known.NONE, Start.LIKELY),
        (16, 0.2, 0, Known.NONE, Start.NOT_SEEN),
    ],
)
def test_a_start_is_silence_that_delay_has_not_counted(
    delay: int | None, silence_s: float | None, since: int, known: Known, start: Start
) -> None:
    assert start_seen(delay, silence_s, since * T, T, known) is start


# Every short history of a controller, its network and the daemon, against the controller's truth.


SPEED = 0.001
"""What a reply moves the axis by, a cycle."""


@dataclass
class Controller:
    """One axis, absolute corrections, HOLDON=1, telegrams each cycle while the program runs."""

    rule: str
    ipoc: int = 5_000_000
    delay: int = 0
    row: int = 0
    start: float = 0.3
    correction: float = 0.0
    port: int = 1

    @property
    def position(self) -> float:
        return self.start + self.correction

    def charge(self, *, answered: bool) -> None:
        self.row = 0 if answered else self.row + 1
        self.delay += not answered

    @property
    def known(self) -> int:
        return self.delay if self.rule == "total" else self.row

    def restart(self) -> None:
        self.start, self.correction, self.delay, self.row = self.position, 0.0, 0, 0


class Bench:
    """A controller and the daemon's exchange and session, in the order in which a cycle has them.

    Invariant: what a reply makes the controller apply is at most SPEED from what it has.
    """

    def __init__(self, rule: str) -> None:
        self.controller = Controller(rule)
        self.now_ns = 10**12
        self.restarts = 0
        self.boot()
        self.pause(30)

    def boot(self) -> None:
        self.exchange = Exchange(T)
        self.session = Session(T)
        self.session.listen(self.now_ns)

    def pause(self, cycles: int) -> None:
        """Nothing is sent."""
        self.now_ns += cycles * T_NS

    def receive(self, ipoc: int, position: float, delay: int, port: int) -> float | None:
        """The daemon's reply to a telegram: the command, None for a bare one or no reply."""
        robot = RobotSample(self.now_ns, ipoc, (position, 0, 0, 0, 0, 0), (), delay)
        session, axes = self.session, (position, 0.0, 0.0, 0.0, 0.0, 0.0)
        session.note_telegram(self.now_ns)
        decision = self.exchange.on_telegram(ipoc, self.now_ns, port)
        self.answered = decision.answer
        if not decision.answer:
            return None
        opens = decision.kind in {TelegramKind.FIRST, TelegramKind.NEW_SESSION}
        if opens or session.needs_proof(robot, decision.missed):
            is_resumed = opens or session.is_interrupted or decision.missed > 0
            found = session.prove(robot, axes, None, port)
            if found is None:
                session.refrain()
                return None
            if session.proof is not Proof.CONTINUED:
                session.open(*found, delay)
            elif is_resumed:
                session.resume(found[1], delay)
                if session.step is not None and self.exchange.state is not Running.RUNNING:
                    self.exchange.resume(session.step)
        session.settle(delay, decision.missed + 1, self.now_ns)
        # Nothing moves before a link has proven itself.
        speed = SPEED if self.exchange.state is Running.RUNNING else 0.0
        command = (session.held[0] + speed, *axes[1:])
        reference = session.reference[0]
        step = self.exchange.step if self.exchange.state is Running.RUNNING else None
        session.note_reply(command, robot, port, step)
        return command[0] - reference

    def cycle(self, *, telegram: bool = True, reply: bool = True) -> None:
        controller = self.controller
        correction, answered = None, False
        if telegram:
            correction = self.receive(
                controller.ipoc, controller.position, controller.known, controller.port
            )
            answered = self.answered and reply
        if answered and correction is not None:
            step = abs(correction - controller.correction)
            assert step < 1.01 * SPEED, f"the robot jumps by {step}"
            controller.correction = correction
        controller.charge(answered=answered)
        controller.ipoc += 12
        self.now_ns += T_NS

    def run(self, cycles: int, **how: bool) -> None:
        for _ in range(cycles):
            self.cycle(**how)

    def stand_still(self, cycles: int) -> None:
        """The daemon's machine is paused, its clock with it; the controller goes on."""
        for _ in range(cycles):
            self.controller.charge(answered=False)
            self.controller.ipoc += 12

    def restart(self, cycles: int, *, ipoc: str) -> None:
        self.controller.restart()
        self.restarts += 1
        self.pause(cycles)
        self.controller.ipoc = {
            "clock": self.controller.ipoc + 12 * cycles,
            "second": self.controller.ipoc + 1000 + 12 * self.restarts,
            "first": 5_000_000,
        }[ipoc]

    def forge(self) -> None:
        """Three datagrams in the controller's name, within one cycle."""
        self.run(2)
        kept = self.now_ns
        for n in range(3):
            self.now_ns += 1_000_000
            assert self.receive(77 + 12 * n, 1.7, 0, self.controller.port) is None
        self.now_ns = kept

    def jump(self, ipoc: int) -> None:
        self.controller.ipoc = ipoc

    def act(self, event: str) -> None:
        what, _, how = event.partition(" ")
        match what:
            case "serve":
                self.run(int(how))
            case "reply":
                self.run(int(how), reply=False)
            case "telegram":
                self.run(int(how), telegram=False)
            case "paused":
                self.stand_still(int(how))
            case "stalled":
                self.pause(int(how))
            case "counter":
                self.jump(int(how[1:]) if how[0] == "=" else self.controller.ipoc + 12 * int(how))
            case "port":
                self.controller.port += 1
            case "forged":
                self.forge()
            case "daemon":
                self.run(int(how), telegram=False)
                self.boot()
            case "restart":
                cycles, ipoc = how.split()
                self.restart(int(cycles), ipoc=ipoc)


EVENTS = (
    "serve 4",
    "reply 1",
    "reply 9",
    "telegram 1",
    "telegram 12",
    "telegram 90",
    "paused 30",
    "paused 90",
    "counter 8",
    "counter -8",
    "counter =0",
    "counter 1000000",
    "port",
    "forged",
    "daemon 0",
    "daemon 8",
    "restart 10 clock",
    "restart 20 second",
    "restart 20 first",
    "restart 250 clock",
)


def live_through(rule: str, events: tuple[str, ...], served: int) -> None:
    """Let a moving program meet some events, then restart it: it must be served again."""
    bench = Bench(rule)
    bench.run(60)
    for event in events:
        bench.act(event)
        bench.run(served)
    bench.run(25)
    bench.restart(60, ipoc="second")
    bench.run(8)
    assert bench.session.is_proven, (rule, events, served)
    before = bench.controller.correction
    bench.run(4)
    assert bench.controller.correction == pytest.approx(before + 4 * SPEED)


@pytest.mark.parametrize("rule", ["total", "row"])
@pytest.mark.parametrize("first", EVENTS)
def test_no_pair_of_faults_makes_a_reply_move_the_robot_by_more_than_a_step(
    first: str, rule: str
) -> None:
    for second, served in product(EVENTS, (0, 1, 4)):
        live_through(rule, (first, second), served)


def test_no_three_faults_do_so_either() -> None:
    """A seeded share; all 16 000 histories of each rule hold."""
    chance = Random("histories")
    for _ in range(1500):
        events = tuple(chance.choice(EVENTS) for _ in range(3))
        live_through(chance.choice(("total", "row")), events, chance.choice((1, 4)))


@pytest.mark.parametrize("rule", ["total", "row"])
@pytest.mark.parametrize(
    "event", ["reply 9", "telegram 12", "paused 60", "paused 90", "counter 60", "counter =0"]
)
def test_a_single_fault_of_a_program_that_goes_on_does_not_end_it(event: str, rule: str) -> None:
    bench = Bench(rule)
    bench.run(60)
    start = bench.session.reference
    bench.act(event)
    bench.run(25)
    assert bench.session.is_proven
    assert bench.session.reference == start


@pytest.mark.parametrize("event", ["daemon 0", "daemon 8", "daemon 30", "daemon 200"])
def test_a_daemon_that_was_restarted_in_motion_sends_bare_replies_only(event: str) -> None:
    bench = Bench("total")
    bench.run(60)
    bench.act(event)
    before = bench.controller.correction
    bench.run(200)
    assert bench.controller.correction == before
    assert "Restart the controller's program" in str(bench.session.unproven)


# A stall directly after a jump of the counter or a restart of the daemon looks like a start.
BEFORE_STALL = [event for event in EVENTS if event.split()[0] not in {"counter", "daemon"}]


@pytest.mark.parametrize("rule", ["total", "row"])
@pytest.mark.parametrize("first", BEFORE_STALL)
def test_a_stall_of_the_controller_after_a_fault_moves_nothing(first: str, rule: str) -> None:
    for stall, served in product(("stalled 8", "stalled 14", "stalled 60"), (0, 1, 4)):
        live_through(rule, (first, stall), served)


@pytest.mark.parametrize("cycles", [8, 14, 60, 500])
@pytest.mark.parametrize("lost", [0, 3])
def test_a_controller_that_was_stalled_in_motion_keeps_its_correction(
    cycles: int, lost: int
) -> None:
    bench = Bench("total")
    bench.run(60)
    bench.run(lost, reply=False)
    bench.act(f"stalled {cycles}")
    before = bench.controller.correction
    bench.run(200)
    assert bench.controller.correction == before
    assert "Restart the controller's program" in str(bench.session.unproven)
