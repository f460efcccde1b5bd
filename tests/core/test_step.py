"""One sampling step: pure, committed to its outputs, and never beyond its limits."""

from typing import Any

import numpy as np
import pytest
from cell import EPOCH_NS, World, object_at, robot_sample
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from step_runs import HOME, Assembly, C, P, assert_within, text, tracking

from linemate.daemon.core import rotations
from linemate.daemon.core.inputs import Inputs, MotionOrder
from linemate.daemon.core.step import initial, step
from linemate.daemon.core.step_state import FIX_SCREWS, RELEASE_WHEEL
from linemate.daemon.core.tracking.task import Phase
from linemate.protocol.stamped_samples import CameraSample, DistanceSample, WrenchSample


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


def test_two_robots_may_take_turns_in_one_process() -> None:
    """Nothing is kept outside the state: interleaving two runs changes neither."""
    alone, one, two = tracking(1.6), tracking(1.6), tracking(1.0)
    alone.run(0.5, MotionOrder.TRACK)
    one.run(0.5, MotionOrder.TRACK, each=lambda _: two.step(MotionOrder.TRACK))
    assert one.outputs is not None
    assert alone.outputs is not None
    assert text(one.outputs) == text(alone.outputs)


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


def test_ready_says_what_is_missing() -> None:
    world = World(P, distance=False)
    assert world.run(0.3).ready == "no distance has been measured yet"
    assert World(P).run(0.3).ready is None


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
