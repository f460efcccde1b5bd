"""Files of a step's motion: its task, its arm and a configuration that runs it.

Invariants:
- The configuration is checked as ``linemated --check`` does before it gets its name.
- Nothing sensed enters the motion, and the tool is not damped, so that it rings.
"""

from pathlib import Path
from typing import Any, Final

import yaml

from linemate.daemon.commissioning.motion.measuring_motion import axis_task, exercise_task
from linemate.daemon.commissioning.walk import SiteState, StepName
from linemate.daemon.commissioning.whole_check import check
from linemate.daemon.config import documents
from linemate.daemon.operator import identify_command
from linemate.daemon.operator.commissioning.site_files import FOLDER, Site, checked

HEAD: Final = "# Made by `linemate commission`, step {name}. Do not edit: run the step again.\n"
NEVER_S: Final = 1e6  # until the sensed motion replaces the programmed one [s]
MOTIONS: Final = {StepName.SIGNS: "axes", StepName.SERVOS: "exercise"}


def write_motion(site: Site, state: SiteState, name: StepName) -> Path:
    """Write a motion's files and return the path of its configuration.

    Raises:
        FileError: the site's configuration is refused, or the motion in it.
        OSError: a file cannot be written.
    """
    report = checked(site, state)
    plain = documents.read(report.station.task.text.encode(), "task").value
    make = axis_task if name is StepName.SIGNS else exercise_task
    motion = MOTIONS[name]
    identify_command.write(site.folder / "arm.urdf", report.station.task.urdf)
    task = site.folder / f"{motion}-task.yaml"
    identify_command.write(
        task, HEAD.format(name=name.value) + _yaml(make(report.parameters, plain))
    )
    config = documents.read(site.config.read_bytes(), str(site.config)).value
    text = HEAD.format(name=name.value) + _yaml(_config(config, state, task.name))
    path = site.directory / f"commission-{motion}.yaml"
    candidate = site.directory / f".{path.name}.candidate"
    identify_command.write(candidate, text)
    try:
        check(candidate)
    finally:
        candidate.unlink(missing_ok=True)
    identify_command.write(path, text)
    return path


def _config(config: dict[str, Any], state: SiteState, task: str) -> dict[str, Any]:
    """Return the site's configuration with the motion's task."""
    overlays = [str(name) for name in config.get("overlays") or ()]
    own = [f"{FOLDER}/{name}" for name in state.overlays()]
    tracking, control = dict(config.get("tracking") or {}), dict(config.get("control") or {})
    tracking["merge"] = {**(tracking.get("merge") or {}), "blend": NEVER_S}
    control["damping"] = False
    kept = {key: value for key, value in config.items() if key not in {"production", "learning"}}
    return {
        **kept,
        "task": f"{FOLDER}/{task}",
        "overlays": overlays + [name for name in own if name not in overlays],
        "tracking": tracking,
        "control": control,
    }


def _yaml(value: dict[str, Any]) -> str:
    return str(yaml.safe_dump(value, sort_keys=False, default_flow_style=None, width=100))
