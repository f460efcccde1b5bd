"""Laws of the body: where the hub hangs, how it swings and decays, what a push does."""

import math

import numpy as np
import pytest

from linemate.simulators.plants import rotation
from linemate.simulators.plants.body import C_IN_BASE, BodyPlant
from linemate.simulators.plants.scenario import Body, Jerk, Scenario, Swing
from linemate.simulators.plants.scenario_draw import sample

STILL = Swing(amplitude=0.0, phase=0.0)


def body(swing: Swing = STILL, jerks: tuple[Jerk, ...] = ()) -> BodyPlant:
    return BodyPlant(Body(offset=(0, 0, 0), rotation=(0, 0, 0), swings=(swing,), jerks=jerks))


def in_c(plant: BodyPlant, t: float) -> np.ndarray:
    """Displacement of the hub from nominal, in c [m]."""
    x, y, z = plant.hub(0.0, t)[0]
    return np.array(rotation.unapply(C_IN_BASE, (x - 2.20, y, z - 1.10)))


def test_the_nominal_hub_travels_along_y_with_the_orientation_of_c() -> None:
    position, turned = body().hub(0.7, 3.0)
    assert position == pytest.approx((2.20, 0.7, 1.10))
    assert turned == pytest.approx(C_IN_BASE)


def test_offset_and_rotation_are_given_in_c() -> None:
    plant = BodyPlant(Body(offset=(0.01, 0.02, 0.03), rotation=(0, 0.4, 0), swings=()))
    position, turned = plant.hub(0.0, 0.0)
    assert position == pytest.approx((2.20 + 0.03, 0.02, 1.10 - 0.01))
    error = rotation.log(rotation.between(C_IN_BASE, turned))
    assert error == pytest.approx((0.0, 0.4, 0.0))


def test_a_small_swing_moves_the_hub_by_its_levers() -> None:
    plant = body(Swing(amplitude=1e-3, phase=0.0, damping=0.0))
    assert in_c(plant, 0.0) == pytest.approx((-0.3e-3, 0.0, -0.9e-3), abs=1e-6)
    turn = rotation.log(rotation.between(C_IN_BASE, plant.hub(0.0, 0.0)[1]))
    assert turn == pytest.approx((0.0, 1e-3, 0.0))


def test_an_undamped_swing_keeps_its_energy() -> None:
    omega, amplitude = math.tau * 0.62, 8e-3
    plant = body(Swing(amplitude=amplitude, phase=0.4, damping=0.0))

    def angle(t: float) -> float:
        return rotation.log(plant.swing(t))[1]

    energies = []
    for t in np.linspace(0, 12, 60):
        rate = (angle(t + 1e-4) - angle(t - 1e-4)) / 2e-4
        energies.append(rate**2 + (omega * angle(t)) ** 2)
    assert energies == pytest.approx([(omega * amplitude) ** 2] * 60, rel=1e-6)


def test_damping_takes_the_same_share_each_period() -> None:
    plant = body(Swing(amplitude=8e-3, phase=0.0, damping=0.01))
    peaks = [rotation.log(plant.swing(n / 0.62))[1] for n in range(8)]
    ratios = np.array(peaks[1:]) / np.array(peaks[:-1])
    assert ratios == pytest.approx([math.exp(-math.tau * 0.01)] * 7, rel=1e-9)


def test_the_suspension_stays_where_it_is_in_a_swing() -> None:
    plant = body(Swing(axis=(0.2, 1.0, -0.3), amplitude=8e-3, phase=0.0))
    position, turned = plant.hub(0.0, 0.3)
    below = rotation.apply(turned, Body().suspension_to_hub)
    still, upright = body().hub(0.0, 0.3)
    expected = np.array(still) - rotation.apply(upright, Body().suspension_to_hub)
    assert np.array(position) - below == pytest.approx(expected, abs=1e-15)


def test_a_jerk_begins_at_its_onset_rings_and_fades() -> None:
    jerk = Jerk(4.0, (0.001, 0.003, -0.001), frequency_hz=2.0, damping=0.1)
    plant = body(jerks=(jerk,))
    assert in_c(plant, 4.0) == pytest.approx((0, 0, 0), abs=1e-15)
    quarter = in_c(plant, 4.125)
    assert quarter == pytest.approx(
        math.exp(-0.1 * math.pi / 2) * np.array(jerk.displacement), rel=1e-9
    )
    assert np.abs(in_c(plant, 14.0)).max() < 1e-8


def test_a_block_of_hubs_is_the_single_ones() -> None:
    scenario = sample(3, Scenario(body=Body(jerks=(Jerk(1.0, (0.001, 0.002, 0.0)),))))
    swings = (*scenario.body.swings, Swing((1, 0, 1), 2e-3, frequency_hz=0.9, phase=1.0))
    plant = BodyPlant(Body(scenario.body.nominal, scenario.body.offset, rotation=(0.1, 0.3, -0.2),
                           swings=swings, jerks=scenario.body.jerks))  # fmt: skip
    times = np.linspace(-2.0, 5.0, 77)
    positions = 0.1 * times
    for pose, s, t in zip(plant.hubs(positions, times), positions, times, strict=True):
        single = plant.hub(float(s), float(t))
        assert pose[0] == pytest.approx(single[0], abs=1e-14)
        assert pose[1] == pytest.approx(single[1], abs=1e-14)


def test_an_open_scenario_is_refused() -> None:
    with pytest.raises(ValueError, match="sample the scenario first"):
        BodyPlant(Body())
    with pytest.raises(ValueError, match="sample the scenario first"):
        BodyPlant(Body(offset=(0, 0, 0), rotation=(0, 0, 0)))
