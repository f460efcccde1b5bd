"""Conveyor of a run: speed, ordered stops and starts, and which of them take place.

Invariants:
    Frozen dataclasses in SI (m, s).
"""

import math
from dataclasses import dataclass, field
from typing import Literal

from linemate.simulators.plants.effects.conveyor_effects import ConveyorEffects, Order, ShapedRamps


@dataclass(frozen=True, slots=True)
class ConveyorEvent:
    """An order to the conveyor's drive.

    Attributes:
        kind: what the conveyor does, "stop" or "start".
        onset_s: scenario time at which the speed begins to change [s].
        acceleration: magnitude of the deceleration or acceleration [m/s^2].
    """

    kind: Literal["stop", "start"]
    onset_s: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class Ripple:
    """Irregularity of the running conveyor; it fades with the speed.

    Attributes:
        speed_sigma: standard deviation of the Ornstein-Uhlenbeck speed [m/s].
        correlation_s: its correlation time [s].
        amplitude: amplitude of the periodic part [m].
        frequency_hz: frequency of the periodic part.
        phase: phase of the periodic part at t = 0 [rad]; None draws it.
    """

    speed_sigma: float = 0.3e-3
    correlation_s: float = 1.0
    amplitude: float = 0.1e-3
    frequency_hz: float = 1.2
    phase: float | None = None


@dataclass(frozen=True, slots=True)
class StopSignal:
    """The signal with which the line's controller announces a stop; it may be wrong.

    A controller of a cycle of 10 to 50 ms sends it; what drive and brake need comes on top.

    Attributes:
        bit: of the robot controller's inputs; None for a line without the signal.
        lead_s: time from the signal to the onset of the stop, negative for a late one [s].
        false_s: scenario times at which it rises without a stop, for 0.5 s [s].
        stuck: it is always set.
        silent: it does not announce the stops that take place.
    """

    bit: int | None = None
    lead_s: float = 0.0
    false_s: tuple[float, ...] = ()
    stuck: bool = False
    silent: bool = False


@dataclass(frozen=True, slots=True)
class Conveyor:
    """The conveyor unit: nominal speed [m/s], stops and starts, ripple, announced stops."""

    nominal_speed: float = 0.106
    events: tuple[ConveyorEvent, ...] = (
        ConveyorEvent("stop", 5.0, 0.104),
        ConveyorEvent("start", 9.0, 0.013),
    )
    ripple: Ripple = field(default_factory=Ripple)
    effects: ConveyorEffects = field(default_factory=ConveyorEffects)
    stop_signal: StopSignal = field(default_factory=StopSignal)


@dataclass(frozen=True, slots=True)
class AppliedEvent:
    """A stop or start that really changed the motion, for judging.

    Attributes:
        kind: what the conveyor does, "stop" or "start".
        onset_s: scenario time of the onset [s].
        speed: speed of the drive at the onset, without ripple [m/s].
        acceleration: signed acceleration of the conveyor [m/s^2].
        settled_s: when the new speed was (or would have been) reached [s].
    """

    kind: Literal["stop", "start"]
    onset_s: float
    speed: float
    acceleration: float
    settled_s: float


def applied_events(conveyor: Conveyor) -> tuple[AppliedEvent, ...]:
    """Walk through the orders: an order for what is already going on changes nothing.

    Args:
        conveyor: nominal speed and orders; the unit runs before the first order.

    Returns:
        What took place, in order of time, each with the speed at its onset.
    """
    if conveyor.effects.shapes_ramps:
        return shaped_ramps(conveyor)[1]
    running, speed, acceleration, since = True, conveyor.nominal_speed, 0.0, -math.inf
    applied: list[AppliedEvent] = []
    for event in sorted(conveyor.events, key=lambda e: e.onset_s):
        if (event.kind == "start") == running:
            continue
        if applied:
            speed = _clamped_speed(conveyor, speed, acceleration, event.onset_s - since)
        running, since = event.kind == "start", event.onset_s
        acceleration = event.acceleration if running else -event.acceleration
        goal = conveyor.nominal_speed if running else 0.0
        settled = since + (goal - speed) / acceleration
        applied.append(AppliedEvent(event.kind, since, speed, acceleration, settled))
    return tuple(applied)


def shaped_ramps(conveyor: Conveyor) -> tuple[ShapedRamps, tuple[AppliedEvent, ...]]:
    """Return the drive's motion of a conveyor whose ramps are shaped, and what took place."""
    orders: list[Order] = []
    running = True
    for event in sorted(conveyor.events, key=lambda e: e.onset_s):
        if (event.kind == "start") != running:
            running = not running
            orders.append(Order(running, event.onset_s, event.acceleration))
    ramps = ShapedRamps(conveyor.nominal_speed, orders, conveyor.effects)
    applied = tuple(
        AppliedEvent(
            "start" if order.starts else "stop",
            order.onset_s,
            speed,
            order.acceleration if order.starts else -order.acceleration,
            settled,
        )
        for order, speed, settled in zip(orders, ramps.speeds, ramps.settled, strict=True)
    )
    return ramps, applied


def _clamped_speed(conveyor: Conveyor, speed: float, acceleration: float, age: float) -> float:
    return min(max(speed + acceleration * age, 0.0), conveyor.nominal_speed)
