"""The merge: what is committed stays, what deviates dies out as an LQ regulator would have it."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking import merge
from linemate.daemon.core.tracking.merge import ORDER
from linemate.daemon.core.tracking.settings import MergeSettings

CYCLES = (0.012, 0.004)
COMMIT, STEPS = 5, 41

lists = st.integers(0, 100_000).map(
    lambda seed: np.cumsum(np.random.default_rng(seed).normal(0.0, 1e-6, (STEPS + 1, 6)), axis=0)
)


def matrices(cycle_s: float = 0.012, commit: int = COMMIT, steps: int = STEPS) -> Array:
    along = merge.merge_matrix(0.025, cycle_s, steps - commit)
    across = merge.merge_matrix(0.04, cycle_s, steps - commit)
    return np.stack([along if axis == 1 else across for axis in range(6)])


MATRICES = matrices()


def merge_once(old: Array, goal: Array, M: Array, commit: int) -> Array:
    """Return the list after one merge by matrices that read every step."""
    calm = merge.calm_matrix(0.012, M.shape[1])
    return merge.merge(old, goal, merge.MergePlan(commit, commit * 0.012, M, 1, calm, 8.0))[0]


def farthest_after_a_corner(steps_before_commit: int) -> float:
    """Return how far [m] a plan swings that stands after it has begun to rise at 2 m/s^2.

    So does the clock of a task that goes on, and stands after all.
    """
    plan = merge.compile_merge(MergeSettings(), 0.036, 0.004, 120, more=0.008)
    goal, poses = np.zeros((121, 6)), np.zeros((121, 6))
    late_s = 0.004 * np.maximum(np.arange(121) - (plan.commit - steps_before_commit), 0)
    poses[:, 2] = late_s**2 - 0.0028
    farthest, calming = 0.0, 0
    for _ in range(250):
        poses, calming = merge.merge(poses, goal, plan, calming)
        farthest = max(farthest, float(poses[:, 2].max()))
    assert abs(poses[0, 2]) < 1e-4
    return farthest


@pytest.mark.parametrize("steps_before_commit", range(-1, 8))
def test_a_corner_that_is_committed_throws_no_plan_far_off_at_4_ms(
    steps_before_commit: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert farthest_after_a_corner(steps_before_commit) < 0.01
    if steps_before_commit == 0:
        monkeypatch.setattr(merge, "LARGEST_SWING", np.inf)
        assert farthest_after_a_corner(steps_before_commit) > 0.03


def farthest_of_corners(dead_time: float, cycle_s: float, seed: int) -> float:
    """Return how far [m] a plan gets whose goal is another one again and again for 2 s.

    Each begins at once, within 3 mm and 0.05 m/s, with a corner of its speed within 0.1 s.
    """
    random, count = np.random.default_rng(seed), round(0.5 / cycle_s)
    plan = merge.compile_merge(MergeSettings(), dead_time, cycle_s, count, more=0.008)
    t = np.arange(count + 1) * cycle_s
    poses, goal, calming, farthest = np.zeros((count + 1, 6)), np.zeros((count + 1, 6)), 0, 0.0
    for _ in range(round(2.0 / cycle_s)):
        if random.random() < cycle_s / 0.03:
            goal = np.zeros((count + 1, 6))
            late_s = np.clip(t, 0.0, 0.15) - random.uniform(0.0, 0.1)
            bend = random.uniform(-1.0, 1.0) * np.maximum(late_s, 0.0) ** 2
            way = random.uniform(-0.05, 0.05) * np.clip(t, 0.0, 0.1)
            goal[:, 2] = random.uniform(-0.003, 0.003) + way + bend
        poses, calming = merge.merge(poses, goal, plan, calming)
        farthest = max(farthest, abs(float(poses[0, 2])))
    return farthest


@pytest.mark.parametrize("cycle_s", [0.004, 0.008, 0.012])
@pytest.mark.parametrize("dead_time", [0.036, 0.0395, 0.041, 0.0435])
def test_no_series_of_corners_drives_a_plan_away(cycle_s: float, dead_time: float) -> None:
    # Without the merge that does not swing: 1.7 m at 4 ms.
    assert max(farthest_of_corners(dead_time, cycle_s, seed) for seed in range(3)) < 0.15


def cubic(t: Array) -> Array:
    """A motion (m, 6) without a jump."""
    return np.outer(t, np.arange(1.0, 7.0)) * 0.01 + np.outer(np.sin(t), np.ones(6)) * 0.02


@pytest.mark.parametrize(
    ("dead_time", "cycle_s", "known"),
    # By hand: (D + T0 + max(4 ms, T0)) / T0.
    [(0.036, 0.012, 5.0), (0.036, 0.004, 11.0), (0.048, 0.012, 6.0), (0.042, 0.012, 5.5),
     (0.039, 0.002, 22.5), (0.040, 0.008, 7.0), (0.124, 0.008, 17.5), (0.184, 0.008, 25.0),
     (0.084, 0.024, 5.5),
     # At least as many as a merge reads; whole ones where it reads every second step.
     (0.0, 0.012, 5.0), (0.030, 0.012, 5.0), (0.036, 0.024, 5.0), (0.0405, 0.001, 46.0)],
)  # fmt: skip
def test_committed_is_dead_time_one_cycle_of_interpolation_and_one_more(
    dead_time: float, cycle_s: float, known: float
) -> None:
    commit, share = merge.commit_steps(dead_time, cycle_s)
    assert 0.0 <= share < 1.0
    assert commit + share == pytest.approx(known, abs=1e-5)


def taken_up(plan: merge.MergePlan, cycle_s: float) -> float:
    """Return when a merge takes up a goal that jumps, in the mean [s]."""
    steps = plan.matrices.shape[1] + plan.commit
    poses, goal, late = np.zeros((steps + 1, 6)), np.ones((steps + 1, 6)), 0.0
    for _ in range(round(2.0 / cycle_s)):
        late += (1.0 - poses[0, merge.ALONG]) * cycle_s
        poses, _ = merge.merge(poses, goal, plan)
    return late


@pytest.mark.parametrize(
    ("cycle_s", "dead_time", "more"),
    [(0.004, 0.036, 0.008), (0.008, 0.120, 0.006), (0.012, 0.036, 0.008), (0.024, 0.084, 0.012)],
)
def test_a_free_tool_is_committed_for_longer_and_takes_a_goal_up_no_later(
    cycle_s: float, dead_time: float, more: float
) -> None:
    steps = math.ceil(0.6 / cycle_s)
    free, clamped = (
        merge.compile_merge(MergeSettings(), dead_time, cycle_s, steps, more=each)
        for each in (more, 0.0)
    )
    assert free.committed_s - clamped.committed_s == pytest.approx(more, abs=1e-8)
    assert taken_up(free, cycle_s) == pytest.approx(taken_up(clamped, cycle_s), abs=0.1 * cycle_s)


@pytest.mark.parametrize("cycle_s", [0.004, 0.008, 0.012])
def test_a_tool_without_a_mode_takes_a_goal_along_the_conveyor_up_earlier(cycle_s: float) -> None:
    steps, settings = math.ceil(0.6 / cycle_s), MergeSettings()
    plain, quick = (
        taken_up(merge.compile_merge(each, 0.036, cycle_s, steps), cycle_s)
        for each in (settings, merge.without_mode(settings))
    )
    # By hand: 3.236 tau of a fifth order less 2 tau of a third order.
    assert plain - quick == pytest.approx(1.236 * settings.along, abs=1.5e-3)


@pytest.mark.parametrize("cycle_s", CYCLES)
@pytest.mark.parametrize(("jump", "most"), [(0.002, 1.15), (0.004, 1.05)])
def test_a_far_jump_of_a_clamped_tool_is_taken_up_without_swinging(
    jump: float, most: float, cycle_s: float
) -> None:
    """A stop that was confirmed after 0.2 s: 94 N before, and 151 N to the other side."""
    steps = round(0.5 / cycle_s)
    plan = merge.compile_merge(merge.without_mode(MergeSettings()), 0.036, cycle_s, steps)
    plan = replace(plan, largest_jump=merge.LARGEST_JUMP)
    poses, goal, calming, way = np.zeros((steps + 1, 6)), np.zeros((steps + 1, 6)), 0, []
    goal[:, 1] = jump
    for _ in range(round(0.6 / cycle_s)):
        poses, calming = merge.merge(poses, goal, plan, calming)
        way.append(float(poses[0, 1]))
    assert max(way) < most * jump
    assert way[-1] == pytest.approx(jump, rel=1e-3)


@pytest.mark.parametrize("cycle_s", [0.002, 0.004, 0.008, 0.012])
def test_the_commitment_grows_with_the_dead_time_and_never_by_a_jump(cycle_s: float) -> None:
    dead_times = np.arange(0.06, 0.2, 0.0005)
    committed = [sum(merge.commit_steps(each, cycle_s)) * cycle_s for each in dead_times]
    assert np.diff(committed) == pytest.approx(0.0005, abs=1e-8)


def continued(share: float, cycle_s: float, jump: Array) -> Array:
    """Return the plan (n, 6), step by step, of a goal that jumps once behind a long rest."""
    steps = math.ceil(0.492 / cycle_s)
    M = np.stack([merge.merge_matrix(0.027, cycle_s, steps - COMMIT, share)] * 6)
    poses, plan = np.zeros((steps + 1, 6)), []
    goal = np.tile(jump, (steps + 1, 1))
    for _ in range(round(2.0 / cycle_s)):
        poses = merge_once(poses, goal, M, COMMIT)
        plan.append(poses[0])
    return np.array(plan)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_a_share_of_a_step_delays_a_plan_by_that_share_of_a_cycle(share: float) -> None:
    T0, jump = 0.012, np.arange(1.0, 7.0) * 1e-3
    whole, partly = continued(0.0, T0, jump), continued(share, T0, jump)
    assert partly[-1] == pytest.approx(jump, abs=1e-6)
    late = (whole - partly).sum(axis=0) / jump
    assert late == pytest.approx(share, abs=0.01)


@settings(max_examples=30, deadline=None)
@given(lists, lists, st.floats(0.05, 0.95))
def test_committed_steps_are_kept_with_one_that_is_kept_by_a_share(
    old: Array, goal: Array, share: float
) -> None:
    M = np.stack([merge.merge_matrix(0.027, 0.012, STEPS - COMMIT, share)] * 6)
    bare = merge_once(old, goal, MATRICES, COMMIT)
    merged = merge_once(old, goal, M, COMMIT)
    assert np.array_equal(merged[: COMMIT + 1], bare[: COMMIT + 1])
    kept = COMMIT + 1
    row = merge.merge_matrix(0.027, 0.012, 1)[0]
    free = goal[kept] + row @ (merged[COMMIT - 4 : kept] - goal[COMMIT - 4 : kept])[::-1]
    assert np.allclose(merged[kept], share * old[kept + 1] + (1.0 - share) * free, atol=1e-9)
    # Behind it the closed loop goes on from what is planned.
    loop = np.stack([merge.merge_matrix(0.027, 0.012, STEPS - kept)] * 6)
    later = merge_once(np.vstack((merged[:1], merged[:-1])), goal, loop, kept)
    assert np.allclose(merged[kept:], later[kept:], atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(lists)
def test_an_unchanged_goal_changes_nothing_with_a_share(old: Array) -> None:
    M = np.stack([merge.merge_matrix(0.027, 0.012, STEPS - COMMIT, 0.5)] * 6)
    goal = np.vstack((old[1:], old[-1:] + 0.3))
    assert np.allclose(merge_once(old, goal, M, COMMIT), goal, atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(lists, lists)
def test_committed_steps_are_kept_bit_for_bit(old: Array, goal: Array) -> None:
    merged = merge_once(old, goal, MATRICES, COMMIT)
    assert np.array_equal(merged[: COMMIT + 1], old[1 : COMMIT + 2])
    assert merged.shape == goal.shape


@settings(max_examples=30, deadline=None)
@given(lists, lists, st.integers(0, 5))
def test_each_axis_is_merged_for_itself(old: Array, goal: Array, axis: int) -> None:
    merged = merge_once(old, goal, MATRICES, COMMIT)
    other = goal.copy()
    other[:, axis] += 1.0
    changed = merge_once(old, other, MATRICES, COMMIT)
    rest = [i for i in range(6) if i != axis]
    assert np.array_equal(merged[:, rest], changed[:, rest])


@settings(max_examples=30, deadline=None)
@given(lists, lists, lists)
def test_the_merge_is_linear(old: Array, goal: Array, shift: Array) -> None:
    plain = merge_once(old, goal, MATRICES, COMMIT)
    # A motion that both lists share, seen a step earlier by the older one.
    moved = np.vstack((np.zeros((1, 6)), shift[:-1]))
    both = merge_once(old + moved, goal + shift, MATRICES, COMMIT)
    assert np.allclose(both, plain + shift, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(lists)
def test_an_unchanged_goal_changes_nothing(old: Array) -> None:
    """The old list is the goal already: the merge carries on with the goal, and with nothing."""
    goal = np.vstack((old[1:], old[-1:] + 0.3))
    assert np.allclose(merge_once(old, goal, MATRICES, COMMIT), goal, atol=1e-12)


@pytest.mark.parametrize("cycle_s", CYCLES)
@pytest.mark.parametrize("tau", [0.019, 0.025, 0.04])
def test_a_deviation_dies_out(tau: float, cycle_s: float) -> None:
    steps = round(1.0 / cycle_s)
    M = merge.merge_matrix(tau, cycle_s, steps)
    history = np.ones(ORDER)  # off by 1 for long
    after = M @ history
    assert abs(after[round(12 * tau / cycle_s) :]).max() < 0.02
    # The slowest of five poles on a circle of 1/tau decays with sin(18 deg)/tau.
    assert abs(after[-1]) < 2.0 * math.exp(-0.3 * steps * cycle_s / tau)
    # No step: it sets off as it was, and overshoots by less than a quarter.
    assert abs(after[0] - 1.0) < 0.05 * (cycle_s / 0.004) ** 3
    assert after.min() > -0.25


@pytest.mark.parametrize("cycle_s", CYCLES)
def test_a_longer_time_constant_is_slower_and_softer(cycle_s: float) -> None:
    rows = [
        merge.merge_matrix(tau, cycle_s, round(0.6 / cycle_s)) @ np.ones(ORDER)
        for tau in (0.025, 0.04)
    ]
    joined = [np.concatenate((np.ones(ORDER), row)) for row in rows]
    jerk = [np.abs(np.diff(row, n=4)).max() for row in joined]
    assert jerk[1] < 0.5 * jerk[0]
    assert (np.abs(rows[1]) > 0.5).sum() > (np.abs(rows[0]) > 0.5).sum()


@pytest.mark.parametrize(("tau", "cycle_s"), [(0.025, 0.012), (0.04, 0.012), (0.019, 0.004)])
def test_the_matrix_is_the_optimum_of_the_whole_sum(tau: float, cycle_s: float) -> None:
    """Minimise sum e^2 + (tau/T0)^10 (fifth difference)^2 over a long list, stacked, at once."""
    n = round(32 * tau / cycle_s)
    history = np.array((1.0, 0.7, 0.5, 0.2, -0.1))  # e(nc), e(nc-1), ... e(nc-4)
    weight = (tau / cycle_s) ** ORDER
    known = history[::-1]
    binomial = np.array([math.comb(ORDER, j) * (-1.0) ** j for j in range(ORDER + 1)])
    difference = np.zeros((n, n + ORDER))
    for row in range(n):
        difference[row, row : row + ORDER + 1] = binomial[::-1]
    A = np.vstack((np.eye(n), weight * difference[:, ORDER:]))
    b = np.concatenate((np.zeros(n), -weight * (difference[:, :ORDER] @ known)))
    best = np.linalg.lstsq(A, b, rcond=None)[0]
    found = merge.merge_matrix(tau, cycle_s, n) @ history
    near = round(10 * tau / cycle_s)
    assert np.allclose(found[:near], best[:near], atol=2e-4 * np.abs(best).max())


@pytest.mark.parametrize(("tau", "cycle_s"), [(0.027, 0.012), (0.04, 0.012), (0.01, 0.004)])
def test_the_closed_loop_is_that_of_the_riccati_equation(tau: float, cycle_s: float) -> None:
    A = np.zeros((ORDER, ORDER))
    A[0] = [-math.comb(ORDER, j) * (-1.0) ** j for j in range(1, ORDER + 1)]
    A[1:, :-1] = np.eye(ORDER - 1)
    B, Q = np.eye(ORDER)[:, :1], np.diag(np.eye(ORDER)[0])
    R = np.array([[(tau / cycle_s) ** (2 * ORDER)]])
    P = solve_discrete_are(A, B, Q, R)
    loop = A - B @ np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    matrix = merge.merge_matrix(tau, cycle_s, 30)
    expected = np.stack([np.linalg.matrix_power(loop, i)[0] for i in range(1, 31)])
    assert matrix == pytest.approx(expected, rel=1e-6, abs=1e-7 * np.abs(expected).max())


def test_merging_again_under_the_same_goal_goes_on_along_the_closed_loop() -> None:
    """Merging each step is the regulator going on: no step notices that it was merged again."""
    T0 = 0.012
    span = np.arange(STEPS + 1) * T0
    old = cubic(span - T0)
    offset = np.array((0.004, -0.02, 0.003, 0.01, 0.0, -0.02))
    first = merge_once(old, cubic(span) + offset, MATRICES, COMMIT)
    lists = [first]
    for k in range(1, 25):
        goal = cubic(span + k * T0) + offset
        lists.append(merge_once(lists[-1], goal, MATRICES, COMMIT))
    for before, after in pairwise(lists):
        assert np.allclose(after[:-1], before[1:], atol=1e-9)


@pytest.mark.parametrize("cycle_s", CYCLES)
def test_a_constant_goal_is_reached_and_kept(cycle_s: float) -> None:
    steps = math.ceil(0.492 / cycle_s)
    commit, _ = merge.commit_steps(0.036, cycle_s)
    M = matrices(cycle_s, commit, steps)
    goal = np.tile((0.01, -0.05, 0.02, 0.05, -0.02, 0.4), (steps + 1, 1))
    poses = np.zeros((steps + 1, 6))
    for _ in range(round(3.0 / cycle_s)):
        poses = merge_once(poses, goal, M, commit)
    assert np.allclose(poses, goal, atol=1e-8)


def ramp(t: Array) -> Array:
    """A conveyor (m,) that stops: 0.1 m/s less 0.104 m/s^2, at rest from t = 0 on."""
    return np.where(t < 0.0, -0.5 * 0.104 * t * t, 0.0)


def swung(cycle_s: float, kernel: Array) -> float:
    """By how much a plan without corners swings out at most where a ramp ends [m]."""
    steps = math.ceil(0.492 / cycle_s)
    commit, _ = merge.commit_steps(0.036, cycle_s)
    M = matrices(cycle_s, commit, steps)
    span = np.arange(steps + 1) * cycle_s
    offsets = np.linspace(-0.06, 0.06, 241)
    weight = np.exp(-0.5 * (offsets / 0.02) ** 2)
    worst = 0.0
    for end_s in (np.arange(commit + 1) + 0.5) * cycle_s:
        truth = np.outer(ramp(span - end_s), np.eye(6)[1])
        times = span[:, None] - cycle_s - end_s + offsets
        old = np.outer(ramp(times) @ weight / weight.sum(), np.eye(6)[1])
        plan = merge_once(old, merge.rounded(truth, kernel), M, commit)
        worst = max(worst, float(np.abs(plan - truth)[:, 1].max()))
    return worst


def test_the_end_of_a_ramp_among_the_five_known_steps_throws_no_plan_off_at_4_ms() -> None:
    commit, _ = merge.commit_steps(0.036, 0.004)
    bare, kernel = np.ones(1), merge.rounding(0.004, commit)
    assert swung(0.004, bare) > 5.0 * swung(0.004, kernel)
    assert swung(0.004, kernel) < 3e-4


def test_nothing_is_rounded_at_12_ms_and_never_among_the_steps_that_a_merge_reads_first() -> None:
    assert merge.rounding(0.012, 5).tolist() == [1.0]
    for cycle_s in (0.004, 0.002, 0.001):
        commit, _ = merge.commit_steps(0.036, cycle_s)
        kernel = merge.rounding(cycle_s, commit)
        assert kernel.sum() == pytest.approx(1.0)
        assert len(kernel) // 2 <= commit + 1 - ORDER
        goal = np.random.default_rng(1).normal(size=(200, 6))
        smooth = merge.rounded(goal, kernel)
        assert np.array_equal(smooth[:, [0, 2, 3, 4, 5]], goal[:, [0, 2, 3, 4, 5]])
        assert smooth[100, 1] == pytest.approx(
            kernel @ goal[100 - len(kernel) // 2 : 101 + len(kernel) // 2, 1]
        )


def test_a_goal_that_flickers_every_step_is_followed_without_growing() -> None:
    """Switching must not pump the loop up: bounded goals give bounded lists, for ever."""
    rng = np.random.default_rng(5)
    poses = np.zeros((STEPS + 1, 6))
    largest = 0.0
    for _ in range(400):
        goal = np.tile(rng.choice((-0.001, 0.001), 6), (STEPS + 1, 1))
        poses = merge_once(poses, goal, MATRICES, COMMIT)
        largest = max(largest, float(np.abs(poses[: COMMIT + 1]).max()))
    assert largest < 0.003


@pytest.mark.parametrize("cycle_s", [0.001, 0.002, 0.004, 0.008, 0.024])
@pytest.mark.parametrize("tau", [0.025, 0.04])
def test_a_merge_at_every_cycle_dies_out_as_at_4_ms(tau: float, cycle_s: float) -> None:
    """Each step is merged again: the step behind the commit point must not swing up."""
    stride = merge.spacing(cycle_s)
    row = merge.merge_matrix(tau, cycle_s, 5)[0]
    polynomial = np.zeros((ORDER - 1) * stride + 2)
    polynomial[0] = 1.0
    polynomial[1::stride][:ORDER] -= row
    slowest = np.abs(np.roots(polynomial)).max()
    # The slowest of five poles on a circle of 1/tau decays with sin(18 deg)/tau.
    known = math.exp(-math.sin(math.radians(18.0)) * cycle_s / tau)
    assert slowest == pytest.approx(known, abs=0.05 * cycle_s / 0.004)


def test_below_2_ms_every_second_step_is_read_and_the_rest_lies_between() -> None:
    assert [merge.spacing(c) for c in (0.001, 0.002, 0.004, 0.024)] == [2, 1, 1, 1]
    fine = merge.merge_matrix(0.025, 0.001, 200)
    coarse = merge.merge_matrix(0.025, 0.002, 100)
    assert np.allclose(fine[1::2], coarse, atol=1e-9)
    motion = np.concatenate((np.ones(9), fine @ np.ones(ORDER)))
    assert np.abs(np.diff(motion, n=4)).max() < 1e-4


@pytest.mark.parametrize("cycle_s", [0.001, 0.002, 0.004, 0.012])
def test_a_corner_is_rounded_alike_and_never_where_the_merge_reads(cycle_s: float) -> None:
    commit, _ = merge.commit_steps(0.036, cycle_s)
    kernel = merge.rounding(cycle_s, commit)
    half = len(kernel) // 2
    assert kernel.sum() == pytest.approx(1.0)
    assert half <= merge.first_read(commit, cycle_s)
    deviation = math.sqrt(float(kernel @ np.arange(-half, half + 1) ** 2)) * cycle_s
    assert deviation == pytest.approx(0.0057, rel=0.1) or (cycle_s == 0.012 and half == 0)
