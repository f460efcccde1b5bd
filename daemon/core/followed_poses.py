"""Target poses handed in with times: a curve through them that the tcp follows.

Chunks of poses may come late, in bursts, and may overlap. Each gives a new curve, a cubic spline
with a stop behind its last pose. The difference to the curve before it decays as a quintic, within
speed and acceleration, behind the committed steps: neither position, speed nor acceleration jumps.

Invariants:
- Pure. Time is counted in steps, so that what is committed stays bit for bit.
- A chunk is taken whole or refused with a reason; a refused chunk changes nothing.
- At most MOST_KNOTS poses are kept.
"""

import math

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from linemate.daemon.core import cubic_spline, rotations
from linemate.daemon.core.cubic_spline import CubicSpline
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.task import FollowLimits

MOST_POSES = 12  # of a chunk, as many as a command takes
MOST_KNOTS = 96  # poses that a curve goes through
KEPT_KNOTS = 4  # poses behind the robot that the next curve goes through too
CLOSEST_S = 0.002  # least time between two poses [s]
OLDEST_S = 5.0  # age of the first pose of a chunk [s]
FARTHEST_S = 10.0  # how far ahead a pose may lie [s]
FURTHEST_OFF = 0.5, 1.0  # from the present curve to a new one [m], [rad]
BEGIN_OFF = 0.005, 0.02  # from the robot at rest to the first pose [m], [rad]
MOST_TURN = 2.5  # of the tcp in the nominal frame [rad]
UNIT_TOLERANCE = 1e-3
WAIT_S = 2.0  # at rest behind the last pose until the following is over [s]
SHORTEST_S = 0.12  # of a stop or of the decay of a difference [s]

_QUARTERS = np.array((0.0, 0.25, 0.5, 0.75, 1.0))
_SAMPLES = np.linspace(0.0, 1.0, 17)
# First and second derivative (2, 17, 3) of a quintic to rest, of length 1 in 1 s, for position,
# speed and acceleration at its begin.
_RATES = np.array(
    (
        (
            -30.0 * _SAMPLES**4 + 60.0 * _SAMPLES**3 - 30.0 * _SAMPLES**2,
            -15.0 * _SAMPLES**4 + 32.0 * _SAMPLES**3 - 18.0 * _SAMPLES**2 + 1.0,
            -2.5 * _SAMPLES**4 + 6.0 * _SAMPLES**3 - 4.5 * _SAMPLES**2 + _SAMPLES,
        ),
        (
            -120.0 * _SAMPLES**3 + 180.0 * _SAMPLES**2 - 60.0 * _SAMPLES,
            -60.0 * _SAMPLES**3 + 96.0 * _SAMPLES**2 - 36.0 * _SAMPLES,
            -10.0 * _SAMPLES**3 + 18.0 * _SAMPLES**2 - 9.0 * _SAMPLES + 1.0,
        ),
    )
).transpose(0, 2, 1)
_QUINTIC_SPEED = 1.875  # peak of a quintic of length 1 in 1 s
_QUINTIC_ACCELERATION = 10.0 / math.sqrt(3.0)
_PEAK = 1.5  # acceleration of a smooth stop from speed 1 m/s in 1 s
_AWAY = 2  # z of c points from the robot to the objects

Chunk = tuple[tuple[float, ...], ...]
"""Poses of a chunk: monotonic time [ns], position [m] and quaternion, w first, in base."""


class ChunkError(ValueError):
    """A chunk that is refused; the message says why."""


class FollowedPoses(Struct, frozen=True, eq=False):
    """The curve, and how far the robot is on it. Times count from its begin [s].

    Attributes:
        steps: steps since it began.
        times, poses: (m,), (m, 6) of the poses handed in, in c.
        breaks: (s + 1,) ends of the polynomials.
        curve: (5, s, 6) their coefficients, the highest power first.
        rest_s: when the curve comes to rest.
        offset: (6, 6) coefficients of the decaying difference, the highest power first.
        offset_s: begin and duration of that decay.
        refused: chunks that the step refused.
        begins_at_rest: the first of ``times`` is the begin of the following, where the robot stood.
    """

    steps: int
    times: Array
    poses: Array
    breaks: Array
    curve: Array
    rest_s: float
    offset: Array
    offset_s: tuple[float, float]
    refused: int = 0
    begins_at_rest: bool = True


