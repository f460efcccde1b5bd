"""What the page draws of a cell: the arm's chain, its rail, the nominal object, the camera.

Invariants:
    * Pure: texts of the daemon or of a recording in, a cell out.
    * What cannot be read is left out of the picture, with the reason in ``trouble``.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import yaml

from linemate.daemon.view.chain import Chain, ChainError, Pose, Vector, read_chain

AT_ORIGIN: Final[Pose] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell.

    Attributes:
        cycle_s: T0 [s], 0 if it is not known.
        chain: The arm, None if it cannot be drawn.
        trouble: Why it cannot be drawn, empty if it can.
        nominal: Nominal object in base as the task begins; its y axis lies along the conveyor.
        camera: Camera in the tcp, None if there is none.
    """

    task: str = ""
    cycle_s: float = 0.0
    chain: Chain | None = None
    trouble: str = "the cell is not known yet"
    nominal: Pose = AT_ORIGIN
    camera: Pose | None = None

    def as_page(self) -> dict[str, Any]:
        """Return plain values for the page."""
        return {
            "task": self.task,
            "cycle_ms": round(1e3 * self.cycle_s, 6),
            "trouble": self.trouble,
            "nominal": self.nominal,
            "camera": self.camera,
            "rail": None if self.chain is None else self.chain.rail(),
            "reach": None if self.chain is None else round(self.chain.reach(), 3),
        }


def read_cell(texts: Mapping[str, Any]) -> Cell:
    """Return the cell of a daemon's answer to ``scene``, or of a recording's metadata.

    Args:
        texts: ``task`` (YAML), ``urdf``, ``geometry`` (YAML) if it was measured, and ``cycle_s``.
    """
    cycle_s = texts.get("cycle_s")
    period_s = float(cycle_s) if isinstance(cycle_s, (int, float)) else 0.0
    try:
        # The task is small and comes from our own daemon.
        task = _mapping(yaml.safe_load(str(texts.get("task", ""))))
        arm = task["arm"]
        name = str(task.get("name", ""))
        nominal = _pose(task["object"]["nominal"])
        camera = _pose(arm["camera_in_tcp"]) if "camera_in_tcp" in arm else None
    except (yaml.YAMLError, ValueError, TypeError, KeyError, AttributeError) as error:
        return Cell(cycle_s=period_s, trouble=f"the task cannot be read: {_short(error)}")
    try:
        chain = read_chain(
            str(texts.get("urdf", "")),
            str(arm.get("flange", "flange")),
            _pose(arm.get("tcp_in_flange", {})),
            linear_axis=bool(arm.get("linear_axis", False)),
            geometry=_geometry(texts),
        )
    except (yaml.YAMLError, ChainError, ValueError, TypeError, KeyError) as error:
        trouble = f"the arm cannot be drawn: {_short(error)}"
        return Cell(name, period_s, None, trouble, nominal, camera)
    return Cell(name, period_s, chain, "", nominal, camera)


def _geometry(texts: Mapping[str, Any]) -> list[tuple[Vector, Vector]]:
    """Return place and rotation vector of each measured axis, seen from the URDF's."""
    value = yaml.safe_load(str(texts.get("geometry", ""))) or {}
    rows = _mapping(value).get("geometry", ())
    return [(_vector(row["shift"]), _vector(row["turn"])) for row in rows]


def _vector(row: Sequence[Any]) -> Vector:
    x, y, z = (float(part) for part in row)
    return x, y, z


def _mapping(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise TypeError("not a mapping")
    return value


def _pose(entry: Mapping[str, Any]) -> Pose:
    """Return a pose of a task file.

    Raises:
        ValueError, TypeError: It is not a pose.
    """
    x, y, z = (float(part) for part in entry.get("position", (0.0, 0.0, 0.0)))
    w, i, j, k = (float(part) for part in entry.get("quaternion", (1.0, 0.0, 0.0, 0.0)))
    length = math.hypot(w, i, j, k)
    if not (math.isfinite(x + y + z) and 0.0 < length < math.inf):
        raise ValueError("a pose that is not finite")
    return x, y, z, w / length, i / length, j / length, k / length


def _short(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".splitlines()[0][:160]
