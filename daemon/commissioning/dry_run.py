"""Errors of runs next to the line without contact: of the control, and of the prediction.

Invariants:
- Pure. The control error is what the arm lacks to its target of the time at which it was measured.
  The prediction's error is what an image shows of the object that the daemon had estimated at the
  time of the exposure.
- The target is that of a tool that sags under its weight, the measured tcp that of a stiff one.
"""

from collections.abc import Sequence

import numpy as np

from linemate.daemon.commissioning.recorded_cell import RecordedCell
from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.task import Phase
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal, ReportLine
from linemate.daemon.recording.step_codec import StepRecord

TRACKED = "track"
SETTLED_S = 3.0  # of the approach, after which errors count [s]
CONTROL_LIMIT = 0.001  # 95th percentile of the control error [m]
SEEN_LIMIT = 0.004  # of the estimated object against images [m]
LEAST = 50


def find_errors(runs: Sequence[Sequence[StepRecord]], cell: RecordedCell) -> list[ReportLine]:
    """Return control error and prediction error of all runs, or why they show none."""
    for steps in runs:
        refusal = _unfit(steps)
        if refusal is not None:
            return [ReportLine("dry run", "mm", 1e3, refusal)]
    settled = [_settled(steps) for steps in runs]
    control = np.concatenate([_control(steps, cell) for steps in settled])
    seen = np.concatenate([_seen(*each, cell) for each in zip(runs, settled, strict=True)])
    return [
        ReportLine("control error, 95 %", "mm", 1e3, _judged(control, CONTROL_LIMIT)),
        ReportLine("object estimated against images, 95 %", "mm", 1e3, _judged(seen, SEEN_LIMIT)),
    ]


def _unfit(steps: Sequence[StepRecord]) -> Refusal | None:
    if any(step.outputs["contact"] for step in steps):
        return Refusal("the tool touched the object. Order retreat before contact")
    if not any(map(_is_approach, steps)):
        return Refusal("the task was not started. Order arm and start while it records")
    return None


def _is_approach(step: StepRecord) -> bool:
    return step.state == TRACKED and step.outputs["phase"] == Phase.APPROACH


def _settled(steps: Sequence[StepRecord]) -> list[StepRecord]:
    followed = [step for step in steps if _is_approach(step)]
    begin = followed[0].inputs.stamp_ns + round(SETTLED_S * 1e9)
    return [step for step in followed if step.inputs.stamp_ns >= begin]


def _judged(errors: Array, limit: float) -> Outcome:
    if len(errors) < LEAST:
        return Refusal(
            f"{len(errors)} values in the approach, at least {LEAST} are needed. Record more runs"
        )
    high = float(np.percentile(errors, 95))
    largest = float(errors.max())
    if high > limit:
        return Refusal(
            f"95 % of the errors are below {1e3 * high:.2f} mm, limit {1e3 * limit:.1f} mm. "
            "Check servos, camera and conveyor again"
        )
    return Estimate(high, 0.0, f"{len(errors)} values, largest {1e3 * largest:.2f} mm")


def _control(settled: Sequence[StepRecord], cell: RecordedCell) -> Array:
    """Return the distances (n,) of the measured tcp to its target of that time [m]."""
    if len(settled) < 2:
        return np.zeros(0)
    epoch = settled[0].inputs.stamp_ns
    times = np.array([step.inputs.stamp_ns - epoch for step in settled]) * 1e-9
    targets = np.array([step.outputs["target"][:3] for step in settled])
    errors = []
    for step in settled:
        robot = step.inputs.robot
        # A prepared step has the robot's sample of the cycle before: 1.3 mm at 0.106 m/s.
        if robot is None or robot.stamp_ns < epoch:
            continue
        joints = np.array((*robot.joints, *robot.external)[: cell.arm.axes])
        position, _ = cell.arm.tcp_in_base(joints)
        t = (robot.stamp_ns - epoch) * 1e-9
        target = np.array([np.interp(t, times, column) for column in targets.T])
        errors.append(float(np.linalg.norm(position - target)))
    return np.array(errors)


def _seen(steps: Sequence[StepRecord], settled: Sequence[StepRecord], cell: RecordedCell) -> Array:
    """Return the distances (n,) of the object in images to the estimate of that time [m]."""
    rows = [(s.inputs.stamp_ns, s.outputs["part"]) for s in settled if s.outputs["part"]]
    moves = [
        (s.inputs.robot.stamp_ns, (*s.inputs.robot.joints, *s.inputs.robot.external))
        for s in steps
        if s.inputs.robot is not None
    ]
    if len(rows) < 2 or len(moves) < 2:
        return np.zeros(0)
    epoch = steps[0].inputs.stamp_ns
    times = np.array([stamp - epoch for stamp, _ in rows]) * 1e-9
    parts = np.array([part[:3] for _, part in rows])
    robot_times = np.array([stamp - epoch for stamp, _ in moves]) * 1e-9
    joints = np.array([values[: cell.arm.axes] for _, values in moves])
    camera = cell.task.arm.camera_in_tcp
    mount, place = rotations.matrix(camera.quaternion), np.array(camera.position)
    errors = []
    for step in settled:
        for image in step.inputs.camera:
            t = (image.exposure_ns - epoch) * 1e-9
            if not times[0] <= t <= times[-1]:
                continue
            q = np.array([np.interp(t, robot_times, column) for column in joints.T])
            position, rotation = cell.arm.tcp_in_base(q)
            seen = position + rotation @ (place + mount @ np.array(image.position))
            estimate = np.array([np.interp(t, times, column) for column in parts.T])
            errors.append(float(np.linalg.norm(seen - estimate)))
    return np.array(errors)
