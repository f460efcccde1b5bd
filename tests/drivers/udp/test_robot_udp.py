"""The robot's link on real sockets."""

import asyncio
import re
import socket
import time
from collections.abc import Iterator
from contextlib import closing

import pytest
from loops import run, until

from linemate.drivers.backoff import Backoff
from linemate.drivers.udp import robot_udp
from linemate.drivers.udp.robot_udp import RobotLink
from linemate.protocol.controller_link import ReadyReply
from linemate.protocol.rsi.telegram_reader import ExpectedTelegram


class Anything(ExpectedTelegram):
    """Expects any datagram, up to the longest that may be complete."""

    def __init__(self) -> None:
        super().__init__(re.compile(b".*").fullmatch, (0, 0), (), (), ())

    def matches(self, data: bytes) -> bool:
        return len(data) < 2048


class Exactly:
    def __init__(self, expected: bytes) -> None:
        self.expected = expected

    def matches(self, data: bytes) -> bool:
        return data == self.expected


def _ready(controller: socket.socket, data: bytes, late_ns: int = 0) -> ReadyReply:
    """Whatever the controller sends is answered so, within a second."""
    until_ns = time.monotonic_ns() + 1_000_000_000 - late_ns
    return ReadyReply(Anything(), controller.getsockname(), until_ns, data)


@pytest.fixture
def controller() -> Iterator[socket.socket]:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as endpoint:
        endpoint.bind(("127.0.0.1", 0))
        endpoint.settimeout(5.0)
        yield endpoint


def _echo(
    data: bytes, stamp_ns: int, address: tuple[str, int], *, is_answered: bool
) -> bytes | None:
    assert not is_answered
    assert stamp_ns > 0
    assert address[0] == "127.0.0.1"
    return b"re:" + data


async def _receive(endpoint: socket.socket) -> bytes:
    return await asyncio.to_thread(endpoint.recv, 4096)


def test_each_telegram_gets_one_reply_at_its_source(controller: socket.socket) -> None:
    async def main() -> None:
        link = RobotLink(_echo, port=0)
        link.open()
        assert link.address is not None
        for number in range(5):
            controller.sendto(b"%d" % number, link.address)
            assert await _receive(controller) == b"re:%d" % number
        link.close()
        assert link.counters["received"] == link.counters["answered"] == 5
        assert link.turnaround_ns is not None
        assert link.turnaround_ns > 0
        assert not link.status.up

    run(main())


def test_after_a_stall_only_the_newest_telegram_is_answered(controller: socket.socket) -> None:
    async def main() -> None:
        link = RobotLink(_echo, port=0)
        link.open()
        assert link.address is not None
        for number in range(20):
            controller.sendto(b"%d" % number, link.address)
        assert await _receive(controller) == b"re:19"
        link.close()
        assert link.counters["stale"] == 19
        assert link.counters["answered"] == 1

    run(main())


@pytest.mark.parametrize(("fresh_ns", "answered"), [(10**10, [b"one", b"two"]), (0, [b"two"])])
def test_only_an_expected_telegram_that_has_just_come_is_answered_before_a_newer_one(
    controller: socket.socket, monkeypatch: pytest.MonkeyPatch, fresh_ns: int, answered: list[bytes]
) -> None:
    monkeypatch.setattr(robot_udp, "FRESH_NS", fresh_ns)
    heard: list[bytes] = []

    def hear(data: bytes, _stamp: int, _source: tuple[str, int], *, is_answered: bool) -> bytes:
        assert is_answered
        heard.append(data)
        return b"ready"

    async def main() -> None:
        link = RobotLink(hear, port=0, ready_reply=lambda: _ready(controller, b"ready"))
        link.open()
        assert link.address is not None
        controller.sendto(b"one", link.address)
        controller.sendto(b"two", link.address)
        link.poll()
        assert heard == answered[:1]
        link.poll()
        assert heard == answered
        assert link.counters["stale"] == 2 - len(answered)
        link.close()

    run(main())


