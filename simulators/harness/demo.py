"""``linemate-sim demo``: daemon and emulators as processes, in real time, over real links.

Invariants:
    This process starts, orders and judges; no datum of the run passes through it.
    The judgement uses the emulator's truth file and the daemon's recording.
    Every process that it started has ended when it ends.
"""

import json
import os
import shutil
import socket
import sys
import tempfile
import time
from argparse import Namespace
from collections import deque
from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from linemate.daemon.config.task_file import Task
from linemate.daemon.operator import doctor
from linemate.daemon.service.host.idle_spinner import IdleSpinner
from linemate.daemon.transport.client import Client, NoAnswerError, RefusedError
from linemate.simulators.devices import truth
from linemate.simulators.devices.worlds import OWN, require
from linemate.simulators.harness import host, scenario_file
from linemate.simulators.harness import identified_overlay as overlay
from linemate.simulators.harness import terminal_view as live
from linemate.simulators.harness.cell import cell_files, cell_station, cell_truth, families
from linemate.simulators.harness.cell.cell_files import CellFiles
from linemate.simulators.harness.cell.cell_truth import shipped_task
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.harness.emulator_command import EX_BROKEN
from linemate.simulators.harness.processes import (
    DAEMON,
    START_S,
    Child,
    ChildError,
    Children,
    interruptible,
    start_daemon,
    wait_until,
)
from linemate.simulators.harness.setup import exchange
from linemate.simulators.harness.terminal_view import Glimpse, LinkGlimpse, TerminalView
from linemate.simulators.harness.world import world_rows
from linemate.simulators.judge import joined, report_json, table
from linemate.simulators.judge.judge import judge, unanswered
from linemate.simulators.plants.scenario import Scenario

LOOPBACK = "127.0.0.1"
STALL_S = 30.0
LOOK_S = 0.5
DAEMON_PRIORITY = 70
EMULATOR_PRIORITY = 60
"""Below the daemon: on a machine with one free core the plant's computing would otherwise stand
between a telegram and its reply. Above everything else: a telegram that goes out late makes the
exchange slip, and a real controller's never does."""
SETTLE_S = 2.5
"""A daemon's link that was not there is tried again within 2 s."""

NOTICEABLE = 0.005
"""Share of the processors' time that is worth a word when the host withheld it."""

EX_UNAVAILABLE = 69


class DemoError(Exception):
    """The demonstration could not be brought to its end."""


