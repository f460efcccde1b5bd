"""A contact is felt at once, and a tool that rings in the air is not taken for one."""

import math
import random
from collections.abc import Callable

import pytest

from linemate.daemon.core.tracking.touch.contact import (
    NEAR,
    NO_CONTACT,
    OFF_M,
    PULL,
    TOUCHES,
    ContactState,
    ToolVibration,
    assume_touch,
    count_touches,
    is_contact,
    is_held_across,
    is_push,
    may_rub,
    record_across,
    record_force,
    tool_vibration,
)

FREQUENCY, DAMPING, STIFFNESS, FORCE = 7.0, 0.02, 50e3, 15.0


def rung(t: float, amplitude: float, frequency: float = FREQUENCY) -> float:
    """The force of a tool that was kicked at 0."""
    w = math.tau * frequency
    return amplitude * math.exp(-DAMPING * w * t) * math.sin(w * t) if t > 0.0 else 0.0


def first_touch(
    cycle_s: float,
    forces: list[float | None],
    *,
    held: int | None = None,
    distance: float = 0.0,
    mode: ToolVibration | None = None,
    accelerations: list[float] | None = None,
) -> int | None:
    mode = mode or tool_vibration(FREQUENCY, DAMPING, STIFFNESS, FORCE, cycle_s)
    contact_state: ContactState = NO_CONTACT
    for k, force in enumerate(forces):
        acceleration = accelerations[k] if accelerations else 0.0
        contact_state = record_force(contact_state, mode, force, acceleration, held=k == held)
        contact_state = count_touches(contact_state, mode, distance, NEAR, is_new=force is not None)
        if contact_state.touches >= 2:
            return k
    return None


def test_one_sample_that_several_steps_have_is_one_touch() -> None:
    """A sensor of 250 Hz in a cycle of 1 ms: every fourth step has a sample."""
    free = [0.0 if k % 4 == 0 else None for k in range(800)]
    assert first_touch(0.001, [*free, -40.0, None, None, None, 0.0, None]) is None
    assert first_touch(0.001, [*free, -40.0, None, None, None, -40.0, None]) == 804


def test_an_acceleration_of_a_few_milliseconds_that_is_planned_alone_is_no_contact() -> None:
    """A plan that loses 9 mm/s within 6 ms; the servos round it off to 3 N."""
    steps, begin = 900, 800
    planned = [-1.42 if begin <= k < begin + 6 else 0.0 for k in range(steps)]
    felt = [3.0 * math.sin(0.075 * (k - begin)) if k >= begin else 0.0 for k in range(steps)]
    assert first_touch(0.001, list(felt), accelerations=planned) is None


@pytest.mark.parametrize("cycle_s", [0.012, 0.004, 0.001])
def test_a_tool_that_rings_does_not_touch(cycle_s: float) -> None:
    chance = random.Random(1)
    steps = round(3.0 / cycle_s)
    kick = round(1.0 / cycle_s)
    forces = [
        6.0 + rung((k - kick) * cycle_s, 100.0) + chance.gauss(0.0, 1.5) for k in range(steps)
    ]
    assert first_touch(cycle_s, list(forces), held=kick) is None


@pytest.mark.parametrize("cycle_s", [0.012, 0.004])
def test_nor_does_one_whose_mode_is_a_twentieth_off(cycle_s: float) -> None:
    steps, kick = round(3.0 / cycle_s), round(1.0 / cycle_s)
    for off in (0.95, 1.05):
        forces = [rung((k - kick) * cycle_s, 60.0, off * FREQUENCY) for k in range(steps)]
        assert first_touch(cycle_s, list(forces), held=kick) is None


