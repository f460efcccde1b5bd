"""Parameters of a step, compiled once at start-up from settings and a task.

Slow (0.3 s): never called in a cycle, except ``retuned``.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from linemate.daemon.core import commitment, rotations, wrench_frame
from linemate.daemon.core.control import controller as control
from linemate.daemon.core.control import dead_time, kinematics, urdf_limits
from linemate.daemon.core.control.settings import ControlSettings
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking import linear_axis, merge
from linemate.daemon.core.tracking.across.transverse import Transverse
from linemate.daemon.core.tracking.classifiers.classifier_bank import BankClassifier
from linemate.daemon.core.tracking.conveyor import Classifier
from linemate.daemon.core.tracking.damping import damped_until, free_table
from linemate.daemon.core.tracking.estimation import prediction_error
from linemate.daemon.core.tracking.reference import (
    Reference,
    compile_reference,
    last_step,
    tabulated,
)
from linemate.daemon.core.tracking.settings import ClassifierKind, TactileNoise, TrackingSettings
from linemate.daemon.core.tracking.task import Phase, TaskFile
from linemate.daemon.core.tracking.touch import compliance, contact
from linemate.daemon.core.tracking.touch.touch_profile import (
    bolt_tips,
    bolts_reach,
    lengthened,
    sighted,
    slowed,
)
from linemate.daemon.core.tracking.touch.withdrawal import compile_withdrawal
from linemate.daemon.core.tracking.tracker_state import Foresight, Tracker
from linemate.daemon.core.wrench_frame import WrenchFrame

TOOL_AXIS = 2  # of the tcp
SIGHT_MARGIN = 0.02  # of the last waypoint before contact to where the camera goes blind [m]
NEAR_GATE = 0.01  # least distance before the object at which go or no-go is decided again [m]
FINAL_S = 0.3  # before contact, from which on the touch cannot be prevented [s]
HISTORY_S = 0.45  # length of the robot's pose history, to date exposures [s]


@dataclass(frozen=True, slots=True, eq=False)
class Parameters:
    """Compiled parameters of tracking and control.

    Attributes:
        settings: of the controller; the tracker keeps its own.
        home: joints (axes,) at the first pose.
        wrench_frame: from the sensor's wrench to that of the tcp, None if they are the same.
    """

    tracker: Tracker
    controller: control.Controller
    cycle_s: float
    settings: ControlSettings
    home: Array
    wrench_frame: WrenchFrame | None = None


def _classifier(task: TaskFile, settings: TrackingSettings) -> Classifier:
    """Return the classifier that is set.

    filterpy takes as long to import as all the rest (1 s): only by the classifiers that use it.
    """
    conveyor, fusion, deviation = task.conveyor, settings.fusion, settings.distance.deviation
    if settings.classifier is ClassifierKind.BANK:
        return BankClassifier(
            conveyor,
            fusion,
            settings.bank,
            deviation,
            settings.mixture,
            settings.jerk,
            settings.wave,
            settings.tactile.compliance,
            settings.sway,
            max(settings.tactile.stiffness[:2]),
        )
    if settings.classifier is ClassifierKind.IMM:
        from linemate.daemon.core.tracking.classifiers.classifier_imm import ImmClassifier

        return ImmClassifier(conveyor, fusion, settings.bank, settings.imm, deviation)
    from linemate.daemon.core.tracking.classifiers.classifier_rule import RuleClassifier

    has_classes = settings.classifier is ClassifierKind.RULE
    return RuleClassifier(conveyor, fusion, settings.rule, deviation, classes=has_classes)


def _axis_range(controller: control.Controller) -> tuple[float, float]:
    """Return the least and the greatest position of the linear axis [m]."""
    if not controller.arm.linear_axis:
        return -math.inf, math.inf
    return float(controller.limits.lower[6]), float(controller.limits.upper[6])


def _axis_travel(task: TaskFile, arm: kinematics.Arm) -> float:
    """Return the way of the linear axis for each metre of the object's, with its sign."""
    if not arm.linear_axis:
        return task.linear_axis.travel
    joints = np.zeros(arm.axes)
    rail = arm.tcp_in_base(joints)[1] @ arm.tcp_jacobian(joints)[:, 6]
    # Rounded: an axis along the conveyor has its share exactly.
    return task.linear_axis.travel * round(float(rail @ np.array(task.conveyor.axis)), 6)


