"""Drives of the seven axes: dead time, smoothing, and two loops of each motor.

Setpoints pass two moving averages, as in controllers that limit acceleration and jerk so. A
position loop (P) around a velocity loop (PI) follows them; speed, acceleration and
gravity are fed forward.

Invariants:
    A setpoint of a cycle is reached, without the lag, at the cycle's end plus the dead time.
    A cycle without a setpoint in time keeps the one before.
"""

import math

import numpy as np

from linemate.simulators.mujoco_world.frame_poses import Array
from linemate.simulators.mujoco_world.mujoco_cell import ArmDrives, known

AXES = 7


class _Average:
    """Moving average of seven axes, each over a length of its own."""

    def __init__(self, lengths: tuple[int, ...], start: Array) -> None:
        self._lengths = np.array(lengths)
        self._kept = np.tile(start, (max(lengths) + 1, 1))
        self._sums = start * self._lengths
        self._at = 0
        self._axes = np.arange(len(lengths))

    def push(self, value: Array) -> tuple[Array, Array]:
        """Return the average and its change in this time step."""
        count = len(self._kept)
        self._kept[self._at] = value
        oldest = self._kept[(self._at - self._lengths) % count, self._axes]
        self._at = (self._at + 1) % count
        change = value - oldest
        self._sums += change
        return self._sums / self._lengths, change / self._lengths


class Drives:
    """Motor torques from setpoints.

    Attributes:
        dead_time_s: setpoint received until it acts [s].
    """

    def __init__(
        self, arm: ArmDrives, start: tuple[float, ...], cycle_s: float, step_s: float
    ) -> None:
        """Stand at the start.

        Args:
            start: A1..A6 [rad], E1 [m].
            step_s: time step of the simulation [s].
        """
        self.dead_time_s = known(arm.dead_time_s)
        self._arm, self._cycle_s, self._step_s = arm, cycle_s, step_s
        self._position_gain = np.array(arm.position_gain)
        self._velocity_gain = np.array(arm.velocity_gain)
        self._inertia = np.ones(AXES)
        self._integral = np.zeros(AXES)
        self._averages = tuple(
            _Average((*(round(of_arm / step_s),) * 6, round(of_rail / step_s)), np.array(start))
            for of_arm, of_rail in zip(arm.smoothing_s, arm.linear_smoothing_s, strict=True)
        )
        self._moved = np.zeros(AXES)
        self._points: dict[int, Array] = {-1: np.array(start)}
        self._last = -1

    def fit(self, inertia: Array) -> None:
        """Set the inertia of each axis as the drives were commissioned with, (7,)."""
        self._inertia = inertia

    def command(self, cycle: int, age_s: float, setpoints: tuple[float, ...]) -> None:
        """Take the setpoints of a cycle.

        Args:
            age_s: time since the cycle began [s].

        Raises:
            ValueError: not seven finite values, or a cycle whose motion has begun.
        """
        if len(setpoints) != AXES or not math.isfinite(sum(setpoints)):
            raise ValueError(f"seven finite setpoints wanted, got {setpoints}")
        if age_s > self.dead_time_s:
            raise ValueError(f"setpoints of cycle {cycle} are {age_s} s old: its motion has begun")
        self._points[cycle] = np.array(setpoints)
        self._last = max(self._last, cycle)

    def reference(self, since_start_s: float) -> Array:
        """Return the setpoints in force, (7,), a time after the start of the run [s]."""
        share, cycle = math.modf((since_start_s - self.dead_time_s) / self._cycle_s)
        if share < 0.0 or cycle < 0.0:
            return self._points[-1]
        number = int(cycle)
        for k in (number - 1, number):
            if k not in self._points:
                self._points[k] = self._points[max(j for j in self._points if j < k)]
        before, after = self._points[number - 1], self._points[number]
        if number > 1:
            # The setpoints of long ago, but for the start's, are of no use.
            self._points.pop(number - 2, None)
        reached: Array = before + share * (after - before)
        return reached

    def torques(self, reference: Array, position: Array, velocity: Array, gravity: Array) -> Array:
        """Return the motors' torques [Nm], E1 [N], (7,) for one time step.

        Args:
            reference: setpoints in force now.
            gravity: what the controller's load data say is needed at rest, (7,).
        """
        first, second = self._averages
        path, moved = second.push(first.push(reference)[0])
        error = self._position_gain * (path - position) + moved / self._step_s - velocity
        self._integral += error * (self._step_s / self._arm.integral_s)
        acceleration = (moved - self._moved) / self._step_s**2
        self._moved = moved
        wanted = self._velocity_gain * (error + self._integral) + acceleration
        torque: Array = self._inertia * wanted + gravity
        return torque
