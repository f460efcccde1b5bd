"""Each effect of the conveyor alone against its closed form, and all of them absent by default."""

import math

import numpy as np
import pytest

from linemate.simulators.plants.conveyor_plan import Conveyor, ConveyorEvent, Ripple, applied_events
from linemate.simulators.plants.conveyor_plant import ConveyorPlant
from linemate.simulators.plants.effects.conveyor_effects import (
    REST_SPEED,
    ConveyorEffects,
    off_line,
)
from linemate.simulators.plants.scenario import Scenario
from linemate.simulators.plants.world import World

SMOOTH = Ripple(speed_sigma=0.0, amplitude=0.0, phase=0.0)
V, A, B = 0.106, 0.104, 0.013
EVENTS = (ConveyorEvent("stop", 5.0, A), ConveyorEvent("start", 9.0, B))
TIMES = np.arange(-1.5, 18.0, 0.0137)


def conveyor(*events: ConveyorEvent, **effects: object) -> Conveyor:
    shaped = ConveyorEffects(**effects)  # type: ignore[arg-type]
    return Conveyor(V, events or EVENTS, SMOOTH, shaped)


def plant(*events: ConveyorEvent, **effects: object) -> ConveyorPlant:
    return ConveyorPlant(conveyor(*events, **effects), 0, -2.0)


def slope(unit: ConveyorPlant, t: float) -> float:
    return (unit.at(t + 1e-6)[0] - unit.at(t - 1e-6)[0]) / 2e-6


def test_without_effects_the_drive_is_the_unit_without_ripple() -> None:
    unit = plant()
    position, speed, acceleration = unit.drive(TIMES)
    assert np.array_equal(position, unit.positions(TIMES))
    assert set(acceleration.tolist()) == {0.0, -A, B}
    assert np.array_equal(speed, unit.motion(TIMES)[1])


def test_an_s_shaped_stop_has_its_jerk_its_length_and_its_distance() -> None:
    rise = 0.2
    unit = plant(ramp_s=rise)
    assert unit.at(0.0)[0] == pytest.approx(0.0, abs=1e-12)
    # Half of the rise after the onset the deceleration is half of its value.
    _, speed, acceleration = unit.drive(np.array([5.0, 5.1, 5.2, 5.5]))
    assert acceleration == pytest.approx([0.0, -A / 2, -A, -A])
    assert V - speed[1] == pytest.approx(0.5 * (A / rise) * 0.1**2)
    stop, _ = applied_events(conveyor(ramp_s=rise))
    assert stop.settled_s == pytest.approx(5.0 + V / A + rise)
    assert unit.at(stop.settled_s)[1] == pytest.approx(0.0, abs=1e-12)
    # Each half of an S takes as much longer as the other half saves.
    assert unit.at(8.0)[0] == pytest.approx(5.0 * V + V * V / 2 / A + V * rise / 2)


def test_a_coasting_stop_is_an_exponential_from_the_speed_at_which_it_takes_over() -> None:
    tau = 0.3
    unit = plant(coast_s=tau)
    begin = 5.0 + (V - A * tau) / A
    for after in (0.0, 0.1, 0.5):
        expected = A * tau * math.exp(-after / tau)
        assert unit.at(begin + after)[1] == pytest.approx(expected)
        assert unit.drive(np.array([begin + after]))[2][0] == pytest.approx(-expected / tau)
    stop, start = applied_events(conveyor(coast_s=tau))
    assert stop.settled_s == pytest.approx(begin + tau * math.log(A * tau / REST_SPEED))
    assert unit.at(stop.settled_s + 1e-9)[1] == 0.0
    assert (start.onset_s, start.speed) == (9.0, 0.0)


def test_a_restart_while_coasting_starts_from_the_speed_left() -> None:
    begin = 5.0 + (V - A * 0.3) / A
    events = (ConveyorEvent("stop", 5.0, A), ConveyorEvent("start", begin + 0.3, B))
    _, start = applied_events(conveyor(*events, coast_s=0.3))
    left = A * 0.3 / math.e
    assert start.speed == pytest.approx(left)
    assert plant(*events, coast_s=0.3).at(begin + 1.3)[1] == pytest.approx(left + B)


