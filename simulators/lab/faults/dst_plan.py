"""What one simulated run is put through, drawn from its seed.

Invariants:
- A seed gives one plan. A plan is plain values, one line of JSON: a plan that failed is kept as it
  is, whatever is drawn differently later. A field that a line lacks has its default.
- A quarter of the seeds has no faults and a quarter one mild fault. A quarter has one to six
  faults, or loses its links one by one and gets them back in another order. A quarter has a row of
  the second catalogue.

The rows of docs/fault-catalogue.md.
"""

import json
import random
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from linemate.simulators.devices.faults import KINDS
from linemate.simulators.lab.faults import dst_plan_rows
from linemate.simulators.lab.world import drawn_line
from linemate.simulators.plants.conveyor_plan import Conveyor, ConveyorEvent
from linemate.simulators.plants.scenario import Fault

CycleMs = Literal[4, 8, 12]
"""The controller's cycles: KUKA has 4 and 12, FANUC 8, ABB multiples of 4."""

SHORTEST_S, LONGEST_S = 1.4, 2.1
"""Scenario time at which a run may end [s]; the lead-in of 0.6 s comes before, and whatever an
operator needs to track again after it."""

MILD_SHARE = (0.5, 1.0)
"""Until when a link that is a little worse stays so, of a run."""

FIRST_S = -0.4
"""When trouble begins at the earliest, in scenario time; the daemon is hardly ready then [s]."""

BLIP_S, OUTAGE_S = 0.012, 0.6
"""Shortest and longest fault that lasts [s]."""

EARLIEST_STOP_S = 0.6
"""A conveyor that stops before the estimate of its speed has settled is no fault of a link [s]."""

START_UP_S = 0.05
"""A daemon that has crashed is not there again sooner [s]."""

MOST_DRIFT = 0.03
"""Largest share by which a drifting cycle comes to differ from the configured one."""

MOST_LEAD_MS = 5.0
"""That may be configured."""

SENSORS = ("distance", "camera", "force_torque")

_SHARE = (0.01, 0.6)
RANGES: dict[str, tuple[float, float]] = {
    "loss": _SHARE,
    "duplicate": _SHARE,
    "reorder": _SHARE,
    "flip": _SHARE,
    "truncate": _SHARE,
    "ipoc_flip": (0.01, 0.2),
    "nan": _SHARE,
    "delay": (0.001, 0.3),
    "jitter": (0.001, 0.05),
    "scale": (1e-3, 1e3),
    "offset": (1e-3, 0.2),
    "drift": (1e-3, 0.5),
    "clock_step": (0.01, 3600.0),
    "clock_rate": (1e-3, 0.5),
    "wall_step": (1e-3, 3600.0),
    "garbage": (1.0, 1472.0),
    "ipoc_jump": (1.0, 1e6),
    "forged": (4.0, 1e6),
    "unreadable": _SHARE,
    "exponent": _SHARE,
}
"""Least and greatest ``value`` of a kind; drawn evenly on a logarithmic scale."""

SIGNED = frozenset({"scale", "offset", "drift", "clock_step", "clock_rate", "wall_step"})
NEWTONS_PER_METRE = 5e3
"""An offset of the force-torque sensor is that much greater than one of a length."""

CATALOGUE = 3
"""Of four seeds the one that draws a row of the second catalogue, and nothing else."""
OTHER_CELLS = 0.15
CELLS = ("second-layout", "six-axes", "ft300", "tf03", "no-force")
FAMILY_CYCLES_MS: dict[str, CycleMs] = {"fanuc": 8, "egm": 4}
"""Cells of the other families of controllers, and their cycles: drawn only if asked for, so that
no seed of the others changes."""
OTHER_LINE = "other-line"
"""Cell whose line stops and starts otherwise than its task file states; drawn only if asked for."""
MEANINGLESS: dict[str, frozenset[str]] = {
    "fanuc": frozenset({"ipoc_flip", "unreadable", "exponent", "forged", "readdress"}),
    "egm": frozenset({"ipoc_flip", "unreadable", "exponent", "forged"}),
}
"""Kinds of faults that a family has not. The first four are changes to RSI's text; ``flip`` strikes
the bytes of the others, counters included. A FANUC controller answers whom it was asked by, and is
asked at one address."""
OVER_PROTOCOL = 0.2
"""Shares of the plans with another cell, and with orders over the command protocol."""

