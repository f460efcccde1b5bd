"""Rows of the catalogue in docs/reliability.md, drawn for a plan: X1 to X19, and R9.

A row gives faults with the figures that the catalogue names, at a time that matters for it.
"""

import random
from collections.abc import Callable
from typing import Any

from linemate.simulators.plants.conveyor_plan import Conveyor, ConveyorEvent
from linemate.simulators.plants.scenario import Fault

Changes = dict[str, Any]
"""Fields of the plan that a row sets, ``faults`` among them."""

TOUCH_S = 1.1
"""About when the tool touches in a run without trouble, scenario time [s]."""
FROM_S, UNTIL_S = 0.3, 2.1
"""Interval in which the robot is led [s]."""
BEGIN_S = -1.4
FIVE_S = 5.0
JITTERS_S = (0.001, 0.003, 0.006, 0.012)
OFFSETS_M = (0.002, 0.005, 0.010)
DRIFTING = 0.3
"""Share of the controllers of another cycle whose cycle drifts while the robot moves."""


def _when(chance: random.Random, first_s: float = FROM_S, last_s: float = UNTIL_S) -> float:
    return round(chance.uniform(first_s, last_s), 3)


def _one_fault(*args: Any) -> Changes:
    return {"faults": (Fault(*args),)}


def _x1(chance: random.Random, cycle_s: float) -> Changes:
    cycles = chance.choice((8, 60, 1_000_000, 0, round(FIVE_S / cycle_s)))
    return _one_fault(_when(chance), "robot", "ipoc_jump", 0.0, float(cycles))


def _x2(chance: random.Random, _: float) -> Changes:
    return _one_fault(
        _when(chance), "daemon", "pause", chance.choice((0.05, 0.36, 0.72, 1.08, 2.0))
    )


def _x3(chance: random.Random, _: float) -> Changes:
    return _one_fault(_when(chance), "robot", "readdress", 0.0, float(chance.randint(0, 1)))


def _x4(chance: random.Random, cycle_s: float) -> Changes:
    ahead = float(chance.choice((50, 1000, 1_000_000)))
    lasting_s = round(cycle_s * chance.choice((0.5, 3.0)), 4)
    return _one_fault(_when(chance), "robot", "forged", lasting_s, ahead, 3)


def _x5(chance: random.Random, _: float) -> Changes:
    return _one_fault(_when(chance), "daemon", "crash", chance.choice((0.05, 0.1, 0.4, 2.4)))


def _x6(chance: random.Random, _: float) -> Changes:
    return _one_fault(_when(chance), "reply", "loss", 1.0, chance.choice((0.05, 0.1, 0.2)))


def _x7(chance: random.Random, _: float) -> Changes:
    at_s, lasting_s = chance.choice(((_when(chance), 1.0), (BEGIN_S, 3.6)))
    return _one_fault(at_s, "robot", "jitter", lasting_s, chance.choice(JITTERS_S))


def _x8(chance: random.Random, _: float) -> Changes:
    link = chance.choice(("robot", "reply"))
    lasting_s = round(chance.uniform(0.02, 0.14), 3)
    changes = _one_fault(_when(chance, TOUCH_S - 0.1), link, "silence", lasting_s)
    return changes | _line(chance)


def _x9(chance: random.Random, _: float) -> Changes:
    at_s = _when(chance, TOUCH_S - 0.1)
    fault = chance.choice(
        (
            Fault(at_s, "operator", "stop"),
            Fault(at_s, "operator", "retreat"),
            Fault(at_s, "force_torque", "silence", 0.4),
            Fault(at_s, "force_torque", "stuck", 0.5),
            Fault(at_s, "distance", "silence", 0.4),
            Fault(at_s, "force_torque", "offset", 0.3, 500.0, 1),
        )
    )
    return {"faults": (fault,)}


def _line(chance: random.Random) -> Changes:
    """A stop and a start 0.2 to 1 s later, around contact."""
    stop_s = _when(chance, 0.7, 1.8)
    stop = ConveyorEvent("stop", stop_s, Conveyor().events[0].acceleration)
    start_s = round(stop_s + chance.uniform(0.2, 1.0), 3)
    start = ConveyorEvent("start", start_s, Conveyor().events[1].acceleration)
    return {"events": chance.choice(((), (stop,), (stop, start)))}


def _x10(chance: random.Random, _: float) -> Changes:
    changes: Changes = {"events": ()}
    while len(changes["events"]) < 2:
        changes = _line(chance)
    return {"faults": (), **changes}


def _x11(chance: random.Random, cycle_s: float) -> Changes:
    changes = _x10(chance, cycle_s)
    stop, start = changes["events"]
    return {"faults": (), "events": (stop, ConveyorEvent("start", start.onset_s, 5e-4))}


