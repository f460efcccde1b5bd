"""Brings the cars of a plan one after the other, and notes what became of each.

Invariants:
- The next car enters only while the robot stands.
- It is called once a cycle of the controller.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from linemate.simulators.devices.line.car_line import CarLine
from linemate.simulators.devices.line.cars import Car, CarTruth, LinePlan
from linemate.simulators.plants.scenario import Scenario

STANDS_S = 0.5  # time without a new setpoint after which the robot stands [s]
STILL = 1e-9  # change of a setpoint that is none: a filter goes on for ever [rad, m a cycle]
STUCK_S = 180.0  # the line gives up if the robot does not stand for so long after the takt [s]


class CarEvent(NamedTuple):
    """A change at the line.

    Attributes:
        entered: the car that enters now, None behind the last one.
        reading: position of the line at that instant [m], less the sensor's mount.
        left: the car before, with what became of it; None before the first one.
    """

    entered: Car | None
    reading: float
    left: tuple[Car, CarTruth] | None


class CarFeeder:
    """The plan that is carried out.

    Attributes:
        line: the world of the cars.
        is_over: the last car has left, or the line gave up.
        complaint: why the line gave up, None if it did not.
    """

    def __init__(self, template: Scenario, plan: LinePlan) -> None:
        """Begin with an empty place.

        Args:
            template: what the cars have in common.
        """
        self.line = CarLine(template, plan)
        self.is_over = False
        self.complaint: str | None = None
        self._plan, self._cycle_s = plan, template.cycle_s
        self._next = 0
        self._due_s = plan.first_s
        self._setpoints: tuple[float, ...] = template.robot.start
        self._standing = 0
        self._impact_mm: float | None = None

    @property
    def cars(self) -> tuple[Car, ...]:
        """Cars that have entered or will enter."""
        return self._plan.cars

    def close(self) -> None:
        """Let no further car enter, but the first; the shift ends as the present one leaves."""
        self._plan = replace(self._plan, cars=self._plan.cars[: max(self._next, 1)])

    def next_event(self, setpoints: tuple[float, ...], cycle: int) -> CarEvent | None:
        """Return what changes at the beginning of a cycle, None if nothing does.

        Args:
            setpoints: of the robot in the cycle before, A1..A6 [rad], E1 [m].
            cycle: number of the controller's cycle that begins.
        """
        is_still = all(abs(a - b) < STILL for a, b in zip(setpoints, self._setpoints, strict=True))
        self._standing = self._standing + 1 if is_still else 0
        self._setpoints = setpoints
        self._judge()
        now_s = self.line.time_s
        if self.is_over or now_s < self._due_s:
            return None
        if self._standing * self._cycle_s < STANDS_S:
            if now_s - self._due_s > STUCK_S:
                self.complaint = f"the robot does not stand at {now_s:.1f} s"
                self.is_over = True
            return None
        left = self._truth()
        if self._next >= len(self._plan.cars):
            self.is_over = True
            return CarEvent(None, self.line.reading, left)
        car = self._plan.cars[self._next]
        self._next += 1
        takt_s = self._plan.takt_s
        is_last = self._next == len(self._plan.cars)
        self._due_s = now_s + (min(takt_s, self._plan.last_s) if is_last else takt_s)
        self.line.enter(car, setpoints, cycle)
        self._impact_mm = None
        return CarEvent(car, self.line.reading, left)

    def _judge(self) -> None:
        """Note the error at the first touch."""
        if self.line.impact is not None and self._impact_mm is None:
            off = np.linalg.inv(self.line.hub_pose()) @ self.line.tcp_pose()
            self._impact_mm = 1e3 * math.hypot(*off[:2, 3].tolist())

    def _truth(self) -> tuple[Car, CarTruth] | None:
        """Return what became of the present car, None before the first one."""
        if not self._next:
            return None
        line = self.line
        collision = None if line.collision is None else line.collision.reason
        is_done = line.screws_fixed_s is not None and line.released_s is not None
        return line.car, CarTruth(is_done and collision is None, collision, self._impact_mm)
