"""Merge of a new goal into the horizon without a jump.

Behind the commit point the deviation ``e = x_t - x_f`` decays along the closed loop of a linear
quadratic regulator. It is of fifth order: servo and elastic mode together need a bounded fourth
derivative.

Invariants:
- Committed steps are kept bit for bit. The next step may be committed by a share, but by a merge
  that does not swing.
- Matrices are computed at start-up; a merge is one product.
- No merge swings farther than the deviation that is committed, its rise and ``LARGEST_SWING`` do.
"""

import cmath
import math
from dataclasses import dataclass, replace

import numpy as np

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.settings import MergeSettings

ORDER = 5
ALONG = 1  # column of a pose along the conveyor

SPACING_S = 0.002  # least distance of the five steps that a merge reads [s]
MARGIN_S = 0.004  # committed beyond the first effect of a command, or a cycle if it is longer [s]
DELAY_PER_TAU = 1.0 / math.sin(math.pi / 10.0)  # mean delay of the closed loop over tau
# Share of tau along the conveyor for a clamped tool. A merge of fifth order gives servo and elastic
# mode a bounded fourth derivative. A clamped tool has no such mode: for the servo third order is
# enough, which takes a goal up after 2 tau.
CLAMPED_SHARE = 2.0 / DELAY_PER_TAU
LARGEST_SWING = 0.006  # of a merge beyond its deviation at nc, and that of SWING_S more [m]
SWING_S = 0.1  # of the deviation's rise there; a merge that swings farther met a corner [s]
LARGEST_JUMP = 0.002  # of a clamped tool that is merged so: it and its servos swing by half [m]
CALM_S = 0.03  # time constant of the merge in its place [s]
CORNER_S = 0.00566  # one sigma of the rounding of corners [s]: 1.4 steps of 4 ms, half of 12 ms


@dataclass(frozen=True, slots=True, eq=False)
class MergePlan:
    """Compiled parameters of a merge.

    Attributes:
        commit: nc, the last step that is kept as it is.
        committed_s: for which the list stands, with the share of step nc + 1 that is kept [s].
        matrices: (6, n - nc, 5 or 6), one merge matrix a column.
        stride: ``spacing`` of the steps that they read.
        calm: (n - nc, 2), the deviation that begins with 1 at nc, and the one that begins with a
            rise of 1 a step, both critically damped.
        swing_steps: ``SWING_S`` in steps of one cycle each.
        largest_jump: deviation from nc on beyond which the merge is the calm one [m].
    """

    commit: int
    committed_s: float
    matrices: Array
    stride: int
    calm: Array
    swing_steps: float
    largest_jump: float = math.inf

    @property
    def first_free(self) -> int:
        """First step at which a goal may get a corner: behind all that a merge reads."""
        return self.commit + (2 if self.matrices.shape[2] > ORDER else 1)


def without_mode(settings: MergeSettings) -> MergeSettings:
    """Return the settings along the conveyor of a tool without an elastic mode."""
    return replace(settings, along=CLAMPED_SHARE * settings.along)


def compile_merge(
    settings: MergeSettings, dead_time: float, cycle_s: float, steps: int, *, more: float = 0.0
) -> MergePlan:
    """Return the parameters of a merge.

    Args:
        dead_time: longest one, with all that (11) and (12) read beyond it [s].
        steps: n, length of the list.
        more: of time that is committed [s]. The merge is quicker by as much, so that a new goal is
            taken up no later in the mean.
    """
    commit, share, quicker = commitment(dead_time, more, cycle_s)
    along, across = (
        merge_matrix(tau - quicker, cycle_s, steps - commit, share)
        for tau in (settings.along, settings.across)
    )
    matrices = np.stack([along if axis == ALONG else across for axis in range(6)])
    return MergePlan(
        commit,
        (commit + share) * cycle_s,
        matrices,
        spacing(cycle_s),
        calm_matrix(cycle_s, steps - commit),
        SWING_S / cycle_s,
    )


def commitment(dead_time: float, more: float, cycle_s: float) -> tuple[int, float, float]:
    """Return nc, the share of the next step, and by how much tau is shorter for ``more`` [s]."""
    shortest = sum(commit_steps(dead_time, cycle_s))
    commit, share = commit_steps(dead_time + more, cycle_s)
    return commit, share, (commit + share - shortest) * cycle_s / DELAY_PER_TAU


