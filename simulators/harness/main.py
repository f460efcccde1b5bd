"""``linemate-sim``: command line of the emulators and the runs.

Invariants:
    A command's module is imported on use, so ``--help`` is quick.
    Exit codes: 0 good, 1 not good, 2 usage, 78 bad file.
"""

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from linemate.daemon import command_line
from linemate.daemon.command_line import (
    BAD_FILE,
    POSITIVE,
    CommandLine,
    UsageError,
    Version,
    bounded,
    check_output_file,
    check_output_folder,
    one_thread,
)
from linemate.daemon.near_names import near_names
from linemate.simulators.harness.cell.variants import SetupError, is_known, known

MAX_SEEDS = 100_000
MAX_ROUND_S = 3600.0
MAX_MINUTES = 1440.0
BENCH_PARTS = ("turnaround", "wakeup", "step", "virtual")
ALL_PARTS = (*BENCH_PARTS, "cpu", "start")
MAX_HOURS = 10_000.0
MODULES = {
    "demo": "harness.demo",
    "run": "lab.runs",
    "campaign": "lab.campaign",
    "shift": "lab.shift.shift",
    "world": "lab.world.measure",
    "measure-arm": "lab.commissioning.arm_tracker",
    "emulator": "harness.emulator_command",
    "bench": "lab.bench.bench",
}
"""Module of each command, below ``linemate.simulators``; its ``main(args) -> int`` runs it."""
DEMO_OF_CARS = "harness.line.demo_line"  # of demo with several cars
EXTRAS = {"matplotlib": "demo", "rich": "demo", "mujoco": "mujoco"}
"""The extra that a package comes with."""


def main(argv: Sequence[str] | None = None) -> int:
    """Parse arguments and run the command.

    Returns:
        The exit code.
    """
    args = _parser().parse_args(argv)
    one_thread()
    return command_line.run("linemate-sim", lambda: _dispatch(args))


def _dispatch(args: argparse.Namespace) -> int:
    if args.command == "schema":
        return _schema(args.kind)
    _check_outputs(args)
    from linemate.daemon.config.documents import FileError

    try:
        with command_line.killed_by_ctrl_c():
            module = import_module(f"linemate.simulators.{_module(args)}")
        return int(module.main(args))
    except FileError as error:
        print(error, file=sys.stderr)
        return BAD_FILE
    except SetupError as error:
        raise UsageError(str(error)) from error
    except ModuleNotFoundError as error:
        package = str(error.name).partition(".")[0]
        if package not in EXTRAS:
            raise
        raise UsageError(
            f"package {package} is missing. Install the extra: "
            f"pip install 'linemate[{EXTRAS[package]}]'"
        ) from error


def _module(args: argparse.Namespace) -> str:
    if args.command == "demo" and args.cars > 1:
        return DEMO_OF_CARS
    return MODULES[args.command]


def _check_outputs(args: argparse.Namespace) -> None:
    if getattr(args, "out", None) is not None:
        check_output_folder(args.out)
    if getattr(args, "plot", None) is not None:
        check_output_file(args.plot, "--plot")
    if getattr(args, "file", None) is not None:
        check_output_file(args.file, "FILE")


def _schema(kind: str) -> int:
    from linemate.simulators.harness import emulator_command, scenario_file
    from linemate.simulators.judge import report_json

    whole = emulator_command.schema() if kind == "emulator" else scenario_file.schema(kind)
    print(report_json.text(whole))
    return 0


def seeds(text: str) -> tuple[int, ...]:
    """One seed, or A..B with both ends."""
    first, separator, last = text.partition("..")
    try:
        low, high = int(first), int(last if separator else first)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} should be N or A..B") from None
    if low < 0 or high < low or high - low >= MAX_SEEDS:
        raise argparse.ArgumentTypeError(f"{text!r} is no rising range of at most {MAX_SEEDS}")
    return tuple(range(low, high + 1))


