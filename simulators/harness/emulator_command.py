"""``linemate-sim emulator``: run a station of emulated devices from a file.

Invariants:
    Keys are those of ``EmulatorConfig``; a scenario is a name or a path.
    Relative paths are relative to the file. A bare name that is not there may be a shipped file.
    Standard output has one JSON line a state; the rest goes to standard error.
"""

import inspect
import sys
from argparse import Namespace
from dataclasses import MISSING, Field, dataclass, field, fields, make_dataclass, replace
from pathlib import Path
from typing import Any

from linemate.daemon.config import documents, files
from linemate.daemon.config.documents import FileError
from linemate.daemon.config.reading.complaints import Complaint
from linemate.protocol.errors import ProtocolError
from linemate.simulators.devices.faults import REAL, Faults
from linemate.simulators.devices.links.emulator import serve
from linemate.simulators.devices.links.emulator_config import EmulatorConfig
from linemate.simulators.harness import host, scenario_file
from linemate.simulators.harness.world import world_rows

OWN = ("scenario", "seed", "cycle_ms", "priority", "cpus")
SHIPPED = ("rsi_xml", "dbc")  # keys whose bare name may be a shipped file
EX_BROKEN = 1
EX_UNAVAILABLE = 69


def _default(entry: "Field[Any]") -> Any:
    if entry.default_factory is not MISSING:
        return field(default_factory=entry.default_factory)
    return field(default=entry.default)


EmulatorFile = make_dataclass(
    "EmulatorFile",
    [
        ("scenario", str, field(default=scenario_file.DEFAULT)),
        ("seed", int | None, field(default=None)),
        ("cycle_ms", float | None, field(default=None)),
        ("priority", int | None, field(default=None)),
        ("cpus", tuple[int, ...], field(default=())),
        *((f.name, f.type, _default(f)) for f in fields(EmulatorConfig) if f.name != "scenario"),
    ],
    frozen=True,
)
"""A file's keys: EmulatorConfig's fields and the ones of ``OWN``."""

_OWN_MEANINGS = """
    scenario: a shipped scenario's name, or a path.
    seed: of the run instead of the scenario's.
    cycle_ms: period of the controller instead of the scenario's [ms].
    priority: of SCHED_FIFO to ask the host for; None: none.
    cpus: the only cores to use; empty: all.
"""
EmulatorFile.__doc__ = inspect.cleandoc(EmulatorConfig.__doc__ or "") + _OWN_MEANINGS


@dataclass(frozen=True, slots=True)
class Wishes:
    """What the host is asked for: a priority of SCHED_FIFO, and cores; None and empty for none."""

    priority: int | None
    cpus: tuple[int, ...]


def load(path: Path) -> tuple[EmulatorConfig, Wishes]:
    """Read a file.

    Returns:
        The station, and what to ask the host for.

    Raises:
        FileError: every error at once.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise FileError([f"{path}:1:1: (file): {error.strerror}"]) from error
    document = documents.read(data, str(path))
    wanted: Any = documents.fill(document, EmulatorFile)
    try:
        scenario = scenario_file.load(_scenario_name(wanted.scenario, path.parent))
        if wanted.seed is not None:
            scenario = replace(scenario, seed=wanted.seed)
        if wanted.cycle_ms is not None:
            scenario = replace(scenario, cycle_s=round(wanted.cycle_ms * 1e-3, 9))
        Faults(scenario.faults, REAL)
        values = {f.name: getattr(wanted, f.name) for f in fields(wanted) if f.name not in OWN}
        placed: dict[str, Any] = {
            name: _placed(document, name, value, path.parent) for name, value in values.items()
        }
        return EmulatorConfig(scenario=scenario, **placed), Wishes(wanted.priority, wanted.cpus)
    except ValueError as error:
        raise FileError([document.line(Complaint((), str(error)))]) from error


def schema() -> dict[str, Any]:
    """JSON schema of an emulator's file."""
    return documents.schema(EmulatorFile, "linemate emulator")


def main(args: Namespace) -> int:
    """Run a station to its end, or until it is ended.

    Returns:
        0; 1 when the controller broke the exchange off; 69 when a port or device cannot be had.

    Raises:
        FileError: what is wrong with the file.
    """
    config, wishes = load(args.config)
    for refused in host.grant(wishes.priority, wishes.cpus):
        print(f"linemate-sim emulator: {refused}", file=sys.stderr)
    try:
        result = serve(config)
    except (OSError, ProtocolError) as error:
        print(f"linemate-sim emulator: {error}", file=sys.stderr)
        return EX_UNAVAILABLE
    broken = result.facts["broken"]
    if broken is None:
        return 0
    print(
        f"linemate-sim emulator: the controller broke the exchange off: {broken}. "
        "Check that the daemon answers each telegram.",
        file=sys.stderr,
    )
    return EX_BROKEN


def _placed(document: documents.YamlDocument, key: str, value: Any, base: Path) -> Any:
    """Return a value of the file with its path resolved.

    Raises:
        FileError: a file to read that is not there.
    """
    if not isinstance(value, Path):
        return value
    if key not in SHIPPED:
        return base / value
    try:
        return files.find(str(value), base, files.PROTOCOL_DATA)
    except files.UnreadableError as error:
        raise FileError([document.line(Complaint((key,), str(error)))]) from error


def _scenario_name(name: str, base: Path) -> str:
    shipped = (*scenario_file.shipped(), *world_rows.names())
    return name if name in shipped else str(base / name)
