"""Setup of a run: the plant's truth, the daemon's settings, and ``--set`` for both.

Invariants:
    Truth (``scenario``) and settings (``tracking``, ``control``, ``task``) are never copied
        into each other.
    An override passes the same validation as a file.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from linemate.daemon.config import documents
from linemate.daemon.config.config import LoadedConfig
from linemate.daemon.config.documents import FileError
from linemate.daemon.core.control import urdf_limits
from linemate.daemon.core.control.settings import ControlSettings
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.daemon.core.tracking.task import TaskFile
from linemate.daemon.near_names import near_names
from linemate.simulators.devices.worlds import OWN, UNUSED
from linemate.simulators.harness import identified_overlay as overlays
from linemate.simulators.harness import scenario_file
from linemate.simulators.harness.cell import families, variants
from linemate.simulators.harness.cell.cell_files import CellFiles
from linemate.simulators.harness.cell.cell_truth import shipped_task
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.harness.world import world_rows
from linemate.simulators.mujoco_world import mujoco_cell
from linemate.simulators.mujoco_world.mujoco_cell import MujocoCell
from linemate.simulators.plants.scenario import Scenario

_OWN_TRUTH = tuple(f"scenario.{part}" for part in UNUSED)


class OverrideError(SetupError):
    """A ``--set KEY=VALUE`` that cannot be applied."""

    def __init__(self, key: str, what: str) -> None:
        super().__init__(f"--set {key}: {what}")
        self.key = key


@cache
def shipped_control() -> ControlSettings:
    """Return the default settings of control with the limits of the shipped arm."""
    task = shipped_task()
    arm = task.file.arm
    return urdf_limits.completed(
        ControlSettings(), task.urdf, arm.flange, linear_axis=arm.linear_axis
    )


@dataclass(frozen=True, slots=True)
class Setup:
    """One run before its seed.

    Attributes:
        urdf: text of the task's URDF.
        variant: which transformation has been applied to tracking and control.
        world: what solves the truth, one of ``worlds.WORLDS``.
        mujoco: sizes of the MuJoCo station.
        controller: family of the controller, one of ``families.FAMILIES``.
        station: the daemon's configuration, for its links; None: those of the shipped cell.
    """

    scenario: Scenario
    tracking: TrackingSettings = field(default_factory=TrackingSettings)
    control: ControlSettings = field(default_factory=shipped_control)
    task: TaskFile = field(default_factory=lambda: shipped_task().file)
    urdf: str = field(default_factory=lambda: shipped_task().urdf, repr=False)
    variant: str = "default"
    world: str = OWN
    mujoco: MujocoCell = field(default_factory=MujocoCell)
    controller: str = families.RSI
    station: LoadedConfig | None = field(default=None, repr=False)


class _Plain(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    scenario: Scenario
    tracking: TrackingSettings
    control: ControlSettings
    task: TaskFile
    mujoco: MujocoCell


ROOTS = ("scenario", "tracking", "control", "task", "mujoco")


def make(
    scenario: str,
    overrides: Sequence[str] = (),
    *,
    variant: str = "default",
    cycle_ms: float | None = None,
    world: str = OWN,
    controller: str | None = None,
    cell: CellFiles | None = None,
) -> Setup:
    """Put a run together.

    Args:
        overrides: ``KEY=VALUE`` each; a key is a path from one of ROOTS, or the end of one
            that is unique; a value is YAML.
        variant: applied before the overrides, which have the last word.
        cycle_ms: instead of the scenario's cycle.
        world: one of ``worlds.WORLDS``; the daemon has what was identified of that station. A
            scenario that is too short for an assembly there is longer.
        controller: one of ``families.FAMILIES``; with its period unless one is given. None: that
            of the cell.
        cell: files of another cell than the shipped one.

    Raises:
        FileError, OverrideError, UnknownVariantError: what is wrong.
    """
    truth = scenario_file.load(scenario, None if cell is None else cell.nominal)
    controller, cycle_ms = exchange(cell, controller, cycle_ms)
    if cycle_ms is not None:
        truth = replace(truth, cycle_s=round(cycle_ms * 1e-3, 9))
    if world != OWN:
        _refuse_cell(cell, world)
        _refuse_unused(truth, overrides)
        truth = replace(truth, duration_s=max(truth.duration_s, mujoco_cell.SHORTEST_RUN_S))
    behind = families.truth(controller, truth)
    if cell is not None:
        known = _of_cell(cell)
    else:
        known = _commissioned(scenario) if world == OWN else identified(world)
    if cell is None or behind is not truth:
        known = _behind(controller, known)
    tracking, control = variants.apply(variant, known.tracking, known.control)
    truth = behind
    known = replace(known, variant=variant, controller=controller)
    setup = replace(known, scenario=truth, tracking=tracking, control=control)
    return override(setup, overrides) if overrides else setup


def exchange(
    cell: CellFiles | None, controller: str | None, cycle_ms: float | None
) -> tuple[str, float | None]:
    """Return family and period of the controller: as asked for, else the cell's, else RSI's."""
    own = None if cell is None else cell.family
    family = controller or own or families.RSI
    if cycle_ms is None and cell is not None and family == own:
        cycle_ms = cell.cycle_ms
    if cycle_ms is None and family != families.RSI:
        cycle_ms = families.CYCLE_MS[family]
    return family, cycle_ms


def _refuse_cell(cell: CellFiles | None, world: str) -> None:
    """Refuse a cell of its own in a world that has the shipped cell alone.

    Raises:
        SetupError: there is one.
    """
    if cell is not None:
        raise SetupError(
            f"--world {world} has the shipped cell alone. Leave --cell, --config and --task out."
        )


def _of_cell(cell: CellFiles) -> Setup:
    """Return the settings of a cell's configuration, without a truth of its own."""
    task = cell.task
    if cell.station is None:
        arm = task.file.arm
        try:
            control = urdf_limits.completed(
                replace(identified().control, limits=()),
                task.urdf,
                arm.flange,
                linear_axis=arm.linear_axis,
            )
        except urdf_limits.UrdfLimitsError as error:
            raise SetupError(f"{arm.urdf}: {error}") from error
        return replace(identified(), control=control, task=task.file, urdf=task.urdf)
    config = cell.station.config
    return Setup(
        scenario_file.load(scenario_file.DEFAULT),
        config.tracking,
        config.control,
        task.file,
        task.urdf,
        station=cell.station,
    )


