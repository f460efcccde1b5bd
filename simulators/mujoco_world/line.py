"""Motion that the conveyor's drive is asked for, tabulated over a run.

Invariants:
    Ramps are S-shaped: the speed of straight ramps, averaged over the time of the rounding.
    Chain and drive vary the speed in proportion to it, so that a conveyor at rest stands still.
"""

import math
from dataclasses import dataclass

import numpy as np

from linemate.simulators.mujoco_world.frame_poses import Array
from linemate.simulators.mujoco_world.mujoco_cell import DrivenRamp, Line, RunOrder, known

WANDER_HZ = (0.07, 0.19, 0.43)
"""Frequencies of the slow variation of the speed."""


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """Position [m], speed [m/s] and acceleration [m/s^2] at each time step, (n,) each."""

    position: Array
    speed: Array
    acceleration: Array


def profile(line: Line, order: RunOrder, step_s: float, count: int) -> Profile:
    """Tabulate a run from its start on; the position is 0 at scenario time 0 without variation.

    Args:
        step_s: time step of the simulation [s].
    """
    nominal = order.nominal_speed * known(line.speed_share)
    times: Array = step_s * np.arange(count, dtype=np.float64) - order.lead_in_s
    speed = _straight(times, nominal, order.ramps, known(line.ramp_share))
    width = max(1, round(known(line.rounding_s) / step_s))
    padded = np.concatenate((np.full(width - 1, speed[0]), speed))
    speed = np.convolve(padded, np.full(width, 1.0 / width), mode="valid")
    travelled = np.concatenate(((0.0,), np.cumsum(0.5 * (speed[1:] + speed[:-1]) * step_s)))
    generator = np.random.default_rng((order.seed, 0x11E))
    turn = math.tau * line.chain_hz / nominal
    variation = line.chain_amplitude * np.cos(turn * travelled + generator.uniform(0, math.tau))
    for hz in WANDER_HZ:
        phase = generator.uniform(0, math.tau)
        variation += line.wander * math.sqrt(2 / 3) * np.sin(math.tau * hz * times + phase)
    speed = speed * (1.0 + variation / nominal)
    moved = np.concatenate(((0.0,), np.cumsum(0.5 * (speed[1:] + speed[:-1]) * step_s)))
    return Profile(moved - nominal * order.lead_in_s, speed, np.gradient(speed, step_s))


def _straight(times: Array, nominal: float, ramps: tuple[DrivenRamp, ...], share: float) -> Array:
    speed = np.full(len(times), nominal)
    for ramp in sorted(ramps, key=lambda r: r.onset_s):
        after = times >= ramp.onset_s
        if not after.any():
            continue
        begin = float(speed[int(np.argmax(after))])
        change = share * ramp.acceleration * (times[after] - ramp.onset_s)
        goal = nominal if ramp.starts else 0.0
        speed[after] = (
            np.minimum(begin + change, goal) if ramp.starts else np.maximum(begin - change, goal)
        )
    return speed
