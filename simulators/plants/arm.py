"""Forward kinematics of the arm on its linear axis, by Denavit and Hartenberg (Craig's form).

Law of this file: the emulator's own kinematics, made from the table in the scenario; it shares
no model file with the daemon. Poses in base; joints in KUKA's sense of rotation.
"""

import math

from linemate.simulators.plants import rotation
from linemate.simulators.plants.rotation import Pose
from linemate.simulators.plants.scenario import Robot


class ArmPlant:
    """Flange and tcp for joint angles and a position of the linear axis."""

    def __init__(self, robot: Robot) -> None:
        self._rows = tuple(
            (_clean(math.cos(link.alpha)), _clean(math.sin(link.alpha)), link.a, link.d, link.theta)
            for link in robot.links
        )
        self._tcp_in_flange: Pose = (robot.tcp_position, rotation.exp(robot.tcp_rotation))

    def flange(self, joints: tuple[float, ...]) -> Pose:
        """Flange in base.

        Args:
            joints: A1..A6 [rad], E1 [m] (root_in_base = Trans(0, E1, 0)).

        Returns:
            Pose of the flange in base.
        """
        px, py, pz = 0.0, joints[6], 0.0
        xx, xy, xz, yx, yy, yz, zx, zy, zz = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
        for (ca, sa, a, d, offset), q in zip(self._rows, joints, strict=False):
            # Columns of the rotation: Rx(alpha) turns y and z, Tx(a) moves along x.
            if ca:
                ux, uy, uz = ca * yx + sa * zx, ca * yy + sa * zy, ca * yz + sa * zz
                zx, zy, zz = ca * zx - sa * yx, ca * zy - sa * yy, ca * zz - sa * yz
            else:
                ux, uy, uz, zx, zy, zz = sa * zx, sa * zy, sa * zz, -sa * yx, -sa * yy, -sa * yz
            px, py, pz = px + a * xx + d * zx, py + a * xy + d * zy, pz + a * xz + d * zz
            c, s = math.cos(q + offset), math.sin(q + offset)
            yx, yy, yz = c * ux - s * xx, c * uy - s * xy, c * uz - s * xz
            xx, xy, xz = c * xx + s * ux, c * xy + s * uy, c * xz + s * uz
        # The half turn about x from the last axis to the flange.
        return (px, py, pz), (xx, -yx, -zx, xy, -yy, -zy, xz, -yz, -zz)

    def tcp(self, joints: tuple[float, ...]) -> Pose:
        """Rigid tcp in base: where the robot holds the tool without deflection."""
        return rotation.multiply(self.flange(joints), self._tcp_in_flange)


def _clean(value: float) -> float:
    """A cosine or sine of a right angle without its rounding error."""
    return float(round(value)) if abs(value - round(value)) < 1e-15 else value
