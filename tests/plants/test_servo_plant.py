"""Laws of the servos: exact against scipy, dead time exact, acceleration bounded."""

import math

import numpy as np
import pytest
from scipy import signal

from linemate.simulators.plants.oscillator import transition
from linemate.simulators.plants.scenario import Axis, Robot
from linemate.simulators.plants.servo_plant import ServoBank

UNLIMITED = 1e9


def drive(axis: Axis, nodes: list[float], cycle_s: float, substeps: int) -> tuple[list[float], ...]:
    """Positions and velocities at the end of each substep for setpoints per cycle."""
    bank = ServoBank((axis,), (nodes[0],), cycle_s, substeps)
    positions, velocities = [], []
    for cycle, node in enumerate(nodes):
        bank.begin_cycle(cycle)
        bank.command(cycle, 0.0, (node,))
        for part in range(substeps):
            bank.advance(cycle * substeps + part)
            positions.append(bank.positions[0])
            velocities.append(bank.velocities[0])
    return positions, velocities


def reference(axis: Axis, nodes: list[float], cycle_s: float, tick: float) -> np.ndarray:
    """The same by scipy's first order hold on a fine grid that holds every corner."""
    omega = math.tau * axis.frequency_hz
    system = signal.StateSpace(
        [[0, 1], [-(omega**2), -2 * axis.damping * omega]], [[0], [omega**2]], [[1, 0]], [[0]]
    )
    count = round(len(nodes) * cycle_s / tick) + 1
    times = np.arange(count) * tick
    corners = np.arange(len(nodes) + 1) * cycle_s + axis.dead_time_s
    values = np.array([nodes[0], *nodes])
    inputs = np.interp(times, corners, values)
    _, out, _ = signal.lsim(system, inputs, times, X0=[nodes[0], 0.0], interp=True)
    return np.asarray(out)


@pytest.mark.parametrize("cycle_s", [0.012, 0.004])
@pytest.mark.parametrize("dead_time_s", [0.0, 0.020, 0.024, 0.030, 0.036, 0.0305, 0.0039])
def test_the_servo_follows_scipy_whatever_its_dead_time(cycle_s: float, dead_time_s: float) -> None:
    axis = Axis(4.5, 0.8, dead_time_s, UNLIMITED)
    nodes = [0.0, *np.random.default_rng(1).normal(0, 0.1, 40).tolist()]
    substeps = round(cycle_s / 0.004)
    positions, _ = drive(axis, nodes, cycle_s, substeps)
    tick = 0.0001
    expected = reference(axis, nodes, cycle_s, tick)[40 :: round(0.004 / tick)]
    assert positions == pytest.approx(expected[: len(positions)], abs=1e-11)


