"""Sign and size of each axis: what a commanded change of each axis moves, as the robot reports it.

    measured change = G commanded change,   G: one on the diagonal, zero elsewhere

Invariants:
- Pure. Only stretches are used in which the command stands, so that no servo lag enters.
- Only changes that the daemon drove count. At rest a command follows the robot, whatever its sign.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from linemate.daemon.core.horizon import Array
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal, ReportLine
from linemate.daemon.recording.step_codec import StepRecord
from linemate.protocol.stamped_samples import AXES

DRIVEN = frozenset({"track", "home"})  # states in which the robot follows the command
BRAKES_S = 1.0  # after such a state, in which the daemon brings the robot to rest
STANDS_S = 0.8  # shortest rest of the command
LATE_S = 0.4  # of it, at its end, in which the robot is read
LEAST_MOVE = 1e-3  # commanded change of an axis that counts [rad, m]
SIZE = 0.05  # largest error of an axis' own size
CROSS = 0.10  # largest motion of another axis, as a share
STILL = 1e-6  # of a standing command [rad]


def find_signs(steps: Sequence[StepRecord]) -> list[ReportLine]:
    """Return the size of each axis' motion for a commanded one, with its sign."""
    changes = _changes(steps)
    if changes is None:
        return [
            _refused(
                "the axes were not moved. Order home and run the task of this step while it records"
            )
        ]
    commanded, measured = changes
    lines = []
    for axis in range(commanded.shape[1]):
        moved = np.abs(commanded[:, axis]) > LEAST_MOVE
        alone = moved & (np.delete(np.abs(commanded), axis, axis=1) < LEAST_MOVE).all(axis=1)
        if not alone.any():
            lines.append(_line(axis, Refusal(f"{AXES[axis]} was not moved alone")))
            continue
        gains = measured[alone] / commanded[alone, axis][:, None]
        lines.append(_line(axis, _judged(axis, gains)))
    return lines


def _refused(reason: str) -> ReportLine:
    return ReportLine("axes", "", 1.0, Refusal(reason))


def _line(axis: int, outcome: Outcome) -> ReportLine:
    return ReportLine(f"{AXES[axis]} moved for commanded", "", 1.0, outcome)


def _judged(axis: int, gains: Array) -> Outcome:
    """Return the size of an axis' motion from gains (n, axes) of its moves, or what is wrong."""
    name, mean = AXES[axis], gains.mean(axis=0)
    own, others = float(mean[axis]), np.abs(np.delete(mean, axis))
    stop = "Do not arm. Check how the controller reads commands of its axes: signs, order"
    if float(others.max()) > CROSS:
        other = [n for n in range(len(mean)) if n != axis][int(others.argmax())]
        return Refusal(
            f"a command for {name} moves {AXES[other]} by {float(mean[other]):.2f} of it, at most "
            f"{CROSS:.2f}. {stop}"
        )
    if own < -SIZE:
        return Refusal(f"{name} moves the other way: {own:.3f} of its command, should be 1. {stop}")
    if abs(own - 1.0) > SIZE:
        return Refusal(
            f"{name} moves by {own:.3f} of its command, should be 1 +-{SIZE:.2f}. {stop}, units"
        )
    spread = float(gains[:, axis].std())
    return Estimate(own, spread, f"{len(gains)} moves, other axes below {float(others.max()):.3f}")


def _changes(steps: Sequence[StepRecord]) -> tuple[Array, Array] | None:
    """Return commanded and measured changes between rests of the command (n, axes)."""
    rows = [step for step in steps if step.inputs.robot is not None and step.outputs["command"]]
    if len(rows) < 10:
        return None
    command = np.array([step.outputs["command"] for step in rows])
    count = command.shape[1]
    times = np.array([step.inputs.stamp_ns for step in rows]) * 1e-9
    joints = np.array(
        [
            (*step.inputs.robot.joints, *step.inputs.robot.external)[:count]
            for step in rows
            if step.inputs.robot is not None
        ]
    )
    moves = (np.abs(np.diff(command, axis=0)) > STILL).any(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate(([True], moves, [True])).astype(int)))
    driven_s = np.where([step.state in DRIVEN for step in rows], times, -np.inf)
    followed = (times - np.maximum.accumulate(driven_s) <= BRAKES_S)[1:] | ~moves
    places, ends = [], []
    for begin, end in edges.reshape(-1, 2).tolist():
        if times[end] - times[begin] >= STANDS_S:
            late = (times >= times[end] - LATE_S) & (times <= times[end])
            places.append((command[end], joints[late].mean(axis=0)))
            ends.append((begin, end))
    if len(places) < 2:
        return None
    commanded, measured = (np.diff(np.array(each), axis=0) for each in zip(*places, strict=True))
    driven = [bool(followed[end:begin].all()) for (_, end), (begin, _) in pairwise(ends)]
    moved = (np.abs(commanded) > LEAST_MOVE).any(axis=1) & np.array(driven)
    return (commanded[moved], measured[moved]) if moved.any() else None
