"""Laws of the carrier: closed forms of sway, static balance, energy and momentum."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from linemate.simulators.plants.forces.carrier import CarrierPlant, Mount, swayed
from linemate.simulators.plants.forces.switches import CarrierMode
from linemate.simulators.plants.rotation import IDENTITY, log

STEP = 0.004
STIFFNESS = np.array((50e3, 50e3, 50e3, 2e3, 2e3, 2e3))
ORIGIN = ((0.0, 0.0, 0.0), IDENTITY)


def ramp(slope: float, begin: float, end: float) -> Callable[[np.ndarray], np.ndarray]:
    """Speeds of a conveyor that changes by a ramp."""
    return lambda times: slope * (np.clip(times, begin, end) - begin)


def mount(mass: float = 50.0, damping: float = 0.0) -> Mount:
    return Mount.at(ORIGIN, np.full(6, mass), np.full(6, damping), STIFFNESS)


def carrier(
    *modes: CarrierMode, speeds: Callable[[np.ndarray], np.ndarray] = np.zeros_like
) -> CarrierPlant:
    return CarrierPlant(modes, speeds, 0.0, STEP)


def hold(plant: CarrierPlant, tcp: np.ndarray, steps: int) -> list[np.ndarray]:
    """Hold the tool with a rigid tcp that stands at ``tcp`` (in c, axes of base)."""
    axes, seen = mount().axes, []
    for _ in range(steps):
        plant.advance(axes.T @ (plant.sway - tcp))
        plant.begin_pull(axes.T @ (plant.sway - tcp))
        seen.append(plant.sway)
    return seen


@pytest.mark.parametrize("hz", [0.62, 1.0, 2.0])
def test_a_stop_leaves_the_closed_forms_amplitude(hz: float) -> None:
    # A ramp of duration T leaves 2 g a / w^2 |sin(w T / 2)|.
    slope, duration, gain, omega = -0.13, 0.82, 0.9, math.tau * hz
    plant = carrier(
        CarrierMode(frequency_hz=hz, damping=0.0, drive=gain),
        speeds=ramp(slope, 1.0, 1.0 + duration),
    )
    seen = []
    for k in range(1500):
        plant.advance()
        if k * STEP > 1.0 + duration:
            seen.append(plant.sway[1])
    expected = 2 * gain * 0.13 / omega**2 * abs(math.sin(omega * duration / 2))
    assert max(seen) == pytest.approx(expected, rel=1e-3)


def test_the_size_of_the_literature_is_met_for_a_long_ramp() -> None:
    # The car hangs a / w^2 aside while the conveyor brakes: 2.3 mm for 0.13 m/s^2 at 1.2 Hz.
    plant = carrier(CarrierMode(frequency_hz=1.2, damping=0.05), speeds=ramp(-0.13, 0.0, 100.0))
    for _ in range(5000):
        plant.advance()
    assert plant.sway[1] == pytest.approx(2.29e-3, rel=5e-3)


def test_a_ramp_between_grid_points_gives_its_whole_momentum() -> None:
    plant = carrier(CarrierMode(frequency_hz=1e-3, damping=0.0), speeds=ramp(-10.0, 0.0053, 0.0066))
    for _ in range(5):
        plant.advance()
    assert plant.speeds == pytest.approx([0.013], rel=1e-6)


def test_a_mode_moves_and_turns_the_hub_along_its_shape() -> None:
    mode = CarrierMode(direction=(0.1, 1.0, 0.0), turn=(0.0, 0.0, 1.1), drive=1.0)
    plant = carrier(mode, speeds=ramp(1.0, 0.0, 9.0))
    for _ in range(50):
        plant.advance()
    x, y, z, a, b, c = plant.sway
    assert (x, z, a, b) == pytest.approx((0.1 * y, 0, 0, 0), abs=1e-12)
    assert c == pytest.approx(1.1 * y)
    assert y < 0


def test_a_force_is_balanced_by_body_and_mount_in_series() -> None:
    omega = math.tau * 2.0
    plant = carrier(CarrierMode(frequency_hz=2.0, damping=0.9, mass=300.0))
    tcp = np.array((0, 5e-3, 0, 0, 0, 0))
    plant.seize(mount(), np.zeros(6))
    plant.begin_pull(mount().axes.T @ -tcp)
    seen = hold(plant, tcp, 4000)
    body, tool = 300.0 * omega**2, 50e3
    assert seen[-1][1] == pytest.approx(5e-3 * tool / (tool + body), rel=1e-9)


@pytest.mark.row
@pytest.mark.long
@pytest.mark.parametrize("hz", [0.5, 4.7, 10.0])
@pytest.mark.parametrize("kg", [100.0, 2000.0])
def test_without_damping_the_energy_of_car_tool_and_mount_stays(hz: float, kg: float) -> None:
    shapes = ((0.0, 1.0, 0.0), (0.3, 0.2, 1.0))
    plant = carrier(
        *(CarrierMode(frequency_hz=hz, damping=0.0, mass=kg, direction=s) for s in shapes)
    )
    axes, tcp = mount().axes, np.array((1e-3, 3e-3, -2e-3, 0, 0, 0))
    plant.seize(mount(), np.array((0.0, 0.02, 0.01, 0, 0, 0)))
    plant.begin_pull(axes.T @ -tcp)

    def total() -> float:
        bent = plant.sway - tcp
        v = plant._shape @ plant.speeds
        return plant.mechanical_energy() + 0.5 * bent @ mount().stiffness @ bent + 25.0 * v @ v

    first = total()
    for _ in range(5000):
        hold(plant, tcp, 1)
        assert total() == pytest.approx(first, rel=1e-7)


def test_the_energy_put_in_is_what_car_and_tool_have() -> None:
    plant = carrier(CarrierMode(frequency_hz=3.0, damping=0.0, mass=500.0))
    tcp = np.array((0, 4e-3, 0, 0, 0, 0))
    plant.seize(mount(), np.zeros(6))
    plant.begin_pull(mount().axes.T @ -tcp)
    for _ in range(333):
        hold(plant, tcp, 1)
        has = plant.mechanical_energy() + 25.0 * plant.speeds[0] ** 2
        assert plant.energy == pytest.approx(has, abs=2e-3)
    assert max(plant.energy, 0.0) < 0.5 * 50e3 * 4e-3**2 + 2e-3


def test_a_catch_keeps_the_momentum() -> None:
    plant = carrier(CarrierMode(frequency_hz=1.0, mass=450.0))
    plant.seize(mount(50.0), np.array((0, 0.1, 0, 0, 0, 0)))
    assert plant.speeds == pytest.approx([50 * 0.1 / 500])
    plant.let_go()
    assert plant.speeds == pytest.approx([0.01])


def test_the_held_tool_is_left_behind_by_the_conveyor_as_the_car_is() -> None:
    # Without mount and spring, car and tool stay where they are while the conveyor speeds up.
    speed = ramp(0.3, 0.0, 9.0)
    for drive, expected in ((1.0, 0.3), (0.0, 0.3 * 50 / 200)):
        plant = carrier(CarrierMode(frequency_hz=1e-4, mass=150.0, drive=drive), speeds=speed)
        free = Mount.at(ORIGIN, np.full(6, 50.0), np.zeros(6), np.zeros(6))
        plant.seize(free, np.zeros(6))
        for _ in range(100):
            plant.advance(free.axes.T @ plant.sway)
            plant.begin_pull(free.axes.T @ plant.sway)
        assert plant.speeds[0] == pytest.approx(-expected * 100 * STEP, rel=1e-4)


def test_a_moving_robot_moves_the_car_as_a_hundredth_of_the_step_says() -> None:
    mode, axes, seen = CarrierMode(frequency_hz=4.7, damping=0.01, mass=300.0), mount().axes, []
    for step in (STEP, STEP / 100):
        plant = CarrierPlant((mode,), np.zeros_like, 0.0, step)
        plant.seize(mount(damping=60.0), np.zeros(6))
        for k in range(1, round(0.4 / step) + 1):
            tcp = np.array((0, 3e-3 * math.sin(30 * k * step), 0, 0, 0, 0))
            plant.advance(axes.T @ (plant.sway - tcp))
            plant.begin_pull(axes.T @ (plant.sway - tcp))
        seen.append(plant.sway[1])
    assert seen[0] == pytest.approx(seen[1], rel=2e-3)


def test_a_car_that_moves_with_the_tool_gains_nothing_at_the_catch() -> None:
    plant = carrier(CarrierMode(frequency_hz=1.0, mass=450.0), speeds=ramp(-0.2, 0.0, 1.0))
    for _ in range(30):
        plant.advance()
    speed = plant.speeds[0]
    plant.seize(mount(), plant._shape @ plant.speeds)
    assert plant.speeds[0] == pytest.approx(speed, rel=1e-12)


def test_a_mode_without_mass_gives_way_to_nothing() -> None:
    plant = carrier(CarrierMode(frequency_hz=1.0))
    assert not plant.yields
    plant.seize(mount(), np.full(6, 0.1))
    hold(plant, np.array((0, 0.01, 0, 0, 0, 0)), 500)
    assert plant.sway == pytest.approx(np.zeros(6), abs=1e-9)


def test_both_excitations_move_one_mode() -> None:
    mode = CarrierMode(frequency_hz=1.0, damping=0.02, mass=400.0)
    speed, tcp = ramp(-0.1, 0.0, 1.0), np.array((0, 2e-3, 0, 0, 0, 0))
    ways = []
    for moving, aside in ((speed, tcp * 0), (np.zeros_like, tcp), (speed, tcp)):
        plant = carrier(mode, speeds=moving)
        plant.seize(mount(), np.zeros(6))
        plant.begin_pull(mount().axes.T @ -aside)
        ways.append(hold(plant, aside, 700)[-1])
    assert ways[2] == pytest.approx(ways[0] + ways[1], rel=1e-9)


def test_a_peek_ends_where_the_step_ends_and_is_smooth_between() -> None:
    plant = carrier(CarrierMode(frequency_hz=5.0, mass=200.0), speeds=ramp(0.5, 0.0, 9.0))
    for _ in range(20):
        plant.advance()
    seen = [plant.peek(0.08 + share * STEP)[1] for share in (0.0, 0.5, 1.0)]
    plant.advance()
    assert seen[2] == pytest.approx(plant.sway[1], rel=1e-9)
    assert plant.at(0.08 + 0.5 * STEP)[1] == pytest.approx(seen[1], rel=1e-4)
    assert seen[0] > seen[1] > seen[2]


def test_speeds_that_are_foreseen_change_no_bit_of_a_peek() -> None:
    times = 0.9995 + 0.0331 * np.arange(8)
    peeks = []
    for foresees in (False, True):
        asked: list[int] = []

        def speeds(at: np.ndarray, asked: list[int] = asked) -> np.ndarray:
            asked.append(len(at))
            return ramp(-0.13, 1.0, 1.8)(at)

        plant = carrier(CarrierMode(frequency_hz=1.0, damping=0.1, drive=0.9), speeds=speeds)
        if foresees:
            plant.foresee(times)
        seen = []
        for t in times.tolist():
            while plant._now() + STEP <= t:
                plant.advance()
            seen.append(plant.peek(t).tobytes())
        peeks.append(seen)
        assert asked.count(1) == (0 if foresees else len(times))
    assert peeks[0] == peeks[1]


def test_the_future_without_contact_is_what_happens() -> None:
    plant = carrier(CarrierMode(frequency_hz=0.8), speeds=ramp(-0.1, 0.5, 1.5))
    for _ in range(100):
        plant.advance()
    expected = plant.at(2.0)
    for _ in range(400):
        plant.advance()
    assert plant.sway == pytest.approx(expected, rel=1e-12)
    assert plant.at(2.0) == pytest.approx(expected, rel=1e-12)


def test_sway_moves_the_hub_in_the_axes_of_c() -> None:
    place, turned = swayed(ORIGIN, np.array((1e-3, 2e-3, 3e-3, 0, 0, 4e-3)))
    assert place == pytest.approx((3e-3, 2e-3, -1e-3))
    assert log(turned) == pytest.approx((4e-3, 0, 0))
