"""The MuJoCo station: a body that yields, an arm that bends, bolts in holes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from linemate.simulators.mujoco_world.frame_poses import vector_of
from linemate.simulators.mujoco_world.mating import FIX_SCREWS
from linemate.simulators.mujoco_world.mujoco_cell import DrivenRamp, MujocoCell, RunOrder, sample

pytest.importorskip("mujoco", reason="the extra 'mujoco' is not installed")

from linemate.simulators.mujoco_world.mujoco_world import MujocoWorld

START = (0.0, -1.6233553393476978, 1.848973829348316, 0.0, 1.3451778367942788, 0.0, 0.0)
ORDER = RunOrder(
    seed=3,
    cycle_s=0.012,
    lead_in_s=1.0,
    duration_s=6.0,
    start=START,
    nominal_speed=0.106,
    ramps=(DrivenRamp(1.0, False, 0.104),),
    hub=(2.2, 0.0, 1.1),
)


def world(cell: MujocoCell | None = None, **changes: object) -> MujocoWorld:
    return MujocoWorld(cell or MujocoCell(), replace(ORDER, **changes))  # type: ignore[arg-type]


def swing_of(hz: float, damping: float = 0.01) -> MujocoCell:
    """Return a cell whose body swings along the conveyor alone."""
    cell = MujocoCell()
    car = replace(
        cell.car,
        fore_aft_hz=hz,
        fore_aft_damping=damping,
        lateral_hz=1.0,
        excitation=0.0,
        tilt=(0.0, 0.0, 0.0),
    )
    line = replace(cell.line, askew=0.0, chain_amplitude=0.0, wander=0.0)
    return replace(cell, car=car, line=line)


def test_a_cell_keeps_its_station_and_gets_other_bodies() -> None:
    first, second = (world(seed=seed, cell_seed=7).cell for seed in (3, 4))
    assert (first.arm, first.line, first.tool, first.sensors) == (
        second.arm, second.line, second.tool, second.sensors,
    )  # fmt: skip
    assert first.car != second.car
    assert world(seed=7).cell.arm == first.arm


def test_a_seed_gives_the_same_run() -> None:
    one, other = world(), world()
    one.advance(0.5)
    other.advance(0.5)
    assert one.hub() == other.hub()
    assert one.take_camera() == other.take_camera()
    assert one.take_wrench() == other.take_wrench()


def test_seeds_differ() -> None:
    assert sample(1, MujocoCell()) != sample(2, MujocoCell())


def test_a_value_that_is_given_is_not_drawn() -> None:
    assert sample(1, swing_of(4.7)).car.fore_aft_hz == 4.7


def test_a_new_draw_leaves_the_others_as_they_were() -> None:
    given = sample(1, swing_of(4.7)).car
    assert given.yaw_hz == sample(1, MujocoCell()).car.yaw_hz


@pytest.mark.parametrize("hz", [0.6, 1.2, 4.7])
def test_the_body_swings_at_its_frequency_after_the_stop(hz: float) -> None:
    station = world(swing_of(hz))
    times = np.arange(2.6, 6.0, 0.012)
    off = []
    for t in times:
        station.advance(float(t))
        off.append(station.hub()[0][1] - station.unit_position())
    swing = np.array(off) - np.mean(off)
    crossings = times[1:][np.diff(np.signbit(swing)) != 0]
    seen_hz = 0.5 / float(np.median(np.diff(crossings)))
    assert seen_hz == pytest.approx(hz, rel=0.06)
    # An S-shaped ramp of 0.104 m/s^2 excites a slow mode by about a / w^2, a fast one by less.
    assert np.ptp(swing) < 4.0 * 0.12 / (math.tau * hz) ** 2 * 1.3 + 1e-5


def test_the_conveyor_stands_after_the_stop() -> None:
    station = world()
    station.advance(3.5)
    assert abs(station.unit_speed()) < 1e-4


def test_the_arm_stands_still_without_setpoints() -> None:
    station = world()
    before = np.array(station.rigid()[0])
    station.advance(0.5)
    assert np.linalg.norm(np.array(station.rigid()[0]) - before) < 1e-4


def test_the_arm_reaches_its_setpoints_after_the_dead_time() -> None:
    station = world()
    goal = (0.01, *START[1:])
    for cycle in range(80):
        station.command(goal, cycle)
        station.advance(station.cycle_start(cycle + 1))
        if station.time_s + station.lead_in_s < station.look_ahead_s:
            assert station.encoders()[0] == pytest.approx(0.0, abs=5e-5)
    assert station.encoders()[0] == pytest.approx(0.01, abs=1e-4)


def test_setpoints_of_a_cycle_whose_motion_has_begun_are_refused() -> None:
    station = world()
    station.advance(0.0)
    with pytest.raises(ValueError, match="motion has begun"):
        station.command(START, station.cycle - 10)


def test_motor_and_link_differ_by_what_the_gear_carries() -> None:
    """The controller computes a tcp that gravity has pulled down."""
    station = world()
    assert 1e-4 < station.reported()[0][2] - station.rigid()[0][2] < 5e-3


def test_the_body_yields_to_the_robot() -> None:
    """A wheel that is pressed against the hub moves the body, and the force is felt."""
    station = world(swing_of(1.0), nominal_speed=1e-5, ramps=(), duration_s=12.0)
    before = station.hub()[0][0]
    pressed = _press(station)
    assert station.contact == "clamped"
    assert station.impact is not None
    assert 10.0 < pressed < 400.0
    assert station.hub()[0][0] > before + 0.3e-3
    assert station.take_wrench()[-1].force[2] < -10.0
    assert station.energy() > 0.0


def _press(station: MujocoWorld, aside: float = 0.0) -> float:
    """Move the tool against the hub, at 25 mm/s in the end; return the force on the mount [N].

    Args:
        aside: of the hub's y at the end [m].
    """
    solver = world()
    goal, turn = station.hub_pose()[:3, 3], station.hub_pose()[:3, :3]
    before = _axes_at(solver, goal - 0.060 * turn[:, 2], turn, np.array(START))
    for cycle in range(120):
        share = 0.5 - 0.5 * math.cos(math.pi * (cycle + 1) / 120)
        _go(station, cycle, np.array(START) + share * (before - np.array(START)))
    axes = before
    for cycle in range(120, 340):
        depth = min(0.003, -0.060 + 0.0003 * (cycle - 120))
        across = aside * max(0.0, cycle - 320) / 20.0
        place = goal + depth * turn[:, 2] + across * turn[:, 1]
        axes = _axes_at(solver, place, turn, axes)
        _go(station, cycle, axes)
    return float(np.linalg.norm(np.array(station.deflection()[:3]) * station.mount_stiffness[:3]))


def _go(station: MujocoWorld, cycle: int, axes: np.ndarray) -> None:
    station.command(tuple(axes.tolist()), cycle)
    station.advance(station.cycle_start(cycle + 1))


def _axes_at(
    solver: MujocoWorld, place: np.ndarray, turn: np.ndarray, near: np.ndarray
) -> np.ndarray:
    """Return the axes that bring the computed tcp there, E1 at rest."""

    def off(q: np.ndarray) -> np.ndarray:
        (x, y, z), r = solver._station.computed_tcp(np.array([*q, 0.0]))
        rotation = turn.T @ np.array(r).reshape(3, 3)
        return np.array([x - place[0], y - place[1], z - place[2], *vector_of(rotation)])

    return np.array([*least_squares(off, near[:6], xtol=1e-10).x, 0.0])


def test_a_pressed_wheel_comes_to_rest_on_the_bolts() -> None:
    """Without a controller that reacts, contact and mount ring down by themselves."""
    station = world(swing_of(4.7, 0.009), nominal_speed=1e-5, ramps=(), duration_s=12.0)
    _press(station)
    assert station.collision is None
    station.advance(station.time_s + 5.0)
    felt = [reading.force for reading in station.take_wrench()]
    touching, late = np.array(felt[-1400:-1150]), np.array(felt[-100:])
    assert np.linalg.norm(np.std(late, axis=0)) < 0.3 * np.linalg.norm(np.std(touching, axis=0))
    assert np.linalg.norm(np.std(late, axis=0)) < 3.0 * station.cell.sensors.force_sigma
    assert np.linalg.norm(np.mean(late, axis=0)) > 20.0


def test_the_hub_loads_a_wheel_that_screws_draw_in_as_much_as_the_mount() -> None:
    station = world(swing_of(4.7, 0.05), nominal_speed=1e-5, ramps=(), duration_s=12.0)
    _press(station, aside=0.003)
    station.digital_out(FIX_SCREWS)
    station.advance(11.0)
    assert station.screws_fixed_s is not None
    on_mount = np.linalg.norm(np.array(station.deflection()[:3]) * station.mount_stiffness[:3])
    assert station._station.touch_n() == pytest.approx(on_mount, rel=0.05)
