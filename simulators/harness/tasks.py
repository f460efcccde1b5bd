"""The task that a run gives to the daemon: the shipped one, read strictly.

Law of this file: a task file in, a ``TaskFile`` out; the daemon's own data is read, not copied.
"""

from functools import cache
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from linemate import daemon
from linemate.daemon.tracking.task import TaskFile
from linemate.simulators.harness import located
from linemate.simulators.harness.located import FileError

DATA = Path(next(iter(daemon.__path__))) / "data"
DEFAULT = "wheel.yaml"


class _Plain(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    task: TaskFile


def load(path: Path) -> TaskFile:
    """Read a task file.

    Raises:
        FileError: it cannot be read, or every error in it.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FileError([f"{path}:1:1: (whole file): {error}"]) from error
    return located.validate(located.read(text, str(path)), _Plain, "task").task


@cache
def default() -> TaskFile:
    """The shipped task: the wheel onto the hub."""
    return load(DATA / DEFAULT)


def urdf(task: TaskFile) -> str:
    """Text of the task's URDF: a bare name is one of the shipped ones."""
    return (DATA / task.arm.urdf).read_text(encoding="utf-8")
