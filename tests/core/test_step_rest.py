"""One sampling step: a hold, a retreat, and a tool that is left on the object."""

from functools import cache

import numpy as np
import pytest
from cell import SPEED, World, robot_sample
from msgspec.structs import replace
from step_runs import Assembly, P, assert_within, tracking

from linemate.daemon.core import rotations
from linemate.daemon.core import step as stepping
from linemate.daemon.core.inputs import MotionOrder
from linemate.daemon.core.step import step
from linemate.daemon.core.step_state import FIX_SCREWS, RELEASE_WHEEL, Outputs
from linemate.daemon.core.tracking.estimation.force_use import is_force_used
from linemate.daemon.core.tracking.goal import rest_state
from linemate.daemon.core.tracking.task import Phase
from linemate.daemon.core.tracking.touch.withdrawal import WAY


def test_hold_in_motion_comes_to_rest_within_the_limits_and_stays_there(assembly: Assembly) -> None:
    k = next(i for i, outputs in enumerate(assembly.outputs) if (outputs.task_time or 0.0) > 2.0)
    before = [outputs.command for outputs in assembly.outputs[:k]]
    state = assembly.states[k]
    assert np.abs(state.control.limiter.speed).max() > 0.05
    commands = []
    for inputs in assembly.inputs[k : k + 80]:
        state, outputs = step(state, replace(inputs, order=MotionOrder.HOLD), P)
        commands.append(outputs.command)
    assert_within([*before, *commands])
    assert len(set(commands[-20:])) == 1
    assert not state.moving


def test_after_a_hold_the_task_can_start_again_only_from_its_first_pose() -> None:
    world = tracking(2.4)
    world.run(0.8, MotionOrder.HOLD)
    assert world.outputs is not None
    assert world.outputs.task_time is None
    assert world.outputs.ready is not None
    assert "away from the task's first pose" in world.outputs.ready


def test_a_retreat_withdraws_straight_back_and_says_when_it_is_over() -> None:
    world = tracking(2.4)
    outputs = world.outputs
    assert outputs is not None
    commands = [outputs.command]
    world.run(0.3, MotionOrder.RETREAT, each=lambda o: commands.append(o.command))
    assert world.outputs is not None
    assert not world.outputs.finished
    assert world.outputs.phase is Phase.RETREAT
    # A clamp that opens in free air drops what it holds.
    assert world.outputs.digital_out == 0
    world.run(1.2, MotionOrder.RETREAT, each=lambda o: commands.append(o.command))
    assert world.outputs.finished
    assert world.outputs.sensed is not None
    tool = rotations.matrix(world.outputs.target[3:])
    way = tool.T @ (np.array(world.outputs.target[:3]) - world.outputs.sensed[:3])
    assert way[2] < -0.1
    assert np.isfinite(commands).all()


@pytest.mark.parametrize("lost", [3, 8])
def test_a_retreat_that_lost_its_commands_goes_on_from_rest(lost: int) -> None:
    world = tracking(2.4)
    world.run(0.24, MotionOrder.RETREAT)
    assert world.outputs is not None
    stands = world.outputs.command
    for _ in range(lost):
        world.step(MotionOrder.RETREAT, sent=False, applied=stands)
    assert world.outputs.command == stands
    gone = world.state.tracker.gone
    assert 0.0 < gone < WAY
    held = set()
    world.run(1.2, MotionOrder.RETREAT, each=lambda o: held.add(o.held))
    assert held <= {None, "limited: tcp"}
    assert world.outputs.finished
    assert world.state.tracker.gone == gone


def test_a_retreat_goes_on_for_a_second_towards_where_the_programme_leaves_the_object() -> None:
    world = on_the_object().fork()
    for _ in range(round(1.3 / P.cycle_s)):
        inputs = world.inputs(MotionOrder.RETREAT)
        assert inputs.robot is not None
        world.take(replace(inputs, robot=replace(inputs.robot, digital_in=2)))
    assert world.outputs is not None
    assert world.outputs.finished
    assert -depth(world.outputs) == pytest.approx(WAY + world.state.tracker.further, abs=0.01)
    # The shipped body's plane comes 0.18 m nearer as it goes on past the tool.
    assert -depth(world.outputs) > 0.21


