"""Sag of the mount under the weight of tool and wheel.

Invariants:
    Static: the deflection at which the mount carries the weight in one posture of the tool.
    Gravity is along -z of base.
"""

import math

from linemate.simulators.plants.forces.switches import Load
from linemate.simulators.plants.rotation import Pose

GRAVITY = 9.80665
"""[m/s^2]"""

Six = tuple[float, float, float, float, float, float]


class Weight:
    """Weight of the tool, with its wheel until that is released."""

    def __init__(self, load: Load, stiffness: Six) -> None:
        self._load, self._stiffness = load, stiffness
        self._mass = load.tool_mass + load.wheel_mass
        self._moment = _moment(load, load.wheel_mass)

    @property
    def lightened(self) -> float:
        """By what the mount's frequencies grow when the wheel is released."""
        tool = self._load.tool_mass
        return math.sqrt((tool + self._load.wheel_mass) / tool) if tool > 0.0 else 1.0

    def drop_wheel(self) -> None:
        """Release the wheel."""
        self._mass = self._load.tool_mass
        self._moment = _moment(self._load, 0.0)

    def sag(self, rigid: Pose) -> Six:
        """Deflection of the mount in rest, along and about the axes of the rigid tcp [m, rad].

        Args:
            rigid: rigid tcp in base.
        """
        # Gravity in the tcp is minus the last row of its orientation.
        _, (*_, x, y, z) = rigid
        gx, gy, gz = -GRAVITY * x, -GRAVITY * y, -GRAVITY * z
        mx, my, mz = self._moment
        k0, k1, k2, k3, k4, k5 = self._stiffness
        return (
            self._mass * gx / k0,
            self._mass * gy / k1,
            self._mass * gz / k2,
            (my * gz - mz * gy) / k3,
            (mz * gx - mx * gz) / k4,
            (mx * gy - my * gx) / k5,
        )


def new_weight(load: Load, stiffness: Six) -> Weight | None:
    """Make the weight of a load; None if the load is off."""
    return Weight(load, stiffness) if load.tool_mass or load.wheel_mass else None


def _moment(load: Load, wheel_mass: float) -> tuple[float, float, float]:
    """Mass times centre of gravity [kg m]."""
    (x, y, z), (a, b, c) = load.tool_centre, load.wheel_centre
    tool = load.tool_mass
    return (tool * x + wheel_mass * a, tool * y + wheel_mass * b, tool * z + wheel_mass * c)
