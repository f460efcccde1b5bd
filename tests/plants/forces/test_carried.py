"""Laws of the two-way contact: off it changes nothing, on it is reproducible and balanced."""

import math
import sys

import numpy as np
import pytest

from linemate.simulators.harness import scenario_file
from linemate.simulators.plants.contact_plant import ContactPlant
from linemate.simulators.plants.effector import EffectorPlant, deflected
from linemate.simulators.plants.forces.carried import CarriedBody
from linemate.simulators.plants.forces.carrier import swayed
from linemate.simulators.plants.forces.switches import CarrierMode, Mating
from linemate.simulators.plants.rotation import Pose
from linemate.simulators.plants.scenario import Body, Contact, Effector, Scenario
from linemate.simulators.plants.scenario_draw import sample
from linemate.simulators.plants.world import World

STEP = 0.004
HUB: Pose = ((2.2, 0.0, 1.1), (0.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0))
"""Orientation of c: the hub's z is x of base."""


class Cell:
    """A robot that pushes the tool along the hub's z onto a car that is carried."""

    def __init__(
        self,
        *modes: CarrierMode,
        lateral: float = 0.0,
        contact: Contact | None = None,
        damping: float = 0.0,
    ) -> None:
        scenario = Scenario(
            body=Body(carrier=modes),
            contact=contact or Contact(),
            effector=Effector(damping=(damping,) * 6),
        )
        self.contact = ContactPlant(scenario.contact, scenario.effector)
        self.effector = EffectorPlant(scenario.effector, STEP)
        parts = self.contact, self.effector
        self.carried = CarriedBody(scenario, np.zeros_like, 0.0, STEP, *parts)
        self.t, self.lateral = 0.0, lateral
        self.rigid = self.at(-0.035 if scenario.contact.mating.bolts else -0.002)

    def at(self, depth: float) -> Pose:
        return (2.2 + depth, self.lateral, 1.1), HUB[1]

    def step(self, depth: float) -> Pose:
        self.t += STEP
        before, self.rigid = self.rigid, self.at(depth)
        hub = self.carried.hub(self.t, self.rigid, HUB)
        self.contact.advance(self.t, STEP, self.effector, before, self.rigid, hub)
        return self.carried.settle(self.t, self.rigid, hub, HUB)

    def push(self, speed: float, depth: float, seconds: float) -> Pose:
        hub = HUB
        for _ in range(round(seconds / STEP)):
            hub = self.step(min(self.rigid[0][0] - 2.2 + speed * STEP, depth))
        return hub


def test_a_pushed_car_and_the_mount_share_the_depth_as_springs_in_series() -> None:
    omega, kg = math.tau * 2.0, 300.0
    cell = Cell(CarrierMode(frequency_hz=2.0, damping=0.7, direction=(0, 0, 1), mass=kg))
    hub = cell.push(0.02, 0.003, 10.0)
    assert cell.contact.phase == "clamped"
    share = 50e3 / (50e3 + kg * omega**2)
    assert hub[0][0] - 2.2 == pytest.approx(0.003 * share, rel=1e-6)
    assert cell.effector.deflection[2] == pytest.approx(-0.003 * (1 - share), rel=1e-6)


def test_a_tool_that_arrives_pushes_the_car_by_its_momentum() -> None:
    kg, tool = 200.0, 50e3 / (math.tau * 7.0) ** 2
    cell = Cell(CarrierMode(frequency_hz=0.05, damping=0.0, direction=(0, 0, 1), mass=kg))
    while cell.contact.phase == "free":
        cell.push(0.03, 1.0, STEP)
    speed = cell.carried._carrier.speeds[0]
    # The clamp draws the tool back by what it went too far within the substep.
    arrives = cell.effector.velocity[2] + cell.contact.caught[0][2] / Contact().close_s
    assert speed == pytest.approx(tool * arrives / (kg + tool), rel=1e-9)
    assert speed > 0.0


def test_a_closing_clamp_leaves_no_momentum() -> None:
    # The tool goes 5 mm aside in 40 ms; the car goes back by its share of the masses.
    kg, tool = 100.0, 50e3 / (math.tau * 4.5) ** 2
    mode = CarrierMode(frequency_hz=0.01, damping=0.0, mass=kg)
    cell = Cell(mode, lateral=0.005)
    cell.effector._modes = tuple((0.01, z) for _, z in cell.effector._modes)
    cell.carried._values = (cell.carried._values[0], np.zeros(6), np.zeros(6))
    hub = cell.push(0.02, 0.001, 0.5)
    assert cell.contact.phase == "clamped"
    assert hub[0][1] == pytest.approx(0.005 * tool / (kg + tool), rel=0.06)
    assert cell.carried._carrier.speeds[0] == pytest.approx(0.0, abs=1e-3)


