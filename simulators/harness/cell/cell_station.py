"""A cell in real time: the files of daemon and emulator with the links of one host.

Invariants:
    Links are of the loopback; everything else of the daemon's file is as configured.
    Relative names become absolute: the written file stands in another folder.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from linemate.daemon.config import documents, files
from linemate.daemon.config.files import DAEMON_DATA, PROTOCOL_DATA
from linemate.daemon.config.settings import Corrections
from linemate.simulators.harness.cell import cell_truth, families
from linemate.simulators.harness.cell.cell_files import CellFiles
from linemate.simulators.harness.cell.variants import SetupError

OWN_LINKS = ("production", "command", "recording", "state", "realtime")
"""Sections that a run on one host has of its own, or cannot have."""


def daemon_file(cell: CellFiles) -> dict[str, Any]:
    """Return the plain values of the daemon's file: task, settings and links as configured."""
    if cell.station is None:
        return {"task": _absolute(cell.task_path)}
    station, base = cell.station, cell.station.path.parent
    data = station.texts["config"].encode()
    value = documents.read(data, str(station.path)).value
    plain = {key: part for key, part in _plain(value).items() if key not in OWN_LINKS}
    named = files.find(plain["task"], base, DAEMON_DATA)
    plain["task"] = _absolute(cell.task_path or named)
    plain["overlays"] = [_absolute(base / name) for name in plain.get("overlays", ())]
    for section, key in (("rsi", "config"), ("distance", "dbc")):
        name = (plain.get(section) or {}).get(key)
        if name is not None:
            plain[section][key] = _absolute(files.find(name, base, PROTOCOL_DATA))
    return plain


def with_links(
    plain: Mapping[str, Any], controller: Mapping[str, Any], can: Mapping[str, Any], wrench: str
) -> dict[str, Any]:
    """Return a daemon's file with the links of one host.

    Args:
        controller: sections of the controller's family.
        can: ``interface`` and ``channel`` of the distance sensor's bus.
        wrench: URL of the force-torque sensor.
    """
    linked = dict(plain)
    for name, section in controller.items():
        linked[name] = {**(plain.get(name) or {}), **section}
    for name in ("rsi", "egm"):
        if name in linked:
            linked[name] |= {"bind": families.LOOPBACK, "peer": None}
    linked["distance"] = {**(plain.get("distance") or {}), "can": dict(can)}
    here = {"bind": families.LOOPBACK, "port": 0, "peer": None}
    linked["camera"] = {**(plain.get("camera") or {}), **here}
    if "force_torque" in plain or "rsi" not in plain:
        linked["force_torque"] = {**(plain.get("force_torque") or {}), "url": wrench}
    return linked


def emulator_file(cell: CellFiles, family: str, folder: Path) -> dict[str, Any]:
    """Return what the emulated station has of the cell, and write the files that it names.

    Args:
        folder: takes the controller's file and the DBC.

    Raises:
        SetupError: a link that the emulated station cannot have.
    """
    file = cell.task.file
    limits = [asdict(limit) for limit in cell_truth.axis_limits(cell.task.urdf, file)]
    content: dict[str, Any] = {"distance_mount": file.conveyor.start_position}
    content[{families.RSI: "controller"}.get(family, family)] = {"limits": limits}
    if family == families.FANUC:
        content["fanuc"]["has_rail"] = file.arm.linear_axis
    station = cell.station
    if station is None:
        return content
    if station.controller_file is not None and family == families.RSI:
        (folder / "rsi.xml").write_text(station.texts["rsi"], encoding="utf-8")
        content["rsi_xml"] = str(folder / "rsi.xml")
        if station.config.rsi.corrections is Corrections.RELATIVE:
            content["controller"]["mode"] = "relative"
    return content | _sensors(cell, folder)


def _sensors(cell: CellFiles, folder: Path) -> dict[str, Any]:
    """Return the emulated ends of the sensors' links."""
    assert cell.station is not None  # noqa: S101 - the caller has looked
    config, dbc = cell.station.config, cell.station.dbc
    distance, camera, wrench = config.distance, config.camera, config.force_torque
    if distance is None or dbc is None or camera is None:
        name = "camera" if camera is None else "distance"
        raise SetupError(f"the configuration has no section {name}: the emulated cell needs it")
    if distance.can_id is not None or distance.step_m is not None:
        raise SetupError(
            "distance.can_id and distance.step_m are not emulated. Write them into the DBC."
        )
    (folder / "distance.dbc").write_text(dbc, encoding="latin-1")
    links: dict[str, Any] = {
        "dbc": str(folder / "distance.dbc"),
        "dbc_message": distance.message,
        "dbc_signal": distance.signal,
    }
    names = {"source": camera.source, "frame": camera.frame, "object": camera.object}
    links |= {f"camera_{key}": name for key, name in names.items() if name is not None}
    if wrench is not None:
        links["force_torque_device"] = wrench.device
    return links


def _absolute(path: Path | None) -> str:
    assert path is not None  # noqa: S101 - a cell without configuration has a task
    return str(path.resolve())


def _plain(value: Any) -> dict[str, Any]:
    plain: dict[str, Any] = json.loads(json.dumps(value))
    return plain
