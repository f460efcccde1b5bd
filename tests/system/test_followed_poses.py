"""Target poses handed in to a whole daemon cycle, late and in bursts, judged by the emulator."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from linemate.daemon.cycle.states import State
from linemate.protocol.command.frame_codec import CommandError
from linemate.protocol.command.requests import decode_request, encode_request
from linemate.simulators.harness import setup
from linemate.simulators.harness.lockstep import Lockstep
from linemate.simulators.judge.judge import judge
from linemate.simulators.judge.rows import STATES

CELL = ("scenario.duration_s=6.5", "scenario.lead_in_s=1.5")
CHUNK_S, POSES = 0.4, 8
BEGIN_S = 0.3

Row = list[float]


@dataclass
class Peer:
    """A client that hands poses in, in the place of the run's operator.

    Attributes:
        delay: of chunk i on its way [s].
        spoil: changes the rows of a chunk before it is sent.
        refusals: reason of each refused chunk, by its number.
    """

    lockstep: Lockstep
    delay: Callable[[int], float] = lambda _: 0.0
    spoil: Callable[[int, list[Row]], Any] = lambda _, rows: rows
    count: int = 10
    refusals: dict[int, str] = field(default_factory=dict)
    refusal: None = None
    begin_ns: int | None = None
    sent: int = 0
    waiting: list[tuple[int, bytes]] = field(default_factory=list)

    def give_order(self) -> None:
        cycle = self.lockstep.cycle
        now_ns = self.lockstep.links.stamp(self.lockstep.world.time_s)
        if self.begin_ns is None:
            if cycle.machine.state is not State.IDLE or cycle.last is None:
                return
            if cycle.refusal("follow") is not None:
                return
            self.begin_ns = now_ns + round(BEGIN_S * 1e9)
            self.place = cycle.last.outputs.target
        while self.sent < self.count and self._due_ns(self.sent) <= now_ns:
            self._send(self.sent, now_ns)
            self.sent += 1
        while self.waiting and self.waiting[0][0] <= now_ns:
            self._arrive(self.waiting.pop(0)[1])

    def _due_ns(self, i: int) -> int:
        assert self.begin_ns is not None
        return self.begin_ns + round((i * CHUNK_S - BEGIN_S) * 1e9)

    def _send(self, i: int, now_ns: int) -> None:
        rows = [self.row(i * CHUNK_S + j * CHUNK_S / POSES) for j in range(POSES)]
        params = {"begin_ns": self.begin_ns, "poses": self.spoil(i, rows)}
        try:
            data = encode_request("follow", params, now_ns // 10**6)
        except CommandError as error:
            self.refusals[i] = str(error)
            return
        arrival = max([now_ns + round(self.delay(i) * 1e9), *(at for at, _ in self.waiting)])
        self.waiting.append((arrival, data))

    def row(self, at_s: float) -> Row:
        x, y, z, *q = self.place
        way = 0.04 * (1.0 - math.cos(1.5 * max(at_s, 0.0)))
        return [at_s, x, y + way, z - 0.5 * way, *q]

    def _arrive(self, data: bytes) -> None:
        params = decode_request(data).params
        begin_ns = params["begin_ns"]
        chunk = tuple((begin_ns + round(1e9 * row[0]), *row[1:]) for row in params["poses"])
        reason = self.lockstep.cycle.hand_in(chunk, "peer")
        if reason is not None:
            self.refusals[self.sent - 1 - len(self.waiting)] = reason


def run(**peer: Any) -> tuple[Peer, Any, dict[str, Any]]:
    lockstep = Lockstep(setup.make("wheel", CELL), 0)
    client = Peer(lockstep, **peer)
    lockstep._operator = client  # type: ignore[assignment]
    while lockstep.turn():
        pass
    evidence = lockstep.evidence()
    return client, evidence.rows, judge(evidence)


def followed(rows: Any) -> Any:
    return rows.state == STATES.index("follow")


def assert_smooth(rows: Any, result: dict[str, Any]) -> None:
    """No limit is violated, and the true tcp jumps by less than 0.1 mm."""
    assert result["limits"]["violations"] == 0
    assert result["telegrams"]["refused"] == result["telegrams"]["late"] == 0
    cycle_s = 1e-3 * result["cycle_ms"]
    moving = followed(rows)
    for poses in (rows.target, rows.tcp_rigid):
        place = poses[moving, :3]
        change = np.linalg.norm(np.diff(place, 2, axis=0), axis=1)
        # Twice the largest acceleration: along the poses, and towards them.
        assert change.max() - 2.0 * 0.5 * cycle_s**2 < 1e-4


def test_poses_in_time_are_followed_within_a_millimetre() -> None:
    peer, rows, result = run()
    assert not peer.refusals
    assert_smooth(rows, result)
    moving = followed(rows)
    begin = rows.t[np.argmax(moving)]
    ahead = (rows.t - begin)[moving]
    last = 0.4 * 10 - 0.05 + BEGIN_S
    inside = ahead < last
    wanted = np.array([peer.row(t - BEGIN_S)[1:4] for t in ahead[inside]])
    off = np.linalg.norm(rows.tcp_rigid[moving, :3][inside] - wanted, axis=1)
    assert off.max() < 2.5e-3, off.max()
    assert rows.state[-1] == STATES.index("idle")
    assert np.ptp(rows.target[-5:, :3], axis=0).max() < 1e-9


def test_chunks_800_ms_late_and_in_bursts_violate_no_limit_and_never_jump() -> None:
    def delay(i: int) -> float:
        burst = 3 * math.ceil(i / 3)
        return 0.8 + (burst - i) * CHUNK_S if i else 0.0

    peer, rows, result = run(delay=delay)
    assert not peer.refusals
    assert_smooth(rows, result)
    assert np.ptp(rows.tcp_rigid[followed(rows), 1]) > 0.05


def test_wrong_chunks_are_refused_and_the_robot_goes_on_as_before() -> None:
    def spoil(i: int, rows: list[Row]) -> Any:
        wrong = {
            2: [[row[0], row[1], row[2] + 0.05, *row[3:]] for row in rows],
            4: [[*rows[0][:2], math.nan, *rows[0][3:]], *rows[1:]],
            6: rows[::-1],
            7: rows * 12_500,
            8: [[row[0], *(1e3 * value for value in row[1:4]), *row[4:]] for row in rows],
        }
        return wrong.get(i, rows)

    peer, rows, result = run(spoil=spoil)
    assert set(peer.refusals) == {2, 4, 6, 7, 8}
    for i, what in ((2, "limit 0.25"), (4, "finite"), (6, "rising times"), (7, "poses")):
        assert what in peer.refusals[i]
    assert_smooth(rows, result)
    # Chunk 9 is followed after all of them.
    assert peer.row(3.95)[2] - rows.tcp_rigid[-1, 1] < 2.5e-3


def test_poses_are_refused_while_the_task_runs_and_after_a_stop_until_the_robot_rests() -> None:
    lockstep = Lockstep(setup.make("wheel", CELL), 0)
    for _ in range(round(3.0 / 0.012)):
        lockstep.turn()
    cycle = lockstep.cycle
    assert cycle.machine.state is State.TRACK
    assert cycle.last is not None
    stamp_ns = cycle.last.inputs.stamp_ns
    pose = cycle.last.outputs.target
    chunk = tuple((stamp_ns + 10**8 * i, *pose) for i in range(1, 4))
    assert cycle.hand_in(chunk) == "follow needs IDLE; the state is TRACK"
    assert cycle.order("stop") is None
    lockstep.turn()
    assert "the state is HOLD" in (cycle.hand_in(chunk) or "")
