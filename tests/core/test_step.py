"""One sampling step: pure, committed to its outputs, and never beyond its limits."""

import dataclasses as dc
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
from cell import AXIS, EPOCH_NS, REST, SPEED, World, object_at, parameters, robot_sample
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core import step as stepping
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.inputs import Inputs, MotionOrder
from linemate.daemon.core.step import (
    FIX_SCREWS,
    RELEASE_WHEEL,
    Outputs,
    StepState,
    finish,
    initial,
    plan,
    step,
)
from linemate.daemon.core.tracking import observation, tracker, tracker_state
from linemate.daemon.core.tracking.estimation import bolt_corrections, contact_compliance
from linemate.daemon.core.tracking.estimation import estimate as estimation
from linemate.daemon.core.tracking.goal import rest_state
from linemate.daemon.core.tracking.settings import PayloadSettings
from linemate.daemon.core.tracking.task import Gate, Phase
from linemate.daemon.core.tracking.touch import held_bolts
from linemate.daemon.core.tracking.touch.compliance import Compliance
from linemate.daemon.core.tracking.touch.firmness import Firmness
from linemate.daemon.core.tracking.touch.force_sign import TESTS, UNANSWERED, ForceSign
from linemate.daemon.core.tracking.touch.withdrawal import WAY
from linemate.daemon.recording import snapshot
from linemate.protocol.stamped_samples import CameraSample, DistanceSample, WrenchSample

P = parameters()
HOME = (*REST, AXIS)
C = P.tracker.reference.nominal


@dataclass(frozen=True, repr=False)
class Assembly:
    """A run, step by step: the state before, the inputs, the outputs."""

    states: list[StepState]
    inputs: list[Inputs]
    outputs: list[Outputs]

    def at(self, task_time: float) -> Outputs:
        """The first outputs at or after a task time."""
        return next(o for o in self.outputs if (o.task_time or 0.0) >= task_time - 1e-9)


def watched(world: World, outcome: Assembly, order: MotionOrder, **changes: Any) -> Outputs:
    inputs = world.inputs(order, **changes)
    outcome.states.append(world.state)
    outcome.inputs.append(inputs)
    outcome.outputs.append(world.take(inputs))
    return outcome.outputs[-1]


@pytest.fixture(scope="module")
def assembly() -> Assembly:
    """The whole task next to a conveyor that never stops: the tool does what it is asked for."""
    world, outcome = World(P), Assembly([], [], [])
    for _ in range(100):
        watched(world, outcome, MotionOrder.HOLD)
    watched(world, outcome, MotionOrder.TRACK, start=True)
    for _ in range(1700):
        asked = outcome.outputs[-1].digital_out
        robot = robot_sample(world.stamp_ns - world.period_ns, world.joints, asked)
        outputs = watched(world, outcome, MotionOrder.TRACK, robot=robot)
        if outputs.finished:
            break
    return outcome


def text(outputs: Outputs) -> str:
    """Everything that a step says, to the last bit."""
    horizon = None if outputs.horizon is None else outputs.horizon.tobytes()
    return repr((replace(outputs, horizon=None), horizon))


def assert_within(commands: Sequence[Sequence[float]] | Array, cycle_s: float = 0.012) -> None:
    """Position, speed, acceleration and jerk of commands that begin at rest."""
    bounds = P.controller.limits
    rows = np.array([*[commands[0]] * 3, *commands])
    assert np.isfinite(rows).all()
    assert (rows >= bounds.lower - 1e-12).all()
    assert (rows <= bounds.upper + 1e-12).all()
    grain = 8.0 * np.spacing(4.0)
    nib = 4e-6 * bounds.acceleration
    for order, limit in enumerate((bounds.speed, bounds.acceleration, bounds.jerk), 1):
        rates = np.abs(np.diff(rows, n=order, axis=0)) / cycle_s**order
        assert (rates <= limit + nib * cycle_s ** (2 - order) + grain / cycle_s**order).all()


