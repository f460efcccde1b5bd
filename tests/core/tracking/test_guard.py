"""The search for an object that is farther away than estimated."""

import numpy as np
import pytest

from linemate.daemon.core.tracking.task import GuardedApproach
from linemate.daemon.core.tracking.touch import contact, guard

DT = 0.012
GUARD = GuardedApproach(speed=0.005, overrun=0.012)
RINGING = contact.tool_vibration(7.0, 0.02, 50e3, 15.0, DT)


def contact_state(force: float, calm: int | None = None) -> contact.ContactState:
    memory = RINGING.memory
    return contact.ContactState((force,) * memory, memory if calm is None else calm)


def after(seconds: float, felt: contact.ContactState) -> guard.ContactSearch:
    search = guard.NO_SEARCH
    for _ in range(round(seconds / DT)):
        search = guard.advanced(search, GUARD, felt, RINGING, DT)
    return search


def test_a_search_advances_at_its_speed_up_to_its_overrun() -> None:
    assert after(1.2, contact_state(0.0)).reach == pytest.approx(0.006)
    assert not guard.has_failed(after(1.2, contact_state(0.0)), GUARD)
    assert after(9.6, contact_state(0.0)).reach == pytest.approx(GUARD.overrun)
    assert guard.has_failed(after(2.5, contact_state(0.0)), GUARD)


@pytest.mark.parametrize(
    "felt", [contact_state(16.0), contact_state(0.0, calm=3), contact.ContactState((0.0, 0.0), 30)]
)
def test_a_search_stands_while_something_presses_or_nothing_can_be_felt(
    felt: contact.ContactState,
) -> None:
    stood = after(1.2, felt)
    assert stood.reach == 0.0
    assert not guard.has_failed(stood, GUARD)
    assert guard.has_failed(after(4.9, felt), GUARD)


def test_a_task_without_an_overrun_never_fails_to_find_its_object() -> None:
    none = GuardedApproach(overrun=0.0)
    assert not guard.has_failed(guard.ContactSearch(0.0, 100.0), none)


def test_the_horizon_goes_on_at_the_speed_of_the_search_and_ends_at_its_bound() -> None:
    relative, span = np.zeros((4, 6)), np.array((0.0, 0.1, 0.2, 1.0))
    search = guard.ContactSearch(0.011, 2.2)
    ahead = guard.reached(relative, search, GUARD, span, is_on=True)
    assert ahead[:, 2].tolist() == pytest.approx([0.011, 0.0115, 0.012, 0.012])
    kept = guard.reached(relative, search, GUARD, span, is_on=False)
    assert kept[:, 2].tolist() == pytest.approx([0.011] * 4)
    assert guard.reached(relative, guard.NO_SEARCH, GUARD, span, is_on=False) is relative
    assert not relative.any()


LONG_AGO = np.full(4, 1.0), 0.1


def test_a_tool_that_has_touched_presses_wherever_the_programme_is() -> None:
    relative = np.zeros((4, 6))
    relative[:, 2] = (-0.009, -0.008, 0.0005, 0.001)
    pressed = guard.pressing(relative, 0.001, 3, LONG_AGO, guard.UNTOUCHED)
    assert pressed[:, 2].tolist() == pytest.approx([0.001] * 4)
    assert relative[0, 2] == -0.009


def test_a_press_that_is_reached_leaves_the_programme_as_it_is() -> None:
    relative = np.full((4, 6), 0.001)
    assert guard.pressing(relative, 0.001, 0, LONG_AGO, guard.UNTOUCHED) is relative


def test_a_way_back_does_not_press() -> None:
    relative = np.zeros((3, 6))
    relative[:, 2] = (0.001, 0.001, -0.1)
    times = np.array((0.0, 0.01, 0.02)), 0.1
    pressed = guard.pressing(relative, 0.001, 0, times, guard.UNTOUCHED)
    assert pressed[2, 2] == -0.1


def test_the_programme_goes_over_into_the_press_without_a_jump() -> None:
    """Touched 3 mm before the estimated object, at 9 mm/s; 0.1 s of motion is commanded."""
    dt, speed, commanded = 0.004, 0.009, 0.1
    since = np.arange(200) * dt
    relative = np.zeros((200, 6))
    relative[:, 2] = -0.003 + speed * since
    duration = guard.pressing_time(speed * commanded - 0.001)
    touched = guard.TouchedProgramme(0.003, 0.0, duration)
    z = guard.pressing(relative, 0.001, 200, (since, commanded), touched)[:, 2]
    early = since <= commanded
    assert z[early] == pytest.approx(speed * since[early])
    assert np.abs(np.diff(z, 2)).max() / dt**2 < guard.ACCELERATION
    assert z[since > commanded + duration] == pytest.approx(0.001)
    assert z.max() < speed * commanded + 0.0005


def test_a_press_takes_longer_from_farther_away() -> None:
    assert guard.pressing_time(0.0) == guard.PRESSING_S
    assert guard.pressing_time(-0.004) == guard.pressing_time(0.004) > 2.0 * guard.PRESSING_S


def test_a_search_goes_on_at_its_speed_until_the_press_takes_over() -> None:
    since = np.array((0.0, 0.05, 0.1))
    touched = guard.TouchedProgramme(0.0002, 0.005)
    relative = np.zeros((3, 6))
    relative[:, 2] = 0.001
    pressed = guard.pressing(relative, 0.001, 0, (since, 0.1), touched)
    assert pressed[:, 2].tolist() == pytest.approx([0.0012, 0.00145, 0.0017])


@pytest.mark.parametrize(
    ("depth", "force", "reach"),
    [(-0.009, -20.0, -0.0094), (0.003, -10.0, 0.0028), (-0.1, 0.0, -0.02)],
)
def test_the_object_is_where_the_tool_touched_less_what_the_mount_gave_way(
    depth: float, force: float, reach: float
) -> None:
    tcp, part = np.zeros(6), np.zeros(6)
    tcp[2] = depth
    assert guard.touched_reach(tcp, part, force, 50e3, 0.02) == pytest.approx(reach)


def test_the_force_of_a_face_is_a_part_of_what_the_mount_gives_over_the_way_on() -> None:
    whole = 50e3 * GuardedApproach().touch_speed * guard.GOES_ON_S
    assert 0.2 * whole < guard.face_force(GuardedApproach(), 50e3) < 0.5 * whole
    # Bolts that are pressed aside in their holes by 60 N rub with up to 30 N.
    least = guard.face_force(GuardedApproach(), 50e3)
    assert guard.face_force(GuardedApproach(), 50e3, 60.0) == pytest.approx(least + 30.0)