def test_a_stranger_does_not_displace_the_controller(controller: socket.socket) -> None:
    async def main() -> None:
        link = RobotLink(_echo, port=0)
        link.open()
        assert link.address is not None
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as stranger:
            controller.sendto(b"robot", link.address)
            stranger.sendto(b"junk", link.address)
            assert await _receive(controller) == b"re:robot"
        link.close()

    run(main())


def test_junk_behind_a_telegram_does_not_push_it_aside(controller: socket.socket) -> None:
    async def main() -> None:
        link = RobotLink(lambda data, *_, is_answered: None if data == b"junk" else data, port=0)
        link.open()
        assert link.address is not None
        for data in (b"old", b"newest", b"junk", b"junk"):
            controller.sendto(data, link.address)
        assert await _receive(controller) == b"newest"
        link.close()
        assert link.counters["unanswered"] == 2
        assert link.counters["stale"] == 1

    run(main())


def test_more_than_two_kilobytes_are_refused_unread(controller: socket.socket) -> None:
    async def main() -> None:
        link = RobotLink(_echo, port=0)
        link.open()
        assert link.address is not None
        controller.sendto(b"x" * 2049, link.address)
        controller.sendto(b"y" * 2048, link.address)
        assert await _receive(controller) == b"re:" + b"y" * 2048
        link.close()
        assert link.counters["oversize"] == 1

    run(main())


def test_no_reply_is_sent_when_the_cycle_gives_none(controller: socket.socket) -> None:
    async def main() -> None:
        link = RobotLink(lambda *_, is_answered: None, port=0)
        link.open()
        assert link.address is not None
        controller.sendto(b"x", link.address)
        await until(lambda: link.counters["unanswered"] == 1)
        link.close()
        assert link.counters["answered"] == 0

    run(main())


def test_a_telegram_that_counts_may_get_no_reply(controller: socket.socket) -> None:
    async def main() -> None:
        link = RobotLink(lambda *_, is_answered: b"", port=0)
        link.open()
        assert link.address is not None
        controller.sendto(b"x", link.address)
        await until(lambda: link.counters["silent"] == 1)
        link.close()
        assert (link.counters["answered"], link.counters["unanswered"]) == (0, 0)
        assert link.status.last_sample_stamp_ns is not None

    run(main())


@pytest.mark.parametrize("attended", [True, False])
def test_a_ready_reply_goes_out_before_its_telegram_is_judged(
    controller: socket.socket, attended: bool
) -> None:
    async def main() -> None:
        order: list[bytes] = []

        def judge(
            data: bytes, stamp_ns: int, address: tuple[str, int], *, is_answered: bool
        ) -> bytes:
            assert is_answered
            # The reply is out already: who asked has it before this is over.
            order.append(controller.recv(100))
            return b"re:" + data

        ready = _ready(controller, b"re:1")
        link = RobotLink(judge, port=0, ready_reply=lambda: ready)
        link.open()
        assert link.address is not None
        controller.sendto(b"1", link.address)
        if attended:
            assert link.attend(time.monotonic_ns() + 1_000_000_000)
        else:
            link.poll()
        link.close()
        assert order == [b"re:1"]
        assert link.counters["received"] == link.counters["answered"] == 1
        assert link.counters["express"] == 1
        assert link.counters["hasty"] == 0
        assert link.turnaround_ns is not None
        assert link.turnaround_ns > 0

    run(main())


@pytest.mark.parametrize("wrong", ["nothing ready", "another peer", "too late", "too long"])
def test_a_telegram_that_nothing_is_ready_for_goes_the_ordinary_way(
    controller: socket.socket, wrong: str
) -> None:
    ready: ReadyReply | None = _ready(controller, b"wrong")
    if wrong == "nothing ready":
        ready = None
    elif wrong == "another peer":
        ready = _ready(controller, b"wrong")._replace(peer=("127.0.0.1", 1))
    elif wrong == "too late":
        ready = _ready(controller, b"wrong", late_ns=1_000_000_001)
    size = 2048 if wrong == "too long" else 1

    async def main() -> None:
        link = RobotLink(_echo, port=0, ready_reply=lambda: ready)
        link.open()
        assert link.address is not None
        for number in range(3):
            controller.sendto(b"%d" % number * size, link.address)
        assert link.attend(time.monotonic_ns() + 1_000_000_000)
        assert await _receive(controller) == b"re:" + b"0" * size
        assert await _receive(controller) == b"re:" + b"2" * size
        link.close()
        assert link.counters["express"] == 0
        assert link.counters["stale"] == 1

    run(main())