# Purity.


@pytest.mark.long
def test_the_same_state_and_inputs_give_the_same_outputs_bit_for_bit(assembly: Assembly) -> None:
    for k in range(0, len(assembly.inputs), 23):
        _, again = step(assembly.states[k], assembly.inputs[k], P)
        assert text(again) == text(assembly.outputs[k])


def test_a_recording_of_the_inputs_replays_bit_for_bit(assembly: Assembly) -> None:
    state = initial(P, robot_sample(EPOCH_NS))
    for inputs, outputs in list(zip(assembly.inputs, assembly.outputs, strict=True))[:350]:
        state, again = step(state, inputs, P)
        assert text(again) == text(outputs)


def other_deliveries(state: StepState, inputs: Inputs) -> list[Inputs]:
    """The same inputs, another delivery of the last command: held, held elsewhere, gone on."""
    gate = state.control.limiter
    there = tuple((gate.position + 1e-4).tolist())
    pace = (tuple(gate.speed.tolist()), tuple(gate.acceleration.tolist()))
    return [
        replace(inputs, sent=True, applied=None, pace=None),
        replace(inputs, sent=False, applied=None, pace=None),
        replace(inputs, sent=False, applied=there, pace=None),
        replace(inputs, sent=False, applied=there, pace=pace),
    ]


@pytest.mark.long
@pytest.mark.row
@pytest.mark.parametrize("order", list(MotionOrder))
def test_a_plan_finished_for_another_delivery_of_the_last_command_is_the_whole_step(
    assembly: Assembly, order: MotionOrder
) -> None:
    contacts = set()
    some = slice(list(MotionOrder).index(order), None, 17)
    for state, first in zip(assembly.states[some], assembly.inputs[some], strict=True):
        assumed = replace(first, order=order)
        planned = plan(state, assumed, P)
        for inputs in other_deliveries(state, assumed):
            (whole, whole_outputs), (made, outcome) = (
                step(state, inputs, P),
                finish(state, planned, inputs, P),
            )
            assert snapshot.encode(made) == snapshot.encode(whole)
            assert text(outcome) == text(whole_outputs)
            contacts.add((outcome.contact, state.tracker.contact))
    assert len(contacts) > 1


def test_a_pose_out_of_reach_is_held_whatever_became_of_the_last_command(
    assembly: Assembly,
) -> None:
    state, first = assembly.states[900], assembly.inputs[900]
    tracker = replace(state.tracker, poses=state.tracker.poses + np.array((5.0, 0, 0, 0, 0, 0)))
    state = replace(state, tracker=tracker)
    planned = plan(state, first, P)
    for inputs in other_deliveries(state, first):
        whole, whole_outputs = step(state, inputs, P)
        made, outcome = finish(state, planned, inputs, P)
        assert whole_outputs.held is not None
        assert "reach" in whole_outputs.held
        assert snapshot.encode(made) == snapshot.encode(whole)
        assert text(outcome) == text(whole_outputs)


def test_two_robots_may_take_turns_in_one_process() -> None:
    """Nothing is kept outside the state: interleaving two runs changes neither."""
    alone, one, two = tracking(1.6), tracking(1.6), tracking(1.0)
    alone.run(0.5, MotionOrder.TRACK)
    one.run(0.5, MotionOrder.TRACK, each=lambda _: two.step(MotionOrder.TRACK))
    assert one.outputs is not None
    assert alone.outputs is not None
    assert text(one.outputs) == text(alone.outputs)


# What was promised.


def test_what_is_committed_is_kept_bit_for_bit(assembly: Assembly) -> None:
    """x_t(k, i) == x_t(k-1, i+1) for i <= nc, in every step that tracks after one that did."""
    nc = P.tracker.commit
    assert nc == 5
    tracked = 0
    for before, after in zip(assembly.outputs, assembly.outputs[1:], strict=False):
        if before.horizon is None or after.horizon is None:
            continue
        tracked += 1
        assert np.array_equal(after.horizon[: nc + 1], before.horizon[1 : nc + 2])
    assert tracked > 1000


