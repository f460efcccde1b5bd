"""Where the tcp should be: the sensed pose against homogeneous transforms, and the blending."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking import approach
from linemate.daemon.core.tracking.approach import Part
from linemate.daemon.core.tracking.settings import SwingMode

MODE = SwingMode()
TILT = math.radians(23.0) * np.array((0.4, -0.5, 0.768))
WIDTH = 0.008  # of the largest swing [rad]


def homogeneous(pose: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotations.exp(pose[3:]), pose[:3]
    return T


def part(angles: Array, tilt: Array = TILT) -> Part:
    along = 0.3 + 0.01 * np.arange(len(angles))
    return Part(-1.06, 2.17, along, rotations.exp(tilt), angles[None])


def swung(where: Part, k: int, mode: SwingMode) -> Array:
    """The object (4, 4), turned as a whole about its suspension: nothing linearised.

    The suspension lies where the levers say: a turn about the axis moves the object by
    axis x (object - suspension), which are the levers; so object - suspension = levers x axis.
    """
    axis = np.eye(3)[mode.axis]
    arm = np.cross(np.array(mode.levers), axis)
    rest = np.eye(4)
    rest[:3, :3], rest[:3, 3] = where.rotation, (where.x, where.along[k], where.z)
    R = rotations.exp(float(where.swing[0, k]) * axis)
    moved = np.eye(4)
    moved[:3, :3] = R @ where.rotation
    moved[:3, 3] = rest[:3, 3] - arm + R @ arm
    return moved


programmed = st.tuples(
    st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3),
    st.lists(st.floats(-0.4, 0.4), min_size=3, max_size=3),
).map(lambda both: np.array((*both[0], *both[1])))


@settings(max_examples=60, deadline=None)
@given(programmed)
def test_at_rest_the_sensed_tcp_is_the_object_times_the_programmed_distance(
    distance: Array,
) -> None:
    where = part(np.zeros(3))
    tcp, seen = approach.sensed(where, (MODE,), np.tile(distance, (3, 1)), turned=True)
    for k in range(3):
        known = swung(where, k, MODE)
        assert np.allclose(homogeneous(tcp[k]), known @ homogeneous(distance), atol=1e-12)
    assert np.allclose(homogeneous(seen), swung(where, 0, MODE), atol=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("levers", [(-0.3, 0.0, -0.9), (0.2, 0.5, -0.4)])
def test_a_swing_is_right_to_the_second_order(
    axis: int, levers: tuple[float, float, float]
) -> None:
    # A lever along the axis itself would be no rotation about it.
    true = tuple(0.0 if i == axis else lever for i, lever in enumerate(levers))
    mode = SwingMode(axis=axis, levers=(true[0], true[1], true[2]))
    distance = np.array((0.02, -0.01, -0.25, 0.0, 0.0, 0.0))
    off = {}
    for size in (WIDTH, WIDTH / 2):
        where = part(np.linspace(-size, size, 9))
        tcp, seen = approach.sensed(where, (mode,), np.tile(distance, (9, 1)), turned=False)
        errors = [float(np.abs(seen[:3] - swung(where, 0, mode)[:3, 3]).max())]
        for k in range(9):
            known = swung(where, k, mode)
            errors.append(np.abs(homogeneous(tcp[k]) - known @ homogeneous(distance)).max() / 100)
        off[size] = max(errors)
    # 30 um of sagitta would be missing in the first order.
    assert off[WIDTH] < 0.5e-6
    assert off[WIDTH / 2] < 0.3 * off[WIDTH]


def test_the_tcp_next_to_a_swinging_object_is_within_a_few_micrometres() -> None:
    where = part(np.linspace(-WIDTH, WIDTH, 9))
    for reach in (-0.40, -0.06, 0.001):
        distance = np.array((0.0, 0.0, reach, 0.0, 0.0, 0.0))
        tcp, _ = approach.sensed(where, (MODE,), np.tile(distance, (9, 1)), turned=False)
        for k in range(9):
            known = swung(where, k, MODE) @ homogeneous(distance)
            assert np.abs(tcp[k, :3] - known[:3, 3]).max() < 0.5 * WIDTH**2 * abs(reach) + 1e-6
            turn = rotations.log(rotations.exp(tcp[k, 3:]) @ known[:3, :3].T)
            assert np.abs(turn).max() < 1e-5


@pytest.mark.parametrize("lead", [0.024, -0.05])
def test_the_goal_of_a_robot_that_lags_is_the_object_later_in_each_direction(lead: float) -> None:
    times, relative = 0.012 * np.arange(41), np.tile((0.01, 0.0, -0.02, 0.0, 0.0, 0.0), (41, 1))

    def seen(at: Array) -> Part:
        swing = WIDTH * np.sin(2.0 * np.pi * 0.62 * at)
        return Part(-1.06, 2.17, 0.3 + 0.106 * at, rotations.exp(TILT), swing[None])

    now, later = (
        approach.sensed(seen(t), (MODE,), relative, turned=False)[0] for t in (times, times + lead)
    )
    moved = approach.ahead(seen(times), lead, 0.012, (MODE,), relative, turned=False)
    assert np.abs(later - now)[:, 0].max() > 1e-4, "across as well"
    assert np.abs(now + moved - later)[1:-1].max() < 2e-4


def test_the_goal_of_a_robot_that_lags_leads_an_object_that_does_not_swing_along_its_way() -> None:
    still = Part(-1.0, 2.0, 0.106 * 0.012 * np.arange(9), np.eye(3), np.zeros((0, 9)))
    moved = approach.ahead(still, 0.05, 0.012, (), np.zeros((9, 6)), turned=False)
    assert np.allclose(moved, (0.0, 0.05 * 0.106, 0.0, 0.0, 0.0, 0.0))


def test_two_swings_add_up() -> None:
    other = SwingMode(axis=0, frequency_hz=0.9, levers=(0.0, 0.4, 0.1))
    angles = np.array(((0.004, -0.002), (0.003, 0.005)))
    both = Part(-1.0, 2.0, np.zeros(2), rotations.exp(TILT), angles)
    still = Part(-1.0, 2.0, np.zeros(2), rotations.exp(TILT), np.zeros((2, 2)))
    here = np.zeros((2, 6))
    tcp, _ = approach.sensed(both, (MODE, other), here, turned=False)
    rest, _ = approach.sensed(still, (MODE, other), here, turned=False)
    first = np.outer(angles[0], MODE.levers) + np.outer(angles[1], other.levers)
    assert np.allclose(tcp[:, :3] - rest[:, :3], first, atol=2e-5)
    for k in range(2):
        turn = np.array((angles[1, k], angles[0, k], 0.0))
        turned = rotations.exp(turn) @ rotations.exp(rest[k, 3:])
        assert np.abs(rotations.log(rotations.exp(tcp[k, 3:]) @ turned.T)).max() < 1e-5


def test_an_object_that_cannot_swing_stands_as_one_that_does_not() -> None:
    distance = np.tile((0.02, -0.01, -0.25, 0.0, 0.0, 0.0), (4, 1))
    still = part(np.zeros(4))
    stiff = Part(still.x, still.z, still.along, still.rotation, np.empty((0, 4)))
    for found, known in zip(
        approach.sensed(stiff, (), distance, turned=False),
        approach.sensed(still, (MODE,), distance, turned=False),
        strict=True,
    ):
        assert np.allclose(found, known, rtol=0.0, atol=1e-14)


def test_a_programme_that_does_not_turn_needs_no_product_of_rotations() -> None:
    where = part(np.linspace(-WIDTH, WIDTH, 5))
    distance = np.tile((0.0, 0.01, -0.2, 0.0, 0.0, 0.0), (5, 1))
    plain, _ = approach.sensed(where, (MODE,), distance, turned=False)
    general, _ = approach.sensed(where, (MODE,), distance, turned=True)
    assert np.allclose(plain, general, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(programmed)
def test_known_poses_are_composed_exactly(distance: Array) -> None:
    vectors = np.array((TILT, -0.5 * TILT, 2.0 * TILT))
    positions = np.arange(9.0).reshape(3, 3)
    tcp, seen = approach.known(positions, vectors, np.tile(distance, (3, 1)), turned=True)
    for k in range(3):
        pose = np.concatenate((positions[k], vectors[k]))
        assert k > 0 or np.array_equal(seen, pose)
        known = homogeneous(pose) @ homogeneous(distance)
        assert np.allclose(homogeneous(tcp[k]), known, atol=1e-10)


def test_the_blend_ends_with_three_derivatives_of_nothing() -> None:
    s = np.linspace(-0.2, 1.2, 1401)
    y = approach.smoothstep(s)
    assert (y[s <= 0.0] == 0.0).all()
    assert np.allclose(y[s >= 1.0], 1.0, atol=1e-12)
    assert (np.diff(y) >= -1e-12).all()
    assert np.allclose(y + y[::-1], 1.0, atol=1e-9)
    # The fourth derivative of the polynomial at its ends, 35 * 4!, bounds what the third jumps by.
    for order, largest in ((1, 2.2), (2, 7.6), (3, 53.0)):
        assert np.abs(np.diff(y, n=order)).max() / 0.001**order < largest
    third = np.diff(y, n=3) / 0.001**3
    assert np.abs(np.diff(third)).max() < 35 * 24 * 0.0011


@settings(max_examples=30, deadline=None)
@given(st.floats(0.0, 1.0), programmed, programmed)
def test_a_blend_lies_between_the_programmed_and_the_sensed(
    share: float, one: Array, other: Array
) -> None:
    found = approach.blend(one[None], other[None], np.array((share,)))[0]
    low, high = np.minimum(one, other), np.maximum(one, other)
    assert (found >= low - 1e-12).all()
    assert (found <= high + 1e-12).all()
    assert np.allclose(approach.blend(one[None], other[None], np.zeros(1))[0], one)
    assert np.allclose(approach.blend(one[None], other[None], np.ones(1))[0], other)


@settings(max_examples=30, deadline=None)
@given(programmed)
def test_a_withdrawal_is_straight_back_out_of_the_object(pose: Array) -> None:
    goal = np.tile(pose, (4, 1))
    way = np.linspace(0.0, 0.15, 4)
    back = approach.withdraw(goal, way)
    assert np.array_equal(back[:, 3:], goal[:, 3:])
    for k in range(4):
        inside = np.linalg.inv(homogeneous(goal[k])) @ homogeneous(back[k])
        assert np.allclose(inside[:3, 3], (0.0, 0.0, -way[k]), atol=1e-12)
    assert np.array_equal(goal, np.tile(pose, (4, 1)))


def test_an_object_that_moves_askew_is_off_by_its_slopes_times_the_way_from_now() -> None:
    along = np.array((0.3, 0.31, 0.36))
    angles = np.zeros((1, 3))
    straight = Part(-1.06, 2.17, along, rotations.exp(TILT), angles)
    askew = Part(-1.06, 2.17, along, rotations.exp(TILT), angles, slopes=(0.01, -0.02))
    relative = np.tile((0.0, 0.0, -0.2, 0.0, 0.0, 0.0), (3, 1))
    tcp, now = approach.sensed(straight, (MODE,), relative, turned=False)
    moved, now_askew = approach.sensed(askew, (MODE,), relative, turned=False)
    off = np.zeros((3, 6))
    off[:, 0], off[:, 2] = 0.01 * (along - along[0]), -0.02 * (along - along[0])
    assert np.allclose(moved - tcp, off, atol=1e-15)
    assert np.allclose(now, now_askew)


def test_an_object_that_its_sway_lifts_is_led_by_as_much() -> None:
    along, angles = np.array((0.3, 0.31, 0.36)), np.zeros((1, 3))
    level = Part(-1.06, 2.17, along, rotations.exp(TILT), angles)
    lifted = Part(
        -1.06, 2.17, along, rotations.exp(TILT), angles, lifted=np.array((1e-4, 1e-3, 3e-3))
    )
    relative = np.tile((0.0, 0.0, -0.2, 0.0, 0.0, 0.0), (3, 1))
    tcp, now = approach.sensed(level, (MODE,), relative, turned=False)
    moved, now_lifted = approach.sensed(lifted, (MODE,), relative, turned=False)
    off = np.zeros((3, 6))
    off[:, 0] = lifted.lifted
    assert np.allclose(moved - tcp, off, atol=1e-15)
    assert np.allclose(now_lifted - now, off[0], atol=1e-15)


def test_a_blend_takes_its_usual_time_unless_the_object_has_gone_far() -> None:
    assert approach.catch_up_time(0.11, 0.5) == 0.5
    late = approach.catch_up_time(0.76, 0.5)
    share = approach.smoothstep(np.linspace(0.0, 1.0, 1001))
    fastest = 0.76 * np.diff(share).max() / (late / 1000)
    assert fastest == pytest.approx(approach.CATCH_UP_SPEED, rel=1e-3)


@pytest.mark.parametrize("lag_s", [-0.03, 0.024, 0.08])
def test_a_lag_behind_a_steady_object_is_made_up_for_up_to_what_is_normal(lag_s: float) -> None:
    """The robot lags by a time: the plan with the lead is that much ahead of it."""
    lead, speed = 0.0, 0.106
    for _ in range(1000):
        lead = approach.lead(lead, -lag_s * speed, speed, 0.012)
    normal_s = approach.NORMAL_LAG / speed
    most = min(abs(lag_s) - normal_s, approach.LARGEST_LEAD)
    assert lead == pytest.approx(np.sign(lag_s) * most, rel=1e-3)


@pytest.mark.parametrize("off", [0.0, 7e-4, -7e-4])
def test_what_identified_servos_leave_of_a_lag_is_left_alone(off: float) -> None:
    assert approach.lead(0.0, off, 0.106, 0.012) == 0.0


def test_a_release_that_waits_makes_up_for_a_whole_lag() -> None:
    """A lag of 0.8 mm bent the mount by 40 N: more than with which the clamp may open."""
    lead, speed = 0.0, 0.106
    for _ in range(1000):
        lead = approach.lead(lead, -0.007 * speed, speed, 0.012, is_whole=True)
    assert lead == pytest.approx(0.007, rel=1e-3)


def test_a_lead_moves_the_tcp_by_the_rates_of_the_object() -> None:
    lead, dt, relative = -0.03, 0.004, np.tile((0.1, -0.2, -0.3, 0.0, 0.0, 0.0), (9, 1))
    times = dt * np.arange(9.0)
    swing, along = WIDTH * np.sin(30.0 * times)[None], 0.1 * times**2
    here = Part(-1.06, 2.17, along, rotations.exp(TILT), swing, lifted=0.3 * along)
    moved = lead * np.gradient(along, dt)
    turned = swing + lead * np.gradient(swing, dt, axis=1)
    lifted = 0.3 * along + lead * np.gradient(0.3 * along, dt)
    there = Part(-1.06, 2.17, along + moved, rotations.exp(TILT), turned, lifted=lifted)
    now, then = (approach.sensed(p, (MODE,), relative, turned=False)[0] for p in (here, there))
    ahead = approach.ahead(here, lead, dt, (MODE,), relative, turned=False)
    assert (ahead == then - now).all()
