"""What the cell looks like: read once, from the daemon's word or from a recording's texts.

Law of this file: pure; texts in, a scene out. What cannot be read is left out of the picture and
said, for a view of half a cell is better than none at three in the morning.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import yaml

from linemate.daemon.view.chain import Chain, ChainError, Pose, read

AT_ORIGIN: Final[Pose] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Scene:
    """A cell.

    Attributes:
        cycle_s: T0 [s], 0 if it is not known.
        chain: of the arm, None if it cannot be drawn.
        trouble: why not, empty if it can.
        nominal: the nominal object in base as the task begins; its y axis lies along the conveyor.
        camera: in the tcp, None if there is none.
        rest: A1..A6 at rest [rad], empty if not known.
    """

    task: str = ""
    cycle_s: float = 0.0
    chain: Chain | None = None
    trouble: str = "the cell is not known yet"
    nominal: Pose = AT_ORIGIN
    camera: Pose | None = None
    rest: tuple[float, ...] = ()

    def told(self) -> dict[str, Any]:
        """What the page is told, plain values."""
        return {
            "task": self.task,
            "cycle_ms": round(1e3 * self.cycle_s, 6),
            "trouble": self.trouble,
            "nominal": self.nominal,
            "camera": self.camera,
        }


def of(told: Mapping[str, Any]) -> Scene:
    """Return the scene of a daemon's word, or of a recording's texts.

    Args:
        told: ``task`` (YAML), ``urdf``, and ``cycle_s``.
    """
    cycle_s = told.get("cycle_s")
    period = float(cycle_s) if isinstance(cycle_s, (int, float)) else 0.0
    try:
        # A task is small and of our own daemon; YAML's limits are those of its reader.
        task = _a_map(yaml.safe_load(str(told.get("task", ""))))
        arm = task["arm"]
        name = str(task.get("name", ""))
        nominal = _pose(task["object"]["nominal"])
        camera = _pose(arm["camera_in_tcp"]) if "camera_in_tcp" in arm else None
        rest = tuple(float(value) for value in arm.get("rest_joints", ()))
    except (yaml.YAMLError, ValueError, TypeError, KeyError, AttributeError) as error:
        return Scene(cycle_s=period, trouble=f"the task cannot be read: {_short(error)}")
    try:
        chain = read(
            str(told.get("urdf", "")),
            str(arm.get("flange", "flange")),
            _pose(arm.get("tcp_in_flange", {})),
            linear_axis=bool(arm.get("linear_axis", False)),
        )
    except (ChainError, ValueError, TypeError, KeyError) as error:
        why = f"the arm cannot be drawn: {_short(error)}"
        return Scene(name, period, None, why, nominal, camera, rest)
    return Scene(name, period, chain, "", nominal, camera, rest)


def _a_map(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise TypeError("no map")
    return value


def _pose(told: Mapping[str, Any]) -> Pose:
    """Read a pose of a task file.

    Raises:
        ValueError, TypeError: it is none.
    """
    x, y, z = (float(part) for part in told.get("position", (0.0, 0.0, 0.0)))
    w, i, j, k = (float(part) for part in told.get("quaternion", (1.0, 0.0, 0.0, 0.0)))
    length = math.hypot(w, i, j, k)
    if not (math.isfinite(x + y + z) and 0.0 < length < math.inf):
        raise ValueError("a pose that is no numbers")
    return x, y, z, w / length, i / length, j / length, k / length


def _short(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".splitlines()[0][:160]