def test_the_target_is_the_value_that_was_committed_first(assembly: Assembly) -> None:
    nc = P.tracker.commit
    for k in range(200, len(assembly.outputs), 37):
        promised = assembly.outputs[k - nc].horizon
        assert promised is not None
        target = assembly.outputs[k].target
        assert np.allclose(C @ promised[nc, :3], target[:3], atol=1e-12)
        turn = rotations.log(C @ rotations.exp(promised[nc, 3:]) @ rotations.matrix(target[3:]).T)
        assert np.abs(turn).max() < 1e-9


def test_no_measured_pose_of_the_robot_enters_the_command() -> None:
    """The chain is feed-forward: a robot that says it is elsewhere is commanded the same."""
    honest, lying = World(P, camera=False), World(P, camera=False)
    for world in (honest, lying):
        world.run(0.3)
        world.step(MotionOrder.TRACK, start=True)
    joints = (0.1, -1.5, 1.7, 0.2, 1.2, 0.1, 0.4)
    for _ in range(150):
        one = honest.step(MotionOrder.TRACK)
        robot = robot_sample(lying.stamp_ns, joints)
        assert lying.step(MotionOrder.TRACK, robot=robot).command == one.command


def test_the_task_is_done_from_start_to_end(assembly: Assembly) -> None:
    phases = [outputs.phase for outputs in assembly.outputs]
    order = [phase for i, phase in enumerate(phases) if i == 0 or phase is not phases[i - 1]]
    assert order == [
        Phase.WAIT,
        Phase.APPROACH,
        Phase.CONTACT,
        Phase.SCREWS,
        Phase.CONTACT,
        Phase.RETREAT,
        Phase.DONE,
    ]
    assert assembly.outputs[-1].finished
    assert {outputs.held for outputs in assembly.outputs[101:]} == {None}


def test_the_tool_is_asked_when_the_task_says(assembly: Assembly) -> None:
    tool = P.tracker.task.tool
    assert assembly.at(tool.fix_screws - 0.05).digital_out == 0
    assert assembly.at(tool.fix_screws + 0.05).digital_out == FIX_SCREWS
    assert assembly.at(tool.release_wheel - 0.05).digital_out == FIX_SCREWS
    assert assembly.at(tool.release_wheel + 0.05).digital_out == FIX_SCREWS | RELEASE_WHEEL


def test_contact_is_felt_where_the_task_plans_it_and_lost_when_the_wheel_is(
    assembly: Assembly,
) -> None:
    touched = [o.task_time or 0.0 for o in assembly.outputs if o.contact]
    assert 5.9 < touched[0] < 6.1
    assert touched[-1] < 15.1
    assert len(touched) > 500


@pytest.mark.parametrize(("touching", "counts"), [(0.0, False), (0.01, False), (0.02, True)])
def test_a_force_measures_the_object_only_after_the_clamp_has_drawn_the_tool_in(
    assembly: Assembly, touching: float, *, counts: bool
) -> None:
    k = next(k for k, o in enumerate(assembly.outputs) if o.contact)
    tracker, inputs = assembly.states[k + 1].tracker, assembly.inputs[k + 1]
    state = replace(tracker, contact=True, touching=touching)
    bent = WrenchSample(inputs.stamp_ns, (0.0, 20.0, 0.0), (0.0, 0.0, 0.0))
    seen = tracker_state.StepSamples(
        inputs.stamp_ns, state.poses[0], inputs.stamp_ns, (), (), (bent,), 0
    )
    blind = replace(seen, wrench=())
    felt, *_ = estimation.estimate(P.tracker, state, seen)
    unfelt, *_ = estimation.estimate(P.tracker, state, blind)
    assert felt.conveyor.contact == counts
    assert unfelt.transverse is not None
    assert felt.transverse is not None
    assert (felt.conveyor.x == unfelt.conveyor.x).all() != counts
    assert (felt.transverse.x == unfelt.transverse.x).all() != counts