def _refuse_unused(scenario: Scenario, overrides: Sequence[str]) -> None:
    """Refuse a truth that the MuJoCo world would pass over.

    Raises:
        SetupError: it is in the scenario, or in an override.
    """
    plain = Scenario()
    changed = [part for part in UNUSED if getattr(scenario, part) != getattr(plain, part)]
    changed += [text for text in overrides if text.startswith(_OWN_TRUTH)]
    if changed:
        raise SetupError(
            f"{changed[0]}: the MuJoCo world has sizes of its own. Set mujoco.* instead."
        )


@cache
def identified(world: str = OWN) -> Setup:
    """Settings of the shipped cell of a world, as ``linemate identify`` found them.

    The plant's own numbers never reach a run; see ``identified_overlay.SHIPPED``.
    """
    whole = Setup(scenario_file.load(scenario_file.DEFAULT), world=world)
    return laid_over(whole, overlays.load(overlays.SHIPPED[world]))


@cache
def _commissioned(scenario: str) -> Setup:
    """Settings of the cell of a scenario: those identified, and what its commissioning adds."""
    known, own = identified(), world_rows.daemon_settings(scenario)
    return laid_over(known, own) if own else known


def _behind(controller: str, known: Setup) -> Setup:
    """Return settings with what was identified of the servos behind a family's controller."""
    servos = overlays.BEHIND.get(controller)
    return known if servos is None else laid_over(known, overlays.load(servos))


def laid_over(setup: Setup, overlay: Mapping[str, Any]) -> Setup:
    """Return a run whose daemon has the settings of an overlay.

    Raises:
        SetupError: the overlay does not fit.
    """
    strange = [key for key in overlay if key not in overlays.SECTIONS]
    if strange:
        raise SetupError(f"an overlay has no section {', '.join(strange)}")
    leaves = overlays.leaves(overlay)
    return override(setup, [f"{path}={json.dumps(value)}" for path, value in leaves])


def override(setup: Setup, overrides: Sequence[str]) -> Setup:
    """Apply ``KEY=VALUE`` one after another.

    Raises:
        OverrideError: no such key, an ambiguous one, or a value that does not fit.
    """
    whole = _Plain(
        scenario=setup.scenario,
        tracking=setup.tracking,
        control=setup.control,
        task=setup.task,
        mujoco=setup.mujoco,
    )
    plain: dict[str, Any] = whole.model_dump(mode="json")
    for assignment in overrides:
        key, separator, text = assignment.partition("=")
        if not separator:
            raise OverrideError(key, "should be KEY=VALUE")
        path = _resolve(plain, key)
        _set_value(plain, path, _value(key, text))
        whole = _validated(plain, key)
    return replace(
        setup,
        scenario=whole.scenario,
        tracking=whole.tracking,
        control=whole.control,
        task=whole.task,
        mujoco=whole.mujoco,
    )


def _value(key: str, text: str) -> Any:
    """A value as a scenario file would have it."""
    try:
        document = documents.read(f"value: {text}".encode(), "--set")
    except FileError as error:
        raise OverrideError(key, f"{text!r} is not YAML") from error
    if document.complaints:
        raise OverrideError(key, document.complaints[0].what)
    return document.value["value"]


def _validated(plain: dict[str, Any], key: str) -> _Plain:
    for complaint in scenario_file.complaints(plain["scenario"]):
        raise OverrideError(key, f"{complaint.what} ({documents.spelled(complaint.path)})")
    try:
        return _Plain.model_validate_json(json.dumps(plain), strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise OverrideError(key, f"{first['msg']} ({place})") from error


Path = tuple[str | int, ...]


def _resolve(plain: dict[str, Any], key: str) -> Path:
    """The one path that a key means: itself from a root, or the end of a single path."""
    parts = tuple(int(part) if part.isdigit() else part for part in key.split("."))
    known = _paths(plain)
    if parts[0] in ROOTS:
        matches = [path for path in known if path == parts]
    else:
        matches = [path for path in known if path[-len(parts) :] == parts]
    if len(matches) == 1:
        return matches[0]
    if matches:
        names = ", ".join(".".join(map(str, path)) for path in matches[:5])
        raise OverrideError(key, f"could be {names}")
    every = [".".join(map(str, path)) for path in known]
    raise OverrideError(key, f"no such key{near_names(key, every)}")


def _paths(value: Any, path: Path = ()) -> list[Path]:
    """Every path there is, branches as well as leaves."""
    items: list[tuple[str | int, Any]] = []
    if isinstance(value, dict):
        items = list(value.items())
    elif isinstance(value, list):
        items = list(enumerate(value))
    paths = [path] if path else []
    for key, item in items:
        paths += _paths(item, (*path, key))
    return paths


def _set_value(plain: dict[str, Any], path: Path, value: Any) -> None:
    branch: Any = plain
    for part in path[:-1]:
        branch = branch[part]
    branch[path[-1]] = value
