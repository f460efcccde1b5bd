"""Target poses in chunks to a real command port, each in its time."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_ends import key_of, open_port, served

from linemate.daemon.service.command_server import CommandPort
from linemate.daemon.transport.client import Client, RefusedError
from linemate.daemon.transport.follow import Follower, follow
from linemate.protocol.command.frame_codec import CommandError, Role

EVE = key_of("eve", Role.VIEW, 2)
POSE = (1.0, 2.0, 0.5, 1.0, 0.0, 0.0, 0.0)
AHEAD_NS = 10**15
"""How far the daemon's clock is ahead of the client's."""

calls: list[dict[str, Any]] = []


def handle(op: str, params: dict[str, Any], _role: str, _who: str) -> dict[str, Any]:
    assert op == "follow"
    if not params["poses"]:
        return {"now_ns": time.monotonic_ns() + AHEAD_NS, "state": "idle"}
    if params["poses"][0][1] > 5.0:
        return {"refused": "the first pose is away"}
    calls.append(params)
    return {"state": "follow"}


@pytest.fixture
def port(tmp_path: Path) -> Iterator[CommandPort]:
    calls.clear()
    with open_port(tmp_path, (EVE,), handle, dict) as port, served(port):
        yield port


def client_of(tmp_path: Path) -> Client:
    return Client.local(next(tmp_path.glob("*.sock")))


def test_chunks_hold_twelve_poses_each_with_their_times(port: CommandPort, tmp_path: Path) -> None:
    slept: list[float] = []
    poses = [(0.1 * i, POSE) for i in range(30)]
    with client_of(tmp_path) as client:
        follow(poses, client, lead_s=1.0, sleep=slept.append)
    assert [len(call["poses"]) for call in calls] == [12, 12, 6]
    begins = [call["begin_ns"] for call in calls]
    assert [round((b - begins[0]) * 1e-9, 6) for b in begins] == [0.0, 1.2, 2.4]
    assert all(call["poses"][0] == [0.0, *POSE] for call in calls)
    # The first pose lies half a second ahead of the daemon's clock.
    assert abs(begins[0] - time.monotonic_ns() - AHEAD_NS - 5e8) < 5e9
    assert len(slept) == 2
    assert all(0.0 < each < 2.5 for each in slept)


def test_a_refusal_ends_the_handing_in(port: CommandPort, tmp_path: Path) -> None:
    poses = [(0.1 * i, (9.0 if i >= 12 else 1.0, *POSE[1:])) for i in range(30)]
    with client_of(tmp_path) as client, pytest.raises(RefusedError, match="is away"):
        follow(poses, client, sleep=lambda _: None)
    assert len(calls) == 1


def test_a_pose_that_is_no_number_is_not_sent(port: CommandPort, tmp_path: Path) -> None:
    with client_of(tmp_path) as client, Follower(client) as follower:
        for wrong in ((float("nan"), *POSE[1:]), POSE[1:]):
            with pytest.raises(CommandError):
                follower.hand_in([(0.0, POSE), (0.1, wrong)])
    assert not calls


def test_a_client_that_may_only_view_hands_nothing_in(port: CommandPort) -> None:
    assert port.udp_address is not None
    with Client.udp(*port.udp_address, EVE) as client, pytest.raises(RefusedError, match="view"):
        Follower(client)
    assert not calls
