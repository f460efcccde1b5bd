"""The last approach where the camera is wrong or covered, judged by the plant's own force."""

import pytest
from contact_runs import live

from linemate.daemon.cycle.states import State
from linemate.simulators.plants.scenario import Fault

TOUCH_N = 80.0
NEARER_N = 85.0
HELD_N = 200.0
CAMERA_Z = -0.15
FARTHEST_MM = 12.0
STANDING = "scenario.conveyor.events=[{kind: stop, onset_s: 3.0, acceleration: 0.104}]"


def farther(by_mm: float) -> tuple[str, ...]:
    """Return the scenario of a camera by which the hub seems nearer than it is."""
    return (f"scenario.camera.position_in_tcp=[-0.10, 0.0, {CAMERA_Z + 1e-3 * by_mm}]",)


@pytest.mark.parametrize("by_mm", [2.0, 5.0, 10.0])
def test_an_object_farther_than_estimated_is_found_at_a_bounded_speed(by_mm: float) -> None:
    lived = live(overrides=farther(by_mm))
    assert lived.collision is None
    assert (lived.contact, lived.state) == ("clamped", State.CONTACT)
    assert lived.force_n < TOUCH_N


@pytest.mark.parametrize("by_mm", [1.0, 2.0, 5.0, 10.0])
def test_an_object_nearer_than_estimated_is_touched_at_a_bounded_speed(by_mm: float) -> None:
    # The line stands from before the touch on: a stop in contact has forces of its own.
    overrides = (*farther(-by_mm), STANDING)
    lived = live(scenario="stop-early", overrides=overrides, until_s=11.0)
    assert lived.collision is None
    assert (lived.contact, lived.state) == ("clamped", State.CONTACT)
    assert lived.force_n < NEARER_N


def test_an_object_nearer_than_the_slow_approach_costs_no_mount() -> None:
    lived = live(overrides=farther(-FARTHEST_MM))
    assert (lived.collision, lived.contact) == (None, "clamped")
    assert lived.force_n < HELD_N


def test_a_search_without_contact_ends_at_its_bound_with_the_reason() -> None:
    lived = live(overrides=farther(FARTHEST_MM + 3.0), until_s=9.5)
    assert lived.collision is None
    assert lived.contact == "free"
    assert lived.because.startswith("no contact")


@pytest.mark.parametrize(
    ("at_s", "lasting_s"),
    [
        pytest.param(5.5, 0.3, id="0.3 s before contact"),
        pytest.param(4.5, 0.5, id="at the last waypoint"),
        pytest.param(4.65, 1.5, id="in all of the last approach"),
    ],
)
def test_a_camera_that_is_covered_before_contact_does_not_end_the_assembly(
    at_s: float, lasting_s: float
) -> None:
    lived = live(Fault(at_s, "camera", "silence", lasting_s))
    assert lived.collision is None
    assert (lived.contact, lived.state) == ("clamped", State.CONTACT)
    assert lived.force_n < TOUCH_N


def both_silent(at_s: float, lasting_s: float) -> tuple[Fault, Fault]:
    """Return faults in which neither distance nor camera sends anything."""
    return tuple(Fault(at_s, link, "silence", lasting_s) for link in ("distance", "camera"))


def test_a_tool_that_sees_nothing_for_a_moment_waits_and_goes_on() -> None:
    silence = both_silent(4.9, 0.25)
    waiting = live(*silence, until_s=6.0)
    assert (waiting.contact, waiting.state) == ("free", State.TRACK)
    lived = live(*silence, until_s=11.0)
    assert lived.collision is None
    assert (lived.contact, lived.state) == ("clamped", State.CONTACT)
    assert lived.force_n < TOUCH_N


def test_a_tool_that_sees_nothing_just_before_the_touch_does_not_touch() -> None:
    lived = live(*both_silent(5.45, 1.0), until_s=9.0)
    assert (lived.collision, lived.contact) == (None, "free")
    assert lived.because == "retreated with a fault"


def test_a_camera_that_stays_covered_holds_the_tool_before_it_touches() -> None:
    lived = live(Fault(3.8, "camera", "silence", 2.0))
    assert (lived.contact, lived.state, lived.because) == ("free", State.HOLD, "no fresh position")


def test_a_camera_that_is_blind_from_80_mm_on_holds_the_tool_before_it_touches() -> None:
    lived = live(overrides=("scenario.camera.blind_below=0.08",))
    assert (lived.contact, lived.state) == ("free", State.HOLD)


@pytest.mark.parametrize("at_s", [3.2, 3.8])
@pytest.mark.parametrize("component", [1, 3])
def test_a_camera_that_is_30_mm_off_before_contact_ends_the_approach(
    at_s: float, component: int
) -> None:
    lived = live(Fault(at_s, "camera", "offset", 20.0, 0.03, component), until_s=7.0)
    assert lived.collision is None
    assert lived.contact == "free"
    assert lived.state in {State.HOLD, State.FAULT}


def test_a_distance_that_freezes_in_the_last_approach_ends_it_before_the_touch() -> None:
    # The conveyor brakes from 5 s on: the estimate stays behind the object.
    lived = live(Fault(5.3, "distance", "stuck", 20.0), until_s=9.0)
    assert lived.collision is None
    assert lived.contact == "free"
    assert (lived.state, lived.because) == (State.FAULT, "retreated with a fault")