def _camera_in_tcp(task: TaskFile, tracking: TrackingSettings) -> tuple[Array, Array]:
    """Return position (3,) and rotation (3, 3) of the camera in the tcp, as touches correct it.

    It is turned about the tcp: an object that the tool touches is only turned by that.
    """
    mount, noise = task.arm.camera_in_tcp, tracking.camera
    felt = np.array((*noise.felt, noise.felt_depth))
    turn = rotations.exp(np.array((*tracking.camera.felt_turn, 0.0)))
    return turn @ np.array(mount.position) + felt, turn @ rotations.matrix(mount.quaternion)


def build(
    task: TaskFile,
    urdf_text: str,
    tracking: TrackingSettings,
    control_settings: ControlSettings,
    cycle_s: float,
) -> Parameters:
    """Return the parameters of a cell.

    Raises:
        ValueError: settings, task and arm contradict each other; the message names them.
    """
    tool = task.arm.tcp_in_flange
    arm = kinematics.load(
        urdf_text,
        task.arm.flange,
        np.array(tool.position),
        rotations.matrix(tool.quaternion),
        linear_axis=task.arm.linear_axis,
        loads=control_settings.bend.loads,
        geometry=control_settings.geometry,
    )
    control_settings = urdf_limits.completed(
        control_settings, urdf_text, task.arm.flange, linear_axis=task.arm.linear_axis
    )
    controller = control.compile_controller(
        control_settings, arm, cycle_s, task.conveyor.nominal_speed
    )
    mount = tracking.tactile
    tips = bolt_tips(tracking.payload.bolts, mount.stiffness[TOOL_AXIS], mount.overload_force)
    task = slowed(task, mount.stiffness[TOOL_AXIS], mount.overload_force)
    waits = max(tracking.camera.blind_below + SIGHT_MARGIN, bolts_reach(tips.length))
    task = lengthened(sighted(task, waits), tips)
    reference = compile_reference(task, tips)
    tracker = _tracker(task, tracking, control_settings, controller, reference, cycle_s)
    home, _, _ = joints_at_rest(arm, task, reference)
    frame = wrench_frame.of_arm(task.arm)
    return Parameters(tracker, controller, cycle_s, control_settings, home, frame)


def _tracker(
    task: TaskFile,
    tracking: TrackingSettings,
    control_settings: ControlSettings,
    controller: control.Controller,
    reference: Reference,
    cycle_s: float,
) -> Tracker:
    """Return the parameters of tracking, for a task as it is planned."""
    delay_s = _longest_delay(control_settings, controller)
    quick, plain = merge.without_mode(tracking.merge), tracking.merge
    more = commitment.free_margin(plain, control_settings, delay_s, cycle_s)
    clamped, retreating, free = (
        merge.compile_merge(settings, delay_s, cycle_s, controller.steps, more=longer)
        for settings, longer in ((quick, 0.0), (plain, 0.0), (plain, more))
    )
    table = tabulated(reference, cycle_s, controller.steps)
    span = np.arange(controller.steps + 1) * cycle_s
    lag = linear_axis.delay(task.linear_axis.ramp, cycle_s)
    leads = prediction_error.lead_times(reference.contact_time - reference.sight_time)
    blend = control_settings.filters.contact_blend
    vibrations = _vibrations(tracking.tactile, control_settings, cycle_s)
    return Tracker(
        task=task,
        settings=tracking,
        reference=reference,
        classifier=_classifier(task, tracking),
        transverse=Transverse(tracking.fusion, tracking.swing, tracking.camera),
        table=table,
        camera=_camera_in_tcp(task, tracking),
        cycle_s=cycle_s,
        steps=controller.steps,
        merge_free=free,
        merge_clamped=replace(clamped, largest_jump=merge.LARGEST_JUMP),
        merge_retreating=retreating,
        corner=merge.rounding(cycle_s, clamped.commit),
        history_length=math.ceil(HISTORY_S / cycle_s),
        span=span,
        axis_steps=controller.preview,
        axis_range=_axis_range(controller),
        axis_travel=_axis_travel(task, controller.arm),
        ahead=np.append(span, (controller.preview * cycle_s + lag, *leads)),
        leads=leads,
        free=free_table(
            reference,
            reference.time_of(Phase.RETREAT),
            blend,
            np.arange(len(table.poses)) * cycle_s,
        ),
        vibration=vibrations[TOOL_AXIS],
        across=(vibrations[0], vibrations[1]),
        compliance=_compliance(tracking, clamped, cycle_s),
        sight_time=reference.sight_time,
        near_time=reference.time_before(max(task.guard.clearance, NEAR_GATE)),
        final_time=last_step(reference.contact_time - FINAL_S, cycle_s),
        search_time=reference.time_of(Phase.CONTACT, Phase.SCREWS),
        press=reference.press,
        damped_until=damped_until(reference, blend),
        withdrawal=compile_withdrawal(
            controller.tcp_limit.free, task.conveyor.nominal_speed, -float(table.relative[-1, 2])
        ),
    )


