"""When a tool may withdraw, and how far it presses until then."""

import numpy as np
import pytest

from linemate.daemon.core.tracking.observation import Wrench
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.touch import release

NEAR, FAR = 0.0, -0.05


@pytest.mark.parametrize(
    ("contact", "released", "distance", "opening", "clamped"),
    [
        (True, False, NEAR, 0.0, True),
        (True, False, NEAR, 100.0, True),
        (True, True, NEAR, 0.3, False),
        (False, True, NEAR, 0.3, False),
        (False, False, NEAR, None, True),
        (False, False, NEAR, 1.9, True),
        (False, False, NEAR, 2.0, False),
        (False, False, FAR, None, False),
    ],
)
def test_a_tool_is_held_back_while_its_clamp_may_be_closed(
    contact: bool, released: bool, distance: float, opening: float | None, clamped: bool
) -> None:
    assert clamped == release.may_be_clamped(
        contact=contact, released=released, distance=distance, opening=opening, timeout=2.0
    )


def test_a_clamp_is_overdue_only_if_it_was_felt_and_ordered_to_open() -> None:
    assert release.is_overdue(2.0, 2.0, contact=True)
    assert not release.is_overdue(1.99, 2.0, contact=True)
    assert not release.is_overdue(None, 2.0, contact=True)
    assert not release.is_overdue(5.0, 2.0, contact=False)


@pytest.mark.parametrize(
    ("opening", "touching", "distance", "pulls", "nothing"),
    [
        (2.0, 1.9, -0.003, False, True),
        (1.99, 1.9, -0.003, False, False),
        (2.0, 2.1, -0.003, False, False),
        (2.0, 1.9, -0.001, False, False),
        (2.0, 1.9, -0.003, True, False),
    ],
)
def test_a_touch_felt_in_a_retreat_is_none_if_nothing_pulls_at_a_tool_that_stands_off(
    opening: float, touching: float, distance: float, pulls: bool, nothing: bool
) -> None:
    assert nothing is release.holds_nothing(
        opening=opening, timeout=2.0, touching=touching, distance=distance, pulls=pulls
    )


def test_a_clamp_that_was_felt_is_closed_until_it_had_the_time_to_open() -> None:
    assert release.opens(0.29, 0.5)
    assert not release.opens(0.31, 0.5)
    assert not release.opens(0.1, 0.1), "the touch was felt after the order"


@pytest.mark.parametrize(
    ("mean", "swing", "swings"), [(150.0, 0.0, False), (0.0, 200.0, True), (0.0, 100.0, False)]
)
def test_a_free_tool_that_swings_has_a_large_force_and_a_small_mean(
    mean: float, swing: float, swings: bool
) -> None:
    pull, power, found = (0.0, 0.0, 0.0), 0.0, []
    for k in range(500):
        force = np.array((mean + swing * np.sin(2.0 * np.pi * 4.0 * 0.004 * k), 0.0, 0.0))
        wrench = Wrench(force, np.zeros(3), 0, 1)
        pull = release.averaged(pull, wrench, 0.004)
        power = release.averaged_square(power, wrench, 0.004)
        found.append(release.swings(pull, power))
    assert set(found[100:]) == {swings}


def test_a_tool_that_is_to_retreat_does_not_press() -> None:
    relative = np.zeros((3, 6))
    relative[:, 2] = -0.004, 0.0, 0.001
    assert release.without_press(relative)[:, 2].tolist() == [-0.004, 0.0, 0.0]
    assert relative[:, 2].tolist() == [-0.004, 0.0, 0.001]
    assert release.without_press(relative[:2])[:, 2].tolist() == [-0.004, 0.0]