def test_nothing_moves_before_the_dead_time_and_everything_after_it() -> None:
    axis = Axis(4.0, 0.75, 0.0305, UNLIMITED)
    bank = ServoBank((axis,), (0.0,), 0.012, 3)
    bank.begin_cycle(0)
    bank.command(0, 0.0, (1.0,))
    for index in range(7):
        if index and index % 3 == 0:
            bank.begin_cycle(index // 3)
        bank.advance(index)
        assert bank.positions == (0.0,)
    assert bank.peek(7, 0.0305 - 0.028) == (0.0,)
    assert bank.peek(7, 0.0306 - 0.028)[0] > 0.0


def test_peeking_to_the_end_of_a_substep_is_advancing() -> None:
    axes = Robot().axes
    bank = ServoBank(axes, (0.0,) * 7, 0.012, 3)
    for index in range(60):
        if index % 3 == 0:
            bank.begin_cycle(index // 3)
            bank.command(index // 3, 0.0, tuple(0.05 * math.sin(index + i) for i in range(7)))
        foreseen = bank.peek(index, 0.004)
        bank.advance(index)
        assert bank.positions == pytest.approx(foreseen, abs=1e-14)


def test_a_large_step_never_exceeds_the_acceleration_limit_and_still_arrives() -> None:
    axis = Axis(4.0, 0.75, 0.036, 4.0)
    positions, velocities = drive(axis, [0.0] + [0.5] * 400, 0.012, 3)
    gains = np.diff([0.0, *velocities]) / 0.004
    assert np.abs(gains).max() == pytest.approx(4.0, rel=1e-9)
    assert positions[-1] == pytest.approx(0.5, abs=1e-6)


def test_a_saturated_motion_agrees_with_fine_integration() -> None:
    axis = Axis(6.0, 0.8, 0.024, 12.0)
    nodes = [0.0] + [0.05 * math.sin(0.2 * k) for k in range(80)]
    positions, _ = drive(axis, nodes, 0.012, 3)
    omega, tick = math.tau * 6.0, 1e-5
    corners, values = np.arange(len(nodes) + 1) * 0.012 + 0.024, np.array([nodes[0], *nodes])
    y = v = 0.0
    fine = []
    for k in range(round(len(nodes) * 0.012 / tick)):
        u = float(np.interp((k + 0.5) * tick, corners, values))
        wish = omega**2 * (u - y) - 2 * 0.8 * omega * v
        a = min(max(wish, -12.0), 12.0)
        y, v = y + v * tick + 0.5 * a * tick * tick, v + a * tick
        if (k + 1) % 400 == 0:
            fine.append(y)
    assert positions == pytest.approx(fine, abs=2e-4)


def test_a_missing_command_holds_the_last_setpoint() -> None:
    bank = ServoBank((Axis(6.0, 0.8, 0.0, UNLIMITED),), (0.0,), 0.012, 3)
    bank.begin_cycle(0)
    bank.command(0, 0.0, (0.3,))
    for index in range(600):
        if index and index % 3 == 0:
            bank.begin_cycle(index // 3)
        bank.advance(index)
    assert bank.positions[0] == pytest.approx(0.3, abs=1e-12)


def test_a_command_later_than_the_shortest_dead_time_is_refused() -> None:
    bank = ServoBank(Robot().axes, (0.0,) * 7, 0.030, 8)
    bank.begin_cycle(0)
    bank.command(0, 0.020, (0.1,) * 7)
    with pytest.raises(ValueError, match="the motion has passed it"):
        bank.command(0, 0.021, (0.1,) * 7)


@pytest.mark.parametrize(("cycle_s", "substeps"), [(0.012, 3), (0.004, 1)])
def test_a_command_given_in_the_next_cycle_is_the_same_command(
    cycle_s: float, substeps: int
) -> None:
    prompt, late = (ServoBank(Robot().axes, (0.0,) * 7, cycle_s, substeps) for _ in range(2))
    given: tuple[float, ...] = (0.0,) * 7
    for cycle in range(200):
        prompt.begin_cycle(cycle)
        late.begin_cycle(cycle)
        if cycle:
            late.command(cycle - 1, cycle_s, given)
        given = tuple(0.1 * math.sin(0.05 * cycle + i) for i in range(7))
        prompt.command(cycle, 0.0, given)
        for part in range(substeps):
            prompt.advance(cycle * substeps + part)
            late.advance(cycle * substeps + part)
            assert late.positions == prompt.positions
            assert late.velocities == prompt.velocities


def test_a_command_for_any_other_cycle_is_refused() -> None:
    bank = ServoBank(Robot().axes, (0.0,) * 7, 0.004, 1)
    for cycle in range(3):
        bank.begin_cycle(cycle)
        bank.advance(cycle)
    for cycle in (0, 3):
        with pytest.raises(ValueError, match=f"command for cycle {cycle} in cycle 2"):
            bank.command(cycle, 0.0, (0.1,) * 7)


@pytest.mark.parametrize("size", [1e-4, 1e-3, 1e-2])
def test_a_cycle_as_a_matrix_is_the_cycle_piece_by_piece(size: float) -> None:
    """Whether none, some or all cycles saturate."""
    rng = np.random.default_rng(5)
    banks = [ServoBank(Robot().axes, (0.0,) * 7, 0.012, 3) for _ in range(2)]
    banks[1]._look_ahead = lambda: banks[1]._one_by_one([])  # type: ignore[method-assign]
    rises, place = np.zeros(7), np.zeros(7)
    for cycle in range(300):
        rises = 0.9 * rises + size * rng.normal(size=7)
        place += rises
        for bank in banks:
            bank.begin_cycle(cycle)
            bank.command(cycle, 0.0, tuple(place.tolist()))
            for part in range(3):
                bank.advance(3 * cycle + part)
        assert banks[0].positions == pytest.approx(banks[1].positions, abs=1e-12)
        assert banks[0].velocities == pytest.approx(banks[1].velocities, abs=1e-11)


@pytest.mark.parametrize("zeta", [0.0, 0.02, 0.8, 1.0, 1.0 + 1e-12, 1.7])
def test_the_transition_is_the_matrix_exponential(zeta: float) -> None:
    from scipy.linalg import expm

    omega = 31.0
    for dt in (0.0, 1e-6, 0.004, 0.1):
        expected = expm(np.array([[0.0, 1.0], [-(omega**2), -2 * zeta * omega]]) * dt)
        assert np.array(transition(omega, zeta, dt)).reshape(2, 2) == pytest.approx(
            expected, rel=1e-6, abs=1e-9
        )