@dataclass(frozen=True, slots=True)
class DemoStation:
    """Where everything of one run is.

    Attributes:
        folder: temporary, for ports, logs and configurations.
        cores: the daemon's and the emulators'; empty leaves them to the scheduler.
        world: name, one of ``worlds.WORLDS``.
        controller: family, one of ``families.FAMILIES``.
        robot_port: UDP port of a controller that the daemon must ask.
        ports: TCP ports of the slcan adapter and of the force-torque sensor.
        daemon: module that is run as the daemon.
        cell: files of another cell than the shipped one.
    """

    folder: Path
    scenario: Scenario
    cores: tuple[tuple[int, ...], tuple[int, ...]] = ((), ())
    world: str = OWN
    controller: str = families.RSI
    robot_port: int = field(default_factory=lambda: _free_port(socket.SOCK_DGRAM))
    ports: tuple[int, int] = field(default_factory=lambda: (_free_port(), _free_port()))
    daemon: str = DAEMON
    cell: CellFiles | None = None

    @property
    def truth(self) -> Path:
        """The emulator's account."""
        return self.folder / "truth.npz"

    @property
    def command_socket(self) -> Path:
        """Path of the daemon's command socket."""
        return self.folder / "command.sock"

    def daemon_file(self) -> dict[str, Any]:
        """Return the daemon's configuration, which has nothing of the emulator's plant."""
        on_rail = self.task.file.arm.linear_axis
        controller = families.daemon_sections(
            self.controller, self.scenario.cycle_s, self.robot_port, on_rail=on_rail
        )
        can, wrench = {"interface": "slcan", "channel": _url(self.ports[0])}, _url(self.ports[1])
        plain = {"task": "wheel.yaml"} if self.cell is None else cell_station.daemon_file(self.cell)
        return {
            **cell_station.with_links(plain, controller, can, wrench),
            "command": {"socket": str(self.command_socket)},
            "recording": {"directory": str(self.folder), "at_start": True},
            # A user may try `param save` during the demo; the folder is deleted at the end.
            "state": str(self.folder),
            "realtime": {
                "priority": DAEMON_PRIORITY,
                "lock_memory": True,
                "cpus": list(self.cores[0]),
                "keep_awake": doctor.is_virtual(doctor.Host()),
            },
            # What was identified of the cell, as after its commissioning.
            **({} if self.cell is not None else self._identified()),
        }

    @property
    def task(self) -> Task:
        """The task of the cell."""
        return shipped_task() if self.cell is None else self.cell.task

    def _identified(self) -> dict[str, Any]:
        known: dict[str, Any] = world_rows.laid_over(
            overlay.load(overlay.SHIPPED[self.world]),
            world_rows.daemon_settings(self.scenario.name),
        )
        servos = overlay.BEHIND.get(self.controller)
        if servos is not None:
            known = world_rows.laid_over(known, overlay.load(servos))
        return known

    def emulator_file(self, listening: Mapping[str, Any]) -> dict[str, Any]:
        """Return the emulator's configuration, which has the daemon's addresses only.

        Args:
            listening: the daemon's own word, ports that the system chose among it.
        """
        return {
            "scenario": "scenario.yaml",
            "world": self.world,
            "priority": EMULATOR_PRIORITY,
            "cpus": list(self.cores[1]),
            "robot_target": listening["robot"],
            **self._emulated(),
            "camera_target": listening["camera"],
            # Not ptys: the kernel's worker that hands on their bytes has an ordinary priority.
            # With a browser and 8 busy processes sensors were silent for 36 ms by it, not for 12.
            "can_bind": [LOOPBACK, self.ports[0]],
            "serial_bind": [LOOPBACK, self.ports[1]],
            # The world waits until the links stand, so that the run is the same on any machine.
            "wait_answered": round(SETTLE_S / self.scenario.cycle_s),
            "end_after_collision_s": 0.2,
            "truth": str(self.truth),
        }

    def _emulated(self) -> dict[str, Any]:
        """Return the emulated ends of the cell's links."""
        family = families.emulator_sections(self.controller, self.robot_port)
        if self.cell is None:
            # Where the task's own distance sensor stands.
            return {**family, "distance_mount": self.task.file.conveyor.start_position}
        own = cell_station.emulator_file(self.cell, self.controller, self.folder)
        return {**own, **{k: {**own.get(k, {}), **v} if k in own else v for k, v in family.items()}}

    def write(self, name: str, value: Mapping[str, Any]) -> Path:
        """Write one of the files that the processes read."""
        path = self.folder / f"{name}.yaml"
        path.write_text(yaml.safe_dump(value, sort_keys=False), encoding="utf-8")
        return path


def _free_port(kind: int = socket.SOCK_STREAM) -> int:
    """Return a free port of the loopback."""
    with socket.socket(type=kind) as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


def _url(port: int) -> str:
    return f"socket://{LOOPBACK}:{port}"


class Emulated:
    """The emulator as this process sees it: the lines it prints.

    Attributes:
        cars: changes at a line of cars that were not read yet.
    """

    def __init__(self, child: Child) -> None:
        self.child = child
        self.ready: dict[str, Any] | None = None
        self.state: dict[str, Any] = {}
        self.end: dict[str, Any] | None = None
        self.cars: deque[dict[str, Any]] = deque(maxlen=64)
        self._stream = child.log.open(encoding="utf-8", errors="replace")
        self._rest = ""

    def read_messages(self) -> None:
        """Read the messages that it has printed since."""
        *lines, self._rest = (self._rest + self._stream.read()).split("\n")
        for text in lines:
            with suppress(ValueError):
                self._on_message(json.loads(text))

    def _on_message(self, message: Any) -> None:
        match message:
            case {"event": "ready"}:
                self.ready = message
            case {"event": "state"}:
                self.state = message
            case {"event": "end"}:
                self.end = message
            case {"event": "car"}:
                self.cars.append(message)
            case _:  # a complaint on standard error that happens to be JSON
                pass

    def close(self) -> None:
        """Look no more."""
        self._stream.close()