WEIGHTS = {
    "robot": 5,
    "reply": 4,
    "distance": 3,
    "camera": 3,
    "force_torque": 3,
    "daemon": 2,
    "operator": 2,
}


@dataclass(frozen=True, slots=True)
class FaultPlan:
    """One run.

    Attributes:
        seed: of the plant, of the faults' own chances and of this plan.
        duration_s: scenario time that it lasts at least [s].
        lead_ms: how long before its telegram a step is prepared, 0: never [ms].
        rule: how the controller counts faulty cycles.
        eager: the operator acts at once, and not only when the trouble is over.
        cycle_ms: of the controller, as configured [ms].
        row: of the second catalogue that the trouble is, empty if it is none.
        cycle_off: by what share of the configured cycle the controller's own is longer.
        cycle_drift: by what share it grows longer each second, up to ``MOST_DRIFT`` [1/s].
        operators: who give orders over the command protocol; 0: orders reach the daemon directly.
    """

    seed: int
    duration_s: float = SHORTEST_S
    lead_ms: float = 0.0
    rule: str = "total"
    eager: bool = False
    events: tuple[ConveyorEvent, ...] = ()
    faults: tuple[Fault, ...] = ()
    cycle_ms: CycleMs = 12
    row: str = ""
    cell: str = ""
    cycle_off: float = 0.0
    cycle_drift: float = 0.0
    operators: int = 0

    @property
    def cycle_s(self) -> float:
        """Of the controller, as configured [s]."""
        return round(1e-3 * self.cycle_ms, 6)

    @property
    def real_cycle_s(self) -> float:
        """Of the controller, as it is [s]."""
        return round(1e-3 * self.cycle_ms * (1.0 + self.cycle_off), 9)

    @property
    def quiet_s(self) -> float:
        """Scenario time after which nothing troubles any more [s]; -inf without faults."""
        return max((end_of(fault) for fault in self.faults), default=float("-inf"))

    def to_line(self) -> str:
        """One line of JSON."""
        plain: dict[str, Any] = asdict(self)
        return json.dumps(plain, separators=(",", ":"))


def from_line(line: str) -> FaultPlan:
    """Read what ``FaultPlan.to_line`` wrote.

    Raises:
        ValueError, TypeError, KeyError: it is no plan.
    """
    plain = json.loads(line)
    plain["events"] = tuple(ConveyorEvent(**event) for event in plain["events"])
    plain["faults"] = tuple(Fault(**fault) for fault in plain["faults"])
    return FaultPlan(**plain)


def draw(seed: int, cycle_ms: CycleMs | None = None, cell: str | None = None) -> FaultPlan:
    """The plan of a seed; the same trouble for any cycle and family of controllers.

    Args:
        cycle_ms: None: 12, or the cell's own.
        cell: one of ``CELLS``, ``OTHER_LINE`` or ``FAMILY_CYCLES_MS``; None draws among ``CELLS``.
    """
    if cell is not None:
        plan = _draw(seed, cycle_ms or FAMILY_CYCLES_MS.get(cell, 12))
        meaningless = MEANINGLESS.get(cell, frozenset())
        faults = tuple(f for f in plan.faults if f.kind not in meaningless)
        if cell == OTHER_LINE:
            plan = replace(plan, events=_other_events(seed, plan.duration_s))
        return replace(plan, cell=cell, faults=faults)
    return _draw(seed, cycle_ms or 12)


def _draw(seed: int, cycle_ms: CycleMs) -> FaultPlan:
    chance = random.Random(f"{seed}/plan")  # noqa: S311 - noise, not a secret
    duration_s = round(chance.uniform(SHORTEST_S, LONGEST_S), 3)
    plan = FaultPlan(
        seed=seed,
        duration_s=duration_s,
        lead_ms=chance.choice((0.0, cycle_ms / 4, min(0.75 * cycle_ms, MOST_LEAD_MS))),
        rule=chance.choice(("total", "row")),
        eager=chance.random() < 0.5,
        events=_events(chance, duration_s),
        cycle_ms=cycle_ms,
    )
    plan = replace(plan, faults=_trouble(seed % 4, chance, duration_s))
    if seed % 4 == CATALOGUE:
        name, changes = dst_plan_rows.draw(chance, plan.cycle_s)
        plan = replace(plan, row=name, **changes)
    if chance.random() < OTHER_CELLS:
        plan = replace(plan, cell=chance.choice(CELLS))
    return replace(plan, operators=plan.operators or int(chance.random() < OVER_PROTOCOL))