@pytest.mark.parametrize(("newest_acts", "left_s"), [(False, -1e-9), (True, -1e-9), (True, 1.0)])
def test_a_process_that_was_stopped_as_it_slept_answers_the_newest_telegram_alone(
    controller: socket.socket, newest_acts: bool, left_s: float
) -> None:
    async def main() -> None:
        ready = _ready(controller, b"of the past")._replace(telegram=Exactly(b"1"))
        link = RobotLink(_echo, port=0, ready_reply=lambda: ready, newest_acts=newest_acts)
        link.open()
        assert link.address is not None
        for number in (1, 2, 3):
            controller.sendto(b"%d" % number, link.address)
        # The time to wait is over, or the clock stood still with the process.
        assert link.attend(time.monotonic_ns() + round(left_s * 1e9))
        assert await _receive(controller) == b"re:3"
        link.close()
        assert link.counters["received"] == 3
        assert link.counters["stale"] == 2
        assert link.counters["answered"] == 1

    run(main())


def test_waiting_for_a_telegram_ends_at_its_time(controller: socket.socket) -> None:
    async def main() -> None:
        link = RobotLink(_echo, port=0)
        assert not link.attend(time.monotonic_ns() + 1_000_000_000)
        link.open()
        until_ns = time.monotonic_ns() + 3_000_000
        assert not link.attend(until_ns)
        assert until_ns <= time.monotonic_ns() < until_ns + 1_000_000_000
        link.close()

    run(main())


def test_a_ready_reply_that_the_ordinary_way_would_not_give_is_counted(
    controller: socket.socket,
) -> None:
    async def main() -> None:
        ready = _ready(controller, b"rash")
        link = RobotLink(lambda *_, is_answered: None, port=0, ready_reply=lambda: ready)
        link.open()
        assert link.address is not None
        controller.sendto(b"1", link.address)
        assert link.attend(time.monotonic_ns() + 1_000_000_000)
        link.close()
        assert link.counters["hasty"] == 1

    run(main())


def test_a_fault_in_the_cycle_is_counted_and_the_link_lives(controller: socket.socket) -> None:
    def fault(
        data: bytes, stamp_ns: int, address: tuple[str, int], *, is_answered: bool
    ) -> bytes | None:
        if data == b"bad":
            raise ZeroDivisionError
        return data

    async def main() -> None:
        link = RobotLink(fault, port=0)
        link.open()
        assert link.address is not None
        controller.sendto(b"bad", link.address)
        await until(lambda: link.counters["callback_errors"] == 1)
        controller.sendto(b"good", link.address)
        assert await _receive(controller) == b"good"
        link.close()

    run(main())


def test_a_port_that_is_taken_is_tried_again_until_it_is_free() -> None:
    async def main() -> None:
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as squatter:
            squatter.bind(("127.0.0.1", 0))
            port = squatter.getsockname()[1]
            link = RobotLink(_echo, port=port, backoff=Backoff(0.01, 0.02))
            link.open()
            assert not link.status.up
            assert "in use" in link.status.reason
        await until(lambda: link.status.up)
        link.close()
        assert link.counters["opened"] == 1

    run(main())


def test_a_socket_that_breaks_is_bound_again(controller: socket.socket) -> None:
    async def main() -> None:
        link = RobotLink(_echo, port=0, backoff=Backoff(0.01, 0.02))
        link.open()
        assert link._socket is not None
        link._down("pulled")
        assert not link.status.up
        await until(lambda: link.status.up)
        assert link.address is not None
        controller.sendto(b"again", link.address)
        assert await _receive(controller) == b"re:again"
        link.close()
        assert link.counters["lost"] >= 1

    run(main())
