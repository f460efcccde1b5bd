"""The feasible trajectory, first half: where the tcp should be over the horizon (Sect. III-C).

Law of this file: from an estimate and the reference to the goal x_f(k + i), and from the
programmed to the sensed motion without a step. Poses (m, 6) in c.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from linemate.daemon import rotations
from linemate.daemon.horizon import Array
from linemate.daemon.tracking.settings import SwingMode
from linemate.protocol.frozen import frozen


@frozen(eq=False)
class Part:
    """The object over the horizon, in c.

    Attributes:
        x, z: at rest across the conveyor [m].
        along: (m,) positions along the conveyor [m].
        rotation: (3, 3) at rest.
        swing: (modes, m) angles [rad].
    """

    x: float
    z: float
    along: Array
    rotation: Array
    swing: Array


def sensed(
    part: Part, modes: Sequence[SwingMode], relative: Array, *, turned: bool
) -> tuple[Array, Array]:
    """Return x_f (m, 6), the sensed tcp with its programmed distance, and the object now (6,).

    A swing moves the object by its levers, (9), and along the chord's sagitta, the second order
    of the same rotation: 30 um at 8 mrad; and it turns the arm from object to tcp.

    Args:
        part: over the horizon.
        modes: of its swing.
        relative: (m, 6) programmed tcp in the nominal object, (x_o^nom)^-1 x_r.
        turned: the programme turns the tcp against the object.
    """
    R = part.rotation
    base = rotations.log(R)
    tcp = np.empty((len(relative), 6))
    tcp[:] = (part.x, 0.0, part.z, *base.tolist())
    place, vectors = tcp[:, :3], tcp[:, 3:]
    place[:, 1] += part.along
    arm = relative[:, :3]
    place += arm @ R.T
    now = np.array((part.x, float(part.along[0]), part.z, *base.tolist()))
    if modes:
        inverse = rotations.left_jacobian_inverse(base)
    for mode, angles in zip(modes, part.swing, strict=True):
        generator, levers, sagitta = _lever(mode)
        column, angle = angles[:, None], float(angles[0])
        place += column * (arm @ (generator @ R).T + (levers + column * sagitta))
        vectors += column * inverse[:, mode.axis]
        now[:3] += angle * (levers + angle * sagitta)
        now[3:] += angle * inverse[:, mode.axis]
    programmed = relative[:, 3:]
    if turned and bool(np.abs(programmed).max() > 0.0):
        own = rotations.exp_many(vectors) @ rotations.exp_many(programmed)
        vectors[:] = rotations.log_many(own)
    return tcp, now


@lru_cache(maxsize=32)
def _lever(mode: SwingMode) -> tuple[Array, Array, Array]:
    """Return a mode's generator (3, 3), its levers (3,) and their sagitta (3,) [m/rad^2]."""
    levers = np.array(mode.levers)
    generator = rotations.skew(np.eye(3)[mode.axis])
    return generator, levers, 0.5 * (generator @ levers)


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
    s = np.clip(s, 0.0, 1.0)
    step: Array = s**4 * (35.0 + s * (-84.0 + s * (70.0 - 20.0 * s)))
    return step


def blend(programmed: Array, goal: Array, share: Array) -> Array:
    """Return the way (m, 6) from the programmed to the sensed motion; share (m,) in [0, 1]."""
    between: Array = programmed + share[:, None] * (goal - programmed)
    return between


def withdraw(goal: Array, way: Array) -> Array:
    """Return the goal (m, 6) moved back along the tool's axis by ``way`` (m,) [m]."""
    back = goal.copy()
    axis = rotations.exp(goal[0, 3:])[:, 2]
    back[:, :3] -= way[:, None] * axis
    return back
