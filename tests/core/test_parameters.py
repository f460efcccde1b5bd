"""Start-up: settings, task and arm become parameters, or a reason why they cannot."""

from dataclasses import replace

import numpy as np
import pytest
from cell import TASK, World, parameters

from linemate.daemon.core.control.kinematics import KinematicsError
from linemate.daemon.core.control.settings import ControlSettings, ServoModel
from linemate.daemon.core.inputs import MotionOrder
from linemate.daemon.core.parameters import Parameters, build
from linemate.daemon.core.tracking.merge import ALONG, ORDER
from linemate.daemon.core.tracking.settings import ClassifierKind, PayloadSettings, TrackingSettings
from linemate.daemon.core.tracking.task import PoseFile, TaskFile
from linemate.simulators.harness.setup import shipped_control

CYCLES = (0.012, 0.004)


def built(
    control: ControlSettings | None = None,
    tracking: TrackingSettings | None = None,
    task: TaskFile | None = None,
    cycle_s: float = 0.012,
    urdf: str = TASK.urdf,
) -> Parameters:
    return build(
        task or TASK.file,
        urdf,
        tracking or TrackingSettings(),
        control or ControlSettings(),
        cycle_s,
    )


@pytest.mark.parametrize("cycle_s", CYCLES)
def test_the_horizon_is_half_a_second_and_everything_in_it_fits(cycle_s: float) -> None:
    made = parameters(cycle_s)
    tracker, controller = made.tracker, made.controller
    assert made.cycle_s == tracker.cycle_s == controller.cycle_s == cycle_s
    assert tracker.steps == controller.steps
    assert tracker.steps * cycle_s == pytest.approx(0.49, abs=0.01)
    free, clamped = tracker.merge_free, tracker.merge_clamped
    assert tracker.commit == free.commit
    assert clamped.matrices.shape == (6, tracker.steps - clamped.commit, ORDER)
    # A step that is committed by a share is one more that the merge reads.
    shared = free.committed_s > free.commit * cycle_s + 1e-9
    assert free.matrices.shape == (6, tracker.steps - free.commit, ORDER + shared)
    assert np.allclose(tracker.span, np.arange(tracker.steps + 1) * cycle_s)


@pytest.mark.parametrize("cycle_s", CYCLES)
def test_a_clamped_tool_follows_the_object_sooner_until_it_is_to_retreat(cycle_s: float) -> None:
    tracker = parameters(cycle_s).tracker
    plans = [tracker.merge_plan(in_contact=True, retreats=retreats) for retreats in (False, True)]
    sooner, later = (float(plan.matrices[ALONG].sum()) * cycle_s for plan in plans)
    assert later - sooner > 0.02


def test_a_robot_that_is_quicker_than_its_servo_models_follows_as_slowly_in_contact() -> None:
    """Servos twice as quick as their models amplify a quicker merge: 181 instead of 150 N."""
    tracker = parameters(0.012).tracker
    for lead, plan in (
        (0.0, tracker.merge_clamped),
        (-0.007, tracker.merge_clamped),
        (-0.05, tracker.merge_retreating),
        (0.05, tracker.merge_clamped),
    ):
        assert tracker.merge_plan(in_contact=True, lead=lead) is plan
        assert tracker.merge_plan(in_contact=False, lead=lead) is tracker.merge_free


@pytest.mark.parametrize("cycle_s", CYCLES)
def test_the_longest_dead_time_is_committed(cycle_s: float) -> None:
    slow = replace(ControlSettings().servos[2], dead_time=0.05)
    servos = (*ControlSettings().servos[:2], slow, *ControlSettings().servos[3:])
    assert built(cycle_s=cycle_s).tracker.merge_clamped.committed_s >= 0.036 + 2 * cycle_s - 1e-9
    longer = built(replace(ControlSettings(), servos=servos), cycle_s=cycle_s)
    assert longer.tracker.merge_clamped.committed_s >= 0.05 + 2 * cycle_s - 1e-9


def test_what_the_damping_reads_beyond_its_setting_is_committed_too() -> None:
    """(11) reads 12 ms ahead; at 8 ms that is two cycles."""
    committed = [built(cycle_s=c).tracker.merge_clamped.committed_s for c in (0.004, 0.008)]
    assert committed == pytest.approx([0.036 + 0.004 + 0.004, 0.036 + 0.008 + 0.008 + 0.004])


