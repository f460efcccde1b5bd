"""``linemate-sim demo --cars N``: car after car in real time, over real links.

This process is the line's controller: it announces each car over the command protocol and lets
production go on. It gives no order to arm, start, go home or retreat.

Invariants:
- What became of a car is the emulator's word; what was reported, the daemon's.
"""

import json
import shutil
import sys
import tempfile
import time
from argparse import Namespace
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from linemate.daemon.operator.production import report_command
from linemate.daemon.production import day_report
from linemate.daemon.transport.client import Client, NoAnswerError, RefusedError
from linemate.simulators.devices.line.cars import Car, LinePlan
from linemate.simulators.devices.worlds import OWN
from linemate.simulators.harness import host, scenario_file
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.harness.demo import (
    EX_UNAVAILABLE,
    STALL_S,
    DemoError,
    DemoStation,
    Emulated,
    sim_command,
)
from linemate.simulators.harness.line import line_station
from linemate.simulators.harness.line.line_station import LineStation
from linemate.simulators.harness.processes import (
    START_S,
    ChildError,
    Children,
    interruptible,
    start_daemon,
    wait_until,
)
from linemate.simulators.judge import report_json
from linemate.simulators.plants.scenario import Scenario

LOOK_S: Final = 0.1
TAKT_S: Final = 34.0  # from one car to the next at least [s]


@dataclass(slots=True)
class LineLog:
    """What became of the cars so far.

    Attributes:
        truths: of the emulator, by part.
        announced: parts in their order.
    """

    truths: dict[str, dict[str, Any]] = field(default_factory=dict)
    announced: list[str] = field(default_factory=list)


def main(args: Namespace) -> int:
    """Run the demonstration.

    Args:
        args: cars, cell, seed, out, json.

    Returns:
        0 if every car was mounted and reported so; 1 if not; 69 if it could not be brought to its
        end.

    Raises:
        SetupError: an option that a line of cars does not have, or a cell without a line.
    """
    _refuse_others(args)
    station = line_station.station(args.cell, args.controller)
    out = args.out or Path("out/demo")
    refused = host.missing_rights()
    if refused is not None:
        print(f"linemate-sim demo: without real-time rights ({refused})", file=sys.stderr)
    try:
        with interruptible():
            result = perform(station, args.cars, args.seed, out)
    except (DemoError, ChildError, TimeoutError, NoAnswerError, RefusedError) as error:
        print(f"linemate-sim demo: {error}", file=sys.stderr)
        return EX_UNAVAILABLE
    print(report_json.text(result) if args.json else _summary(result, out))
    return 0 if result["good"] else 1


def _refuse_others(args: Namespace) -> None:
    """Refuse options that a line of cars does not have.

    Raises:
        SetupError: one is given.
    """
    names = ("config", "task", "scenario", "cycle_ms")
    given = [name for name in names if getattr(args, name) is not None]
    given += ["world"] if args.world != OWN else []
    given += [name for name in ("strict", "view") if getattr(args, name)]
    if given:
        name = given[0].replace("_", "-")
        raise SetupError(f"--cars takes the cell's {line_station.STATION}: leave --{name} out")


def perform(line: LineStation, cars: int, seed: int, out: Path) -> dict[str, Any]:
    """Bring cars through the cell, and leave the records and their page.

    Raises:
        ChildError: a process ended early.
        DemoError, NoAnswerError, RefusedError, TimeoutError: what else went wrong.
    """
    scenario = replace(line.scenario, seed=seed, lead_in_s=line.entry_s)
    plan = line_station.plan(line, cars, seed, TAKT_S)
    with tempfile.TemporaryDirectory(prefix="linemate-") as name:
        folder = Path(name)
        (folder / "records").mkdir()
        cores = host.shared_out() if host.missing_rights() is None else ((), ())
        family = line.files.config.controller.kind.value
        station = DemoStation(folder, scenario, cores, controller=family, cell=line.cell())
        sections = line.daemon_sections(str(folder / "records"))
        log, telegrams = _run(station, sections, plan)
        out.mkdir(parents=True, exist_ok=True)
        lines: list[str] = []
        for path in sorted((folder / "records").iterdir()):
            shutil.copy(path, out / path.name)
            if path.suffix == ".jsonl":
                lines += path.read_text(encoding="utf-8").splitlines()
    records, _ = report_command.read(lines)
    (out / "report.html").write_text(day_report.page(records, "demonstration"), encoding="utf-8")
    return _judged(plan.cars, log, records, telegrams)


