"""State of the filter across the conveyor."""

from msgspec import Struct

from linemate.daemon.core.horizon import Array

X, Z, TURN = 0, 1, 2  # rows of x, z, and of the first of three rotations
STATIC = 5  # states without the swings
LEAST_INFLATION = 2.0  # NIS from which the variance of a camera is inflated
LARGEST_INFLATION = 25.0  # of a camera's variance


class TransverseState(Struct, frozen=True, eq=False):
    """Estimate across the conveyor.

    Attributes:
        x: (8 + 2 m + p + g,): x, z [m], a small rotation [rad]; for each swing its angle and
            quadrature [rad]; the slopes of x and z for each metre of the conveyor's way; the ratio
            of x for each metre of sway along it; for each swing with a ``spread`` the error of its
            frequency as a share; for each with a ``gain`` that gain. Rotation and frequency errors
            are folded into the fields below after each correction, then 0.
        rotation: (3, 3) the object at rest in c.
        rejected: measurements rejected in a row.
        frequency_factors: each swing's frequency over the identified one.
        nis: average normalised innovation squared of the camera's poses.
        speed: of the conveyor in the last step [m/s].
        unit: position of the conveyor unit in the last step [m], None before.
        swaying: speed of the object against the conveyor in the last step [m/s].
        felt: slow mean of felt poses off x [m]; None before the first one.
        shrinkage: (n,) what ``believed`` adds to x: it takes back errors that may not be there.
        errors: (4, 4) covariance of the camera's errors with that shrinkage.
    """

    x: Array
    P: Array
    rotation: Array
    rejected: int = 0
    frequency_factors: tuple[float, ...] = ()
    nis: float = 1.0
    speed: float = 0.0
    unit: float | None = None
    swaying: float = 0.0
    felt: float | None = None
    shrinkage: Array | None = None
    errors: Array | None = None

    @property
    def inflation(self) -> float:
        """Factor of a camera's stated variance: 1 while its NIS is plausible."""
        return min(self.nis, LARGEST_INFLATION) if self.nis > LEAST_INFLATION else 1.0