def approached(cycle_s: float, share: float, pressed: float) -> int | None:
    """The step after 3 s at which a press is felt, less than 0 for a touch before it is pressed.

    The tool rings by 40 N, on a mount of that share of its stiffness, as it comes near the object
    after 2 s.
    """
    frequency = math.sqrt(share) * FREQUENCY
    amplitude = 40.0 * math.exp(2.0 * DAMPING * math.tau * frequency)
    mode = tool_vibration(FREQUENCY, DAMPING, STIFFNESS, FORCE, cycle_s)
    state, made = NO_CONTACT, round(3.0 / cycle_s)
    for k in range(made + round(0.3 / cycle_s)):
        force = rung(k * cycle_s, amplitude, frequency)
        force -= min(pressed, max(0.0, (k - made) * cycle_s * 800.0))
        distance = -0.05 if k * cycle_s < 2.0 else 0.0
        state = record_force(state, mode, force, 0.0, held=False)
        state = count_touches(state, mode, distance, NEAR)
        if state.touches >= TOUCHES:
            return k - made
    return None


@pytest.mark.parametrize("cycle_s", [0.012, 0.004])
@pytest.mark.parametrize("share", [0.45, 0.57, 0.75, 1.4, 2.0])
def test_a_tool_that_rings_on_a_mount_of_another_stiffness_does_not_touch(
    cycle_s: float, share: float
) -> None:
    assert approached(cycle_s, share, 0.0) is None


@pytest.mark.parametrize("cycle_s", [0.012, 0.004])
@pytest.mark.parametrize("share", [0.57, 1.0, 1.4])
def test_a_tool_that_rings_on_such_a_mount_feels_a_contact_that_grows(
    cycle_s: float, share: float
) -> None:
    found = approached(cycle_s, share, 90.0)
    assert found is not None
    assert 0.0 < found * cycle_s <= 0.5 / FREQUENCY + 0.06


@pytest.mark.parametrize("cycle_s", [0.012, 0.004])
@pytest.mark.parametrize("amplitude", [0.0, 60.0])
def test_a_contact_is_felt_within_two_steps_of_its_force_also_while_ringing(
    cycle_s: float, amplitude: float
) -> None:
    kick, made = round(1.0 / cycle_s), round(1.6 / cycle_s)
    rate = 800.0  # a millimetre of 50 N in 60 ms [N/s]
    forces = [
        6.0
        + rung((k - kick) * cycle_s, amplitude)
        - min(50.0, max(0.0, (k - made) * cycle_s * rate))
        for k in range(made + round(0.2 / cycle_s))
    ]
    found = first_touch(cycle_s, list(forces), held=kick)
    assert found is not None
    enough = made + math.ceil(1.3 * FORCE / rate / cycle_s)
    assert made < found <= enough + 2


def test_weight_and_bias_are_no_contact() -> None:
    assert first_touch(0.004, [40.0] * 500) is None


@pytest.mark.parametrize("cycle_s", [0.012, 0.004])
def test_the_force_that_brakes_the_tool_as_planned_is_no_contact(cycle_s: float) -> None:
    mass = STIFFNESS / (math.tau * FREQUENCY) ** 2
    steps = round(1.0 / cycle_s)
    accelerations = [1.2 * math.sin(math.tau * k / steps) for k in range(steps)]
    forces: list[float | None] = [-mass * a for a in accelerations]
    assert first_touch(cycle_s, forces) is not None
    assert first_touch(cycle_s, forces, accelerations=accelerations) is None


@pytest.mark.parametrize("cycle_s", [0.012, 0.004])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_tool_that_begins_to_ring_near_the_object_does_not_touch(
    cycle_s: float, sign: float
) -> None:
    # The first half of a swing is in the mean of the period before, and the second is not.
    mode = tool_vibration(FREQUENCY, DAMPING, STIFFNESS, FORCE, cycle_s)
    contact_state, kick = NO_CONTACT, round(1.1 / cycle_s)
    for k in range(round(2.0 / cycle_s)):
        force = -4.0 + sign * rung((k - kick) * cycle_s, 42.0)
        distance = -0.05 if k * cycle_s < 1.0 else 0.0
        contact_state = count_touches(
            record_force(contact_state, mode, force, 0.0, held=False), mode, distance, NEAR
        )
        # The first quarter of a swing may be a contact, for there is no telling yet.
        if sign < 0.0 and 0.0 <= (k - kick) * cycle_s < 0.5 / FREQUENCY + 0.02:
            contact_state = ContactState(
                contact_state.forces, contact_state.calm, 0, contact_state.free
            )
        assert contact_state.touches < TOUCHES