def begin(pose: Array) -> FollowedPoses:
    """Return the curve of a robot that stands with its tcp at a pose (6,) in c."""
    curve = np.zeros((5, 1, 6))
    curve[-1, 0] = pose
    return FollowedPoses(
        steps=0,
        times=np.zeros(0),
        poses=np.zeros((0, 6)),
        breaks=np.array((0.0, 1.0)),
        curve=curve,
        rest_s=0.0,
        offset=np.zeros((6, 6)),
        offset_s=(0.0, SHORTEST_S),
    )


def poses_ahead(state: FollowedPoses, old: Array, commit: int, cycle_s: float) -> Array:
    """Return the tcp (n + 1, 6) in c from this step on.

    Args:
        old: list (n + 1, 6) of the step before; its committed steps are kept.
        commit: nc, the last step that stands already.
    """
    poses = np.empty_like(old)
    poses[: commit + 1] = old[1 : commit + 2]
    later = np.arange(state.steps + commit + 1, state.steps + len(old)) * cycle_s
    poses[commit + 1 :] = _positions(state, later)
    return poses


def is_over(state: FollowedPoses, cycle_s: float) -> bool:
    """Return whether the robot has rested for WAIT_S behind the last pose."""
    rest_s = max(state.rest_s, sum(state.offset_s))
    return state.steps * cycle_s >= rest_s + WAIT_S


def extend(
    state: FollowedPoses,
    chunk: Chunk,
    stamp_ns: int,
    *,
    nominal: Array,
    plane: float,
    limits: FollowLimits,
    cycle_s: float,
    commit: int,
) -> FollowedPoses:
    """Return the state with one more chunk.

    Args:
        stamp_ns: monotonic time of this step [ns].
        nominal: (3, 3) axes of c in base.
        plane: of the object along z of c [m].
        commit: nc, the last step that stands already.

    Raises:
        ChunkError: why it is refused.
    """
    now_s = state.steps * cycle_s
    times = _times(chunk, stamp_ns) + now_s
    poses = _in_nominal(chunk, nominal)
    _refuse_near(poses, plane, limits)
    if not len(state.times):
        _refuse_elsewhere(state, poses[0])
    at = now_s + commit * cycle_s
    knots, through, begins = _joined(state, times, poses, at)
    spline = cubic_spline.through(knots, through, begins_at_rest=begins)
    _refuse_fast(spline, knots, limits)
    breaks, curve, rest_s = _with_stop(spline, knots, limits)
    fresh = replace(
        state,
        times=knots,
        poses=through,
        breaks=breaks,
        curve=curve,
        rest_s=rest_s,
        begins_at_rest=begins,
    )
    return _eased(state, fresh, at, limits)


def _joined(
    state: FollowedPoses, times: Array, poses: Array, at: float
) -> tuple[Array, Array, bool]:
    """Return the poses that the curve goes through and their times, and whether it begins at rest.

    Args:
        at: when the curve begins to count [s]; KEPT_KNOTS poses before it are kept.

    Raises:
        ChunkError: too many poses lie ahead.
    """
    known, through = state.times, state.poses
    if not len(known):
        # The curve begins at rest: poses before the first one keep its place.
        known = times[0] - SHORTEST_S * np.array((2.0, 1.0))
        through = np.concatenate((poses[:1], poses[:1]))
    first = max(0, int(np.searchsorted(known, at)) - KEPT_KNOTS)
    last = max(first, int(np.searchsorted(known, times[0] - CLOSEST_S)))
    knots = np.concatenate((known[first:last], times))
    if len(knots) > MOST_KNOTS:
        raise ChunkError(f"{len(knots)} poses lie ahead, limit {MOST_KNOTS}. Hand in later.")
    begins = first == 0 and state.begins_at_rest
    return knots, np.concatenate((through[first:last], poses)), begins


def _times(chunk: Chunk, stamp_ns: int) -> Array:
    """Return the times of a chunk's poses from now [s].

    Raises:
        ChunkError: too many, not rising, too old or too far ahead.
    """
    if not 0 < len(chunk) <= MOST_POSES:
        raise ChunkError(f"{len(chunk)} poses, limit 1..{MOST_POSES}. Split the chunk.")
    if not all(len(pose) == 8 and all(map(math.isfinite, pose)) for pose in chunk):
        raise ChunkError("a pose is not 8 finite numbers: time, position, quaternion.")
    times = np.array([(pose[0] - stamp_ns) * 1e-9 for pose in chunk])
    apart = float(np.diff(times).min(initial=math.inf))
    if apart < CLOSEST_S:
        raise ChunkError(
            f"the time between two poses is {1e3 * apart:.1f} ms, at least {1e3 * CLOSEST_S:g} ms. "
            "Hand in rising times."
        )
    if times[0] < -OLDEST_S or times[-1] > FARTHEST_S:
        raise ChunkError(
            f"times {times[0]:.2f}..{times[-1]:.2f} s from now, limit "
            f"{-OLDEST_S:g}..{FARTHEST_S:g} s. Take the daemon's clock."
        )
    return times


