"""Acceleration of the tool as its plan had it when the wrench was measured."""

import math
from collections.abc import Sequence

from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.observation import Wrench
from linemate.daemon.core.tracking.tracker_state import StepSamples, Tracker, TrackerState
from linemate.protocol.stamped_samples import Vector3

WRENCH_S = 0.05  # a wrench may be so old; health excludes an older one [s]


def update_acceleration(
    tracker: Tracker, state: TrackerState, raw: Wrench | None, samples: StepSamples
) -> TrackerState:
    """Return the state with the samples of the wrench, and the tool's acceleration at its time.

    The wrench is older than the step: by its transfer, and by half a cycle of samples. A plan of
    the step itself would be ahead of the force that accelerates the tool.
    """
    count = math.ceil(WRENCH_S / tracker.cycle_s) + 1
    planned = (*state.accelerations, planned_acceleration(tracker, state.poses))[-count:]
    if raw is None:
        return replace(state, accelerations=planned, sampled=())
    late = (samples.stamp_ns - raw.stamp_ns) * 1e-9 / tracker.cycle_s
    mean = float(raw.force[2])
    sampled = tuple([each.force[2] - mean for each in samples.wrench])
    then = at_delay(planned, late)
    return replace(state, accelerations=planned, acceleration=then, sampled=sampled)


def at_delay(values: Sequence[Vector3], late: float) -> Vector3:
    """Return a vector some steps ago, between two of them linearly.

    Args:
        values: one a step, newest last.
        late: steps; one beyond the oldest value gives the oldest.
    """
    late = min(max(late, 0.0), len(values) - 1.0)
    whole = int(late)
    (x, y, z), (a, b, c) = values[-1 - whole], values[max(-2 - whole, -len(values))]
    share = late - whole
    return (x + share * (a - x), y + share * (b - y), z + share * (c - z))


def planned_acceleration(tracker: Tracker, poses: Array) -> Vector3:
    """Return the acceleration in the tool's axes at the second of some poses [m/s^2]."""
    (a, b, c, *_), (x, y, z, *turned), (d, e, f, *_) = poses[:3].tolist()
    r, s, t, u, v, w, i, j, k = rotations.exp_rows(*turned)
    square = tracker.cycle_s**2
    dx, dy, dz = a - 2.0 * x + d, b - 2.0 * y + e, c - 2.0 * z + f
    return (
        (r * dx + u * dy + i * dz) / square,
        (s * dx + v * dy + j * dz) / square,
        (t * dx + w * dy + k * dz) / square,
    )
