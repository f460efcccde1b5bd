"""Cell of a recording: its task and its arm, from the recording's texts."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from linemate.daemon.config import task_file
from linemate.daemon.config.documents import FileError
from linemate.daemon.core import rotations
from linemate.daemon.core.control import kinematics
from linemate.daemon.core.control.kinematics import Arm
from linemate.daemon.core.tracking.task import TaskFile
from linemate.protocol.stamped_samples import Vector3


class CellError(ValueError):
    """Texts that do not describe a cell; the message says what is missing."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedCell:
    """Task and arm that a recording was made with."""

    task: TaskFile
    arm: Arm


def read_cell(texts: Mapping[str, str], name: str) -> RecordedCell:
    """Return the cell of a recording.

    Args:
        texts: of the cell by name: at least task and urdf, and geometry if it was measured.
        name: of the recording, for messages.

    Raises:
        CellError: a text is missing or wrong.
    """
    missing = [text for text in ("task", "urdf") if text not in texts]
    if missing:
        raise CellError(f"{name}: the recording holds no {' and no '.join(missing)}")
    try:
        task = task_file.parse(texts["task"].encode(), f"{name}: task")
        tool = task.arm.tcp_in_flange
        arm = kinematics.load(
            texts["urdf"],
            task.arm.flange,
            np.array(tool.position),
            rotations.matrix(tool.quaternion),
            linear_axis=task.arm.linear_axis,
            geometry=task_file.geometry_of(texts, name),
        )
    except (FileError, ValueError) as error:
        raise CellError(f"{name}: {error}") from error
    return RecordedCell(task, arm)


def flange_in_tcp(texts: Mapping[str, str], name: str) -> Vector3:
    """Return the place of the flange in the tcp [m].

    Raises:
        CellError: a text is missing or wrong.
    """
    tool = read_cell(texts, name).task.arm.tcp_in_flange
    x, y, z = (-rotations.matrix(tool.quaternion).T @ np.array(tool.position)).tolist()
    return (x, y, z)