def _vibrations(
    mount: TactileNoise, settings: ControlSettings, cycle_s: float
) -> list[contact.ToolVibration]:
    """Return how the tool vibrates along each axis of its mount."""
    return [
        contact.tool_vibration(
            mode.frequency_hz,
            mode.damping,
            stiffness,
            mount.contact_force,
            cycle_s,
            mount.deflection,
        )
        for mode, stiffness in zip(settings.effector, mount.stiffness[:3], strict=False)
    ]


def _longest_delay(settings: ControlSettings, controller: control.Controller) -> float:
    """Return the longest time from a desired pose to the pose of an axis [s]."""
    longest = max(model.dead_time for model in settings.servos[: controller.arm.axes])
    longest += dead_time.bounds(settings)[1] + controller.spreading_delay_s
    # (11) reads whole cycles: at 8 ms 16 ms instead of 12.
    longest += controller.effector_future_s - settings.filters.effector_future_s
    return longest


def _compliance(
    tracking: TrackingSettings, clamped: merge.MergePlan, cycle_s: float
) -> compliance.ComplianceModel:
    """Return the model of the clamped tool: its softest axis, with the delay of the merge."""
    along, across = (
        clamped.commit + merge.delay(clamped.matrices[axis]) for axis in (merge.ALONG, 0)
    )
    return compliance.ComplianceModel(
        stiffness=min(tracking.tactile.stiffness), delays=(across, along, across), dt=cycle_s
    )


def joints_at_rest(
    arm: kinematics.Arm, task: TaskFile, reference: Reference
) -> tuple[Array, float, float]:
    """Return the joints at rest, the linear axis where it brings the tcp to the first pose.

    Returns:
        Joints (axes,), and how far the tcp is away from the first pose with them [m], [rad].
    """
    position = reference.nominal @ reference.rest[:3]
    rotation = reference.nominal @ rotations.exp(reference.rest[3:])
    joints = np.array((*task.arm.rest_joints, 0.0)[: arm.axes])
    there, turned = arm.tcp_in_base(joints)
    off = position - there
    if arm.linear_axis:
        rail = turned @ arm.tcp_jacobian(joints)[:, 6]
        joints[6] = float(off @ rail)
        off = off - joints[6] * rail
    angle = float(np.linalg.norm(rotations.log(turned.T @ rotation)))
    return joints, float(np.linalg.norm(off)), angle


def retuned(parameters: Parameters, tracking: TrackingSettings) -> Parameters:
    """Return parameters with another estimator tuning; fast enough between two steps.

    For settings that change neither the shape of a state nor the plan: noise, gates, thresholds of
    the classifiers. The result equals that of ``build``.

    Args:
        tracking: settings that differ in nothing else.
    """
    vibrations = _vibrations(tracking.tactile, parameters.settings, parameters.cycle_s)
    tracker = replace(
        parameters.tracker,
        settings=tracking,
        camera=_camera_in_tcp(parameters.tracker.task, tracking),
        classifier=_classifier(parameters.tracker.task, tracking),
        transverse=Transverse(tracking.fusion, tracking.swing, tracking.camera),
        vibration=vibrations[TOOL_AXIS],
        across=(vibrations[0], vibrations[1]),
    )
    return replace(parameters, tracker=tracker)


def with_foresight(parameters: Parameters, foresight: Foresight) -> Parameters:
    """Return the parameters with an oracle instead of an estimate (variant of a campaign)."""
    return replace(parameters, tracker=replace(parameters.tracker, foresight=foresight))


def with_classifier(parameters: Parameters, classifier: Classifier) -> Parameters:
    """Return the parameters with another conveyor classifier (simulated runs and replays)."""
    return replace(parameters, tracker=replace(parameters.tracker, classifier=classifier))