def test_a_force_beyond_overload_does_not_measure_the_object(assembly: Assembly) -> None:
    k = next(k for k, o in enumerate(assembly.outputs) if o.contact)
    tracker, inputs = assembly.states[k + 1].tracker, assembly.inputs[k + 1]
    state = replace(tracker, contact=True, touching=1.0)
    limit = P.tracker.settings.tactile.overload_force
    for force, counts in ((0.9 * limit, True), (1.1 * limit, False)):
        bent = WrenchSample(inputs.stamp_ns, (0.0, force, 0.0), (0.0, 0.0, 0.0))
        seen = tracker_state.StepSamples(
            inputs.stamp_ns, state.poses[0], inputs.stamp_ns, (), (), (bent,), 0
        )
        after, *_, wrench = estimation.estimate(P.tracker, state, seen)
        assert wrench is not None
        assert after.conveyor is not None
        assert after.conveyor.contact == counts


def suspect(assembly: Assembly, **changes: Any) -> tuple[tracker_state.TrackerState, Inputs]:
    """A contact whose force is suspect, and the inputs of its next step."""
    k = next(k for k, o in enumerate(assembly.outputs) if o.contact)
    state, inputs = assembly.states[k + 1].tracker, assembly.inputs[k + 1]
    sign = ForceSign(is_suspect=True, failed=TESTS)
    return replace(state, contact=True, touching=1.0, force_sign=sign, **changes), inputs


def test_a_large_force_that_answered_no_test_has_no_end(assembly: Assembly) -> None:
    limit = UNANSWERED * P.tracker.settings.tactile.overload_force
    state, _ = suspect(assembly, pull=(1.1 * limit, 0.0, 0.0))
    assert tracker.unanswered(P.tracker, state) == pytest.approx(1.1 * limit)
    for off in (
        {"pull": (0.9 * limit, 0.0, 0.0)},
        {"releasing": 0.1},
        {"contact": False},
        {"force_sign": ForceSign(is_suspect=True, failed=TESTS - 1)},
    ):
        assert tracker.unanswered(P.tracker, replace(state, **off)) is None


def test_a_suspect_force_that_swings_is_observed_and_moves_no_target(assembly: Assembly) -> None:
    state, inputs = suspect(assembly)
    offset, part = state.compliance.offset, np.zeros(6)
    for step_ in range(40):
        stamp_ns = inputs.stamp_ns + step_ * 12_000_000
        history = observation.remember(state.history, stamp_ns, state.poses[0], 20)
        force = np.array((0.0, 60.0 * np.sin(0.4 * step_), 0.0))
        wrench = observation.Wrench(force, np.zeros(3), stamp_ns, 1)
        samples = tracker_state.StepSamples(stamp_ns, None, stamp_ns, (), (), (), 0)
        state = replace(state, history=history)
        state = contact_compliance.comply(P.tracker, state, samples, None, wrench, part)
    assert state.compliance.power > 20.0**2
    assert state.compliance.offset == offset


def test_a_wheel_whose_screws_are_not_fixed_is_kept_in_a_larger_oscillation(
    assembly: Assembly,
) -> None:
    state = assembly.states[assembly.outputs.index(assembly.at(7.5))].tracker
    assert Gate.SCREWS_FIXED not in state.passed
    # 120 N rms for two seconds: between a quarter and a half of the overload.
    swings = Compliance(past=(120.0**2,) * 20, power=120.0**2, softened=2.0)
    state = replace(state, compliance=swings)
    assert tracker.swinging(P.tracker, state) is None
    fixed = replace(state, passed=state.passed | {Gate.SCREWS_FIXED})
    assert tracker.swinging(P.tracker, fixed) == pytest.approx(120.0)