def _run(
    station: DemoStation, sections: Mapping[str, Any], plan: LinePlan
) -> tuple[LineLog, dict[str, int]]:
    """Start both processes, bring the cars, end both.

    Args:
        sections: of the daemon's file, next to those of one car.
    """
    folder = station.folder
    daemon_file = station.daemon_file() | dict(sections)
    with Children() as children:
        file = station.write("daemon", daemon_file)
        daemon, listening = start_daemon(children, file, folder / "daemon.log")
        emulated_file = station.emulator_file(listening) | {"line": _plain(plan)}
        station.write("scenario", scenario_file.to_plain(station.scenario))
        file = station.write("emulator", emulated_file)
        child = children.start(
            "emulator", sim_command("emulator", "--config", str(file)), folder / "emulator.log"
        )
        with closing(Emulated(child)) as emulated:
            wait_until(lambda: _is_ready(emulated), children, START_S, "the emulator's links")
            where = f"linemate status --watch --socket {station.command_socket}"
            print(f"linemate-sim demo: {where}", file=sys.stderr, flush=True)
            with Client.local(station.command_socket) as client:
                log = _lead(emulated, client, station.scenario)
        end = emulated.end
        if child.ended() != 0 or end is None:
            raise ChildError("emulator", "did not end well", child.tail())
        if daemon.end() != 0:
            raise ChildError("daemon", "did not end well", daemon.tail())
    return log, dict(end["telegrams"])


def _lead(emulated: Emulated, client: Client, scenario: Scenario) -> LineLog:
    """Announce the cars and let production go on until the emulator ends."""
    log, moved, last_s = LineLog(), time.monotonic(), None
    while emulated.child.ended() is None:
        emulated.read_messages()
        while emulated.cars:
            _on_car(emulated.cars.popleft(), client, log)
        shown = client.call("queue", timeout_s=2.0)
        if shown["held"] is not None and shown["state"] in {"idle", "fault"}:
            client.call("ack" if shown["state"] == "fault" else "next", timeout_s=2.0)
        now_s = emulated.state.get("time_s")
        if now_s != last_s or emulated.state.get("waiting"):
            last_s, moved = now_s, time.monotonic()
        if time.monotonic() - moved > STALL_S + scenario.lead_in_s:
            raise DemoError(f"nothing has moved for {STALL_S:g} s; production: {shown}")
        time.sleep(LOOK_S)
    emulated.read_messages()
    while emulated.cars:
        _on_car(emulated.cars.popleft(), None, log)
    return log


def _on_car(event: Mapping[str, Any], client: Client | None, log: LineLog) -> None:
    """Announce the car that enters, and note what became of the one before."""
    left = event["left"]
    if left is not None:
        log.truths[left["part"]] = left
        print(f"linemate-sim demo: {left}", file=sys.stderr, flush=True)
    if event["part"] is not None and client is not None:
        names = ("part", "variant", "distance")
        client.call("announce", {name: event[name] for name in names}, timeout_s=2.0)
        log.announced.append(event["part"])


def _judged(
    cars: tuple[Car, ...], log: LineLog, records: list[dict[str, Any]], telegrams: dict[str, int]
) -> dict[str, Any]:
    """Return what became of the cars as plain values."""
    by_part = {record["part"]: record for record in records}
    rows = []
    for car in cars:
        record, truth = by_part.get(car.part), log.truths.get(car.part, {})
        rows.append(
            {
                "id": car.part,
                "variant": car.variant,
                "outcome": "unreported" if record is None else "ok" if record["ok"] else "nok",
                "reason": "" if record is None else record["reason"],
                "mounted": bool(truth.get("mounted")),
                "collision": truth.get("collision"),
                "impact_mm": truth.get("impact_mm"),
                "duration_s": None if record is None else record["duration_s"],
            }
        )
    good = all(row["mounted"] and row["outcome"] == "ok" for row in rows)
    return {"version": 1, "good": good, "telegrams": telegrams, "cars": rows}


def _plain(plan: LinePlan) -> dict[str, Any]:
    plain: dict[str, Any] = json.loads(json.dumps(asdict(plan)))
    return plain


def _is_ready(emulated: Emulated) -> bool:
    emulated.read_messages()
    return emulated.ready is not None


def _summary(result: Mapping[str, Any], out: Path) -> str:
    lines = [
        f"{row['id']} {row['variant']}: {row['outcome']} {row['reason']}".rstrip()
        for row in result["cars"]
    ]
    impacts = [row["impact_mm"] for row in result["cars"] if row["impact_mm"] is not None]
    if impacts:
        lines.append(f"largest error at the touch: {max(impacts):.2f} mm")
    mounted = sum(row["mounted"] for row in result["cars"])
    lines.append(
        f"{mounted} of {len(result['cars'])} cars mounted; telegrams {result['telegrams']}"
    )
    return "\n".join([*lines, f"{out}/report.html"])