def test_a_tool_that_leaves_the_object_does_not_catch_up_with_commands_that_were_lost(
    assembly: Assembly,
) -> None:
    """A catch-up at twice the speed shook the free tool with 422 N half a period after its stop."""
    released = next(k for k, o in enumerate(assembly.outputs) if o.phase is Phase.RETREAT)
    k = next(k for k in range(released, 10**6) if assembly.states[k].tracker.distance < -0.05)
    state, stands = assembly.states[k], assembly.states[k].applied
    plain = np.diff([outputs.command for outputs in assembly.outputs[k : k + 80]], axis=0)
    commands = []
    for i, inputs in enumerate(assembly.inputs[k : k + 80]):
        lost = {"sent": False, "applied": tuple(stands.tolist())} if i < 8 else {}
        state, outputs = step(state, replace(inputs, **lost), P)
        commands.append(outputs.command)
    steps = np.linalg.norm(np.diff(commands[7:], axis=0), axis=1)
    usual = np.linalg.norm(plain, axis=1)
    assert steps.max() < 1.1 * usual.max()
    # Two halves of a start, half a period of the free tool apart, cancel each other's swing.
    assert steps[1:8].mean() == pytest.approx(0.5 * usual[:8].mean(), rel=0.1)


def ways_after_silence(assembly: Assembly, silent: int, *, is_open: bool) -> np.ndarray:
    """Return the way of each command (n,) along the conveyor after some lost ones [m].

    They begin 0.26 s after the clamp was ordered to open.
    """
    world, k = World(P), next(k for k, o in enumerate(assembly.outputs) if o.digital_out & 2)
    world.k, world.state, world.outputs = k, assembly.states[k], assembly.outputs[k - 1]
    world.run(0.26, MotionOrder.TRACK)
    stands = world.state.applied
    lost = {"sent": False, "applied": tuple(stands.tolist())}
    for _ in range(silent):
        world.step(MotionOrder.TRACK, robot=None, **lost)
    commands = [stands]
    for i in range(12):
        bits = RELEASE_WHEEL if is_open else 0
        robot = robot_sample(world.stamp_ns - world.period_ns, world.joints, bits)
        # The first telegram after the silence still reports that its own command was lost.
        world.step(MotionOrder.TRACK, robot=robot if i else None, **({} if i else lost))
        commands.append(np.array(world.outputs.command))
    nominal, arm = P.tracker.reference.nominal, P.controller.arm
    return np.diff([arm.tcp_in(nominal, joints)[1] for joints in commands])


def test_a_tool_whose_clamp_opened_in_silence_does_not_catch_up(assembly: Assembly) -> None:
    """The catch-up swung the free tool with 226 N after 84 ms, and with 347 N after 108 ms."""
    ways = ways_after_silence(assembly, 5, is_open=True)
    assert ways == pytest.approx(SPEED * 0.012, rel=0.6)


def test_a_tool_that_is_still_clamped_after_a_silence_catches_up(assembly: Assembly) -> None:
    """It waits for the first telegram: the clamp should have opened in the silence."""
    ways = ways_after_silence(assembly, 5, is_open=False)
    assert ways[0] == pytest.approx(SPEED * 0.012, rel=0.1)
    assert ways.sum() == pytest.approx(18 * SPEED * 0.012, rel=0.05)


def test_a_tool_that_may_be_free_catches_up_with_more_than_half_of_a_large_lag(
    assembly: Assembly,
) -> None:
    """One that kept 10 mm was dragged along the hub; one that caught up with all swung by 447 N."""
    ways = ways_after_silence(assembly, 8, is_open=True)
    assert ways[0] == pytest.approx((1.0 + 0.6 * 9.0) * SPEED * 0.012, rel=0.1)
    assert ways[1:] == pytest.approx(SPEED * 0.012, rel=0.6)


def test_a_free_tool_that_brakes_on_hold_stands_before_it_withdraws() -> None:
    world = tracking(2.4)
    world.run(0.06, MotionOrder.HOLD)
    speeds = [np.abs(world.state.control.limiter.speed).max()]
    assert world.state.moving
    while world.state.tracker.anchor is None:
        world.step(MotionOrder.RETREAT)
        speeds.append(np.abs(world.state.control.limiter.speed).max())
    *braking, _ = speeds
    assert (np.diff(braking) <= 1e-9).all()
    assert braking[-1] == 0.0
    world.run(1.2, MotionOrder.RETREAT)
    assert world.outputs is not None
    assert world.outputs.finished