def variants(text: str) -> tuple[str, ...]:
    """Names of variants, separated by commas."""
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    unknown = [name for name in names if not is_known(name)]
    if unknown or not names:
        near = near_names(unknown[0], known()) if unknown else ""
        others = near or f"; there are {', '.join(known())}"
        raise argparse.ArgumentTypeError(f"no variant {', '.join(unknown) or text!r}{others}")
    return names


def variant(text: str) -> str:
    """Name of one variant."""
    names = variants(text)
    if len(names) != 1:
        raise argparse.ArgumentTypeError(f"{text!r} should be one variant")
    return names[0]


def scheduler(text: str) -> str:
    """Where runs are made: ``local``, or a dask scheduler's address."""
    from linemate.simulators.harness import cluster

    if text != "local" and not cluster.is_address(text):
        schemes = ", ".join(cluster.SCHEMES)
        raise argparse.ArgumentTypeError(f"{text!r} is neither local nor an address; {schemes}")
    return text


def _parser() -> argparse.ArgumentParser:
    parser = CommandLine(
        prog="linemate-sim", description="Emulators of the station, and runs against them."
    )
    parser.add_argument("--version", action=Version)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_demo(commands)
    _add_run(commands)
    _add_campaign(commands)
    _add_shift(commands)
    _add_world(commands)
    _add_measure_arm(commands)
    emulator = commands.add_parser("emulator", help="the emulators alone, in real time")
    emulator.add_argument("--config", type=Path, required=True, metavar="FILE")
    _add_bench(commands)
    schema = commands.add_parser("schema", help="JSON schema of a file")
    schema.add_argument("kind", choices=("scenario", "task", "emulator"))
    return parser


def _cycles(text: str) -> tuple[int, ...]:
    """Cycles in ms, separated by commas."""
    names = tuple(dict.fromkeys(text.split(",")))
    if not set(names) <= {"12", "4", "2", "1"}:
        raise argparse.ArgumentTypeError(f"{text!r} should be of 12, 4, 2 and 1")
    return tuple(map(int, names))


def _parts(text: str) -> tuple[str, ...]:
    """Parts of the bench, separated by commas."""
    names = tuple(dict.fromkeys(text.split(",")))
    if not set(names) <= set(ALL_PARTS):
        raise argparse.ArgumentTypeError(f"{text!r} should be of {', '.join(ALL_PARTS)}")
    return names


_count = bounded(int, 1, MAX_SEEDS, f"should be 1..{MAX_SEEDS}")
_hours = bounded(float, POSITIVE, MAX_HOURS, f"should be hours, at most {MAX_HOURS:g}")
_minutes = bounded(float, POSITIVE, MAX_MINUTES, f"should be 0..{MAX_MINUTES:g} minutes")
_seconds = bounded(float, 0.1, MAX_ROUND_S, f"should be 0.1..{MAX_ROUND_S:g} seconds")
_cycle_ms = bounded(float, 1.0, 24.0, "should be 1..24 ms")
_share = bounded(float, 0.0, 1.0, "should be a share, 0..1")

Commands = argparse._SubParsersAction  # noqa: SLF001 -- argparse has no public name for it


def _add_which_world(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--world", choices=("own", "mujoco"), default="own",
        help="what emulates the station: own plants, or MuJoCo (extra 'mujoco'); own",
    )  # fmt: skip


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--scenario", metavar="NAME|FILE", help="the emulated truth; that of the cell, else wheel"
    )
    _add_which_world(parser)
    parser.add_argument(
        "--controller", choices=("rsi", "fanuc", "egm"),
        help="the robot controller: KUKA RSI, FANUC Stream Motion or ABB EGM; that of --config, "
        "else rsi",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, metavar="DIR", help="leave results there")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def _add_cell(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--cell", metavar="NAME|DIR",
        help="a shipped cell, or a folder with linemated.yaml and scenario.yaml",
    )  # fmt: skip
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="the daemon's configuration, instead"
    )
    parser.add_argument(
        "--task", type=Path, metavar="FILE", help="the task file, instead of the configuration's"
    )


