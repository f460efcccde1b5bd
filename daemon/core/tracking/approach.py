"""Goal of the tcp over the horizon (Sect. III-C): sensed poses x_f, blending, retraction.

Poses are (m, 6) in c.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.settings import SwingMode

STEEPEST = 2.1875  # largest rate of ``smoothstep`` from 0 to 1 in unit time
IN_TIME_SPEED = 0.5  # of a blend up to which it takes its usual time [m/s]
CATCH_UP_SPEED = 0.25  # of one that begins late, when the object has gone far [m/s]

NORMAL_LAG = 0.0008  # of a tcp along the conveyor behind its plan, by servos identified well [m]
LEAD_S = 1.0  # time constant with which a lag is made up for: ten dead times [s]
# Of the goal before the object: dead time and lag of a servo of 4 Hz. None is quicker than at once.
LARGEST_LEAD = 0.1  # [s]


class Part(Struct, frozen=True, eq=False):
    """The object over the horizon, in c.

    Attributes:
        x, z: at rest across the conveyor [m].
        along: (m,) positions along the conveyor [m].
        rotation: (3, 3) at rest.
        swing: (modes, m) angles [rad].
        slopes: of x and z for each metre along the conveyor.
        lifted: (m,) way in x by the sway along the conveyor from now on [m]; None for none.
    """

    x: float
    z: float
    along: Array
    rotation: Array
    swing: Array
    slopes: tuple[float, float] = (0.0, 0.0)
    lifted: Array | None = None


def lead(before: float, off: float, speed: float, dt: float, *, is_whole: bool = False) -> float:
    """Return how far the goal is ahead of the object, for a robot with a longer dead time [s].

    A lag behind steady motion is a time: at rest there is none. What identified servos leave of it
    is left alone, unless all of it is to go: in contact 0.8 mm bend the mount by 40 N on 50 N/mm.

    Args:
        before: the lead of the step before, which the plan has [s].
        off: mean of the measured tcp off its plan along the conveyor [m].
        speed: of the object, not 0 [m/s].
    """
    lag = off + before * speed
    normal = 0.0 if is_whole else NORMAL_LAG
    beyond = lag - min(max(lag, -normal), normal)
    later = before - dt / LEAD_S * beyond / speed
    return min(max(later, -LARGEST_LEAD), LARGEST_LEAD)


def is_quicker(lead: float, nominal_speed: float) -> bool:
    """Return whether a robot is ahead of its servo models by more than identified ones leave.

    Args:
        nominal_speed: of the object [m/s].
    """
    return -lead * nominal_speed > NORMAL_LAG


def ahead(
    part: Part, lead: float, dt: float, modes: Sequence[SwingMode], relative: Array, *, turned: bool
) -> Array:
    """Return what the tcp of an object moves in the lead (m, 6): along its way, and by swings.

    A robot that lags does so in each direction: a body that swings across bends the mount as well.

    Args:
        lead: less than 0 for a robot that is quicker than its servo models [s].
        dt: between the steps of the horizon [s].
        relative: (m, 6) programmed tcp in the nominal object.
        turned: the programme turns the tcp against the object.
    """
    later = replace(
        part,
        along=part.along + lead * _rates(part.along, dt),
        swing=part.swing + lead * _rates(part.swing, dt),
        lifted=None if part.lifted is None else part.lifted + lead * _rates(part.lifted, dt),
    )
    (now, _), (then, _) = (sensed(p, modes, relative, turned=turned) for p in (part, later))
    return np.asarray(then - now)


def _rates(values: Array, dt: float) -> Array:
    """Return the rates (..., m) of values (..., m) as numpy's gradient, in a third of its time."""
    rates = np.empty_like(values)
    rates[..., 1:-1] = (values[..., 2:] - values[..., :-2]) / (2.0 * dt)
    rates[..., 0] = (values[..., 1] - values[..., 0]) / dt
    rates[..., -1] = (values[..., -1] - values[..., -2]) / dt
    return rates