@pytest.mark.row
@pytest.mark.long
@pytest.mark.parametrize("begun", [5.3, 5.5, 5.6])
def test_a_retreat_before_contact_stands_still_and_withdraws(begun: float) -> None:
    """Led on towards the object, the tool would come to it: 0.2 s later it touches."""
    world = tracking(begun)
    assert world.outputs is not None
    assert not world.outputs.contact
    assert world.outputs.task_time is not None
    assert world.outputs.task_time < P.tracker.reference.contact_time
    outcome: list[Outputs] = []
    # A tool that may be clamped waits for its clamp's time-out of 2 s.
    world.run(3.2, MotionOrder.RETREAT, each=outcome.append)
    assert {o.task_time for o in outcome} == {world.outputs.task_time}
    depths = [depth(o) for o in outcome]
    # Commands that were sent before go on for a while.
    assert max(depths) < -0.001
    assert depths[-1] < -0.1
    assert outcome[-1].finished


def depth(outputs: Outputs) -> float:
    """Return how far the commanded tool is beyond the object, along its own axis [m]."""
    assert outputs.part is not None
    tool = rotations.matrix(outputs.target[3:])
    return float((tool.T @ (np.array(outputs.target[:3]) - outputs.part[:3]))[2])


def test_no_screws_are_ordered_in_a_retreat() -> None:
    world = tracking(9.0)
    assert world.outputs is not None
    assert world.outputs.digital_out == FIX_SCREWS
    outcome: list[Outputs] = []
    world.run(0.5, MotionOrder.RETREAT, each=outcome.append)
    assert {o.digital_out for o in outcome} == {RELEASE_WHEEL}


@cache
def on_the_object() -> World:
    """A tool that was clamped for half a second when the robot was ordered to hold."""
    world = tracking(7.0)
    assert world.outputs is not None
    assert world.outputs.contact
    world.run(0.5, MotionOrder.HOLD)
    return world


def test_a_tool_that_is_held_on_the_object_is_asked_to_release_it_and_stays_in_contact() -> None:
    outputs = on_the_object().outputs
    assert outputs is not None
    assert outputs.digital_out == RELEASE_WHEEL
    assert outputs.contact


def test_from_there_it_follows_the_object_and_withdraws_once_it_is_released() -> None:
    world = on_the_object().fork()
    world.run(0.4, MotionOrder.RETREAT)
    assert world.outputs is not None
    assert world.outputs.clamped
    speed = np.array(world.outputs.target[:3])
    world.step(MotionOrder.RETREAT)
    moved = np.array(world.outputs.target[:3]) - speed
    assert np.linalg.norm(moved) / P.cycle_s == pytest.approx(SPEED, rel=0.3)
    for _ in range(round(1.0 / P.cycle_s)):
        inputs = world.inputs(MotionOrder.RETREAT)
        assert inputs.robot is not None
        world.take(replace(inputs, robot=replace(inputs.robot, digital_in=2)))
    assert world.outputs.finished
    assert not world.outputs.contact


@pytest.mark.parametrize(
    ("withdrawn", "is_on_it"),
    [(None, True), (0.3, True), (P.tracker.withdrawal.duration + 0.01, False)],
)
def test_a_tool_that_was_withdrawn_is_not_on_the_object_any_more(
    withdrawn: float | None, *, is_on_it: bool
) -> None:
    there = replace(on_the_object().state.tracker, withdrawn=withdrawn)
    rested = rest_state.rest(P.tracker, there, there.poses[0], 0.0)
    assert rested.contact == is_on_it
    assert rested.started == is_on_it
    assert rested.withdrawn is None


def test_a_tool_at_rest_that_may_be_clamped_measures_the_object_once_its_clamp_pulls() -> None:
    """A free one that swung after lost telegrams took the object to where it was, and held on."""
    on_it = replace(on_the_object().state.tracker, touching=0.05, releasing=0.1)
    there = replace(on_it, contact=False, clamped=True, pull=(0.0, 20.0, 0.0), pull_power=70.0**2)
    rested = rest_state.rest(P.tracker, there, there.poses[0], 0.0)
    assert rested.contact
    assert not is_force_used(P.tracker, rested, None)
    assert is_force_used(P.tracker, replace(rested, pull=(0.0, 80.0, 0.0)), None)
    felt = rest_state.rest(P.tracker, replace(there, contact=True), there.poses[0], 0.0)
    assert is_force_used(P.tracker, felt, None)


def test_a_controller_that_begins_again_there_finds_the_tool_on_the_object() -> None:
    world = on_the_object()
    there = robot_sample(world.stamp_ns, world.command)
    assert stepping.is_engaged(world.state, P, there)
    state = stepping.resumed(P, world.state, there)
    assert state.tracker.contact
    assert state.tracker.conveyor is world.state.tracker.conveyor
    assert not state.moving
    away = robot_sample(world.stamp_ns, (world.command[0] + 0.1, *world.command[1:]))
    assert not stepping.is_engaged(world.state, P, away)
