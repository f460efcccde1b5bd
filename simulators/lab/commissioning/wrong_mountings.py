"""What ``linemate commission`` finds of a cell that is mounted wrongly, by the plant's truth.

    python -m linemate.simulators.lab.commissioning.wrong_mountings

It prints JSON: for each mounting and shipped cell how far the result is off the truth, or why the
step was refused.
"""

import json
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from linemate.daemon.commissioning.walk import StepName, StepOutcome, StepRecordOfSite
from linemate.daemon.core import rotations
from linemate.simulators.devices.guided_robot import FORWARD
from linemate.simulators.devices.rsi_controller import Seven
from linemate.simulators.lab import commission_cell, commission_run
from linemate.simulators.lab.commission_cell import EmulatedCell
from linemate.simulators.lab.commissioning import site_copy

A5_MIRRORED: Final[Seven] = (1.0, 1.0, 1.0, 1.0, -1.0, 1.0, 1.0)
A3_MIRRORED: Final[Seven] = (1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0)
CAMERA_PLACE, CAMERA_TURN = (-0.06, 0.05, -0.12), (0.1, -0.2, 0.9)
SENSOR_TURN: Final = (0.2, -0.4, 1.0)
OFFSET, TURN = (0.05, 0.0, -0.04), (0.0, 0.03, 0.0)  # of the objects off their nominal place

Overlay = Mapping[str, Any]
Errors = dict[str, float]


@dataclass(frozen=True, slots=True)
class Mounting:
    """What is mounted wrongly, and the step that should find or refuse it.

    Attributes:
        errors: of the step's overlay against the truth, None if the step should refuse.
        signs: of the axes as the controller counts.
        corrected: share of a correction by which each axis moves.
        truth: ``KEY=VALUE`` of the scenario.
    """

    what: str
    step: StepName
    errors: Callable[[Overlay, EmulatedCell], Errors] | None = None
    signs: Seven = FORWARD
    corrected: Seven = FORWARD
    truth: tuple[str, ...] = ()


def _turn_mrad(quaternion: Any, truth: Any) -> float:
    """Return the angle between a pose's quaternion and a rotation vector [mrad]."""
    off = rotations.exp(np.array(truth)).T @ rotations.matrix(tuple(quaternion))
    return 1e3 * float(np.linalg.norm(rotations.log(off)))


def _camera(overlay: Overlay, _cell: EmulatedCell) -> Errors:
    mount = overlay["task"]["arm"]["camera_in_tcp"]
    off = np.subtract(mount["position"], CAMERA_PLACE)
    turned = _turn_mrad(mount["quaternion"], CAMERA_TURN)
    return {"mm": 1e3 * float(np.linalg.norm(off)), "mrad": turned}


def _sensor(overlay: Overlay, cell: EmulatedCell) -> Errors:
    arm, payload = overlay["task"]["arm"], overlay["tracking"]["payload"]
    return {
        "mrad": _turn_mrad(arm["sensor_in_tcp"]["quaternion"], SENSOR_TURN),
        "kg": abs(payload["mass"] - site_copy.TOOL_MASS[cell.site.name]),
    }


def _line(overlay: Overlay, cell: EmulatedCell) -> Errors:
    off = np.subtract(
        overlay["task"]["conveyor"]["axis"], commission_run.line_direction(cell.setup())
    )
    return {"mrad": 1e3 * float(np.linalg.norm(off))}


def _object(overlay: Overlay, cell: EmulatedCell) -> Errors:
    nominal, place = cell.setup().task.object.nominal, overlay["task"]["object"]["nominal"]
    axes = rotations.matrix(nominal.quaternion)
    off = axes.T @ np.subtract(place["position"], nominal.position) - OFFSET
    turned = rotations.exp(np.array(TURN)).T @ axes.T @ rotations.matrix(tuple(place["quaternion"]))
    return {
        "mm": 1e3 * float(np.linalg.norm(off)),
        "mrad": 1e3 * float(np.linalg.norm(rotations.log(turned))),
    }


MOUNTINGS: Final = (
    Mounting(
        "camera turned by 0.93 rad and moved", StepName.CAMERA, _camera,
        truth=(
            f"scenario.camera.position_in_tcp={list(CAMERA_PLACE)}",
            f"scenario.camera.rotation_in_tcp={list(CAMERA_TURN)}",
        ),
    ),
    Mounting(
        "sensor on the flange, turned by 1.1 rad, opposite sign, with a tool", StepName.FORCE,
        _sensor,
        truth=(
            f"scenario.force_torque.rotation_in_tcp={list(SENSOR_TURN)}",
            "scenario.force_torque.sign=-1",
        ),
    ),
    Mounting("axis A5 counts the other way", StepName.CAMERA, signs=A5_MIRRORED),
    Mounting("correction of A3 moves it the other way", StepName.SIGNS, corrected=A3_MIRRORED),
    Mounting(
        "conveyor 10 mrad off", StepName.CONVEYOR, _line,
        truth=("scenario.conveyor.effects.askew=[0.01, 0.0]",),
    ),
    Mounting(
        "objects 50 and 40 mm off their nominal place, turned by 30 mrad", StepName.OBJECT, _object,
        truth=(f"scenario.body.offset={list(OFFSET)}", f"scenario.body.rotation={list(TURN)}"),
    ),
)  # fmt: skip


def tried(mounting: Mounting, name: str, folder: Path) -> dict[str, Any]:
    """Measure a wrong mounting in a copy of a shipped cell."""
    site = site_copy.copied(name, folder)
    truth = mounting.truth
    words = []
    if mounting.step is StepName.FORCE:
        words = ["--sensor-at", "flange"]
        truth += (
            f"scenario.force_torque.position_in_tcp={_flange_in_tcp(site)}",
            f"scenario.effector.load.tool_mass={site_copy.TOOL_MASS[name]}",
        )
    cell = EmulatedCell(site, mounting.signs, mounting.corrected, truth)
    files = commission_cell.recorded(cell, mounting.step, folder)
    record = site_copy.commission(site, mounting.step, *words, "--from", *files)
    row = {"mounting": mounting.what, "cell": name, "step": mounting.step.value}
    if record.outcome is not StepOutcome.MEASURED:
        return row | {"refused": _refusal(record), "written": record.overlay is not None}
    assert mounting.errors is not None  # noqa: S101 - a mounting that should be refused was not
    errors = mounting.errors(site_copy.overlay(site, mounting.step), cell)
    return row | {"off": {unit: round(value, 4) for unit, value in errors.items()}}


def _flange_in_tcp(site: Path) -> list[float]:
    tcp = EmulatedCell(site).setup().task.arm.tcp_in_flange
    place: list[float] = (-rotations.matrix(tcp.quaternion).T @ tcp.position).tolist()
    return place


def _refusal(record: StepRecordOfSite) -> str:
    """Return the reason of the first figure that was refused, or that of the step."""
    reasons = [str(figure["refused"]) for figure in record.figures if "refused" in figure]
    return [*reasons, record.reason][0]


def main() -> int:
    """Print what each mounting gave."""
    rows = []
    for mounting in MOUNTINGS:
        for name in site_copy.TOOL_MASS:
            with tempfile.TemporaryDirectory(prefix="linemate-") as folder:
                rows.append(tried(mounting, name, Path(folder)))
            print(rows[-1], file=sys.stderr, flush=True)
    print(json.dumps({"rows": rows}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
