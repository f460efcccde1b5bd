"""An attacker with all frames: 10^5 datagrams, none executed, none answered.

The attacker may change, cut, join, delay and reflect frames and seal them with other keys than the
daemon's. LINEMATE_ATTACKS is the number of datagrams, LINEMATE_SEED their seed.
"""

import os
import random
from collections import Counter
from collections.abc import Callable

from command_ends import MS, S, Secrets, World, client_address, key_of

from linemate.protocol.command.authenticated import CommandClient, CommandServer
from linemate.protocol.command.client_core import Answer
from linemate.protocol.command.frame_codec import (
    HEADER,
    TAG_BYTES,
    FrameType,
    Role,
    Tagger,
    frame_body,
)

TRIES = int(os.environ.get("LINEMATE_ATTACKS", "100000"))
SEED = int(os.environ.get("LINEMATE_SEED", "1"))
ORDERS = ("arm", "start", "stop", "retreat", "ack", "save", "status")
HEARD = 200
CACHED = 4
"""Replies that a server gives again: an exact copy of their requests is no attack."""

ALICE = key_of("alice", Role.OPERATE, 1)
BOB = key_of("bob", Role.OPERATE, 2)


class Attacker:
    """What he heard of one conversation, and his tricks."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.world = World((ALICE, BOB))
        self.client = self.world.client(ALICE)
        self.address = client_address(self.client)
        self.hello = self.client.hello(self.world.now_ns)
        self.requests: list[bytes] = []
        self.replies: list[bytes] = list(self.world.deliver(self.hello, self.address))
        for count in range(HEARD):
            self.world.now_ns += 10 * MS
            sent = self.client.request(
                ORDERS[count % len(ORDERS)], {}, self.world.now_ns + 500 * MS
            )
            self.requests.append(sent.frame)
            for reply in self.world.deliver(sent.frame, self.address):
                self.replies.append(reply)
                assert isinstance(self.client.on_datagram(reply, self.world.now_ns), Answer)
        self.old = self.requests[:-CACHED]

    def any_frame(self) -> bytes:
        return self.random.choice((*self.requests, *self.replies))

    def flipped(self) -> bytes:
        data = bytearray(self.random.choice(self.requests))
        for _ in range(self.random.choice((1, 1, 1, 2, 8))):
            data[self.random.randrange(len(data))] ^= 1 << self.random.randrange(8)
        changed = bytes(data)
        return self.flipped() if changed in self.requests else changed

    def truncated(self) -> bytes:
        data = self.random.choice(self.requests)
        return data[: self.random.randrange(len(data))]

    def extended(self) -> bytes:
        return self.random.choice(self.requests) + self.random.randbytes(self.random.randint(1, 64))

    def replayed(self) -> bytes:
        return self.random.choice(self.old)

    def reflected(self) -> bytes:
        return self.random.choice(self.replies)

    def renumbered(self) -> bytes:
        """A later sequence, another session, another key: with the tag as it was heard."""
        data = bytearray(self.random.choice(self.requests))
        magic, version, kind, key_id, session, sequence = HEADER.unpack_from(data)
        change = self.random.randrange(4)
        kind = self.random.choice(list(FrameType)) if change == 0 else kind
        key_id = BOB.id if change == 1 else key_id
        session = self.random.getrandbits(64) if change == 2 else session
        sequence = sequence + self.random.randint(1, 1000) if change == 3 else sequence
        HEADER.pack_into(data, 0, magic, version, kind, key_id, session, sequence)
        return self.flipped() if bytes(data) in self.requests else bytes(data)

    def spliced(self) -> bytes:
        """The head of one frame, the payload of another, the tag of a third."""
        one, two, three = (self.any_frame() for _ in range(3))
        made = one[: HEADER.size] + two[HEADER.size : -TAG_BYTES] + three[-TAG_BYTES:]
        return self.flipped() if made in self.requests or made == self.hello else made

    def forged(self) -> bytes:
        """A flawless request under a key of his own."""
        tagger = Tagger(self.random.randbytes(32))
        head = HEADER.unpack_from(self.random.choice(self.requests))
        payload = self.random.choice(self.requests)[HEADER.size : -TAG_BYTES]
        body = frame_body(FrameType.REQUEST, head[3], head[4], head[5] + 1, payload)
        return tagger.seal(body)

    def noise(self) -> bytes:
        return self.random.randbytes(self.random.randint(0, 1400))


def test_nothing_that_an_attacker_can_make_is_carried_out_or_answered() -> None:
    attacker = Attacker(SEED)
    world = attacker.world
    tricks: tuple[Callable[[], bytes], ...] = (
        attacker.flipped,
        attacker.truncated,
        attacker.extended,
        attacker.replayed,
        attacker.reflected,
        attacker.renumbered,
        attacker.spliced,
        attacker.forged,
        attacker.noise,
    )
    done, tried = len(world.done), Counter[str]()
    for _ in range(TRIES):
        trick = attacker.random.choice(tricks)
        address = attacker.random.choice((attacker.address, "elsewhere"))
        data = trick()
        if data == attacker.hello:
            continue
        assert world.deliver(data, address) == [], (trick.__name__, data.hex())
        tried[trick.__name__] += 1
    assert len(world.done) == done
    assert sum(tried.values()) == TRIES
    assert min(tried.values()) > TRIES // 20
    answer = world.ask(attacker.client, "arm")
    assert answer is not None
    assert answer.ok


def test_nothing_that_was_heard_is_carried_out_by_the_daemon_after_its_restart() -> None:
    attacker = Attacker(SEED + 1)
    world = attacker.world
    # The same keys, new secrets: what a restart is.
    world.server = CommandServer(world.keys, Secrets(1000))
    done = len(world.done)
    for frame in (*attacker.requests, *attacker.replies):
        assert world.deliver(frame, attacker.address) == []
    assert len(world.done) == done


def test_a_request_held_back_is_never_carried_out_after_its_deadline() -> None:
    attacker = Attacker(SEED + 2)
    world, client = attacker.world, attacker.client
    done, expired = len(world.done), 0
    for count in range(2000):
        held = client.request(ORDERS[count % len(ORDERS)], {}, world.now_ns + 500 * MS)
        world.now_ns += attacker.random.choice((600 * MS, 1 * S, 3 * S, 10 * S))
        for reply in world.deliver(held.frame, attacker.address):
            answer = client.on_datagram(reply, world.now_ns)
            assert isinstance(answer, Answer)
            assert (answer.ok, answer.code) == (False, "expired")
            expired += 1
    assert len(world.done) == done
    assert expired == 2000


def test_a_key_that_was_never_the_daemons_opens_nothing() -> None:
    attacker = Attacker(SEED + 3)
    mallory = CommandClient(key_of("mallory", Role.OPERATE, 9), 1)
    assert attacker.world.deliver(mallory.hello(0)) == []
    assert attacker.world.server.sessions == 1