def test_a_tool_that_may_be_clamped_unfelt_stands_off_by_what_its_mount_bears() -> None:
    relative = np.full((3, 6), 0.001)
    relative[:, 2] = -0.012, -0.011, -0.010
    stood = release.at_stand_off(relative)
    # The whole way is moved: a corner in it would be a swing of what is planned from it.
    assert stood[:, 2] == pytest.approx([-0.005, -0.004, -0.003])
    assert np.delete(stood, 2, axis=1).tolist() == np.delete(relative, 2, axis=1).tolist()
    assert relative[0, 2] == -0.012
    relative[2, 2] = -0.002
    assert np.array_equal(release.at_stand_off(relative), relative)


def test_a_mean_force_follows_a_pull_and_not_a_tool_that_rings() -> None:
    dt, pulled, rung = 0.012, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    highest = 0.0
    for k in range(100):
        steady, ring = np.array((60.0, 0.0, 0.0)), np.zeros(3)
        ring[0] = 100.0 * np.sin(2.0 * np.pi * 5.0 * k * dt)
        pulled = release.averaged(pulled, Wrench(steady, np.zeros(3), 0, 1), dt)
        rung = release.averaged(rung, Wrench(ring, np.zeros(3), 0, 1), dt)
        highest = max(highest, abs(rung[0]))
    assert pulled[0] == pytest.approx(60.0, rel=0.01)
    assert highest < 45.0
    assert release.averaged(pulled, None, dt) == pulled


@pytest.mark.parametrize(
    ("power", "pull", "calm"),
    [
        (59.0**2, (20.0, 20.0, -50.0), True),
        (61.0**2, (0.0, 0.0, 0.0), False),
        (0.0, (22.0, 22.0, 0.0), False),
        (0.0, (0.0, 0.0, -200.0), True),
    ],
)
def test_a_clamp_opens_on_an_object_that_neither_swings_nor_pulls_across(
    power: float, pull: tuple[float, float, float], calm: bool
) -> None:
    assert release.is_calm(power, pull) == calm


GATED = ((2.0, Gate.OBJECT_SEEN), (14.0, Gate.SCREWS_FIXED), (15.0, Gate.WHEEL_RELEASED))


def test_the_hub_holds_the_wheel_once_the_programme_has_passed_the_screws() -> None:
    fixed = frozenset({Gate.SCREWS_FIXED})
    assert release.is_held_by_hub(GATED, fixed, 14.1)
    assert not release.is_held_by_hub(GATED, fixed, 14.0)
    assert not release.is_held_by_hub(GATED, frozenset(), 14.1)
    assert not release.is_held_by_hub(GATED[:1], fixed, 14.1)


@pytest.mark.parametrize(("lasting", "gone"), [(release.UNLOADING_S, 0.3), (0.1, 0.2)])
def test_the_press_goes_behind_what_is_commanded_and_is_gone_as_the_clamp_is_open(
    lasting: float, gone: float
) -> None:
    relative = np.zeros((40, 6))
    relative[:, 2] = 0.001
    span = 0.012 * np.arange(40)
    depth = release.unloading(relative, span, 0.1, lasting)[:, 2]
    assert (depth[span <= 0.1] == 0.001).all()
    assert (np.diff(depth) <= 0.0).all()
    assert (np.abs(depth[span >= gone]) < 1e-12).all()
    assert (depth[span < gone - 0.02] > 0.0).all()
    assert (relative[:, 2] == 0.001).all()


def test_a_tool_that_does_not_press_is_not_unloaded() -> None:
    relative = np.full((5, 6), -0.002)
    assert release.unloading(relative, np.full(5, 1.0), 0.1) is relative


def test_a_tool_that_may_hold_nothing_goes_back_to_where_a_closed_clamp_pulls() -> None:
    relative, since = np.zeros((50, 6)), np.linspace(0.0, 1.0, 50)
    relative[:, 2] = 0.001
    depth = release.standing_off(relative, since, 0.1)[:, 2]
    assert depth[0] == 0.0
    assert depth[-1] == pytest.approx(-release.STAND_OFF)
    assert np.abs(np.diff(depth)).max() < 0.0005
    assert relative[0, 2] == 0.001