@pytest.mark.parametrize(("times", "is_felt"), [(0.9 * PULL, False), (1.3 * PULL, True)])
def test_a_pull_towards_the_object_is_a_contact_only_if_it_is_strong(
    times: float, is_felt: bool
) -> None:
    forces: list[float | None] = [0.0] * 100 + [times * FORCE] * 10
    assert (first_touch(0.004, forces) is not None) == is_felt


def test_far_from_the_object_nothing_is_a_contact() -> None:
    forces: list[float | None] = [0.0] * 100 + [-60.0] * 10
    assert first_touch(0.004, forces, distance=-0.05) is None


def test_a_contact_is_felt_beyond_the_estimated_object_too() -> None:
    forces: list[float | None] = [0.0] * 100 + [-60.0] * 10
    assert first_touch(0.004, forces, distance=0.012) is not None
    assert first_touch(0.004, forces, distance=-0.005) == 101


def test_while_it_remembers_the_time_before_the_robot_held_nothing_is_reported() -> None:
    memory = tool_vibration(FREQUENCY, DAMPING, STIFFNESS, FORCE, 0.004).memory
    assert memory * 0.004 == pytest.approx(1.5 / FREQUENCY, abs=0.012)
    forces: list[float | None] = [6.0] * 100 + [-0.5 * k for k in range(200)]
    assert first_touch(0.004, forces, held=100) == 100 + memory + 1


def often_held(cycle_s: float, seconds: float, lost: float, press: float) -> int | None:
    """Return the step of the first contact for a robot that loses replies again and again.

    Each lost reply kicks the tool. It comes near the object after 1 s and is pressed 0.1 s later.
    """
    mode = tool_vibration(FREQUENCY, DAMPING, STIFFNESS, FORCE, cycle_s)
    chance = random.Random(3)
    contact_state, kicks = NO_CONTACT, list[int]()
    for k in range(round(seconds / cycle_s)):
        held = chance.random() < lost
        if held:
            kicks.append(k)
        force = 6.0 + sum(rung((k - kick) * cycle_s, 30.0) for kick in kicks)
        force += press if k * cycle_s >= 1.1 else 0.0
        distance = -0.05 if k * cycle_s < 1.0 else 0.0
        contact_state = count_touches(
            record_force(contact_state, mode, force, 0.0, held=held), mode, distance, NEAR
        )
        if contact_state.touches >= TOUCHES:
            return k
    return None


@pytest.mark.parametrize(("cycle_s", "lost"), [(0.012, 0.2), (0.004, 0.1)])
@pytest.mark.parametrize("press", [-180.0, 180.0])
def test_a_contact_is_felt_within_a_period_although_replies_are_lost_all_the_time(
    cycle_s: float, lost: float, press: float
) -> None:
    found = often_held(cycle_s, 2.0, lost, press)
    assert found is not None
    assert 1.1 < found * cycle_s <= 1.1 + 2.0 / FREQUENCY


@pytest.mark.parametrize(("cycle_s", "lost"), [(0.012, 0.2), (0.004, 0.1)])
def test_a_tool_that_lost_replies_kick_again_and_again_does_not_touch(
    cycle_s: float, lost: float
) -> None:
    assert often_held(cycle_s, 6.0, lost, 0.0) is None