def test_the_tool_stays_on_the_hub_and_feels_what_the_car_feels() -> None:
    omega, kg = math.tau * 3.0, 400.0
    cell = Cell(CarrierMode(frequency_hz=3.0, damping=0.0, direction=(0, 0, 1), mass=kg))
    cell.push(0.02, 0.002, 0.5)
    carrier, tool = cell.carried._carrier, 50e3 / (math.tau * 7.0) ** 2
    for _ in range(100):
        before = carrier.speeds[0]
        hub = cell.step(0.002)
        assert deflected(cell.rigid, cell.effector.deflection)[0] == pytest.approx(hub[0])
        after = carrier.speeds[0]
        force = -50e3 * cell.effector.deflection[2] - kg * omega**2 * carrier.coordinates[0]
        assert (after - before) / STEP == pytest.approx(force / (kg + tool), abs=0.08)


def test_a_released_car_swings_on_with_its_speed() -> None:
    cell = Cell(CarrierMode(frequency_hz=1.0, damping=0.0, direction=(0, 0, 1), mass=300.0))
    cell.push(0.03, 0.004, 0.3)
    carrier, omega = cell.carried._carrier, math.tau
    cell.contact._open(cell.t)
    cell.step(-0.1)
    q, v = carrier.coordinates[0], carrier.speeds[0]
    assert not carrier.held
    cell.step(-0.1)
    assert carrier.speeds[0] == pytest.approx(
        v * math.cos(omega * STEP) - omega * q * math.sin(omega * STEP), rel=1e-9
    )


HEAVY = CarrierMode(frequency_hz=3.0, damping=0.5, direction=(0, 0, 1), mass=500.0)
BOLTS = Contact(mating=Mating(bolts=5, angle=0.0))


@pytest.mark.parametrize("lateral", [0.0, 0.0015])
def test_bolts_within_the_chamfer_go_in_and_the_clamp_closes(lateral: float) -> None:
    cell = Cell(HEAVY, lateral=lateral, contact=BOLTS, damping=0.1)
    cell.push(0.03, 0.001, 1.5)
    assert cell.contact.phase == "clamped"
    assert cell.contact.collision is None
    assert cell.contact.impact is not None
    assert cell.contact.impact.position[2] == pytest.approx(-0.001, abs=0.3e-3)
    assert cell.contact.impact.speed == pytest.approx(0.03, rel=0.5)


def test_bolts_next_to_their_holes_keep_the_clamp_open_until_the_mount_gives_up() -> None:
    cell = Cell(HEAVY, lateral=0.004, contact=BOLTS, damping=0.1)
    cell.push(0.03, -0.023, 1.0)
    assert cell.contact.phase == "free"
    assert cell.contact.collision is None
    assert -50e3 * cell.effector.deflection[2] > 20.0
    cell.push(0.03, 0.05, 1.0)
    assert cell.contact.collision is not None
    assert cell.contact.collision.reason.startswith("mount overloaded before the clamp closed")


def test_a_tool_that_comes_too_far_off_the_bolts_has_missed() -> None:
    cell = Cell(HEAVY, lateral=0.008, contact=BOLTS, damping=0.1)
    cell.push(0.03, 0.0, 2.0)
    assert cell.contact.collision is not None
    assert cell.contact.collision.reason.startswith("missed the hub: 8.0 mm")


def test_a_touch_pushes_a_car_that_gives_way() -> None:
    kg, omega = 500.0, math.tau * 3.0
    cell = Cell(HEAVY, lateral=0.004, contact=BOLTS, damping=0.3)
    hub = cell.push(0.03, -0.023, 2.0)
    force = kg * omega**2 * (hub[0][0] - 2.2)
    assert force > 20.0
    assert -50e3 * cell.effector.deflection[2] == pytest.approx(force, rel=0.01)


def test_a_wheel_is_torn_off_beyond_the_clamps_strength() -> None:
    contact = Contact(deflection_limit=0.2, mating=Mating(tear_off=2500.0))
    cell = Cell(HEAVY, contact=contact)
    cell.push(0.1, 0.3, 5.0)
    assert cell.contact.collision is not None
    assert cell.contact.collision.reason.startswith("wheel torn off: 25")
    assert cell.contact.phase == "released"


def test_each_hub_has_its_own_angle_within_the_range() -> None:
    contact = Contact(mating=Mating(bolts=5, angle_range=0.035))
    drawn = {sample(seed, Scenario(contact=contact)).contact.mating.angle for seed in range(20)}
    assert len(drawn) == 20
    assert all(angle is not None and abs(angle) <= 0.035 for angle in drawn)


SWAY = CarrierMode(frequency_hz=1.0, damping=0.02, mass=400.0, frequency_spread=0.2)


