"""One sampling step: what becomes of the last command."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from step_runs import Assembly, P, text, tracking

from linemate.daemon.core.inputs import Inputs, MotionOrder
from linemate.daemon.core.step import finish, plan, step
from linemate.daemon.core.step_state import StepState
from linemate.daemon.recording import snapshot
from linemate.protocol.stamped_samples import DistanceSample


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