def _in_nominal(chunk: Chunk, nominal: Array) -> Array:
    """Return the poses (m, 6) in c.

    Raises:
        ChunkError: a quaternion is none, or the tcp turns too far.
    """
    poses = np.empty((len(chunk), 6))
    for row, pose in zip(poses, chunk, strict=True):
        w, x, y, z = pose[4:]
        length = math.sqrt(w * w + x * x + y * y + z * z)
        if abs(length - 1.0) > UNIT_TOLERANCE:
            raise ChunkError(f"a quaternion has length {length:.4g}, limit 1. Normalise it.")
        row[:3] = nominal.T @ np.array(pose[1:4])
        unit = (w / length, x / length, y / length, z / length)
        row[3:] = rotations.log(nominal.T @ rotations.matrix(unit))
    turn = float(np.linalg.norm(poses[:, 3:], axis=1).max())
    if turn > MOST_TURN:
        raise ChunkError(f"the tcp turns by {turn:.2f} rad off the object, limit {MOST_TURN} rad.")
    return poses


def _refuse_near(poses: Array, plane: float, limits: FollowLimits) -> None:
    """Refuse poses near to the objects' plane.

    Raises:
        ChunkError: one is too near.
    """
    gap = plane - float(poses[:, _AWAY].max())
    if gap < limits.clearance:
        raise ChunkError(
            f"a pose is {1e3 * gap:.0f} mm before the object's plane, limit "
            f"{1e3 * limits.clearance:.0f} mm. Stay away, or set follow.clearance of the task."
        )


def _refuse_elsewhere(state: FollowedPoses, first: Array) -> None:
    """Refuse a first pose away from the robot.

    Raises:
        ChunkError: it is away.
    """
    off = first - state.curve[-1, 0]
    way, turn = float(np.linalg.norm(off[:3])), float(np.linalg.norm(off[3:]))
    if way > BEGIN_OFF[0] or turn > BEGIN_OFF[1]:
        raise ChunkError(
            f"the first pose is {1e3 * way:.1f} mm and {1e3 * turn:.1f} mrad off the robot, limit "
            f"{1e3 * BEGIN_OFF[0]:g} mm and {1e3 * BEGIN_OFF[1]:g} mrad. Begin where it stands."
        )


def _refuse_fast(spline: CubicSpline, knots: Array, limits: FollowLimits) -> None:
    """Refuse a curve that is too fast.

    Raises:
        ChunkError: speed or acceleration is beyond its limit.
    """
    at = (knots[:-1, None] + np.diff(knots)[:, None] * _QUARTERS).ravel()
    for order, most, turn, unit in (
        (1, limits.speed, limits.turn_speed, "/s"),
        (2, limits.acceleration, limits.turn_acceleration, "/s²"),
    ):
        rates = spline(at, order)
        way = float(np.linalg.norm(rates[:, :3], axis=1).max())
        angle = float(np.linalg.norm(rates[:, 3:], axis=1).max())
        if way > most or angle > turn:
            raise ChunkError(
                f"the poses need {way:.3g} m{unit} and {angle:.3g} rad{unit}, limit {most:g} and "
                f"{turn:g}. Hand in slower or smoother poses."
            )


def _with_stop(
    spline: CubicSpline, knots: Array, limits: FollowLimits
) -> tuple[Array, Array, float]:
    """Return breaks and coefficients of a spline with a stop behind it, and when it rests [s]."""
    end = knots[-1]
    pose, speed = spline(end), spline(end, 1)
    way, turn = float(np.linalg.norm(speed[:3])), float(np.linalg.norm(speed[3:]))
    duration = max(
        SHORTEST_S, _PEAK * way / limits.acceleration, _PEAK * turn / limits.turn_acceleration
    )
    # v (1 - 3 s² + 2 s³), s = t/duration: it begins with the spline's speed, ends at rest.
    curve = np.zeros((5, len(knots), 6))
    curve[1:, :-1] = spline.coefficients
    curve[0, -1] = 0.5 * speed / duration**3
    curve[1, -1] = -speed / duration**2
    curve[3, -1], curve[4, -1] = speed, pose
    return np.append(knots, end + duration), curve, float(end + duration)