def seen(scenario: Scenario) -> tuple[str, str, bytes]:
    world = World(scenario)
    world.advance(7.0)
    return repr(world.take_camera()), repr(world.take_distance()), world.hub_pose().tobytes()


def test_the_same_seed_gives_the_same_sway() -> None:
    scenario = Scenario(seed=3, body=Body(carrier=(SWAY,)))
    assert seen(scenario) == seen(scenario)


def test_sway_reaches_camera_and_hub_and_not_the_distance_sensor() -> None:
    camera, distance, hub = seen(Scenario(seed=3))
    swaying = seen(Scenario(seed=3, body=Body(carrier=(SWAY,))))
    assert swaying[0] != camera
    assert swaying[1] == distance
    assert swaying[2] != hub


def test_the_hub_of_a_swaying_world_is_the_still_ones_moved() -> None:
    scenario = Scenario(seed=3, body=Body(carrier=(SWAY,)))
    still, swaying = World(Scenario(seed=3)), World(scenario)
    for t in (4.0, 5.5, 6.3):
        still.advance(t)
        swaying.advance(t)
        expected = swayed(still.hub(), np.array(swaying.sway()))
        assert swaying.hub()[0] == pytest.approx(expected[0], abs=1e-12)
    assert abs(swaying.sway()[1]) > 1e-4
    assert swaying.energy() == 0.0


def test_the_hub_between_grid_points_is_smooth() -> None:
    world = World(Scenario(seed=3, body=Body(carrier=(SWAY,))))
    world.advance(5.7)
    times = 5.7 + np.arange(-20, 21) * 1e-3
    ys = np.array([world.hub_pose(float(t))[1, 3] for t in times])
    assert np.abs(np.diff(ys, 3)).max() < 2e-8


def test_both_cycles_see_one_swaying_body() -> None:
    slow, fast = (
        World(Scenario(seed=8, cycle_s=c, body=Body(carrier=(SWAY,)))) for c in (0.012, 0.004)
    )
    slow.advance(7.0)
    fast.advance(7.0)
    assert slow.hub_pose() == pytest.approx(fast.hub_pose(), abs=1e-12)


def test_each_car_has_its_own_frequency_within_the_spread() -> None:
    scenario = Scenario(body=Body(carrier=(SWAY, SWAY)))
    drawn = [sample(seed, scenario).body.carrier for seed in range(20)]
    found = {mode.frequency_hz for modes in drawn for mode in modes}
    assert len(found) == 40
    assert all(0.8 <= hz <= 1.2 for hz in found)
    assert sample(4, sample(4, scenario)) == sample(4, scenario)


def test_a_scenario_file_sets_the_modes() -> None:
    text = b"body: {carrier: [{frequency_hz: 4.7, damping: 0.009, mass: 900}, {turn: [1, 0, 0]}]}"
    modes = scenario_file.parse(text, "x.yaml").body.carrier
    assert modes[0] == CarrierMode(frequency_hz=4.7, damping=0.009, mass=900)
    assert modes[1].turn == (1, 0, 0)
    with pytest.raises(scenario_file.FileError, match="mass: should be at least"):
        scenario_file.parse(b"body: {carrier: [{mass: -1}]}", "x.yaml")


@pytest.mark.row
@pytest.mark.long
@pytest.mark.parametrize(("hz", "kg"), [(0.5, 100.0), (10.0, 100.0), (5.0, 2000.0)])
def test_a_touch_of_an_undamped_car_does_not_grow_by_itself(hz: float, kg: float) -> None:
    mode = CarrierMode(frequency_hz=hz, damping=0.0, direction=(0, 0, 1), mass=kg)
    cell = Cell(mode, lateral=0.004, contact=BOLTS)
    cell.push(0.03, -0.023, 0.5)
    levels = []
    for _ in range(6):
        bent = []
        for _ in range(250):
            cell.step(-0.023)
            bent.append(cell.effector.deflection[2])
        carrier = cell.carried._carrier
        levels.append(carrier.mechanical_energy() + 0.5 * 50e3 * max(map(abs, bent)) ** 2)
    assert max(levels[3:]) <= 1.1 * max(levels[:3])


def test_a_touch_of_a_car_is_as_a_tenth_of_the_step_says(monkeypatch: pytest.MonkeyPatch) -> None:
    mode = CarrierMode(frequency_hz=2.0, damping=0.02, direction=(0, 0, 1), mass=100.0)
    seen = []
    for step in (0.004, 0.0004):
        monkeypatch.setattr(sys.modules[__name__], "STEP", step)
        cell = Cell(mode, lateral=0.004, contact=BOLTS, damping=0.1)
        cell.push(0.05, -0.022, 0.4)
        seen.append(cell.carried.sway[2])
    assert seen[0] == pytest.approx(seen[1], rel=0.02)
    assert seen[1] > 1e-3