def main(args: Namespace) -> int:
    """Run the demonstration.

    Args:
        args: scenario, cell, config, task, world, controller, cycle_ms, seed, out, view, strict,
            json.

    Returns:
        0 assembled within limits with no more late replies than the controller tolerates, none
        if strict; 1 not; 69 when it could not be brought to its end.

    Raises:
        FileError: what is wrong with the scenario's file.
        SetupError: a cycle that the controller does not have.
    """
    cell = cell_files.chosen(args)
    require(args.world)
    controller, cycle_ms = exchange(cell, args.controller, args.cycle_ms)
    cycle_ms = cycle_ms or families.CYCLE_MS[controller]
    if cell is not None and args.world != OWN:
        raise SetupError(f"--world {args.world} has the shipped cell alone: leave --cell out")
    if cycle_ms not in families.CYCLES_MS[controller]:
        known = " or ".join(f"{ms:g}" for ms in families.CYCLES_MS[controller])
        raise SetupError(f"--cycle-ms {cycle_ms:g}: {controller} has {known}")
    name, task = cell_files.scenario(args.scenario, cell), None if cell is None else cell.nominal
    plain = scenario_file.load(name, task)
    scenario = families.truth(controller, plain)
    scenario = replace(scenario, seed=args.seed, cycle_s=round(cycle_ms * 1e-3, 9))
    out = args.out or Path("out/demo")
    refused = host.missing_rights()
    if refused is not None:
        print(_cost(refused), file=sys.stderr)
    try:
        with interruptible():
            result = perform(
                scenario,
                out,
                is_viewed=args.view,
                strict=args.strict,
                world=args.world,
                controller=controller,
                cell=cell,
            )
    except (DemoError, ChildError, TimeoutError, NoAnswerError, RefusedError) as error:
        print(f"linemate-sim demo: {error}", file=sys.stderr)
        return EX_UNAVAILABLE
    print(report_json.text(result) if args.json else _summary(result, out))
    return 0 if result["within_limits"] else 1


def perform(
    scenario: Scenario,
    out: Path,
    *,
    is_viewed: bool = False,
    strict: bool = False,
    world: str = OWN,
    controller: str = families.RSI,
    cell: CellFiles | None = None,
) -> dict[str, Any]:
    """Run a scenario with everything in its place, judge it, and leave the results.

    Args:
        scenario: of the emulated station, seed and cycle included.
        out: takes result.json, report.html, fig4.png, fig5.png and the recording.
        is_viewed: a page shows it as it goes.
        strict: one late reply is too many.
        world: name, one of ``worlds.WORLDS``.
        controller: family, one of ``families.FAMILIES``.
        cell: files of another cell than the shipped one.

    Returns:
        The result, as in result.json.

    Raises:
        ChildError: a process ended early.
        DemoError, NoAnswerError, RefusedError, TimeoutError: what else went wrong.
    """
    with tempfile.TemporaryDirectory(prefix="linemate-") as folder:
        # A core of one's own is a gift to a real-time process, and a cage to any other.
        cores = host.shared_out() if host.missing_rights() is None else ((), ())
        station = DemoStation(Path(folder), scenario, cores, world, controller, cell=cell)
        began_s, stolen_s = time.monotonic(), host.stolen_s()
        status = run_station(station, is_viewed=is_viewed)
        withheld = _withheld(stolen_s, host.stolen_s(), time.monotonic() - began_s)
        recording = _only_recording(station.folder)
        evidence = joined.evidence(station.truth, recording, scenario)
        limits = cell_truth.axis_limits(station.task.urdf, station.task.file)
        evidence = replace(evidence, refusal=status.get("unfit"), limits=limits)
        result = judge(evidence, strict=strict)
        result["step_us"] = _step_us(status) or result["step_us"]
        facts = truth.load(station.truth)[1]
        result["notes"] = [*_notes(status, facts), *withheld]
        report_json.write_results(out, result, evidence.rows)
        # A row of the world has a slash in its name.
        name = scenario.name.replace("/", "-")
        kept = out / f"{name}-seed{scenario.seed}-{result['cycle_ms']:g}ms.mcap"
        shutil.move(recording, kept)
    return result