def commit_steps(dead_time: float, cycle_s: float) -> tuple[int, float]:
    """Return nc, the last step that is kept as it is, and the share s of the next one.

    ``nc + s`` cycles are committed: the dead time, one cycle of interpolation, and 4 ms or one
    more cycle. Rounding them up made a dead time of 120 ms worse than one of 180 ms. Where a merge
    reads every second step they are rounded up, by less than 1 ms.

    Args:
        dead_time: longest one, with all that (11) and (12) read beyond it [s].
    """
    cycles = (dead_time + cycle_s + max(MARGIN_S, cycle_s)) / cycle_s
    stride = spacing(cycle_s)
    least = (ORDER - 1) * stride + 1  # A merge reads committed steps alone.
    if cycles <= least or stride > 1:
        return max(math.ceil(cycles - 1e-6), least), 0.0
    commit = math.floor(cycles + 1e-6)
    share = cycles - commit
    return commit, share if share > 1e-6 else 0.0


def spacing(cycle_s: float) -> int:
    """Return the distance of the steps that a merge reads [steps], 2 ms or a cycle.

    A merge amplifies unevenness of the goal by (tau/spacing)^4. Over five steps of 1 ms the
    control error was 1.5 mm, and a run ended with an overload.
    """
    return max(1, round(SPACING_S / cycle_s))


def first_read(commit: int, cycle_s: float) -> int:
    """Return the earliest step of the list that a merge reads."""
    return commit - (ORDER - 1) * spacing(cycle_s)


def merge_matrix(tau: float, cycle_s: float, steps: int, share: float = 0.0) -> Array:
    """Return M (steps, 5): the deviation after the commit point from five before it.

    Row i is e at nc + 1 + i for the history ``e(nc), e(nc-p), ..., e(nc-4p)``, p = ``spacing``.
    Between steps of p a spline of fifth degree keeps the fourth derivative continuous.

    With a share s of step nc + 1 that is kept, M is (steps, 6), and the history begins with the
    e'(nc+1) of the last list: ``e(nc+1) = s e'(nc+1) + (1 - s) a e(nc..nc-4)``, a the first row of
    the closed loop, which goes on from there.

    Args:
        share: of step nc + 1 that is kept, 0 to 1; 0 if p is more than a step.
    """
    stride = spacing(cycle_s)
    if share > 0.0:
        return _partly_committed(_closed_loop(tau, cycle_s, steps), share)
    if stride == 1:
        return _closed_loop(tau, cycle_s, steps)
    from scipy.interpolate import make_interp_spline  # 0.2 s: not before it is needed

    # Three steps more: the spline's free end is behind the list.
    coarse = _closed_loop(tau, stride * cycle_s, math.ceil(steps / stride) + 3)
    known = np.vstack((np.eye(ORDER)[::-1], coarse))
    spline = make_interp_spline(np.arange(1 - ORDER, len(coarse) + 1), known, k=ORDER)
    rows: Array = spline(np.arange(1, steps + 1) / stride)
    return rows


def calm_matrix(cycle_s: float, steps: int) -> Array:
    """Return (steps, 2): critically damped deviations from a value of 1, and from a rise of 1.

    They read no differences of higher order: whatever is committed, they do not swing.
    """
    count = np.arange(1.0, steps + 1)
    late = count * cycle_s / CALM_S
    decay = np.exp(-late)
    return np.column_stack((decay * (1.0 + late), decay * count))


def _partly_committed(rows: Array, share: float) -> Array:
    """Return M (steps, 6) with a share of the first step kept, of M (steps, 5) without."""
    first = np.concatenate(((share,), (1.0 - share) * rows[0]))
    later = np.outer(rows[:-1, 0], first)
    later[:, 1:ORDER] += rows[:-1, 1:]
    return np.vstack((first, later))


def _closed_loop(tau: float, step_s: float, steps: int) -> Array:
    """Return the deviation at each of so many steps from the last five before them.

    The feedback minimises ``sum e^2 + (tau/step)^10 (fifth difference of e)^2``. The poles of its
    closed loop are the stable roots of ``1 + (tau/step)^10 (1 - z)^5 (1 - 1/z)^5``. A Riccati
    equation has the same solution, but at 4 ms only to four digits.
    """
    poles = np.array([_pole(max(tau / step_s, 0.2), k) for k in range(ORDER)])
    loop = np.zeros((ORDER, ORDER))
    loop[0] = -np.poly(poles).real[1:]
    loop[1:, :-1] = np.eye(ORDER - 1)
    rows = np.empty((steps, ORDER))
    state = np.eye(ORDER)
    for i in range(steps):
        state = loop @ state
        rows[i] = state[0]
    return rows