def _add_bench(commands: "Commands[CommandLine]") -> None:
    bench = commands.add_parser("bench", help="turn-around, lateness, computing time")
    bench.add_argument("--json", action="store_true", help="print JSON instead of a table")
    bench.add_argument("--rounds", type=_count, default=5, metavar="N", help="5")
    bench.add_argument(
        "--round-s", type=_seconds, default=0.6, metavar="S", help="length of a round; 0.6"
    )
    bench.add_argument(
        "--cycles", type=_cycles, default=(12, 4, 2, 1), metavar="MS,...", help="of 12, 4, 2, 1"
    )
    bench.add_argument(
        "--parts",
        type=_parts,
        default=BENCH_PARTS,
        metavar="A,...",
        help=", ".join(BENCH_PARTS)
        + "; cpu: an assembly at each cycle, by part; start: the start and rest",
    )
    bench.add_argument(
        "--awake",
        action=argparse.BooleanOptionalAction,
        dest="idle_spinner",
        help="let no core sleep; in a virtual machine",
    )
    bench.add_argument("--plot", type=Path, metavar="FILE", help="draw the ratios")


def _add_plan(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set", action="append", default=[], dest="overrides", metavar="KEY=VALUE",
        help="e.g. scenario.camera.dropout_rate=0.1, tracking.rule.tentative=2e-3",
    )  # fmt: skip
    parser.add_argument("--workers", type=_count, help="processes; all cores by default")


def _add_demo(commands: "Commands[CommandLine]") -> None:
    demo = commands.add_parser("demo", help="daemon and emulators in real time, over real links")
    _add_common(demo)
    _add_cell(demo)
    demo.add_argument(
        "--cycle-ms", type=float, choices=(4, 8, 12, 24),
        help="rsi: 12 or 4, fanuc: 8 or 4, egm: 4, 8, 12 or 24",
    )  # fmt: skip
    demo.add_argument("--seed", type=int, default=0, metavar="N")
    demo.add_argument(
        "--cars",
        type=_count,
        default=1,
        metavar="N",
        help="car after car, of the station's variants; 1",
    )
    demo.add_argument("--strict", action="store_true", help="end with 1 if a single reply was late")
    demo.add_argument("--view", action="store_true", help="show it in the browser as it goes")


def _add_run(commands: "Commands[CommandLine]") -> None:
    run = commands.add_parser("run", help="the same chain in virtual time")
    _add_common(run)
    _add_cell(run)
    _add_plan(run)
    run.add_argument("--cycle-ms", type=_cycle_ms, metavar="MS", help="instead of the scenario's")
    run.add_argument("--seed", type=seeds, default=(0,), dest="seeds", metavar="N|A..B")
    run.add_argument("--variant", type=variant, default="default", metavar="NAME", help="default")
    run.add_argument(
        "--record", action="store_true", help="leave a recording with the truth; needs --out"
    )
    run.add_argument("--timing", action="store_true", help="measure computing times as well")


def _add_campaign(commands: "Commands[CommandLine]") -> None:
    campaign = commands.add_parser("campaign", help="many runs, a table of variants")
    _add_common(campaign)
    _add_cell(campaign)
    _add_plan(campaign)
    campaign.add_argument(
        "--cycle-ms", type=_cycle_ms, metavar="MS", help="instead of the scenario's"
    )
    campaign.add_argument("--seeds", type=_count, default=40, metavar="N")
    campaign.add_argument("--first-seed", type=int, default=0, metavar="M")
    _add_scheduler(campaign)
    campaign.add_argument(
        "--detection", type=_hours, metavar="HOURS",
        help="conveyor, sensors and classifier alone: latencies, false alarms, jerks",
    )  # fmt: skip
    campaign.add_argument("--variants", type=variants, default=("default",), metavar="A,B,...")