def run_station(station: DemoStation, *, is_viewed: bool = False) -> dict[str, Any]:
    """Start both processes, see the run through, end both; return the daemon's last status."""
    scenario, folder = station.scenario, station.folder
    title = f"{scenario.name}, seed {scenario.seed}, {1e3 * scenario.cycle_s:g} ms"
    # The daemon sees to its own cores.
    others = station.cores[1] if doctor.is_virtual(doctor.Host()) else ()
    with closing(IdleSpinner(others)), Children() as children, live.view(title) as view:
        daemon, listening = _start_daemon(station, children)
        station.write("scenario", scenario_file.to_plain(scenario))
        file = station.write("emulator", station.emulator_file(listening))
        child = children.start(
            "emulator",
            _command("simulators.harness.main", "emulator", "--config", str(file)),
            folder / "emulator.log",
        )
        with closing(Emulated(child)) as emulated:
            wait_until(lambda: _is_ready(emulated), children, START_S, "the emulator's links")
            print(
                f"linemate-sim demo: linemate status --watch --socket {station.command_socket}",
                file=sys.stderr,
                flush=True,
            )
            if is_viewed:
                _open_view(station, children)
            with Client.local(station.command_socket) as client:
                status = _watch(station, emulated, daemon, client, view)
        if daemon.end() != 0:
            raise ChildError("daemon", "did not end well", daemon.tail())
    return status


def _open_view(station: DemoStation, children: Children) -> None:
    """Show the daemon on a page, by a process of its own, and return its address."""
    command = _command("daemon.operator.main", "view", "--socket", str(station.command_socket))
    child = children.start("view", command, station.folder / "view.log")
    wait_until(lambda: bool(child.tail()), children, START_S, "the view")
    # Not before: on a busy machine it would take too long to begin.
    child.give_way()
    print(f"linemate-sim demo: the view is at {child.tail()[0]}", file=sys.stderr, flush=True)


def _start_daemon(station: DemoStation, children: Children) -> tuple[Child, dict[str, Any]]:
    """Start the daemon, and wait for its word of where it listens."""
    file = station.write("daemon", station.daemon_file())
    return start_daemon(children, file, station.folder / "daemon.log", station.daemon)


def _stalled(emulated: Emulated, status: Mapping[str, Any], operator: "_DemoOperator") -> str:
    """Say why nothing moves."""
    telegrams = emulated.state.get("telegrams") or {}
    late = unanswered(telegrams)
    if emulated.state.get("waiting") and late:
        return (
            f"the world waits for a link that stands, and {late} telegrams got no answer in "
            "time: this machine is too busy for such a cycle"
        )
    return operator.refusal or f"the daemon is {status.get('state')}"


def _watch(
    station: DemoStation, emulated: Emulated, daemon: Child, client: Client, view: TerminalView
) -> dict[str, Any]:
    """Arm, start, and look on until the emulator has ended; return the daemon's last status."""
    operator = _DemoOperator(client)
    status: dict[str, Any] = {}
    moved = time.monotonic()
    last_s: float | None = None
    while emulated.child.ended() is None:
        daemon.check()
        emulated.read_messages()
        status = operator.give_order()
        view.show(_glimpse(station.scenario.cycle_s, emulated.state, status))
        now_s = None if emulated.state.get("waiting", True) else emulated.state.get("time_s")
        if now_s != last_s:
            last_s, moved = now_s, time.monotonic()
        if time.monotonic() - moved > STALL_S:
            raise DemoError(
                f"nothing has moved for {STALL_S:g} s; {_stalled(emulated, status, operator)}"
            )
        time.sleep(LOOK_S)
    emulated.read_messages()
    if emulated.child.ended() not in {0, EX_BROKEN} or emulated.end is None:
        raise ChildError("emulator", "did not end well", emulated.child.tail())
    return status