@pytest.mark.parametrize("cycle_s", CYCLES)
def test_a_robot_without_dead_time_is_driven_all_the_same(cycle_s: float) -> None:
    servos = tuple(replace(model, dead_time=0.0) for model in ControlSettings().servos)
    made = built(replace(ControlSettings(), servos=servos), cycle_s=cycle_s)
    assert made.tracker.commit >= ORDER
    for plan in (made.tracker.merge_free, made.tracker.merge_clamped):
        assert plan.matrices.shape[1] == made.tracker.steps - plan.commit
    world = World(made)
    world.run(0.3)
    world.step(MotionOrder.TRACK, start=True)
    outputs = world.run(0.3, MotionOrder.TRACK)
    assert outputs.horizon is not None
    assert np.isfinite(outputs.command).all()


@pytest.mark.parametrize("kind", list(ClassifierKind))
def test_every_classifier_that_can_be_chosen_is_there(kind: ClassifierKind) -> None:
    made = built(tracking=replace(TrackingSettings(), classifier=kind))
    world = World(made)
    world.run(0.9)
    assert world.outputs is not None
    assert world.outputs.speed == pytest.approx(0.106, abs=2e-3)


def test_a_finer_cycle_tells_the_same() -> None:
    """What is found and wanted is the same at 12 and at 4 ms."""
    targets = []
    for cycle_s in CYCLES:
        world = World(parameters(cycle_s))
        world.run(1.2)
        world.step(MotionOrder.TRACK, start=True)
        while world.time < 0.299:
            world.step(MotionOrder.TRACK)
        assert world.outputs is not None
        assert world.outputs.part is not None
        targets.append((world.outputs.target[:3], world.outputs.part[:3]))
    # The last steps lie within a coarse cycle of each other: 1.3 mm along the conveyor.
    for one, other in zip(*targets, strict=True):
        assert np.abs(np.array(one) - other).max() < 0.003


@pytest.mark.parametrize("what", ["servos", "limits"])
def test_six_models_for_seven_axes_are_refused(what: str) -> None:
    settings = shipped_control()
    with pytest.raises(ValueError, match="7 axes"):
        built(replace(settings, **{what: getattr(settings, what)[:6]}))


def test_a_urdf_that_does_not_fit_the_task_is_refused_with_its_reason() -> None:
    with pytest.raises(KinematicsError, match="joints"):
        built(task=replace(TASK.file, arm=replace(TASK.file.arm, linear_axis=False)))
    with pytest.raises(KinematicsError, match="no frame 'tool'"):
        built(task=replace(TASK.file, arm=replace(TASK.file.arm, flange="tool")))
    with pytest.raises(KinematicsError, match="not a URDF"):
        built(urdf="<robot")


def test_a_task_that_cannot_be_is_refused_with_its_reason() -> None:
    with pytest.raises(ValueError, match="times must rise"):
        built(task=replace(TASK.file, waypoints=TASK.file.waypoints[::-1]))
    turned = replace(TASK.file.object, nominal=PoseFile((2.2, 0.0, 1.1), (0.0, 0.0, 0.0, 1.0)))
    with pytest.raises(ValueError, match="y axis"):
        built(task=replace(TASK.file, object=turned))


@pytest.mark.parametrize(("bolts", "away"), [(0.025, 0.08), (0.09, 0.1)])
def test_the_tool_waits_before_it_can_meet_the_tips_of_bolts(bolts: float, away: float) -> None:
    tracking = replace(TrackingSettings(), payload=PayloadSettings(bolts=bolts))
    task = built(tracking=tracking).tracker.task
    assert task.waypoints[2].pose.position[2] == pytest.approx(-away)


def test_without_prediction_the_tool_is_behind_the_object() -> None:
    behind = {}
    for predict in (True, False):
        world = World(built(tracking=replace(TrackingSettings(), predict=predict)))
        world.run(1.2)
        world.step(MotionOrder.TRACK, start=True)
        # Past the blend from the programmed to the sensed motion.
        outputs = world.run(2.9, MotionOrder.TRACK)
        assert outputs.sensed is not None
        behind[predict] = outputs.sensed[1] - outputs.target[1]
    # Five committed steps, and what the merge needs after them, at 106 mm/s.
    assert abs(behind[True]) < 0.0005
    assert 0.106 * 0.060 < behind[False] < 0.106 * 0.2


def test_settings_of_a_servo_may_be_anything_their_ranges_allow() -> None:
    for model in (
        ServoModel(1.0, 0.06, 0.0),
        ServoModel(30.0, 2.9, 0.1),
        ServoModel(3.0, 1.0, 0.02),
    ):
        servos = (model, *ControlSettings().servos[1:])
        made = built(replace(ControlSettings(), servos=servos))
        assert np.isfinite(made.controller.servo).all()
        assert np.allclose(made.controller.servo.sum(axis=0), 1.0)