def _add_scheduler(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--scheduler", type=scheduler, default="local", metavar="local|ADDRESS",
        help="local cores, or a dask scheduler such as tcp://127.0.0.1:8786 (extra 'cluster')",
    )  # fmt: skip


def _add_shift(commands: "Commands[CommandLine]") -> None:
    shift = commands.add_parser("shift", help="car after car in virtual time, by a PLC's requests")
    shift.add_argument("--cars", type=_count, default=20, metavar="N", help="20")
    shift.add_argument(
        "--cell", metavar="NAME|DIR",
        help="a shipped cell, or a folder with station.yaml; the shipped wheel in five variants",
    )  # fmt: skip
    shift.add_argument(
        "--controller", choices=("rsi", "fanuc", "egm"),
        help="rsi; EGM at 4 ms and FANUC at 8 ms have their own emulated controllers",
    )  # fmt: skip
    shift.add_argument("--seed", type=int, default=0, metavar="N")
    shift.add_argument(
        "--takt", type=_seconds, default=57.6, metavar="S", help="from car to car at least; 57.6"
    )
    shift.add_argument(
        "--faulty", type=_share, default=0.02, metavar="SHARE", help="of cars with a fault; 0.02"
    )
    shift.add_argument(
        "--opc-ua", action="store_true",
        help="the line's controller is a client of the OPC UA server alone (extra 'plc')",
    )  # fmt: skip
    shift.add_argument("--workers", type=_count, metavar="N", help="daemons to split it over; 1")
    shift.add_argument(
        "--minutes", type=_minutes, metavar="M", help="of computing, after which no car enters"
    )
    _add_scheduler(shift)
    shift.add_argument("--json", action="store_true", help="print JSON instead of a table")


def _add_measure_arm(commands: "Commands[CommandLine]") -> None:
    arm = commands.add_parser("measure-arm", help="poses of the arm as a laser tracker sees them")
    arm.add_argument("file", type=Path, metavar="FILE", help="table for `linemate identify-arm`")
    arm.add_argument(
        "--scenario", metavar="NAME|FILE", help="the emulated truth; that of the cell, else wheel"
    )
    _add_cell(arm)
    arm.add_argument(
        "--set", action="append", default=[], dest="overrides", metavar="KEY=VALUE",
        help="e.g. scenario.robot.effects.geometry.zero_sigma=0.3e-3",
    )  # fmt: skip
    arm.add_argument("--seed", type=int, default=0, metavar="N", help="of the cell; 0")
    arm.add_argument("--poses", type=_count, default=40, metavar="N", help="40")
    arm.add_argument(
        "--positions", action="store_true", help="a single reflector: positions without orientation"
    )


def _add_world(commands: "Commands[CommandLine]") -> None:
    world = commands.add_parser("world", help="rows of the realistic world, judged by its truth")
    _add_which_world(world)
    world.add_argument("--rows", metavar="A,B,...", help="names of rows; all by default")
    world.add_argument("--seeds", type=seeds, default=(0, 1, 2), metavar="N|A..B", help="0..2")
    world.add_argument("--cycle-ms", type=_cycle_ms, metavar="MS", help="instead of the scenario's")
    world.add_argument(
        "--learnt",
        type=int,
        default=0,
        metavar="N",
        help="cars before each run in the same cell, whose touches correct the camera; 0",
    )
    world.add_argument(
        "--identified",
        type=int,
        default=0,
        metavar="N",
        help="exercises before each row in the same cell, for `linemate identify`; 0",
    )
    world.add_argument("--json", action="store_true", help="print JSON instead of a table")
    world.add_argument("--check", action="store_true", help="end with 1 if a run collided")
    world.add_argument("--list", action="store_true", help="print the rows and what they change")
    world.add_argument(
        "--kept", type=Path, default=Path("out/world"), metavar="DIR",
        help="for finished runs: an interrupted command goes on there; out/world",
    )  # fmt: skip
    _add_plan(world)


if __name__ == "__main__":
    sys.exit(main())
