"""Robot that its own programme guides through postures while the exchange runs.

Invariants:
    Corrections of the exchange are added to the programme, as on a controller.
    An axis may count the other way than its plant turns.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from linemate.simulators.devices.emulated_world import EmulatedWorld
from linemate.simulators.devices.robot_plant import RobotPlant, seven
from linemate.simulators.devices.rsi_controller import Applied, RobotReading, Seven

FORWARD: Seven = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True)
class PostureProgramme:
    """Point-to-point motions of a controller's own programme.

    Attributes:
        postures: A1..A6 [rad], E1 [m], one after another.
        begin_s: scenario time of the first motion [s].
        move_s: duration of a motion [s].
        dwell_s: time of rest after it [s].
    """

    postures: Sequence[Seven]
    begin_s: float
    move_s: float = 2.0
    dwell_s: float = 2.0

    @property
    def end_s(self) -> float:
        """Scenario time at which the last rest is over [s]."""
        return self.begin_s + len(self.postures) * (self.move_s + self.dwell_s)

    def at(self, t: float, start: Seven) -> Seven:
        """Axes at a scenario time, from where they stood before the first motion."""
        number, rest = divmod(max(t - self.begin_s, 0.0), self.move_s + self.dwell_s)
        n = int(number)
        if not self.postures or t <= self.begin_s:
            return start
        if n >= len(self.postures):
            return self.postures[-1]
        before = start if n == 0 else self.postures[n - 1]
        s = min(rest / self.move_s, 1.0)
        share = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        return seven(
            tuple(a + share * (b - a) for a, b in zip(before, self.postures[n], strict=True))
        )


class GuidedRobot(RobotPlant):
    """A robot plant with a programme, whose axes may count the other way."""

    def __init__(
        self,
        world: EmulatedWorld,
        programme: PostureProgramme,
        signs: Seven = FORWARD,
        corrected: Seven = FORWARD,
    ) -> None:
        """Begin at rest.

        Args:
            signs: 1, or -1 for an axis that the controller counts the other way.
            corrected: share of a correction by which each axis moves, as the controller counts.
        """
        self._signs, self._programme = signs, programme
        self._moves = tuple(a * b for a, b in zip(signs, corrected, strict=True))
        super().__init__(world)
        self._origin = super().start

    @property
    def start(self) -> Seven:
        """Where the robot stands at the beginning, as the controller counts."""
        return self._counted(super().start)

    def read(self) -> RobotReading:
        """What the controller's telegram says of the robot now."""
        reading = super().read()
        self.axes = self._counted(reading.axes)
        return RobotReading(self.axes, reading.tcp, reading.digital_in)

    def apply(self, applied: Applied) -> None:
        """Command programme and correction of the open cycle, and go to the next one."""
        world, start = self.world, self.start
        sent = applied.motion or applied.setpoints
        ahead = self._programme.at(world.cycle_start(self.cycle + 1), self._origin)
        corrected = tuple(
            place + share * (value - begin)
            for place, share, value, begin in zip(ahead, self._moves, sent, start, strict=True)
        )
        world.command(corrected, self.cycle)
        world.digital_out(applied.digital_out)
        self.cycle += 1
        world.advance(world.cycle_start(self.cycle))

    def _counted(self, axes: Seven) -> Seven:
        return seven(tuple(s * q for s, q in zip(self._signs, axes, strict=True)))
