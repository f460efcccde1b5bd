"""Target poses handed in: late, in bursts, wrong; the curve never jumps."""

import itertools
import math
import re
from typing import Any

import numpy as np
import pytest
from cell import World, parameters
from hypothesis import example, given, settings
from hypothesis import strategies as st
from msgspec import structs

from linemate.daemon.core import followed_poses
from linemate.daemon.core.followed_poses import Chunk, ChunkError
from linemate.daemon.core.inputs import MotionOrder
from linemate.daemon.core.step import extended, followed

P = parameters()
T0 = P.cycle_s
LIMITS = P.tracker.task.follow


@pytest.fixture(scope="module")
def stood() -> World:
    world = World(P)
    world.run(1.0)
    return world


def pose_of(world: World) -> tuple[float, ...]:
    assert world.outputs is not None
    return world.outputs.target


def path(world: World, at_s: float, amplitude: float = 0.03) -> tuple[float, ...]:
    """A pose of a slow swing in y that begins at rest where the robot stands."""
    x, y, z, *q = pose_of(world)
    way = amplitude * (1.0 - math.cos(1.5 * at_s)) if at_s > 0.0 else 0.0
    return x, y + way, z, *q


def chunk(world: World, begin_ns: int, first_s: float, count: int, apart_s: float = 0.05) -> Chunk:
    times = [first_s + i * apart_s for i in range(count)]
    return tuple((begin_ns + round(1e9 * t), *path(world, t)) for t in times)


def lists(world: World, arrivals: dict[int, list[Chunk]], steps: int) -> list[Any]:
    """Lists x_t of a robot that gets chunks at its steps."""
    state, orders, found = world.state, [], []
    runner = World(P)
    runner.state, runner.outputs, runner.k = state, world.outputs, world.k
    for i in range(steps):
        chunks = tuple(arrivals.get(i, ()))
        runner.step(MotionOrder.FOLLOW, chunks=chunks)
        orders.append(runner.outputs)
        found.append(runner.state.tracker.poses)
    assert runner.state.follow is not None
    return [np.array(found), runner.state.follow, orders]


def judge(world: World, found: Any) -> None:
    """Committed steps are kept, and nothing jumps."""
    commit = P.tracker.commit
    for before, after in itertools.pairwise(found):
        assert np.array_equal(after[: commit + 1], before[1 : commit + 2])
    tcp = found[:, 0, :3]
    speed, change = np.diff(tcp, axis=0) / T0, np.diff(tcp, 2, axis=0) / T0**2
    assert np.linalg.norm(speed, axis=1).max() <= 2.0 * LIMITS.speed
    # Along the poses and towards them, each within its limit.
    assert np.linalg.norm(change, axis=1).max() <= 2.1 * LIMITS.acceleration


def test_poses_in_time_are_followed(stood: World) -> None:
    begin_ns = stood.stamp_ns + 200_000_000
    arrivals = {round(0.5 * i / T0): [chunk(stood, begin_ns, 0.5 * i, 10)] for i in range(6)}
    found, follow, _ = lists(stood, arrivals, round(3.0 / T0))
    judge(stood, found)
    assert follow.refused == 0
    wanted = [path(stood, k * T0 - 0.2)[1] for k in range(len(found))]
    nominal = P.tracker.reference.nominal
    y = (found[:, 0, :3] @ nominal.T)[:, 1]
    off = np.abs(y - wanted)
    assert off.max() < 2e-4


@pytest.mark.long
def test_chunks_late_by_800_ms_and_in_bursts_never_jump(stood: World) -> None:
    begin_ns = stood.stamp_ns + 200_000_000
    arrivals: dict[int, list[Chunk]] = {0: [chunk(stood, begin_ns, 0.0, 10)]}
    for i in range(1, 12):
        # Sent half a second ahead, held for 0.8 s, and let go four at a time.
        burst = 4 * math.ceil(i / 4)
        arrivals.setdefault(round((0.5 * (burst - 1) + 0.8) / T0), []).append(
            chunk(stood, begin_ns, 0.5 * i, 10)
        )
    found, follow, outputs = lists(stood, arrivals, round(9.5 / T0))
    judge(stood, found)
    assert follow.refused == 0
    y = (found[:, 0, :3] @ P.tracker.reference.nominal.T)[:, 1]
    assert abs(y[-1] - path(stood, 5.95)[1]) < 1e-6 + 0.03
    assert outputs[-1].finished
    assert np.ptp(found[-1], axis=0).max() < 1e-12


def test_the_end_of_the_poses_is_a_smooth_stop(stood: World) -> None:
    arrivals = {0: [chunk(stood, stood.stamp_ns + 200_000_000, 0.0, 12, 0.08)]}
    found, follow, outputs = lists(stood, arrivals, round(4.5 / T0))
    judge(stood, found)
    over = [i for i, each in enumerate(outputs) if each.finished]
    assert abs(over[0] * T0 - follow.rest_s - followed_poses.WAIT_S) < 2.0 * T0


