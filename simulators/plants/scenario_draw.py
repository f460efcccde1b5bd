"""Draw the values that a scenario leaves open.

Invariants:
    One named random stream a value.
"""

import math
from dataclasses import replace

from linemate.simulators.plants.forces.switches import CarrierMode
from linemate.simulators.plants.scenario import Body, Contact, Effector, Scenario, Swing
from linemate.simulators.plants.streams import stream


def sample(seed: int, scenario: Scenario | None = None) -> Scenario:
    """Draw what the scenario leaves open (None), each value from its own stream.

    Args:
        seed: of the run; it replaces the scenario's.
        scenario: what is given; the default is the study's.

    Returns:
        A scenario without open values. Sampling it again with the same seed changes nothing.
    """
    scenario = replace(scenario or Scenario(), seed=seed)
    ripple = scenario.conveyor.ripple
    if ripple.phase is None:
        ripple = replace(ripple, phase=float(stream(seed, "ripple.phase").uniform(0, math.tau)))
    conveyor = replace(scenario.conveyor, ripple=ripple)
    effector = _sample_effector(seed, scenario.effector)
    body = _sample_body(seed, scenario.body)
    contact = _sample_contact(seed, scenario.contact)
    return replace(scenario, conveyor=conveyor, body=body, effector=effector, contact=contact)


def _sample_contact(seed: int, contact: Contact) -> Contact:
    mating = contact.mating
    if mating.angle is not None:
        return contact
    share = float(stream(seed, "mating.angle").uniform(-1, 1))
    return replace(contact, mating=replace(mating, angle=share * mating.angle_range))


def _sample_effector(seed: int, effector: Effector) -> Effector:
    load = effector.load
    mass = _spread(seed, "load.wheel_mass", load.wheel_mass, load.wheel_mass_spread)
    return replace(effector, load=replace(load, wheel_mass=mass, wheel_mass_spread=0.0))


def _sample_body(seed: int, body: Body) -> Body:
    if body.offset is None:
        x, y, z = stream(seed, "body.offset").uniform(-1, 1, 3).tolist()
        range_x, range_y, range_z = body.offset_range
        body = replace(body, offset=(x * range_x, y * range_y, z * range_z))
    if body.rotation is None:
        # Mostly a turn about z and y; about x it would be a body that hangs askew.
        axis = stream(seed, "body.rotation").standard_normal(3) * (0.3, 1.0, 1.0)
        x, y, z = (axis * (body.tilt / math.sqrt(float(axis @ axis)))).tolist()
        body = replace(body, rotation=(x, y, z))
    swings = tuple(_sample_swing(seed, i, swing) for i, swing in enumerate(body.swings))
    carrier = tuple(_sample_mode(seed, i, mode) for i, mode in enumerate(body.carrier))
    return replace(body, swings=swings, carrier=carrier)


def _sample_swing(seed: int, index: int, swing: Swing) -> Swing:
    if swing.amplitude is None:
        share = float(stream(seed, f"swing.{index}.amplitude").uniform(0.5, 1.0))
        swing = replace(swing, amplitude=share * swing.amplitude_max)
    if swing.phase is None:
        phase = float(stream(seed, f"swing.{index}.phase").uniform(0, math.tau))
        swing = replace(swing, phase=phase)
    return swing


def _sample_mode(seed: int, index: int, mode: CarrierMode) -> CarrierMode:
    return replace(
        mode,
        frequency_hz=_spread(
            seed, f"carrier.{index}.frequency", mode.frequency_hz, mode.frequency_spread
        ),
        mass=_spread(seed, f"carrier.{index}.mass", mode.mass, mode.mass_spread),
        frequency_spread=0.0,
        mass_spread=0.0,
    )


def _spread(seed: int, name: str, value: float, share: float) -> float:
    return value * (1.0 + share * float(stream(seed, name).uniform(-1, 1))) if share else value