def _eased(
    state: FollowedPoses, fresh: FollowedPoses, at: float, limits: FollowLimits
) -> FollowedPoses:
    """Return a fresh curve with the difference to the present one, which decays from ``at`` on.

    Raises:
        ChunkError: the difference is too large.
    """
    none = replace(fresh, offset=np.zeros((6, 6)))
    present, ahead = _derivatives(state, at), _derivatives(none, at)
    off = present - ahead  # (3, 6) position, speed, acceleration
    way, turn = float(np.linalg.norm(off[0, :3])), float(np.linalg.norm(off[0, 3:]))
    if way > FURTHEST_OFF[0] or turn > FURTHEST_OFF[1]:
        raise ChunkError(
            f"the poses are {way:.2f} m and {turn:.2f} rad off the robot, limit "
            f"{FURTHEST_OFF[0]:g} m and {FURTHEST_OFF[1]:g} rad. Begin again where it stands."
        )
    duration = _decay_time(off, limits)
    return replace(fresh, offset=_quintic(off, duration), offset_s=(at, duration))


def _decay_time(off: Array, limits: FollowLimits) -> float:
    """Return how long a difference (3, 6) takes to decay within speed and acceleration [s].

    It may keep the speed and the acceleration that it begins with, if they are beyond the limits.
    """
    size = np.hypot.reduce(off.reshape(3, 2, 3), axis=2)  # (3, 2) way and turn
    most = np.array(
        ((limits.speed, limits.turn_speed), (limits.acceleration, limits.turn_acceleration))
    )
    allowed = np.maximum(most, 1.001 * size[1:])
    least = np.sqrt(_QUINTIC_ACCELERATION * size[0] / most[1]).max()
    duration = max(SHORTEST_S, float(least), float((_QUINTIC_SPEED * size[0] / most[0]).max()))
    # Slower than FARTHEST_S helps no more; the command limits hold as ever.
    while duration < FARTHEST_S:
        scaled = off * np.array((1.0, duration, duration**2))[:, None]
        rates = (_RATES @ scaled).reshape(2, len(_SAMPLES), 2, 3)
        peaks = np.sqrt((rates * rates).sum(axis=3)).max(axis=1)
        if (peaks <= allowed * ((duration,), (duration**2,))).all():
            break
        duration *= 1.2
    return duration


def _quintic(off: Array, duration: float) -> Array:
    """Return coefficients (6, 6) from position, speed, acceleration (3, 6) to rest at 0."""
    e, v, a = off[0], off[1] * duration, off[2] * duration**2
    return np.array(
        (
            (-6.0 * e - 3.0 * v - 0.5 * a) / duration**5,
            (15.0 * e + 8.0 * v + 1.5 * a) / duration**4,
            (-10.0 * e - 6.0 * v - 1.5 * a) / duration**3,
            0.5 * off[2],
            off[1],
            off[0],
        )
    )


def _positions(state: FollowedPoses, times: Array) -> Array:
    """Return the curve (m, 6) at times (m,) [s]."""
    return _curve(state, times, 0) + _decay(state, times, 0)


def _derivatives(state: FollowedPoses, at: float) -> Array:
    """Return position, speed and acceleration (3, 6) of the curve at a time [s]."""
    times = np.array((at,))
    return np.concatenate([_curve(state, times, i) + _decay(state, times, i) for i in range(3)])


def _curve(state: FollowedPoses, times: Array, order: int) -> Array:
    first, last = float(state.breaks[0]), float(state.breaks[-1])
    inside = np.clip(times, first, last)
    piece = np.clip(
        np.searchsorted(state.breaks, inside, side="right") - 1, 0, len(state.breaks) - 2
    )
    coefficients = _differentiated(state.curve, order)[:, piece]
    values = _polynomial(coefficients, inside - state.breaks[piece])
    if order:
        values[(times < first) | (times >= last)] = 0.0
    return values


def _decay(state: FollowedPoses, times: Array, order: int) -> Array:
    at, duration = state.offset_s
    local = times - at
    values = _polynomial(_differentiated(state.offset, order), np.clip(local, 0.0, duration))
    values[local >= duration] = 0.0
    return values


def _differentiated(coefficients: Array, order: int) -> Array:
    """Return the coefficients of a derivative, the highest power first."""
    for _ in range(order):
        powers = np.arange(len(coefficients) - 1, 0, -1.0)
        shape = (-1, *(1 for _ in coefficients.shape[1:]))
        coefficients = coefficients[:-1] * powers.reshape(shape)
    return coefficients


def _polynomial(coefficients: Array, at: Array) -> Array:
    """Return a polynomial (m, 6) at (m,) by Horner's rule."""
    values = np.zeros((len(at), coefficients.shape[-1]))
    for row in coefficients:
        values = values * at[:, None] + row
    return values
