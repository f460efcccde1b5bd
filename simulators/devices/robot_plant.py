"""Robot as a controller sees it: units and frames between plant and wire.

Invariants:
    Setpoints of a cycle act within that cycle.
    The plant is never ahead of the next telegram.
"""

from linemate.protocol.units import rotation_to_abc
from linemate.simulators.devices.emulated_world import EmulatedWorld
from linemate.simulators.devices.rsi_controller import Applied, RobotReading, Seven


class RobotPlant:
    """Reads and commands a world.

    Attributes:
        cycle: the controller's cycle that is open, counted from the start of the run.
        axes: what was last read, A1..A6 [rad], E1 [m].
    """

    def __init__(self, world: EmulatedWorld) -> None:
        self.world = world
        self.cycle = 0
        self.axes = self.start

    @property
    def start(self) -> Seven:
        """Where the robot stands at the beginning, A1..A6 [rad], E1 [m]."""
        return seven(self.world.start)

    def read(self) -> RobotReading:
        """What the controller's telegram says of the robot now."""
        world = self.world
        (x, y, z), (r11, r12, r13, r21, r22, r23, r31, r32, r33) = world.reported()
        a, b, c = rotation_to_abc(((r11, r12, r13), (r21, r22, r23), (r31, r32, r33)))
        self.axes = seven(world.encoders())
        return RobotReading(self.axes, (x, y, z, a, b, c), digital_in=world.digital_in())

    def apply(self, applied: Applied) -> None:
        """Command what the controller applies in the open cycle, and go to the next one.

        The world may be there already: no axis moves before its dead time has passed.

        Args:
            applied: the open cycle's outcome.
        """
        self.world.command(applied.motion or applied.setpoints, self.cycle)
        self.world.digital_out(applied.digital_out)
        self.cycle += 1
        self.world.advance(self.world.cycle_start(self.cycle))


def seven(values: tuple[float, ...]) -> Seven:
    """Seven values, A1..A6 and E1.

    Returns:
        The same.

    Raises:
        ValueError: if there are not seven.
    """
    a, b, c, d, e, f, g = values
    return (a, b, c, d, e, f, g)