def _events(chance: random.Random, duration_s: float) -> tuple[ConveyorEvent, ...]:
    if chance.random() < 0.4:
        return ()
    stop_s = round(chance.uniform(EARLIEST_STOP_S, duration_s), 3)
    stop = ConveyorEvent("stop", stop_s, Conveyor().events[0].acceleration)
    if chance.random() < 0.5:
        return (stop,)
    start_s = round(stop_s + chance.uniform(0.3, 1.5), 3)
    return (stop, ConveyorEvent("start", start_s, Conveyor().events[1].acceleration))


def _other_events(seed: int, duration_s: float) -> tuple[ConveyorEvent, ...]:
    """Draw one or two stops, and the starts after them."""
    chance = random.Random(f"{seed}/line")  # noqa: S311 - noise, not a secret
    events, at_s = [], chance.uniform(EARLIEST_STOP_S, duration_s)
    for _ in range(chance.choice((1, 2))):
        stop, start = drawn_line.LINES[drawn_line.NAME].accelerations(chance)
        start_s = at_s + chance.uniform(0.2, 1.5)
        events.append(ConveyorEvent("stop", round(at_s, 3), round(stop, 3)))
        events.append(ConveyorEvent("start", round(start_s, 3), round(start, 3)))
        at_s = start_s + chance.uniform(0.2, 1.5)
    return tuple(events)


def _trouble(density: int, chance: random.Random, duration_s: float) -> tuple[Fault, ...]:
    if density == 0:
        return ()
    if density == 1:
        return (_mild(chance, duration_s),)
    if chance.random() < 0.25:
        return _swizzle(chance, duration_s)
    links = chance.choices(tuple(WEIGHTS), tuple(WEIGHTS.values()), k=chance.randint(1, 6))
    return _in_time(_fault(link, chance, duration_s) for link in links)


def _mild(chance: random.Random, duration_s: float) -> Fault:
    """A link that is a little worse than it should be, most of the time."""
    link = chance.choice(("robot", "reply", *SENSORS))
    kinds = [k for k in ("loss", "duplicate", "reorder", "jitter") if k in KINDS[link]]
    kind = chance.choice(kinds)
    value = chance.uniform(2e-4, 2e-3) if kind == "jitter" else chance.uniform(0.002, 0.05)
    lasting_s = duration_s * chance.uniform(*MILD_SHARE) - FIRST_S
    return Fault(FIRST_S, link, kind, round(lasting_s, 3), round(value, 6))


def _swizzle(chance: random.Random, duration_s: float) -> tuple[Fault, ...]:
    """Links go one by one and come back in another order."""
    links = [*SENSORS, "robot", "reply"]
    chance.shuffle(links)
    links = links[: chance.randint(2, len(links))]
    offs = sorted(chance.uniform(FIRST_S, duration_s) for _ in links)
    ons = [offs[-1] + chance.uniform(BLIP_S, OUTAGE_S) for _ in links]
    return _in_time(
        Fault(round(off, 3), link, "silence", round(on - off, 3))
        for link, off, on in zip(links, offs, ons, strict=True)
    )


def _fault(link: str, chance: random.Random, duration_s: float) -> Fault:
    kind = chance.choice(KINDS[link])
    at_s = round(chance.uniform(FIRST_S, duration_s), 3)
    shortest_s = START_UP_S if kind == "crash" else BLIP_S
    lasting = round(shortest_s * (OUTAGE_S / shortest_s) ** chance.random(), 3)
    value = 0.0
    if kind in RANGES:
        low, high = RANGES[kind]
        value = low * (high / low) ** chance.random()
        if kind in {"offset", "drift"} and link == "force_torque":
            value *= NEWTONS_PER_METRE
        if kind in SIGNED and chance.random() < 0.5:
            value = -value
    count = chance.randint(0, 3) if kind in {"offset", "drift"} else chance.randint(1, 8)
    return Fault(at_s, link, kind, lasting, float(f"{value:.4g}"), count)


def _in_time(faults: Any) -> tuple[Fault, ...]:
    return tuple(sorted(faults, key=lambda fault: (fault.at_s, fault.link, fault.kind)))


def end_of(fault: Fault) -> float:
    """Return when the last piece that a fault touched has arrived [s]."""
    late_s = {"delay": 1.0, "jitter": 8.0}.get(fault.kind, 0.0) * fault.value
    return fault.at_s + fault.duration_s + late_s