def test_a_step_without_a_force_repeats_the_last_one_and_memory_is_bounded() -> None:
    mode = tool_vibration(FREQUENCY, DAMPING, STIFFNESS, FORCE, 0.004)
    contact_state = record_force(NO_CONTACT, mode, None, 0.0, held=False)
    assert contact_state.forces == ()
    for force in [1.0, None, 2.0] * 100:
        contact_state = record_force(contact_state, mode, force, 0.0, held=False)
    assert contact_state.forces[-3:] == (1.0, 1.0, 2.0)
    assert len(contact_state.forces) == mode.memory


def test_without_a_force_sensor_a_touch_is_assumed_at_the_place_when_it_is_due() -> None:
    contact_state = NO_CONTACT
    for _ in range(TOUCHES):
        contact_state = assume_touch(contact_state, 0.001, is_due=True)
    assert contact_state.touches == TOUCHES
    assert assume_touch(contact_state, 0.001, is_due=False).touches == 0


@pytest.mark.parametrize("distance", [-0.02, math.inf])
def test_without_a_force_sensor_no_touch_is_assumed_far_from_the_object(distance: float) -> None:
    assert assume_touch(NO_CONTACT, distance, is_due=True).touches == 0


@pytest.mark.parametrize(
    ("reach", "rubs"), [(-0.002, False), (-0.004, True), (-0.024, True), (-0.026, False)]
)
def test_bolts_may_rub_between_their_length_and_the_face(reach: float, rubs: bool) -> None:
    assert may_rub(reach, 0.025) is rubs
    assert not may_rub(reach, 0.0)


@pytest.mark.parametrize(("pushed", "felt"), [(18.0, False), (26.0, True)])
def test_a_contact_can_be_asked_for_with_another_least_force(pushed: float, felt: bool) -> None:
    cycle_s = 0.012
    mode = tool_vibration(FREQUENCY, DAMPING, STIFFNESS, FORCE, cycle_s)
    state = NO_CONTACT
    for k in range(60):
        state = record_force(state, mode, -pushed if k > 58 else 0.0, 0.0, held=False)
    assert is_contact(state, mode)
    assert is_contact(state, mode, 22.0) is felt


@pytest.mark.parametrize(("force", "pushes"), [(-40.0, True), (100.0, False)])
def test_a_pull_is_a_contact_and_no_push(force: float, pushes: bool) -> None:
    mode = tool_vibration(FREQUENCY, DAMPING, STIFFNESS, FORCE, 0.012)
    state = NO_CONTACT
    for k in range(60):
        state = record_force(state, mode, force if k > 58 else 0.0, 0.0, held=False)
    assert is_contact(state, mode, 22.0)
    assert is_push(state, mode, 22.0) is pushes


@pytest.mark.parametrize(
    ("samples", "touches"), [((), 1), ((0.0,), 1), ((-3.0, 0.0, 3.0), 3), ((-40.0, 20.0, 20.0), 1)]
)
def test_a_step_whose_samples_all_show_the_contact_needs_no_second_step(
    samples: tuple[float, ...], touches: int
) -> None:
    mode = tool_vibration(FREQUENCY, DAMPING, STIFFNESS, FORCE, 0.012)
    state = NO_CONTACT
    for _ in range(60):
        state = record_force(state, mode, 0.0, 0.0, held=False, samples=(-30.0, 30.0))
        state = count_touches(state, mode, 0.0, NEAR)
    assert state.touches == 0
    state = record_force(state, mode, -25.0, 0.0, held=False, samples=samples)
    assert count_touches(state, mode, 0.0, NEAR).touches == touches


def drifted(
    rate: float, distance_at: Callable[[float], float], *, off: float = OFF_M
) -> ContactState:
    """Return the state of a tool whose sensor drifts for 0.4 s, after a second of rest."""
    mode = tool_vibration(FREQUENCY, DAMPING, STIFFNESS, FORCE, 0.012)
    state: ContactState = NO_CONTACT
    for k in range(117):
        t = 0.012 * k - 1.0
        state = record_force(state, mode, rate * max(t, 0.0), 0.0, held=False)
        state = count_touches(state, mode, distance_at(t), 0.014, off=off)
        if state.touches >= TOUCHES:
            break
    return state


