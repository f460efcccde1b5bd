"""One sampling step: which force measures the object, and which moves no target."""

import dataclasses as dc
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from step_runs import Assembly, P, tracking

from linemate.daemon.core import rotations
from linemate.daemon.core.inputs import Inputs, MotionOrder
from linemate.daemon.core.step import step
from linemate.daemon.core.step_state import FIX_SCREWS
from linemate.daemon.core.tracking import observation, tracker, tracker_state
from linemate.daemon.core.tracking.estimation import bolt_corrections, contact_compliance
from linemate.daemon.core.tracking.estimation import estimate as estimation
from linemate.daemon.core.tracking.settings import PayloadSettings
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.touch import held_bolts
from linemate.daemon.core.tracking.touch.compliance import Compliance
from linemate.daemon.core.tracking.touch.firmness import Firmness
from linemate.daemon.core.tracking.touch.force_sign import TESTS, UNANSWERED, ForceSign
from linemate.protocol.stamped_samples import WrenchSample


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
