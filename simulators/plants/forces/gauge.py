"""Bias and slow drift of a force-torque sensor.

Invariants:
    A function of time alone; each axis has its own draw.
    A sensor whose effects are off draws nothing.
"""

import math

from linemate.simulators.plants.forces.switches import ForceTorqueEffects
from linemate.simulators.plants.streams import stream

Six = tuple[float, float, float, float, float, float]


class GaugeErrors:
    """What the sensor shows in addition to the wrench and its noise."""

    def __init__(self, effects: ForceTorqueEffects, seed: int, start_s: float) -> None:
        forces, torques = effects.bias_force, effects.bias_torque
        self._bias = _draw(seed, "force_torque.bias", forces, torques)
        forces, torques = effects.drift_force, effects.drift_torque
        self._drift = _draw(seed, "force_torque.drift", forces, torques)
        self._start, self._time = start_s, effects.drift_time_s

    def at(self, t: float) -> Six:
        """Error at a scenario time, forces [N] and torques [Nm]."""
        share = -math.expm1(-(t - self._start) / self._time)
        x, y, z, a, b, c = (
            bias + share * drift for bias, drift in zip(self._bias, self._drift, strict=True)
        )
        return (x, y, z, a, b, c)


def new_gauge(effects: ForceTorqueEffects, seed: int, start_s: float) -> GaugeErrors | None:
    """Make the errors; None if they are off."""
    sizes = effects.bias_force, effects.bias_torque, effects.drift_force, effects.drift_torque
    return GaugeErrors(effects, seed, start_s) if any(sizes) else None


def _draw(seed: int, name: str, force: float, torque: float) -> list[float]:
    shares: list[float] = stream(seed, name).uniform(-1.0, 1.0, 6).tolist()
    sizes = (force, force, force, torque, torque, torque)
    return [size * share for size, share in zip(sizes, shares, strict=True)]
