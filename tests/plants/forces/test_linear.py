"""Laws of the linear step: it is the closed form, and it adds no energy."""

import math

import numpy as np
import pytest

from linemate.simulators.plants.forces import linear
from linemate.simulators.plants.oscillator import transition


@pytest.mark.parametrize(
    ("hz", "zeta", "dt"), [(0.5, 0.0, 0.004), (10, 0.05, 0.01), (40, 0.9, 0.3)]
)
def test_a_step_of_one_oscillator_is_its_closed_form(hz: float, zeta: float, dt: float) -> None:
    omega, mass = math.tau * hz, 300.0
    matrices = (np.array([[v]]) for v in (mass, 2 * zeta * omega * mass, omega**2 * mass))
    step = linear.step(*matrices, dt)
    assert step.state.ravel() == pytest.approx(transition(omega, zeta, dt), abs=1e-10 * omega)


def test_a_constant_force_ends_in_static_equilibrium() -> None:
    mass, damping, stiffness = np.eye(2) * 200, np.eye(2) * 900, np.array([[9e4, 2e4], [2e4, 7e4]])
    step = linear.step(mass, damping, stiffness, 0.004)
    force, state = np.array([50.0, -20.0]), np.zeros(4)
    for _ in range(5000):
        state = step.state @ state + (step.start + step.end) @ force
    assert state[:2] == pytest.approx(np.linalg.solve(stiffness, force), rel=1e-9)
    assert state[2:] == pytest.approx((0, 0), abs=1e-12)


def test_a_rising_force_is_integrated_as_a_ramp() -> None:
    # A free mass under u = r t moves by r t^3 / (6 m).
    zero = np.zeros((1, 1))
    step = linear.step(np.array([[50.0]]), zero, zero, 0.5)
    state = step.end @ np.array([100.0])
    assert state == pytest.approx((100.0 * 0.5**2 / 300.0, 100.0 * 0.5 / 100.0), rel=1e-12)


def test_two_half_steps_are_a_whole_one() -> None:
    matrices = np.eye(2) * 150, np.eye(2) * 60, np.array([[4e5, 5e4], [5e4, 6e4]])
    half, whole = (linear.step(*matrices, dt) for dt in (0.002, 0.004))
    assert half.state @ half.state == pytest.approx(whole.state, rel=1e-10, abs=1e-12)


def test_axes_turn_both_halves_of_a_vector_of_six() -> None:
    axes = np.arange(1.0, 10.0).reshape(3, 3)
    assert (linear.for_both(axes) == np.kron(np.eye(2), axes)).all()
