"""Faults of a sensor's reading: frozen, wrong unit, drift, NaN, wrong clock.

Invariants:
    Pure: a reading and a time in, a reading out.
    Faults act before the checksum, so the frame is well-formed.
    Each fault has its own random stream, as in ``faulty_link``.
"""

import math
import random
from collections import Counter

from linemate.simulators.devices.faults import Faults, holds
from linemate.simulators.devices.faulty_link import stream
from linemate.simulators.plants.scenario import Fault

KINDS = frozenset({"stuck", "scale", "offset", "drift", "nan", "frame", "flipped"})
CLOCK_KINDS = frozenset({"clock_step", "clock_rate", "clock_frozen"})

ODD = (float("nan"), float("inf"), float("-inf"), 3e38, -3e38, 5e-324, -0.0)
"""What is no measurement but fits a float field, of 32 bits too."""


class FaultySensor:
    """What becomes of one sensor's readings.

    Attributes:
        suffered: readings that a fault touched, by kind.
        is_sound: no fault ever touches it.
    """

    def __init__(self, link: str, faults: Faults, seed: int) -> None:
        """Take the sensor's own faults from a scenario's."""
        self.suffered: Counter[str] = Counter()
        mine = faults.of(link)
        self._faults = [(fault, stream(seed, fault)) for fault in mine if fault.kind in KINDS]
        self._clocks = [fault for fault in mine if fault.kind in CLOCK_KINDS]
        self.is_sound = not self._faults and not self._clocks
        self._stuck: dict[float, tuple[float, ...]] = {}

    def reading(
        self, values: tuple[float, ...], time_s: float, additive: int | None = None
    ) -> tuple[float, ...]:
        """What the sensor says instead of a reading.

        Args:
            additive: how many leading values can be scaled and offset, None: all. A quaternion
                behind a position cannot.

        Returns:
            As many values.
        """
        for fault, chance in self._faults:
            if holds(fault, time_s):
                values = self._suffer(fault, chance, values, time_s, additive or len(values))
        return values

    def clock(self, time_s: float) -> float:
        """What the sensor's clock shows at a scenario time [s]."""
        if not self._clocks:
            return time_s
        shown_s = time_s
        for fault in self._clocks:
            if holds(fault, time_s):
                self.suffered[fault.kind] += 1
                if fault.kind == "clock_step":
                    shown_s += fault.value
                elif fault.kind == "clock_rate":
                    shown_s += fault.value * (time_s - fault.at_s)
                else:
                    shown_s = fault.at_s
        return shown_s

    def _suffer(
        self,
        fault: Fault,
        chance: random.Random,
        values: tuple[float, ...],
        time_s: float,
        additive: int,
    ) -> tuple[float, ...]:
        if fault.kind == "nan":
            if chance.random() >= fault.value:
                return values
            self.suffered[fault.kind] += 1
            place = chance.randrange(len(values))
            return (*values[:place], chance.choice(ODD), *values[place + 1 :])
        self.suffered[fault.kind] += 1
        if fault.kind == "stuck":
            return self._stuck.setdefault(fault.at_s, values)
        if fault.kind in {"frame", "flipped"}:
            return _other_pose(fault.kind, values)
        scaled = fault.value if fault.kind == "scale" else 1.0
        added = {"offset": fault.value, "drift": fault.value * (time_s - fault.at_s)}.get(
            fault.kind, 0.0
        )
        changed = [
            value * scaled + (added if fault.count in {0, i} else 0.0)
            for i, value in enumerate(values[:additive], 1)
        ]
        return (*changed, *values[additive:])


def _other_pose(kind: str, values: tuple[float, ...]) -> tuple[float, ...]:
    """Return a pose x y z, w x y z as a camera with a wrong convention gives it."""
    x, y, z, qw, qx, qy, qz = values
    if kind == "flipped":
        return (x, y, z, qw, -qx, -qy, -qz)
    half = math.sqrt(0.5)  # a quarter turn about z: half * (1, 0, 0, 1) times the quaternion
    turned = (half * (qw - qz), half * (qx - qy), half * (qy + qx), half * (qz + qw))
    return (-y, x, z, *turned)
