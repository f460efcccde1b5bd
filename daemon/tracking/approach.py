"""The feasible trajectory, first half: where the tcp should be over the horizon (Sect. III-C).

Law of this file: from an estimate and the reference to the goal x_f(k + i), and from the
programmed to the sensed motion without a step. Poses (m, 6) in c.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linemate.daemon import rotations
from linemate.daemon.horizon import Array
from linemate.daemon.tracking.settings import SwingMode

_GENERATORS = tuple(rotations.skew(axis) for axis in np.eye(3))


@dataclass(frozen=True, slots=True, eq=False)
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


def part_poses(part: Part, modes: Sequence[SwingMode]) -> tuple[Array, Array, Array]:
    """Return the object's positions (m, 3), rotation vectors (m, 3) and swing turns (m, 3).

    A swing moves the object by its levers, (9), and along the chord's sagitta, the second order
    of the same rotation: 30 um at 8 mrad.
    """
    count = len(part.along)
    positions = np.empty((count, 3))
    positions[:, 0], positions[:, 1], positions[:, 2] = part.x, part.along, part.z
    turns = np.zeros((count, 3))
    for mode, angles in zip(modes, part.swing, strict=True):
        levers = np.array(mode.levers)
        positions += angles[:, None] * levers
        positions += (0.5 * angles * angles)[:, None] * (_GENERATORS[mode.axis] @ levers)
        turns[:, mode.axis] += angles
    base = rotations.log(part.rotation)
    vectors = base + turns @ rotations.left_jacobian_inverse(base).T
    return positions, vectors, turns


def sensed(
    part: Part, modes: Sequence[SwingMode], relative: Array, *, turned: bool
) -> tuple[Array, Array]:
    """Return x_f (m, 6), the sensed tcp with its programmed distance, and the object (m, 6).

    Args:
        part: over the horizon.
        modes: of its swing.
        relative: (m, 6) programmed tcp in the nominal object, (x_o^nom)^-1 x_r.
        turned: the programme turns the tcp against the object.
    """
    positions, vectors, turns = part_poses(part, modes)
    programmed = relative[:, 3:]
    arm = relative[:, :3] @ part.rotation.T
    tcp = np.empty((len(arm), 6))
    x, y, z = turns.T
    tcp[:, 0] = positions[:, 0] + arm[:, 0] + y * arm[:, 2] - z * arm[:, 1]
    tcp[:, 1] = positions[:, 1] + arm[:, 1] + z * arm[:, 0] - x * arm[:, 2]
    tcp[:, 2] = positions[:, 2] + arm[:, 2] + x * arm[:, 1] - y * arm[:, 0]
    if turned and bool(np.abs(programmed).max() > 0.0):
        own = rotations.exp_many(vectors) @ rotations.exp_many(programmed)
        tcp[:, 3:] = rotations.log_many(own)
    else:
        tcp[:, 3:] = vectors
    return tcp, np.concatenate((positions, vectors), axis=1)


def known(
    positions: Array, vectors: Array, relative: Array, *, turned: bool
) -> tuple[Array, Array]:
    """Return x_f (m, 6) and the object (m, 6) where the object's poses are known.

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
    return tcp, np.concatenate((positions, vectors), axis=1)


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