def test_the_torque_of_a_swing_hardly_turns_the_object(assembly: Assembly) -> None:
    k = assembly.outputs.index(assembly.at(7.5))
    before, given = assembly.states[k].tracker, assembly.inputs[k : k + 80]
    assert before.contact
    turned = {}
    for has_swung in (False, True):
        firm = Firmness(is_firm=False, has_swung=has_swung)
        swung = Compliance(past=(50.0**2,) * 10, power=50.0**2, firmness=firm)
        state, angles = before, []
        for n, inputs in enumerate(given):
            torque = 10.0 * np.sin(6.0 * np.pi * n * P.cycle_s)
            felt = tuple(replace(w, torque=(0.0, torque, 0.0)) for w in inputs.wrench)
            samples = tracker_state.StepSamples(
                inputs.stamp_ns, None, 0, inputs.distance, (), felt, 0
            )
            history = observation.remember(state.history, inputs.stamp_ns, state.poses[0], 20)
            state = replace(state, history=history, compliance=swung, touching=1.0)
            state, *_ = estimation.estimate(P.tracker, state, samples)
            off = before.transverse.rotation.T @ state.transverse.rotation
            angles.append(np.linalg.norm(rotations.log(off)))
        turned[has_swung] = max(angles)
    assert turned[True] < 0.2 * turned[False]


def test_the_tcp_is_where_the_object_wants_it_once_it_is_close(assembly: Assembly) -> None:
    for outputs, inputs in zip(assembly.outputs, assembly.inputs, strict=True):
        time = outputs.task_time
        if time is None or outputs.sensed is None or outputs.part is None or not 5.0 < time < 5.9:
            continue
        assert np.abs(np.array(outputs.target[:3]) - outputs.sensed[:3]).max() < 5e-4
        place, turned = object_at((inputs.stamp_ns - EPOCH_NS) * 1e-9 - 1.5)
        assert np.abs(C @ place - outputs.part[:3]).max() < 1.5e-3
        off = rotations.log(C @ turned @ rotations.matrix(outputs.part[3:]).T)
        assert np.abs(off).max() < 1.5e-3


def test_the_commands_of_a_whole_task_stay_within_the_limits(assembly: Assembly) -> None:
    assert_within([outputs.command for outputs in assembly.outputs])


# Holding.


junk = st.floats(-10.0, 10.0)
distances = st.builds(
    lambda late, position: DistanceSample(EPOCH_NS - late, position, 1.0),
    st.integers(0, 50_000_000),
    junk,
)
wrenches = st.builds(
    lambda force, torque: WrenchSample(EPOCH_NS, force, torque),
    st.tuples(*[st.floats(-500, 500)] * 3),
    st.tuples(*[st.floats(-50, 50)] * 3),
)


@settings(max_examples=15, deadline=None)
@given(
    st.lists(
        st.tuples(st.lists(distances, max_size=3), st.lists(wrenches, max_size=3), st.booleans()),
        max_size=30,
    )
)
def test_hold_never_moves_a_robot_at_rest(
    steps: list[tuple[list[DistanceSample], list[WrenchSample], bool]],
) -> None:
    state = initial(P, robot_sample(EPOCH_NS))
    for k, (distance, wrench, telegram) in enumerate(steps, 1):
        now = EPOCH_NS + k * 12_000_000
        inputs = Inputs(
            k,
            now,
            robot_sample(now) if telegram else None,
            tuple(replace(each, stamp_ns=each.stamp_ns + k * 12_000_000) for each in distance),
            (),
            tuple(replace(each, stamp_ns=now) for each in wrench),
        )
        state, outputs = step(state, inputs, P)
        assert outputs.command == HOME
        assert outputs.held == "hold"
        assert outputs.digital_out == 0