@pytest.mark.parametrize("rate", [250.0, -150.0])
def test_a_force_that_drifts_while_the_tool_stands_before_the_object_is_doubted(
    rate: float,
) -> None:
    """Fault seed 30234: a clamp closed on nothing 12 mm before the hub."""
    felt = drifted(rate, lambda _: -0.012)
    assert felt.touches == 0
    assert felt.doubtful


def test_a_force_of_a_tool_that_may_be_clamped_is_not_doubted() -> None:
    felt = drifted(-150.0, lambda _: -0.012, off=math.inf)
    assert felt.touches == TOUCHES
    assert not felt.doubtful


@pytest.mark.parametrize("speed", [0.002, 0.004, 0.009, 0.02])
def test_a_tool_that_advances_feels_a_touch_at_any_speed_and_none_is_doubted(speed: float) -> None:
    felt = drifted(-STIFFNESS * speed, lambda t: min(t, 0.4) * speed - 0.008)
    assert felt.touches == TOUCHES
    assert not felt.doubtful


@pytest.mark.parametrize("speed", [0.004, 0.009, 0.02])
def test_a_force_that_grows_less_than_the_mount_is_pressed_is_no_touch(speed: float) -> None:
    felt = drifted(-0.2 * STIFFNESS * speed, lambda t: t * speed - 0.008)
    assert felt.touches == 0
    assert not felt.doubtful


def test_a_pull_is_doubted_before_the_object_also_while_the_tool_advances() -> None:
    felt = drifted(900.0, lambda t: min(t, 0.4) * 0.009 - 0.012)
    assert felt.touches == 0
    assert felt.doubtful


def held_across(
    forces: list[float], frequency: float = FREQUENCY, planned: list[float] | None = None
) -> int | None:
    """The step in which a clamp is felt that pulls across the tool's axis.

    Args:
        planned: accelerations of the tool [m/s^2].
    """
    cycle_s, state = 0.012, NO_CONTACT
    axial = tool_vibration(FREQUENCY, DAMPING, STIFFNESS, FORCE, cycle_s)
    mode = tool_vibration(frequency, DAMPING, STIFFNESS, FORCE, cycle_s)
    for k, force in enumerate(forces):
        state = record_force(state, axial, 0.0, 0.0, held=False)
        acceleration = 0.0 if planned is None else planned[k]
        state = record_across(state, (mode, mode), (2.0, force), (0.0, acceleration), held=False)
        if is_held_across(state, (mode, mode)):
            return k
    return None


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_clamp_that_closes_off_the_objects_axis_is_felt_across(side: float) -> None:
    """Along the axis it presses with less than a contact's force."""
    assert held_across([0.0] * 40 + [side * 18.0 * k for k in range(1, 9)]) == 42


@pytest.mark.parametrize("share", [0.85, 1.0, 1.15])
def test_a_tool_that_rings_across_is_not_held(share: float) -> None:
    ringing = [6.0 + rung(k * 0.012, 150.0, share * FREQUENCY) for k in range(-40, 80)]
    assert held_across(ringing[40 + 7 :]) is None


def test_a_tool_that_its_own_plan_swings_across_is_not_held() -> None:
    """The target of a blind tool is corrected by 12 mm as readings contradict it."""
    push = [6.0 * math.sin(math.pi * k / 8) for k in range(9)]
    planned = [0.0] * 40 + push + [-a for a in push] + [0.0] * 40
    mass = STIFFNESS / (2.0 * math.pi * FREQUENCY) ** 2
    # The tool follows its plan, a step late.
    forces = [-mass * a for a in (0.0, *planned[:-1])]
    assert held_across(forces) is not None
    assert held_across(forces, planned=planned) is None


def test_less_than_a_clamp_gives_is_not_held_across() -> None:
    assert held_across([0.0] * 40 + [PULL * FORCE - 1.0] * 40) is None
