"""Weight of the tool and of what it carries: the tare of the wrench."""

import math

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.observation import Wrench
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.touch import release, tare
from linemate.daemon.core.tracking.tracker_state import Tracker, TrackerState
from linemate.protocol.stamped_samples import Vector3

CLEAR_WAY = 0.05  # way from the object at which a released tool has cleared it [m]


def update_tare(tracker: Tracker, state: TrackerState, raw: Wrench | None) -> TrackerState:
    """Return the state with its tare: taken in the approach, kept in contact, then dropped.

    Args:
        raw: wrench of the sensor.
    """
    if Gate.WHEEL_RELEASED in state.passed:
        is_clear = state.distance < -CLEAR_WAY
        later = tare.released(state.tare, raw, tracker.cycle_s, is_clear=is_clear)
        return state if later is state.tare else replace(state, tare=later)
    if state.contact and _is_unloading(tracker, state):
        delay = tracker.compliance.delays[0] * tracker.cycle_s
        later = tare.unloaded(state.tare, tracker.cycle_s, delay)
        return state if later is state.tare else replace(state, tare=later)
    near = tare.frozen_within(tracker.task.guard.clearance, tracker.settings.payload.bolts)
    is_free = state.started and not state.contact and -math.inf < state.distance < -near
    if raw is None or not is_free or state.withdrawn is not None or state.stood > 0.0:
        return state
    down, settings = gravity(tracker, state.poses[0]), tracker.settings
    # The force that brakes the tool on its way is no weight.
    inertia = tracker.vibration.mass * state.acceleration[2]
    still = replace(raw, force=raw.force + np.array((0.0, 0.0, inertia)))
    nominal = gravity(tracker, np.zeros(6))
    later = tare.updated(
        state.tare, still, down, nominal, settings.payload, settings.tactile, tracker.cycle_s
    )
    return replace(state, tare=later)


def gravity(tracker: Tracker, pose: Array) -> Vector3:
    """Return the unit vector of gravity in a tcp (6,) in c: it is along -z of base."""
    a, b, c, d, e, f, g, h, i = rotations.exp_rows(*pose[3:].tolist())
    x, y, z = tracker.reference.axes[2]
    return (-a * x - d * y - g * z, -b * x - e * y - h * z, -c * x - f * y - i * z)


def carried_weights(tracker: Tracker, state: TrackerState) -> tuple[Vector3, ...]:
    """Return the weights that the sensor may state without a contact, in the tcp [N].

    Before the tare it is not known whether it was zeroed with the payload on.
    """
    weight = tracker.settings.payload.mass * tare.GRAVITY
    known = tare.carried(state.tare, tracker.settings.tactile)
    if state.tare.wrench is not None or state.tare.empty is not None or weight == 0.0:
        return (known,)
    x, y, z = gravity(tracker, state.poses[0])
    return known, (weight * x, weight * y, weight * z)


def _is_unloading(tracker: Tracker, state: TrackerState) -> bool:
    """Return whether the object takes weight over: a known one as soon as it is screwed on."""
    if state.tare.part is None:
        return release.is_held_by_hub(tracker.reference.gated, state.passed, state.time)
    is_fixed = Gate.SCREWS_FIXED in state.passed and state.fixing is not None
    return state.tare.unloading is not None or (is_fixed and not state.force_sign.is_suspect)