@pytest.mark.parametrize("order", list(MotionOrder))
def test_a_step_without_any_sample_works(order: MotionOrder) -> None:
    state = initial(P, robot_sample(EPOCH_NS))
    for k in range(1, 30):
        now = EPOCH_NS + k * 12_000_000
        state, outputs = step(state, Inputs(k, now, None, order=order), P)
        assert np.isfinite(outputs.command).all()
        assert outputs.part is None
        assert outputs.speed is None
        assert outputs.ready is not None
    if order is not MotionOrder.RETREAT:
        assert np.allclose(outputs.command, HOME, atol=1e-9)


_TRACKING: dict[float, World] = {}


def tracking(seconds: float) -> World:
    """A world whose robot has tracked for some time, past the start position."""
    if seconds not in _TRACKING:
        world = World(P)
        world.run(1.2)
        world.step(MotionOrder.TRACK, start=True)
        for _ in range(round(seconds / P.cycle_s)):
            world.step(MotionOrder.TRACK)
        _TRACKING[seconds] = world
    return _TRACKING[seconds].fork()


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


def test_ready_says_what_is_missing() -> None:
    world = World(P, distance=False)
    assert world.run(0.3).ready == "no distance has been measured yet"
    assert World(P).run(0.3).ready is None


# Retreat.


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


def test_no_screws_are_ordered_while_the_object_does_not_push_back() -> None:
    world = tracking(8.3)
    assert world.outputs is not None
    assert world.outputs.contact
    for force in (0.0, 50.0):
        fork = world.fork()
        fork.state = replace(
            fork.state, tracker=replace(fork.state.tracker, pull=(0.0, 0.0, force))
        )
        for _ in range(round(0.5 / P.cycle_s)):
            inputs = fork.inputs(MotionOrder.TRACK)
            felt = tuple(replace(w, force=(0.0, 0.0, force)) for w in inputs.wrench)
            outputs = fork.take(replace(inputs, wrench=felt))
            assert not outputs.digital_out & FIX_SCREWS
        assert (outputs.task_time or 0.0) > 8.5


@pytest.mark.parametrize(("push", "is_doubted"), [(300.0, True), (120.0, False)])
def test_a_touch_with_more_force_than_the_advance_gives_ends_and_moves_no_target(
    push: float, *, is_doubted: bool
) -> None:
    world = tracking(7.0)
    world.state = replace(world.state, tracker=replace(world.state.tracker, touching=0.2))
    offsets = []
    for _ in range(12):
        inputs = world.inputs(MotionOrder.TRACK)
        felt = tuple(replace(w, force=(0.0, 0.0, -push)) for w in inputs.wrench)
        outputs = world.take(replace(inputs, wrench=felt))
        offsets.append(world.state.tracker.compliance.offset)
    assert outputs.contact
    assert (outputs.unanswered_n is not None) == is_doubted
    assert (offsets[-1] == offsets[-4]) == is_doubted


def test_a_released_tool_that_springs_free_shows_no_place_of_the_object(assembly: Assembly) -> None:
    """The wheel stays on the hub, and its bolts with it: the tool would follow its own swing."""
    payload = PayloadSettings(bolts=0.025, bolt_play=0.0005)
    its = dc.replace(P.tracker.settings, payload=payload)
    with_bolts = dc.replace(P, tracker=dc.replace(P.tracker, settings=its))
    k = next(i for i, s in enumerate(assembly.states) if Gate.WHEEL_RELEASED in s.tracker.passed)
    state = assembly.states[k]
    assert held_bolts.is_entered(payload, state.tracker.distance)
    for inputs in assembly.inputs[k : k + 20]:
        felt = tuple(replace(w, force=(-120.0, 0.0, 0.0)) for w in inputs.wrench)
        state, outputs = step(state, replace(inputs, wrench=felt), with_bolts)
        assert not outputs.contact
        assert state.tracker.held == bolt_corrections.UNHELD


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


# Whatever comes in.


BAD = (float("nan"), float("inf"), float("-inf"), 1e308, -1e308, 1e12)