def test_a_creeping_conveyor_creeps_only_while_it_is_stopped() -> None:
    creep = 0.2e-3
    unit = plant(creep_speed=creep)
    assert unit.at(8.0)[0] - unit.at(7.0)[0] == pytest.approx(creep)
    assert unit.at(4.0)[1] == V
    assert unit.at(17.5)[1] == pytest.approx(V)


def test_the_polygon_effect_is_that_of_a_sprocket() -> None:
    teeth, pitch = 8, 0.1
    unit = plant(teeth=teeth, pitch=pitch)
    times = np.linspace(-1.9, 4.9, 20001)
    position, speed = unit.motion(times)
    half = math.pi / teeth
    # The chain's speed is the sprocket's times the cosine, whose mean is sin(half) / half.
    ratio = speed / V * math.sin(half) / half
    assert ratio.max() == pytest.approx(1.0, abs=1e-6)
    assert ratio.min() == pytest.approx(math.cos(half), abs=1e-3)
    assert np.ptp(position - V * times) < 2e-3
    shifted = unit.positions(times[:1000] + pitch / V) - unit.positions(times[:1000])
    assert shifted == pytest.approx(np.full(1000, pitch), abs=1e-9)


def test_stick_slip_stands_and_catches_up_and_fades_with_the_speed() -> None:
    step = 0.5e-3
    unit = plant(stick_slip=step, stick_slip_speed=0.010)
    smooth = plant()
    times = np.arange(9.0, 12.0, 1e-3)
    lag = smooth.positions(times) - unit.positions(times)
    assert 0.3 * step < lag.max() < 0.8 * step
    assert lag.min() >= 0.0
    assert (np.diff(unit.positions(times)) >= -1e-12).all()
    # Soon after the onset the drive winds up and the unit all but stands.
    assert unit.at(9.1)[1] < 0.2 * smooth.at(9.1)[1]
    fast = 9.0 + 0.010 / B
    assert unit.at(fast + 0.01) == smooth.at(fast + 0.01)
    assert unit.at(4.0) == smooth.at(4.0)


@pytest.mark.parametrize(
    "effects",
    [
        {"ramp_s": 0.25},
        {"coast_s": 0.3},
        {"ramp_s": 0.2, "coast_s": 0.2, "creep_speed": 1e-4},
        {"teeth": 10},
        {"stick_slip": 0.4e-3, "ramp_s": 0.1},
    ],
)
def test_the_speed_is_the_derivative_of_the_position(effects: dict[str, float]) -> None:
    unit = plant(**effects)
    for t in np.arange(-1.49, 17.0, 0.1711):
        assert unit.at(t)[1] == pytest.approx(slope(unit, t), abs=2e-7)
    single = np.array([unit.at(float(t)) for t in TIMES]).T
    assert np.abs(single - np.array(unit.motion(TIMES))).max() < 1e-12


def test_a_turned_line_leads_aside_and_upwards() -> None:
    effects = ConveyorEffects(askew=(0.010, -0.005))
    x, y, z = off_line(effects, np.array([1.0]))[0]
    assert (x, z) == (pytest.approx(0.010, rel=1e-3), pytest.approx(-0.005, rel=1e-3))
    # The unit travels as far as it did.
    assert math.hypot(x, 1.0 + y, z) == pytest.approx(1.0)


def test_the_rail_sags_between_its_supports() -> None:
    effects = ConveyorEffects(sag=2e-3, sag_span=3.0)
    down = off_line(effects, np.array([0.0, 0.75, 1.5, 3.0]))[:, 2]
    assert down == pytest.approx([0.0, -1e-3, -2e-3, 0.0], abs=1e-12)


def test_the_hub_of_a_world_follows_the_turned_line() -> None:
    straight = World(Scenario(conveyor=Conveyor(ripple=SMOOTH)))
    turned = World(Scenario(conveyor=conveyor(askew=(0.010, 0.0))))
    for t in (-1.0, 2.345, 4.0):
        shift = turned.hub_pose(t)[:3, 3] - straight.hub_pose(t)[:3, 3]
        assert shift[0] == pytest.approx(V * t * math.sin(0.010), abs=1e-9)
    for world in (straight, turned):
        world.advance(2.0)
    shift = turned.hub_pose()[:3, 3] - straight.hub_pose()[:3, 3]
    assert shift[0] == pytest.approx(V * 2.0 * math.sin(0.010), abs=1e-9)
