"""The MuJoCo station: a body that yields, an arm that bends, bolts in holes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from linemate.simulators.mujoco_world.mujoco_cell import MujocoCell, Ramp, RunOrder, sample

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
    ramps=(Ramp(1.0, False, 0.104),),
    hub=(2.2, 0.0, 1.1),
)


def world(cell: MujocoCell | None = None, **changes: object) -> MujocoWorld:
    return MujocoWorld(cell or MujocoCell(), replace(ORDER, **changes))  # type: ignore[arg-type]


def swing_of(hz: float, damping: float = 0.01) -> MujocoCell:
    """Return a cell whose body swings along the conveyor alone."""
    cell = MujocoCell()
    car = replace(
        cell.car, fore_aft_hz=hz, fore_aft_damping=damping, excitation=0.0, tilt=(0.0, 0.0, 0.0)
    )
    line = replace(cell.line, askew=0.0, chain_amplitude=0.0, wander=0.0)
    return replace(cell, car=car, line=line)


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
    assert given.lateral_hz == sample(1, MujocoCell()).car.lateral_hz


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
    """A wheel that is pressed against the hub moves a soft body, and the force is felt."""
    station = world(swing_of(1.0), nominal_speed=1e-3, ramps=())
    pressed = _press(station)
    assert station.contact == "clamped"
    assert station.impact is not None
    assert 20.0 < pressed < 400.0
    felt = station.take_wrench()[-1]
    assert felt.force[2] < -10.0


def _press(station: MujocoWorld) -> float:
    """Move the tool along its axis against the hub with the arm's own kinematics."""
    from scipy.optimize import least_squares

    from linemate.simulators.mujoco_world.frame_poses import vector_of

    solver = world()
    goal, turn = station.hub_pose()[:3, 3], station.hub_pose()[:3, :3]
    axes = np.array(START)
    for cycle in range(250):
        depth = min(0.0015, -0.05 + 0.0003 * cycle)
        place = goal + turn[:, 2] * depth

        def off(q: np.ndarray, place: np.ndarray = place) -> np.ndarray:
            (x, y, z), r = solver._station.computed_tcp(np.array([*q, 0.0]))
            rotation = turn.T @ np.array(r).reshape(3, 3)
            return np.array([x - place[0], y - place[1], z - place[2], *vector_of(rotation)])

        axes[:6] = least_squares(off, axes[:6], xtol=1e-10).x
        station.command(tuple(axes.tolist()), cycle)
        station.advance(station.cycle_start(cycle + 1))
    return float(np.linalg.norm(np.array(station.deflection()[:3]) * station.mount_stiffness[:3]))