def sensed(
    part: Part, modes: Sequence[SwingMode], relative: Array, *, turned: bool
) -> tuple[Array, Array]:
    """Return x_f (m, 6), the sensed tcp with its programmed distance, and the object now (6,).

    A swing moves the object by its levers, (9), and along the chord's sagitta, the second order
    of the same rotation: 30 um at 8 mrad; and it turns the arm from object to tcp. So x_f is
    linear in its terms: a step's arm, its arm times each angle, 1, the way along the conveyor,
    each angle, each angle's square. One product adds them up; without an arm they are the object.

    Args:
        relative: (m, 6) programmed tcp in the nominal object, (x_o^nom)^-1 x_r.
        turned: the programme turns the tcp against the object.
    """
    series = _series(tuple(modes))
    at_rest, along, swing, square = series.places
    R = part.rotation
    base = rotations.log(R)
    terms, adds = np.empty((len(series.adds), len(relative))), series.adds.copy()
    terms[:3], adds[:3, :3] = relative[:, :3].T, R.T
    terms[at_rest], terms[along], now = 1.0, part.along, float(part.along[0])
    (x_slope, z_slope), (x, z) = part.slopes, (part.x, part.z)
    adds[at_rest] = (x - x_slope * now, 0.0, z - z_slope * now, *base.tolist())
    adds[along, :3] = x_slope, 1.0, z_slope
    if modes:
        inverse = rotations.left_jacobian_inverse(base)
        terms[swing:square] = part.swing
        np.multiply(part.swing, part.swing, out=terms[square:])
    for m, mode in enumerate(modes):
        turned_arm = slice(3 + 3 * m, 6 + 3 * m)
        np.multiply(terms[:3], part.swing[m], out=terms[turned_arm])
        adds[turned_arm, :3] = series.generators[m].dot(R).T
        adds[swing + m, 3:] = inverse[:, mode.axis]
    tcp = terms.T.dot(adds)
    now_in_c = terms[at_rest:, 0].dot(adds[at_rest:])
    if part.lifted is not None:
        tcp[:, 0] += part.lifted
        now_in_c[0] += part.lifted[0]
    programmed = relative[:, 3:]
    if turned and np.count_nonzero(programmed):
        own = rotations.exp_many(tcp[:, 3:]) @ rotations.exp_many(programmed)
        tcp[:, 3:] = rotations.log_many(own)
    return tcp, now_in_c


class _Series(Struct, frozen=True, eq=False):
    """What each term of x_f adds to a pose, as far as the modes alone show.

    Attributes:
        adds: (t, 6) [m, rad] for one unit of the term.
        places: of the first term without an arm, of the way along the conveyor, of the first
            angle, of its square.
        generators: (3, 3) of each mode.
    """

    adds: Array
    places: tuple[int, int, int, int]
    generators: tuple[Array, ...]


@lru_cache(maxsize=8)
def _series(modes: tuple[SwingMode, ...]) -> _Series:
    """Return the series of some modes: their levers [m/rad] and the sagitta [m/rad^2] in it."""
    count = len(modes)
    at_rest = 3 + 3 * count
    along, swing, square = at_rest + 1, at_rest + 2, at_rest + 2 + count
    adds = np.zeros((square + count, 6))
    generators = tuple(rotations.skew(np.eye(3)[mode.axis]) for mode in modes)
    for m, (mode, generator) in enumerate(zip(modes, generators, strict=True)):
        adds[swing + m, :3] = mode.levers
        adds[square + m, :3] = 0.5 * (generator @ np.array(mode.levers))
    adds.setflags(write=False)
    return _Series(adds, (at_rest, along, swing, square), generators)


def known(
    positions: Array, vectors: Array, relative: Array, *, turned: bool
) -> tuple[Array, Array]:
    """Return x_f (m, 6) and the object now (6,) where the object's poses are known.

    Args:
        positions: (m, 3) of the object.
        vectors: (m, 3) rotation vectors of the object.
        relative: (m, 6) programmed tcp in the nominal object.
        turned: the programme turns the tcp against the object.
    """
    R = rotations.exp_many(vectors)
    tcp = np.empty((len(positions), 6))
    tcp[:, :3] = positions + (R @ relative[:, :3, None])[:, :, 0]
    tcp[:, 3:] = vectors
    if turned:
        tcp[:, 3:] = rotations.log_many(R @ rotations.exp_many(relative[:, 3:]))
    return tcp, np.concatenate((positions[0], vectors[0]))


def smoothstep(s: Array) -> Array:
    """Return the seventh-order step (m,) from 0 to 1: its first three derivatives end at 0."""
    s = np.minimum(np.maximum(s, 0.0), 1.0)  # a third of the time of np.clip
    step: Array = s**4 * (35.0 + s * (-84.0 + s * (70.0 - 20.0 * s)))
    return step


def smoothstep_at(s: float) -> float:
    """Return ``smoothstep`` of one value."""
    s = min(max(s, 0.0), 1.0)
    return s**4 * (35.0 + s * (-84.0 + s * (70.0 - 20.0 * s)))


def catch_up_time(way: float, usual_s: float) -> float:
    """Return how long a blend takes that moves the goal by a way [m] as well [s].

    A start at which the object is 0.76 m on was blended at 3.5 m/s, which the limits cut: the free
    tool rang with 370 N.

    Args:
        usual_s: of an object where it is expected at the start [s].
    """
    if STEEPEST * way <= IN_TIME_SPEED * usual_s:
        return usual_s
    return STEEPEST * way / CATCH_UP_SPEED


def blend(programmed: Array, goal: Array, share: Array) -> Array:
    """Return the blend (m, 6) of programmed and sensed motion; share (m,) in [0, 1]."""
    between: Array = programmed + share[:, None] * (goal - programmed)
    return between


def withdraw(goal: Array, way: Array) -> Array:
    """Return the goal (m, 6) moved back along the tool's axis by ``way`` (m,) [m]."""
    back = goal.copy()
    axis = rotations.exp(goal[0, 3:])[:, 2]
    back[:, :3] -= way[:, None] * axis
    return back
