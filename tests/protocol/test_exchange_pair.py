"""The cyclic exchange: both roles as a pair over a link that loses."""

from dataclasses import dataclass, field
from importlib.resources import files

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linemate.protocol.exchange import Exchange, TelegramKind
from linemate.protocol.exchange_controller import ControllerExchange, Judgement
from linemate.protocol.rsi.codec import (
    RobotTelegram,
    RsiCodec,
    RsiError,
    SensorTelegram,
    parse_config,
)

FIRST = 4208163634


CONFIG = parse_config((files("linemate.protocol") / "data" / "rsi_joints.xml").read_bytes())


@dataclass
class ExchangePair:
    """Both ends on one link: real codecs, real exchanges, bytes in between, no socket.

    A delivery a cycle and direction: how the link treats the datagram. What is delayed arrives at
    the head of the next cycle, before that cycle's own datagram.
    """

    step: int = 4
    robot: RsiCodec = field(default_factory=lambda: RsiCodec(CONFIG))
    sensor: RsiCodec = field(default_factory=lambda: RsiCodec(CONFIG))
    now_ns: int = 0
    refused: int = 0
    answers: int = 0
    kinds: list[TelegramKind] = field(default_factory=list)
    judgements: list[Judgement | None] = field(default_factory=list)
    delayed: dict[str, list[bytes]] = field(default_factory=lambda: {"down": [], "up": []})

    def __post_init__(self) -> None:
        self.controller = ControllerExchange(self.step, 10_000, first_counter=FIRST)
        self.daemon = Exchange(0.004)

    def cycle(self, down: str = "ok", up: str = "ok") -> None:
        self.now_ns += 4_000_000
        telegram = RobotTelegram(
            self.controller.next_counter(),
            joints=(0.1,) * 6,
            external=(0.0,) * 6,
            tcp=(0.0,) * 6,
            delay=self.controller.delay,
        )
        replies = []
        for data in self.link("down", down, self.robot.format_robot(telegram)):
            replies += self.answer(data)
        for data in self.link("up", up, *replies):
            self.judge(data)
        self.judgements.append(self.controller.close_cycle())

    def link(self, direction: str, delivery: str, *datagrams: bytes) -> list[bytes]:
        arriving, self.delayed[direction] = self.delayed[direction], []
        for data in datagrams:
            match delivery:
                case "lost":
                    pass
                case "twice":
                    arriving += [data, data]
                case "delayed":
                    self.delayed[direction].append(data)
                case "garbled":
                    arriving.append(data.replace(b"<IPOC>", b"<IPOC>9"))
                case "cut":
                    arriving.append(data[: len(data) // 2])
                case _:
                    arriving.append(data)
        return arriving

    def answer(self, data: bytes) -> list[bytes]:
        try:
            telegram = self.sensor.parse_robot(data)
        except RsiError:
            self.refused += 1
            return []
        decision = self.daemon.on_telegram(telegram.ipoc, self.now_ns)
        self.kinds.append(decision.kind)
        if not decision.answer:
            return []
        self.answers += 1
        reply = SensorTelegram(telegram.ipoc, joints=(0.0,) * 6, external=(0.0,))
        return [self.sensor.prepare_sensor(reply).with_counter(telegram.ipoc_text)]

    def judge(self, data: bytes) -> None:
        try:
            reply = self.robot.parse_sensor(data)
        except RsiError:
            self.controller.on_unreadable()
        else:
            self.controller.on_reply(reply.ipoc)


@pytest.mark.parametrize("step", [12, 4, 1])
def test_on_a_good_link_every_telegram_is_answered(step: int) -> None:
    pair = ExchangePair(step)
    for _ in range(50):
        pair.cycle()
    assert pair.judgements == [Judgement.ACCEPTED] * 50
    assert pair.kinds == [TelegramKind.FIRST] + [TelegramKind.NORMAL] * 49
    assert pair.daemon.step == step
    assert pair.controller.delay == 0


def test_what_the_link_does_is_seen_at_both_ends() -> None:
    pair = ExchangePair()
    deliveries = [
        ("ok", "ok", Judgement.ACCEPTED),
        ("ok", "ok", Judgement.ACCEPTED),
        ("ok", "ok", Judgement.ACCEPTED),
        ("lost", "ok", Judgement.MISSING),
        ("ok", "lost", Judgement.MISSING),
        ("twice", "ok", Judgement.ACCEPTED),
        ("ok", "twice", Judgement.ACCEPTED),
        ("cut", "ok", Judgement.MISSING),
        ("ok", "cut", Judgement.REFUSED),
        ("garbled", "ok", Judgement.MISSING),
        ("ok", "garbled", Judgement.REFUSED),
        ("ok", "delayed", Judgement.MISSING),
        ("ok", "ok", Judgement.ACCEPTED),
        ("delayed", "ok", Judgement.MISSING),
        ("ok", "ok", Judgement.ACCEPTED),
    ]
    for down, up, _ in deliveries:
        pair.cycle(down, up)
    assert pair.judgements == [judgement for _, _, judgement in deliveries]
    assert pair.refused == 1
    assert pair.daemon.counters == {
        "first": 1,
        "normal": 8,
        "gap": 3,
        "duplicate": 1,
        "backward": 0,
        "late": 0,
        "new_session": 0,
        "refused": 1,
        "missed": 3,
        "overdue": 0,
        "sessions": 1,
    }
    counts = pair.controller.counts
    assert (counts.sent, counts.answered, counts.late) == (15, 7, 2)
    assert (counts.lost, counts.refused, counts.duplicate) == (4, 2, 1)
    assert (counts.wrong_counter, counts.unreadable) == (1, 1)
    assert pair.controller.delay == 8


def test_a_controller_started_again_is_a_new_session() -> None:
    pair = ExchangePair()
    for _ in range(5):
        pair.cycle()
    pair.controller.restart(0)
    for _ in range(5):
        pair.cycle()
    assert pair.kinds[-3:] == [TelegramKind.NEW_SESSION, TelegramKind.NORMAL, TelegramKind.NORMAL]
    assert pair.judgements[5:] == [Judgement.MISSING] * 2 + [Judgement.ACCEPTED] * 3
    assert pair.daemon.session == 2


DELIVERIES = st.sampled_from(["ok", "ok", "ok", "lost", "twice", "delayed", "garbled", "cut"])


@settings(max_examples=100)
@given(st.lists(st.tuples(DELIVERIES, DELIVERIES), max_size=30))
def test_after_any_link_has_come_to_its_senses_the_exchange_goes_on(
    deliveries: list[tuple[str, str]],
) -> None:
    pair = ExchangePair()
    for down, up in deliveries:
        pair.cycle(down, up)
    for _ in range(10):
        pair.cycle()
    assert pair.judgements[-6:] == [Judgement.ACCEPTED] * 6
    assert pair.answers <= len(pair.kinds)
    # Charged: every cycle without a good reply, and those with a bad one after the good one.
    counts = pair.controller.counts
    unanswered = counts.sent - counts.answered
    assert 0 <= pair.controller.delay - unanswered <= counts.wrong_counter + counts.unreadable