def spoiled(inputs: Inputs, where: str, value: float) -> Inputs:
    """Inputs with one number that no sensor could mean; decoders refuse it, the step survives."""
    if where == "distance":
        return replace(inputs, distance=(DistanceSample(inputs.stamp_ns, value, 1.0),))
    if where == "force":
        sample = WrenchSample(inputs.stamp_ns, (0.0, value, value), (0.0, 0.0, value))
        return replace(inputs, wrench=(sample,))
    if where in {"camera", "turn"}:
        place = (0.0, value, 0.4) if where == "camera" else (0.0, 0.0, 0.4)
        quaternion = (1.0, 0.0, value, 0.0) if where == "turn" else (1.0, 0.0, 0.0, 0.0)
        sample = CameraSample(
            inputs.stamp_ns,
            inputs.stamp_ns - 50_000_000,
            "c",
            "camera",
            "hub",
            1,
            place,
            quaternion,
        )
        return replace(inputs, camera=(sample,))
    assert inputs.robot is not None
    joints: Any = (*inputs.robot.joints[:4], value, 0.0)
    return replace(inputs, robot=replace(inputs.robot, joints=joints))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("where", ["distance", "force", "camera", "turn", "robot"])
@pytest.mark.parametrize("value", BAD)
def test_no_number_reaches_the_command_that_is_none(where: str, value: float) -> None:
    world = tracking(1.0)
    commands = [world.command]
    for k in range(30):
        inputs = world.inputs(MotionOrder.TRACK)
        if k in {5, 6, 7, 8, 9, 20}:
            inputs = spoiled(inputs, where, value)
        commands.append(world.take(inputs).command)
    assert_within(commands)


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(
        st.tuples(
            st.sampled_from(list(MotionOrder)),
            st.integers(1, 25),
            st.sampled_from(("all", "no camera", "no distance", "nothing", "unsent", "outlier")),
        ),
        min_size=1,
        max_size=5,
    )
)
def test_whatever_is_ordered_and_lost_the_robots_setpoints_stay_within_the_limits(
    stretches: list[tuple[MotionOrder, int, str]],
) -> None:
    world = tracking(1.6)
    # Two commands: where the robot stands if the reply before the first stretch is lost.
    applied = [world.command, world.step(MotionOrder.TRACK).command]
    for order, length, what in stretches:
        for i in range(length):
            inputs = world.inputs(order)
            if what == "nothing":
                inputs = replace(inputs, robot=None, distance=(), camera=(), wrench=())
            elif what == "no camera":
                inputs = replace(inputs, camera=())
            elif what == "no distance":
                inputs = replace(inputs, distance=())
            elif what == "outlier":
                inputs = replace(inputs, distance=(DistanceSample(inputs.stamp_ns, 1.0 * i, 1.0),))
            elif what == "unsent" and i == length // 2:
                # The reply before did not arrive: the robot stands where it was.
                inputs = replace(inputs, sent=False)
                assert_steady(applied[:-1] or applied)
                applied = [applied[max(len(applied) - 2, 0)]]
            applied.append(world.take(inputs).command)
    assert_steady(applied)


def assert_steady(commands: list[tuple[float, ...]]) -> None:
    """As ``assert_within``, but the first of them may have been in motion."""
    bounds = P.controller.limits
    rows = np.array(commands)
    assert np.isfinite(rows).all()
    assert (rows >= bounds.lower - 1e-12).all()
    assert (rows <= bounds.upper + 1e-12).all()
    for order, limit in enumerate((bounds.speed, bounds.acceleration, bounds.jerk), 1):
        rates = np.abs(np.diff(rows, n=order, axis=0)) / 0.012**order
        assert (rates <= limit * (1 + 1e-5) + 1e-14 / 0.012**order).all()