def refused(world: World, rows: Chunk) -> str:
    with pytest.raises(ChunkError) as error:
        extended(followed(world.state), rows, world.stamp_ns, P)
    return str(error.value)


def test_wrong_chunks_are_refused_with_value_and_limit(stood: World) -> None:
    begin = stood.stamp_ns + 200_000_000
    good = chunk(stood, begin, 0.0, 6)
    jump = [list(row) for row in good]
    jump[3][2] += 0.05
    away = [(row[0], row[1], row[2] + 0.05, *row[3:]) for row in good]
    nan = [list(row) for row in good]
    nan[2][3] = math.nan
    backwards = (good[2], good[1], good[0])
    x, y, z, *_ = pose_of(stood)
    nominal = P.tracker.reference.nominal
    ahead = nominal[:, 2] * 1.0
    near = tuple((row[0], *(np.array(row[1:4]) + ahead), *row[4:]) for row in good)
    for rows, what in (
        (jump, r"the poses need .* m/s .* limit 0.25"),
        (away, r"the first pose is 50.0 mm"),
        (nan, "8 finite numbers"),
        (backwards, "at least 2 ms. Hand in rising times"),
        (good * 10_000, "60000 poses, limit"),
        ((), "0 poses"),
        (((begin, x, y, z, 0.0, 0.0, 0.0, 0.0), good[1]), "length 0"),
        (tuple((row[0] - 10**11, *row[1:]) for row in good), "Take the daemon's clock"),
        (tuple((row[0] + 10**11, *row[1:]) for row in good), "Take the daemon's clock"),
        (near, "before the object's plane"),
        ((good[0][:7],), "8 finite numbers"),
    ):
        text = refused(stood, tuple(tuple(row) for row in rows))
        assert re.search(what, text), text
    turned = tuple((row[0], x, y, z, 0.0, 1.0, 0.0, 0.0) for row in good)
    assert "rad" in refused(stood, turned)


def test_a_refused_chunk_in_a_step_changes_nothing(stood: World) -> None:
    begin = stood.stamp_ns + 200_000_000
    good = chunk(stood, begin, 0.0, 12)
    bad = tuple((row[0], row[1] + 0.05, *row[2:]) for row in chunk(stood, begin, 0.3, 6))
    with_bad, follow, _ = lists(stood, {0: [good], 10: [bad]}, 120)
    without, _, _ = lists(stood, {0: [good]}, 120)
    assert follow.refused == 1
    assert np.array_equal(with_bad, without)


@settings(max_examples=25)
@example(delays=[0.0, 0.0, 0.0, 0.375, 0.0], lead=0.5)
@given(delays=st.lists(st.floats(0.0, 0.8), min_size=5, max_size=5), lead=st.floats(-0.3, 0.6))
def test_any_delay_up_to_800_ms_keeps_the_curve_smooth(delays: list[float], lead: float) -> None:
    state = followed_poses.begin(np.zeros(6))
    nominal, commit = np.eye(3), P.tracker.commit
    begin_ns = 10**10
    arrivals = sorted((0.4 * i + delay, i) for i, delay in enumerate(delays))
    # A link keeps the order.
    order = sorted(i for _, i in arrivals)
    due = dict(zip(order, sorted(t for t, _ in arrivals), strict=True))
    old = np.zeros((P.tracker.steps + 1, 6))
    found = []
    for k in range(round(5.0 / T0)):
        state = structs.replace(state, steps=state.steps + 1)
        for i in [i for i in order if i in due and due[i] <= k * T0]:
            del due[i]
            rows = tuple(
                (
                    begin_ns + round(1e9 * t),
                    0.04 * (1.0 - math.cos(1.2 * max(t, 0.0))),
                    0,
                    0,
                    1,
                    0,
                    0,
                    0,
                )
                for t in (0.4 * i + 0.08 * j for j in range(5))
            )
            stamp = begin_ns + round(1e9 * (k * T0 - lead))
            state = followed_poses.extend(
                state, rows, stamp, nominal=nominal, plane=1.0, limits=LIMITS,
                cycle_s=T0, commit=commit,
            )  # fmt: skip
        old = followed_poses.poses_ahead(state, old, commit, T0)
        found.append(old[0, 0])
    change = np.diff(found, 2) / T0**2
    assert np.abs(np.diff(found)).max() / T0 <= 2.0 * LIMITS.speed
    assert np.abs(change).max() <= 2.1 * LIMITS.acceleration
    assert abs(found[-1] - 0.04 * (1.0 - math.cos(1.2 * 1.92))) < 0.03
