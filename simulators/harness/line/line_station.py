"""Station of a line: a cell's production, and cars without a fault.

Invariants:
- A cell's folder has ``station.yaml``, the daemon's configuration with the section ``production``.
- The daemon's sections have the variants' files and where a car is announced, and nothing else of
  the plant.
"""

import json
import random
import tempfile
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import yaml

from linemate.daemon.config import config, files
from linemate.daemon.config.config import LoadedConfig
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.config.settings import ProductionSettings
from linemate.simulators.devices.line.cars import Car, LinePlan
from linemate.simulators.harness import identified_overlay, scenario_file
from linemate.simulators.harness.cell import cell_files, cell_station, families
from linemate.simulators.harness.cell.cell_files import CellFiles
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.plants.conveyor_plan import ConveyorEvent
from linemate.simulators.plants.scenario import Scenario, Vector3

STATION: Final = "station.yaml"
NOWHERE: Final = 1
"""Port of a controller that the daemon asks, until the links of a run are known."""


@dataclass(frozen=True, slots=True)
class LineStation:
    """Where car after car comes.

    Attributes:
        files: the daemon's configuration, with variants.
        scenario: what the cars have in common; of its stops only how quickly the line's drive
            stops and starts.
    """

    files: LoadedConfig = field(repr=False)
    scenario: Scenario

    @property
    def production(self) -> ProductionSettings:
        """The section ``production``."""
        section = self.files.config.production
        assert section is not None  # noqa: S101 - ``station`` refuses a file without it
        return section

    @property
    def variants(self) -> tuple[str, ...]:
        """Names of the variants."""
        return tuple(self.files.variants)

    @property
    def hubs(self) -> dict[str, Vector3]:
        """True nominal place of each variant in base [m], whatever overlays say."""
        tasks = {
            name: cell_files.written_task(self.files, file)
            for name, file in self.production.variants.items()
        }
        return {name: task.file.object.nominal.position for name, task in tasks.items()}

    @property
    def entry_s(self) -> float:
        """A car is announced, and enters, this long before the start position [s]."""
        way = -self.production.announced_at
        return round(way / self.scenario.conveyor.nominal_speed, 6)

    @property
    def duration_s(self) -> float:
        """Duration of the longest task while the line runs [s]."""
        return max(task.file.waypoints[-1].time for task in self.files.variants.values())

    def stop(self, at_s: float, standing_s: float) -> tuple[ConveyorEvent, ...]:
        """Return a stop of the line, as the truth's drive stops and starts.

        Args:
            standing_s: from the onset of the stop to that of the start [s].
        """
        drive = {event.kind: event for event in self.scenario.conveyor.events}
        if not {"stop", "start"} <= drive.keys():
            return ()
        start_s = round(at_s + standing_s, 3)
        return replace(drive["stop"], onset_s=at_s), replace(drive["start"], onset_s=start_s)

    def cell(self) -> CellFiles:
        """Return the station as the cell of a run."""
        return CellFiles(self.files.task, self.files)

    def daemon_sections(self, records: str | None = None) -> dict[str, Any]:
        """Return the section of the daemon's file that makes it a production.

        Args:
            records: directory of the quality records, if it keeps any.
        """
        base = self.files.path.parent
        section: dict[str, Any] = json.loads(json.dumps(asdict(self.production)))
        variants = {
            name: str(files.find(file, base, DAEMON_DATA).resolve())
            for name, file in self.production.variants.items()
        }
        return {"production": section | {"variants": variants, "records": records}}


@cache
def station(cell: str | None = None, family: str | None = None) -> LineStation:
    """Return the station of a shipped cell or of a folder; None: of the shipped wheel.

    Args:
        family: of the controller; None: that of the cell.

    Raises:
        FileError: every error of the files at once.
        SetupError: no such cell, or no production in it.
    """
    folder = cell_files.folder(cell or cell_files.SHIPPED)
    file = folder / STATION
    if not file.is_file():
        raise SetupError(
            f"--cell {cell}: no {STATION} in {folder}. Write one: the cell's "
            f"{cell_files.CONFIG} with a section production."
        )
    loaded = config.load(file)
    if loaded.config.production is None:
        raise SetupError(f"{file}: has no section production")
    truth = folder / cell_files.SCENARIO
    name = str(truth) if truth.is_file() else scenario_file.DEFAULT
    scenario = scenario_file.load(name, CellFiles(loaded.task, loaded).nominal)
    line = LineStation(loaded, replace(scenario, cycle_s=loaded.cycle_s))
    return line if family in {None, loaded.config.controller.kind.value} else behind(line, family)


def behind(line: LineStation, family: str) -> LineStation:
    """Return a station with another controller: its exchange, its period, its servos."""
    cycle_s = 1e-3 * families.CYCLE_MS[family]
    scenario = families.truth(family, replace(line.scenario, cycle_s=cycle_s))
    on_rail = line.files.task.file.arm.linear_axis
    own = families.daemon_sections(family, cycle_s, NOWHERE, on_rail=on_rail)
    plain = cell_station.daemon_file(line.cell()) | line.daemon_sections()
    plain = cell_station.with_links(plain, own, {"interface": "virtual"}, "virtual")
    if scenario.robot.axes != line.scenario.robot.axes:
        plain["overlays"] = [*plain.get("overlays", ()), str(identified_overlay.BEHIND[family])]
    with tempfile.TemporaryDirectory(prefix="linemate-") as folder:
        file = Path(folder) / STATION
        file.write_text(yaml.safe_dump(plain, sort_keys=False), encoding="utf-8")
        return LineStation(config.load(file), scenario)


def plan(station: LineStation, cars: int, seed: int, takt_s: float) -> LinePlan:
    """Return cars of all variants; every second one has a stop of the line.

    Args:
        takt_s: from one car to the next at least [s].
    """
    chance = random.Random(seed)  # noqa: S311 - a plan, not a secret
    names, drawn = station.variants, []
    for number in range(cars):
        events: tuple[ConveyorEvent, ...] = ()
        if number % 2:
            events = station.stop(round(chance.uniform(2.0, 10.0), 3), 3.0)
        variant = names[(number + seed) % len(names)]
        drawn.append(Car(f"D{seed}-{number + 1:03d}", variant, chance.randrange(2**31), events))
    return LinePlan(tuple(drawn), station.hubs, takt_s, station.entry_s, first_s=3.0, last_s=30.0)