class _DemoOperator:
    """Arms and starts as soon as the daemon lets it, once, and reads the status."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._started = False
        self.refusal: str | None = None

    def give_order(self) -> dict[str, Any]:
        """Give the order that is due, and return the status."""
        status = self._client.call("status", timeout_s=2.0)
        order = {"idle": "arm", "armed": "start"}.get(str(status.get("state")))
        if order is not None and not self._started:
            try:
                self._client.call(order, timeout_s=2.0)
                self._started = order == "start"
            except RefusedError as error:
                self.refusal = f"{order} refused: {error}"
        return status


def _is_ready(emulated: Emulated) -> bool:
    emulated.read_messages()
    return emulated.ready is not None


def _glimpse(cycle_s: float, state: Mapping[str, Any], status: Mapping[str, Any]) -> Glimpse:
    """What there is to see: the emulator's state and the daemon's status."""
    waiting = bool(state.get("waiting", True))
    telegrams = state.get("telegrams") or {}
    turnaround = None if waiting else state.get("turnaround_us")
    errors = []
    if status.get("sensed") and status.get("target"):
        pairs = zip(status["sensed"][:3], status["target"][:3], strict=True)
        plan = 1e3 * sum((a - b) ** 2 for a, b in pairs) ** 0.5
        errors.append(("plan", f"{plan:.2f} mm"))
    if state.get("tcp_to_hub"):
        away = 1e3 * sum(value**2 for value in state["tcp_to_hub"]) ** 0.5
        errors.append(("tcp to hub", f"{away:.1f} mm"))
    return Glimpse(
        time_s=float(state.get("time_s", 0.0)),
        state=str(status.get("state", "")),
        phase=str(status.get("phase", "")),
        task_time=status.get("task_time"),
        scenario=str(status.get("scenario", "")),
        tentative=status.get("scenario_state") == "tentative",
        speed=status.get("speed"),
        errors=tuple(errors),
        links=_links(status),
        idle_us=None if turnaround is None else 1e6 * cycle_s - turnaround["max"],
        cycle_us=1e6 * cycle_s,
        missed=None if waiting else unanswered(telegrams),
        tolerated=state.get("tolerated"),
        held="the world waits until the links stand" if waiting else _held(status),
    )


def _held(status: Mapping[str, Any]) -> str | None:
    """Return why the robot is held, None if it is not; at rest it is the state's cause."""
    held = status.get("held")
    if held != "hold":
        return None if held is None else str(held)
    return str(status.get("cause") or held)


def _links(status: Mapping[str, Any]) -> tuple[LinkGlimpse, ...]:
    links: Mapping[str, Mapping[str, Any]] = status.get("links") or {}
    return tuple(
        LinkGlimpse(
            name,
            counts["counters"].get("samples", counts["counters"].get("answered")),
            None if counts["age_s"] is None else 1e3 * counts["age_s"],
            "" if counts["up"] else str(counts["reason"]),
        )
        for name, counts in links.items()
    )


def _step_us(status: Mapping[str, Any]) -> dict[str, Any] | None:
    """The daemon's own measurement of its steps, which no one else can make."""
    step_us = status.get("step_us")
    return step_us if isinstance(step_us, dict) else None


def _withheld(before_s: float | None, after_s: float | None, passed_s: float) -> list[str]:
    """Say how much of the processors' time this machine never had, if that was noticeable."""
    if before_s is None or after_s is None:
        return []
    share = (after_s - before_s) / (passed_s * (os.cpu_count() or 1))
    if share < NOTICEABLE:
        return []
    return [
        f"this machine's host withheld {100 * share:.1f} % of its processors' time (steal): what "
        "was late for that counts all the same"
    ]


def _notes(status: Mapping[str, Any], facts: Mapping[str, Any]) -> list[str]:
    """Notes of a result: refusals of the host and their cost."""
    notes = [str(refusal) for refusal in status.get("host") or ()]
    pace = facts["pace"]
    if pace["slips"] or pace["late"]:
        held_ms = pace["slipped_ns"] / 1e6
        notes.append(
            f"the emulators were delayed: {pace['late']} telegrams went out late, and "
            f"{pace['slips']} times the whole schedule slipped, {held_ms:.0f} ms in all: the "
            "machine had other work, or its host did"
        )
    dropped = (status.get("recording") or {}).get("dropped")
    if dropped:
        notes.append(f"{dropped} steps were not recorded")
    return notes


def _cost(refused: str) -> str:
    return (
        f"without real-time rights ({refused}): replies come in time only while the machine has "
        "nothing else to do; under load they may be late by tens of milliseconds. Grant "
        "RLIMIT_RTPRIO (ulimit -r 98) or CAP_SYS_NICE to be rid of that. A browser that is already "
        "open has the same priority as the emulated sensors and may starve them: close it, or "
        "start it with nice -n 19."
    )


def _only_recording(folder: Path) -> Path:
    recordings = sorted(folder.glob("*.mcap"))
    if len(recordings) != 1:
        raise DemoError(f"{len(recordings)} recordings of the daemon where there should be one")
    return recordings[0]


def _summary(result: dict[str, Any], out: Path) -> str:
    return f"{table.plain(result)}\n\n{out}/: " + ", ".join(
        sorted(path.name for path in out.iterdir() if path.is_file())
    )


def sim_command(*words: str) -> list[str]:
    """Return the command line of ``linemate-sim`` with some words."""
    return _command("simulators.harness.main", *words)


def _command(module: str, *words: str) -> list[str]:
    return [sys.executable, "-m", f"linemate.{module}", *words]
