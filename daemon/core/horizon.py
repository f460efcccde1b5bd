"""Interface between tracking and control: the paper's predictive interface x_t(k, i).

Poses are in the *nominal frame* c: its axes are those of the nominal object (y along the conveyor),
its origin is that of base.
"""

from collections.abc import Callable, Hashable
from typing import Any, Generic, TypeVar

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]
Key = TypeVar("Key", bound=Hashable)


class KeptValues(Generic[Key]):
    """A function of the horizon's times that computes its last values once.

    The times are the same array in each step. Most steps have no image, and change no frequency.
    """

    def __init__(self, compute: Callable[[Key, Array], NDArray[Any]]) -> None:
        self._compute = compute
        self._last: tuple[Key, Array, NDArray[Any]] | None = None

    def __call__(self, key: Key, times: Array) -> NDArray[Any]:
        """Return the values at some times; they are read-only."""
        last = self._last
        if last is not None and last[1] is times and last[0] == key:
            return last[2]
        values = self._compute(key, times)
        values.setflags(write=False)
        self._last = key, times, values
        return values


def exponential(pole: complex, times: Array) -> ComplexArray:
    """Return e^(pole t) (m,): damping, cosine and sine at once."""
    return np.asarray(np.exp(pole * times))


class Horizon(Struct, frozen=True, eq=False):
    """Desired tcp poses at steps k + i, i = 0..n.

    Attributes:
        poses: (n+1, 6) position [m] and rotation vector [rad] of the tcp in c, so that
            ``tcp_in_base = (C p, C Exp(r))``.
        axis: (m,) planned positions of the linear axis [m], as far as control reads them; each but
            the last was in the last step's plan.
        free: (n+1,) 1 where the tool hangs free, 0 where it is clamped to the object, between them
            during a blend.
        nominal: (3, 3) C, the axes of c in base.
        committed: nc; ``poses[:nc + 1]`` are the last list's ``poses[1:nc + 2]``, bit for bit.
    """

    poses: Array
    axis: Array
    free: Array
    nominal: Array
    committed: int = 0
