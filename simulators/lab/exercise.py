"""Exercise of a cell for identification: the motions of the shipped one about its first pose.

Invariants:
    Arm, object and conveyor are the cell's; every waypoint keeps its time.
"""

import json
from dataclasses import asdict, replace
from functools import cache

import numpy as np
import yaml

from linemate.daemon.config import task_file
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.config.task_file import Task
from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.task import PoseFile, TaskFile

EXERCISE = "exercise.yaml"
DECIMALS = 9


@cache
def shipped() -> Task:
    """Return the exercise of the shipped cell."""
    return task_file.load(DAEMON_DATA / EXERCISE)


def of_cell(task: Task) -> Task:
    """Return the exercise of a cell: its arm moves about its own first pose.

    Args:
        task: of the cell; its first waypoint is in base.
    """
    plain = shipped().file
    if task.file.arm == plain.arm:
        return shipped()
    there, turned = _placed(task.file.waypoints[0].pose)
    first, frame = _placed(plain.waypoints[0].pose)
    waypoints = []
    for point in plain.waypoints:
        position, rotation = _placed(point.pose)
        moved = there + turned @ frame.T @ (position - first)
        pose = _pose(moved, turned @ frame.T @ rotation)
        waypoints.append(replace(point, pose=pose))
    file = replace(
        plain,
        arm=task.file.arm,
        object=task.file.object,
        conveyor=task.file.conveyor,
        waypoints=tuple(waypoints),
    )
    return Task(task_file.exact(file), task.urdf, text(file))


def _placed(pose: PoseFile) -> tuple[Array, Array]:
    return np.array(pose.position), rotations.matrix(pose.quaternion)


def _pose(position: Array, rotation: Array) -> PoseFile:
    x, y, z = np.round(position, DECIMALS).tolist()
    w, i, j, k = np.round(rotations.quaternion(rotation), DECIMALS).tolist()
    return PoseFile((x, y, z), (w, i, j, k))


def text(file: TaskFile) -> str:
    """Return a task as the text of a file."""
    return yaml.safe_dump(json.loads(json.dumps(asdict(file))), sort_keys=False)
