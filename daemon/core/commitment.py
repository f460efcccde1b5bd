"""How long a plan is committed: until what the filters read of its changes cancels.

(11) and (12) read steps behind the commit point nc, where the plan may still change. A goal that
drifts by d a cycle changes step nc + i of the plan by ``d c_i``, c_i = 1 - sum of row i of M. The
step comes one nearer with each cycle: until step nc + 1 + i is committed it changes by ``d C_i``,
C_i = c_1 + .. + c_i. So a command is wrong by ``d S``, S = sum w_(nc+1+i) C_i over the taps w of
both filters. They have both signs: S falls through zero as nc grows.
"""

import math
from dataclasses import replace

import numpy as np

from linemate.daemon.core.control import dead_time, inverse_filter
from linemate.daemon.core.control.settings import ControlSettings
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking import merge
from linemate.daemon.core.tracking.settings import MergeSettings

STEP_S = 0.001
MOST_S = 0.016  # later than that a change of goal is taken up too late [s]
ARM_AXES = 6  # the linear axis has a plan of its own


def free_margin(
    settings: MergeSettings, control: ControlSettings, dead_time_s: float, cycle_s: float
) -> float:
    """Return how much longer a tool that hangs free is committed [s], in whole milliseconds.

    Args:
        dead_time_s: as in ``merge.compile_merge`` [s].
    """
    if not control.feed_forward:
        return 0.0
    taps, first = _taps(control, cycle_s)

    def left(more: float) -> float:
        return _uncancelled(settings, taps, first, dead_time_s, more, cycle_s)

    before = left(0.0)
    for step in range(1, round(MOST_S / STEP_S) + 1):
        if before <= 0.0:
            return (step - 1) * STEP_S
        now = left(step * STEP_S)
        if now <= 0.0 and before < -now:
            return (step - 1) * STEP_S
        before = now
    return MOST_S


def _taps(control: ControlSettings, cycle_s: float) -> tuple[Array, int]:
    """Return the taps (m,) of (11) and (12) in one, and the step of the first.

    (12) is that of the arm's slowest axis, (11) that of the mode along the conveyor.
    """
    filters = replace(control.filters, servo_future_s=dead_time.future_reach(control))
    slowest = max(
        control.servos[:ARM_AXES],
        # Its delay on a ramp: D + 2 z / w.
        key=lambda each: each.dead_time + each.damping / (math.pi * each.frequency_hz),
    )
    taps = inverse_filter.servo_inverse(slowest, filters, cycle_s)
    reach = inverse_filter.tap_steps(filters.servo_past_s, filters.servo_future_s, cycle_s)
    first = int(reach[0])
    if len(control.effector) > merge.ALONG:
        mode = inverse_filter.effector_inverse(control.effector[merge.ALONG], filters, cycle_s)
        reach = inverse_filter.tap_steps(
            filters.effector_past_s, filters.effector_future_s, cycle_s
        )
        taps, first = np.convolve(taps, mode), first + int(reach[0])
    return taps, first


def _uncancelled(
    settings: MergeSettings,
    taps: Array,
    first: int,
    dead_time_s: float,
    more: float,
    cycle_s: float,
) -> float:
    """Return S, for so much longer a commitment [s]."""
    commit, share, quicker = merge.commitment(dead_time_s, more, cycle_s)
    read = taps[commit + 2 - first :]
    if len(read) == 0:
        return 0.0
    rows = merge.merge_matrix(settings.along - quicker, cycle_s, len(read), share)
    return float(read @ np.cumsum(1.0 - rows.sum(axis=1)))