def _x12(chance: random.Random, _: float) -> Changes:
    lasting_s = round(chance.uniform(0.3, 2.0), 3)
    at_s = round(TOUCH_S - 0.1 - chance.uniform(0.0, lasting_s), 3)
    kind, value, count = chance.choice(
        (
            ("silence", 0.0, 1),
            ("silence", 0.0, 1),
            ("frame", 0.0, 1),
            ("flipped", 0.0, 1),
            ("offset", 0.03, chance.randint(1, 3)),
            ("offset", -0.03, chance.randint(1, 3)),
            ("clock_step", 0.02, 1),
            ("clock_step", -0.02, 1),
        )
    )
    return _one_fault(max(at_s, BEGIN_S), "camera", kind, lasting_s, value, count)


def _x13(chance: random.Random, _: float) -> Changes:
    kind, value = chance.choice(
        (
            ("offset", 0.03),
            ("offset", -0.03),
            ("delay", 0.02),
            ("stuck", 0.0),
            ("silence", 0.0),
            ("both", 0.0),
        )
    )
    at_s, lasting_s = _when(chance), round(chance.uniform(0.3, 1.0), 3)
    if kind == "both":
        silent = (Fault(at_s, link, "silence", lasting_s) for link in ("camera", "distance"))
        return {"faults": tuple(silent)}
    return _one_fault(at_s, "distance", kind, lasting_s, value)


def _x14(chance: random.Random, _: float) -> Changes:
    kind, value, count = chance.choice(
        (
            ("offset", 20.0, chance.randint(1, 3)),
            ("offset", 500.0, chance.randint(1, 3)),
            ("scale", -1.0, 1),
            ("flip", 0.3, 2),
            ("flip", 1.0, 2),
            ("flip", 1.0, 8),
            ("stuck", 0.0, 1),
            ("clock_frozen", 0.0, 1),
            ("silence", 0.0, 1),
        )
    )
    lasting_s = round(chance.uniform(0.3, 1.0), 3)
    return _one_fault(_when(chance, 0.9), "force_torque", kind, lasting_s, value, count)


def _x15(chance: random.Random, _: float) -> Changes:
    off = chance.choice(OFFSETS_M) * chance.choice((1.0, -1.0))
    return _one_fault(BEGIN_S, "camera", "offset", 4.0, off, 3)


def _x16(chance: random.Random, _: float) -> Changes:
    if chance.random() < DRIFTING:
        return {"faults": (), "cycle_drift": chance.choice((0.002, 0.01, -0.002, -0.01))}
    off = chance.choice((0.02, 0.04, 0.06, 0.07, 0.08, 0.1)) * chance.choice((1.0, -1.0))
    return {"faults": (), "cycle_off": off}


def _x17(chance: random.Random, _: float) -> Changes:
    kind, value = chance.choice(
        (("exponent", 1.0), ("exponent", 0.3), ("unreadable", 0.05), ("unreadable", 1.0))
    )
    lasting_s = 3.6 if kind == "exponent" else round(chance.uniform(0.1, 1.0), 3)
    return _one_fault(
        BEGIN_S if kind == "exponent" else _when(chance), "robot", kind, lasting_s, value
    )


def _x19(chance: random.Random, _: float) -> Changes:
    count = chance.randint(1, 4)
    orders = tuple(
        Fault(_when(chance), "operator", chance.choice(("set", "set", "stop", "arm")), 0.0, 0.0, n)
        for n in range(count)
    )
    return {"faults": tuple(sorted(orders, key=lambda f: f.at_s)), "operators": 2}


def _r9(chance: random.Random, _: float) -> Changes:
    return _one_fault(_when(chance), "robot", "drives_off", round(chance.uniform(0.3, 1.0), 3))


ROWS: dict[str, Callable[[random.Random, float], Changes]] = {
    "R9": _r9,
    "X1": _x1,
    "X2": _x2,
    "X3": _x3,
    "X4": _x4,
    "X5": _x5,
    "X6": _x6,
    "X7": _x7,
    "X8": _x8,
    "X9": _x9,
    "X10": _x10,
    "X11": _x11,
    "X12": _x12,
    "X13": _x13,
    "X14": _x14,
    "X15": _x15,
    "X16": _x16,
    "X17": _x17,
    "X19": _x19,
}
"""X18 is a matter of ``--check``, X20 of recordings: neither is a fault of a run."""


OFTEN = {"R9": 2, "X9": 3, "X12": 2, "X13": 2, "X14": 3}
"""Rows of many kinds are drawn so many times as often as the others."""


def draw(chance: random.Random, cycle_s: float) -> tuple[str, Changes]:
    """Draw one row, and what it sets in a plan."""
    (name,) = chance.choices(tuple(ROWS), [OFTEN.get(name, 1) for name in ROWS])
    return name, ROWS[name](chance, cycle_s)