def test_a_reply_that_was_lost_is_taken_up_from_where_the_robot_stands() -> None:
    world = tracking(2.4)
    commands = [world.command]
    world.run(0.12, MotionOrder.TRACK, each=lambda o: commands.append(o.command))
    stood = commands[-2]
    outputs = world.step(MotionOrder.TRACK, sent=False)
    limits = P.controller.limits
    first = np.abs(np.array(outputs.command) - stood)
    assert (first <= limits.jerk * 0.012**3 * (1 + 1e-6)).all()
    assert outputs.held is not None
    world.run(0.5, MotionOrder.TRACK)
    assert world.outputs is not None
    assert world.outputs.held is None


def test_where_the_robot_holds_may_be_given() -> None:
    world = tracking(1.0)
    stands = tuple(q + 0.001 for q in world.command)
    outputs = world.step(MotionOrder.HOLD, sent=False, applied=stands)
    assert np.allclose(outputs.command, stands, atol=1e-9)


def test_a_robot_that_goes_on_is_led_as_if_the_step_before_were_its_own(assembly: Assembly) -> None:
    k = next(k for k, o in enumerate(assembly.outputs) if (o.task_time or 0.0) > 2.0)
    state, inputs = assembly.states[k], assembly.inputs[k]
    gate = state.control.limiter
    there = tuple(gate.position.tolist())
    pace = (tuple(gate.speed.tolist()), tuple(gate.acceleration.tolist()))
    sent, outcome = step(state, inputs, P)
    on, goes_on = step(state, replace(inputs, sent=False, applied=there, pace=pace), P)
    held, _ = step(state, replace(inputs, sent=False, applied=there), P)
    assert np.abs(gate.speed).max() > 0.05
    assert goes_on.command == pytest.approx(outcome.command, abs=1e-9)
    asked = sent.control.limiter.acceleration
    assert on.control.limiter.acceleration == pytest.approx(asked, abs=1e-6)
    assert np.abs(held.control.limiter.acceleration - asked).max() > 1.0
    # One that held has set its tool ringing, and its force tells nothing for a while.
    assert on.tracker.contact_state == sent.tracker.contact_state
    assert held.tracker.contact_state.calm == 0 < sent.tracker.contact_state.calm


def test_a_robot_that_goes_on_behind_its_plan_is_not_sent_back_by_its_next_lost_command(
    assembly: Assembly,
) -> None:
    k = next(k for k, o in enumerate(assembly.outputs) if (o.task_time or 0.0) > 2.0)
    state, inputs = assembly.states[k], assembly.inputs[k]
    gate = state.control.limiter
    pace = (tuple(gate.speed.tolist()), tuple(gate.acceleration.tolist()))
    behind = tuple((gate.position - 0.05 * gate.speed).tolist())
    state, _ = step(state, replace(inputs, sent=False, applied=behind, pace=pace), P)
    _, outputs = step(state, replace(assembly.inputs[k + 1], sent=False, applied=behind), P)
    rail = outputs.command[6] - behind[6]
    assert gate.speed[6] > 0.05
    assert rail > 0.0


def test_a_robot_that_goes_on_brakes_within_its_limits_though_it_was_taken_to_stand(
    assembly: Assembly,
) -> None:
    k = next(k for k, o in enumerate(assembly.outputs) if (o.task_time or 0.0) > 2.0)
    before, state = assembly.states[k - 2 : k]
    gate = state.control.limiter
    there = tuple(gate.position.tolist())
    pace = (tuple(gate.speed.tolist()), tuple(gate.acceleration.tolist()))
    commands = [tuple(s.control.limiter.position.tolist()) for s in (before, state)]
    hold = replace(
        assembly.inputs[k], order=MotionOrder.HOLD, start=False, sent=False, applied=there
    )
    state, _ = step(state, hold, P)
    assert not state.moving
    state, outcome = step(state, replace(hold, pace=pace), P)
    commands.append(outcome.command)
    while state.moving:
        state, outcome = step(state, replace(hold, sent=True, applied=None), P)
        commands.append(outcome.command)
    assert_steady(commands)
    assert np.abs(np.subtract(commands[-1], there)).max() > 1e-4