def _pole(ratio: float, k: int) -> complex:
    """Return a stable pole: ``(1 - z) (1 - 1/z) = w`` with ``w^5 = -ratio^-10``."""
    w = cmath.rect(ratio**-2.0, math.pi * (2 * k + 1) / ORDER)
    middle = 1.0 - 0.5 * w
    half = cmath.sqrt(middle * middle - 1.0)
    return min(middle - half, middle + half, key=abs)


def delay(matrix: Array) -> int:
    """Return how many steps behind the commit point the merge takes up a goal, in the mean."""
    return round(float(matrix.sum()))


def rounding(cycle_s: float, commit: int) -> Array:
    """Return a kernel (2 h + 1,) that rounds the corners of a goal over its steps.

    It ends before the first step that the merge reads: h <= nc - 4 p, p = ``spacing``.

    Where a ramp ends, the speed of the goal has a corner. A merge over five steps of 4 ms amplifies
    it by (tau/T0)^4 and overshoots by millimetres. A binomial kernel of sigma 5.7 ms leaves a
    thirtieth of it and moves the goal by less than 2 um; at 12 ms the kernel is 1.
    """
    stride, most = spacing(cycle_s), first_read(commit, cycle_s)
    wanted = int(2.0 * (CORNER_S / (stride * cycle_s)) ** 2 + 1e-9)
    half = max(0, min(wanted, (most + 1 - stride) // stride))
    taps = np.zeros(2 * half * stride + 1)
    taps[::stride] = [math.comb(2 * half, i) for i in range(2 * half + 1)]
    # Between steps of the spacing the weights are interpolated.
    ramp = np.arange(1.0, stride)
    taps = np.convolve(taps, np.concatenate((ramp, (stride,), ramp[::-1])))
    kernel: Array = taps / taps.sum()
    return kernel


def rounded(goal: Array, kernel: Array) -> Array:
    """Return a goal (m, d) with its corners along the conveyor rounded."""
    if len(kernel) == 1:
        return goal
    smooth = goal.copy()
    smooth[:, ALONG] = smoothed(goal[:, ALONG], kernel)
    return smooth


def smoothed(values: Array, kernel: Array) -> Array:
    """Return values (m,) with their corners rounded but for half a kernel at their ends.

    The merge does not read the beginning; the end is a horizon away.
    """
    half = len(kernel) // 2
    if half == 0:
        return values
    smooth = values.copy()
    smooth[half:-half] = np.correlate(values, kernel, "valid")
    return smooth


def merge(old: Array, goal: Array, plan: MergePlan, calming: int = 0) -> tuple[Array, int]:
    """Return the new list x_t (n+1, d) from the old one and the goal x_f, and ``calming``.

    Args:
        old: last step's list (n+1, d).
        goal: where the list should be (n+1, d).
        plan: its matrices are of the d columns.
        calming: merges that do not swing yet to come, until all that is read was made by them.
    """
    commit, stride, matrices = plan.commit, plan.stride, plan.matrices
    merged = np.empty_like(goal)
    merged[: commit + 1] = old[1 : commit + 2]
    read = slice(commit - (ORDER - 1) * stride, commit + 1, stride)
    history = (merged[read] - goal[read])[::-1]  # (5, d)
    if matrices.shape[2] > ORDER:
        history = np.concatenate(((old[commit + 2] - goal[commit + 1])[None], history))
    # In order in memory the product costs a quarter less.
    late = matrices @ np.ascontiguousarray(history.T)[:, :, None]
    late = late[:, :, 0].T
    swings = np.abs(late[:, :3])
    farthest = float(np.maximum.reduce(swings, axis=None))
    is_far = farthest > plan.largest_jump
    if calming or is_far or farthest > LARGEST_SWING:  # seldom
        now = merged[commit] - goal[commit]
        rise = (now - (merged[commit - stride] - goal[commit - stride])) / stride
        known = np.abs(now[:3]) + plan.swing_steps * np.abs(rise[:3])
        if is_far or (swings.max(axis=0) > known + LARGEST_SWING).any():
            calming = ORDER * stride + 1
        if calming:
            calming -= 1
            late = plan.calm.dot(np.stack((now, rise)))
    np.add(goal[commit + 1 :], late, out=merged[commit + 1 :])
    return merged, calming
