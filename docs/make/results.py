"""Stored results: measure, condense and store them, and put their figures into pages.

``python -m docs.make.results NAME`` runs the command of one result in a clean tree and stores
``docs/results/NAME.json``: command, commit, date and figures. ``docs.make.write`` fills the
blocks ``<!-- figures NAME: begin -->`` of the pages from these files.
"""

import argparse
import datetime as dt
import json
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from docs.make import (
    bench_results,
    commission_results,
    contact_results,
    fault_results,
    lag_results,
    peer_results,
    shift_results,
    world_results,
)
from docs.make.figures import number
from linemate.simulators.judge.statistics import seed_text

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs/results"

Result = dict[str, Any]

# What a campaign's file keeps, of the summary that it prints.
KEPT = (
    "assembled",
    "control_error.approach.max_mm",
    "control_error.approach.max_mrad",
    "total_error.stop.max_mm",
    "total_error.impact.max_mm",
    "total_error.contact.max_mm",
    "total_error.restart.max_mm",
    "contact_force_n.max",
    "detection.stop.perceived_s",
    "detection.stop.confirmed_s",
    "detection.start.perceived_s",
    "detection.start.confirmed_s",
    "false_alarms.confirmed",
    "limits.violations",
)


def campaign(raw: Result) -> Result:
    """Return the kept figures of each variant, and how many runs were assembled."""
    counts = {}
    for variant in raw["summary"]:
        runs = [run for run in raw["runs"] if run["variant"] == variant]
        counts[variant] = {
            "runs": len(runs),
            "seeds": seed_text(run["seed"] for run in runs),
            "assembled": sum(run["assembled"] for run in runs),
            "within_limits": sum(run["within_limits"] for run in runs),
        }
    return {
        variant: counts[variant] | {key: figures[key] for key in KEPT[1:] if key in figures}
        for variant, figures in raw["summary"].items()
    }


def demo(raw: Result) -> Result:
    """Return what one run in real time shows."""
    keys = ("scenario", "seed", "cycle_ms", "duration_s", "outcome", "assembled", "within_limits",
            "telegrams", "control_error", "total_error", "notes")  # fmt: skip
    return {key: raw[key] for key in keys} | {"contact_force_n": raw["contact_force_n"]["max"]}


def busy(raw: Result) -> Result:
    """Return seed, load, outcome and late replies of demonstrations on a busy host."""
    return {"runs": raw["runs"]}


def bench(raw: Result) -> Result:
    """Return the step's time and the speed of a run in virtual time, with the machine."""
    return {key: raw[key] for key in ("machine", "step_us", "virtual_times_realtime")}


def turnaround(raw: Result) -> Result:
    """Return replies next to those of an echo, idle, loaded and without preparation."""
    return {key: raw[key] for key in ("machine", "rounds", "notes", "echo", "fifo", "turnaround")}


def processor_time(raw: Result) -> Result:
    """Return the daemon's processor time and memory by part, with the machine."""
    return {key: raw[key] for key in ("machine", "cpu")}


def start_and_rest(raw: Result) -> Result:
    """Return what a start, a restart and a rest of the daemon take, with the machine."""
    return {key: raw[key] for key in ("machine", "start")}


COMMANDS: dict[str, tuple[str, Callable[[Result], Result]]] = {
    "demo": ("linemate-sim demo --json", demo),
    "demo-busy": ("linemate-sim demo --seed SEED --json", busy),
    "campaign": ("linemate-sim campaign --seeds 40 --variants default,rule --json", campaign),
    "campaign-4ms": ("linemate-sim campaign --seeds 40 --cycle-ms 4 --json", campaign),
    "stop-in-contact": (
        "linemate-sim campaign --seeds 40 --scenario stop-in-contact --json", campaign,
    ),
    "oracle": ("linemate-sim campaign --seeds 40 --variants oracle --json", campaign),
    "verified": ("linemate-sim campaign --seeds 40 --first-seed 1000 --json", campaign),
    "without": (
        "linemate-sim campaign --seeds 8 --variants default,no-prediction,no-classes"
        " --set scenario.duration_s=26 --json",
        campaign,
    ),
    "bench": ("linemate-sim bench --parts virtual,step --json", bench),
    "turnaround": (
        "linemate-sim bench --parts turnaround --cycles 4,2 --rounds 5 --round-s 16 --json",
        turnaround,
    ),
    "cpu": ("linemate-sim bench --parts cpu --cycles 12,4 --json", processor_time),
    "start": ("linemate-sim bench --parts start --cycles 4 --json", start_and_rest),
    **{name: (text, world_results.condensed) for name, text in world_results.COMMANDS.items()},
    **{name: (text, shift_results.condensed) for name, text in shift_results.COMMANDS.items()},
    **{name: (text, contact_results.whole) for name, text in contact_results.COMMANDS.items()},
    **{name: (text, fault_results.whole) for name, text in fault_results.COMMANDS.items()},
    **{name: (text, lag_results.rows) for name, text in lag_results.COMMANDS.items()},
    **{name: (text, campaign) for name, text in lag_results.CAMPAIGNS.items()},
    **{name: (text, peer_results.rows) for name, text in peer_results.COMMANDS.items()},
    **{name: (text, commission_results.rows) for name, text in commission_results.COMMANDS.items()},
}  # fmt: skip


def store(name: str, raw: Result, commit: str) -> None:
    """Condense a command's output and store it."""
    command, condense = COMMANDS[name]
    record = {
        "command": command,
        "commit": commit,
        "date": dt.datetime.now(dt.UTC).date().isoformat(),
        "figures": condense(raw),
    }
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / f"{name}.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def load(name: str) -> Result:
    """Return the figures of one stored result."""
    record: Result = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    figures: Result = record["figures"]
    return figures


def is_stored(name: str) -> bool:
    """Return whether a result was measured; a table shows what there is."""
    return (FOLDER / f"{name}.json").exists()


def filled(page: str) -> str:
    """Return a page's text with the blocks of figures as the stored results have them."""
    for name, table in TABLES.items():
        begin, end = f"<!-- figures {name}: begin -->", f"<!-- figures {name}: end -->"
        head, mark, rest = page.partition(begin)
        if mark:
            page = f"{head}{begin}\n{table()}\n{end}{rest.partition(end)[2]}"
    return page


# --- figures as text ----------------------------------------------------------------------


def spread(figure: Mapping[str, Any]) -> str:
    """Return "median [95 % interval] (worst)"; no interval for fewer than six values."""
    low, high = figure["ci95"]
    interval = f" [{number(low)}, {number(high)}]" if figure["n"] >= 6 else ""
    return f"{number(figure['median'])}{interval} ({number(figure['worst'])})"


def median(figures: Result, key: str) -> str:
    """Return the median of a figure."""
    return number(figures[key]["median"])


def worst(figures: Result, key: str) -> str:
    """Return the largest value of a figure."""
    return number(figures[key]["worst"])


def of(figures: Result, key: str = "assembled") -> str:
    """Return "n of m" runs."""
    return f"{figures[key]} of {figures['runs']}"


CONTROL = "control_error.approach.max"
STOP, IMPACT = "total_error.stop.max_mm", "total_error.impact.max_mm"
FORCE = "contact_force_n.max"


def shown(name: str) -> str:
    """Return a link to a result, which has the command and the commit."""
    return f"[{name}](docs/results/{name}.json)"


def readme() -> str:
    """Return the table of figures of README.md."""
    run, real = load("campaign"), load("demo")
    default, fast = run["default"], load("campaign-4ms")["default"]
    crowd = load("demo-busy")["runs"]
    loads = [each["load_1min"] for each in crowd]
    sent, answered = real["telegrams"]["sent"], real["telegrams"]["answered"]
    late = real["telegrams"]["late"]
    control, control_fast = worst(default, f"{CONTROL}_mm"), worst(fast, f"{CONTROL}_mm")
    rows = (
        (
            "the paper's scenario in real time, 12 ms",
            f"{'assembled' if real['assembled'] else 'not assembled'}; {answered} of {sent}"
            f" telegrams answered, {late} late; control error"
            f" {number(real['control_error']['approach']['max_mm'])} mm at most",
            "demo",
        ),
        (
            f"the same at a load of {number(min(loads))} to {number(max(loads))},"
            " with rights for real time",
            f"{sum(each['assembled'] for each in crowd)} of {len(crowd)} assembled",
            "demo-busy",
        ),
        (
            f"{default['runs']} objects in virtual time, 12 ms",
            f"{of(default)} assembled; control error {control} mm,"
            f" {worst(default, f'{CONTROL}_mrad')} mrad at most (paper: 1 mm, 2 mrad);"
            f" total error after a stop {median(default, STOP)} mm, at impact"
            f" {median(default, IMPACT)} mm (medians)",
            "campaign",
        ),
        (
            "the same at 4 ms",
            f"{of(fast)} assembled; control error {control_fast} mm at most; total error after"
            f" a stop {median(fast, STOP)} mm",
            "campaign-4ms",
        ),
    )  # fmt: skip
    first = world_results.readme(load, is_stored)
    lines = [f"| {what} | {figure} | {shown(name)} |" for what, figure, name in (*first, *rows)]
    return "\n".join(["| what | figure | result |", "|---|---|---|", *lines])


def output() -> str:
    """Return the head of what `make demo` prints, with the total error of the stored run."""
    run = load("demo")
    telegrams = run["telegrams"]
    lines = [
        f"{run['outcome']}{' within limits' if run['within_limits'] else ''};"
        f" replies: {telegrams['late']} late ({telegrams['tolerated']} tolerated);"
        f" scenario {run['scenario']}, seed {run['seed']}, {run['cycle_ms']:g} ms,"
        f" {run['duration_s']:.1f} s",
        "",
        "Errors",
        "  error                    window    max mm  rms mm  max mrad  rms mrad",
        "  ...",
    ]
    for index, (window, error) in enumerate(run["total_error"].items()):
        if error is not None:
            name = "" if index else "total (tcp to true hub)"
            lines.append(
                f"  {name:23s}  {window:8s}{error['max_mm']:8.3f}{error['rms_mm']:8.3f}"
                f"{error['max_mrad']:10.3f}{error['rms_mrad']:10.3f}"
            )
    return "\n".join(["```text", *lines, "```"])


ACCURACY_ROWS = (
    ("assembled", None),
    ("control error, approach, mm", f"{CONTROL}_mm"),
    ("control error, approach, mrad", f"{CONTROL}_mrad"),
    ("total error after a stop, mm", STOP),
    ("total error at impact, mm", IMPACT),
    ("total error in contact, mm", "total_error.contact.max_mm"),
    ("total error after a restart, mm", "total_error.restart.max_mm"),
    ("contact force, N", FORCE),
    ("stop perceived, s", "detection.stop.perceived_s"),
    ("stop confirmed, s", "detection.stop.confirmed_s"),
    ("start perceived, s", "detection.start.perceived_s"),
    ("start confirmed, s", "detection.start.confirmed_s"),
    ("violations of limits", "limits.violations"),
)


def _columns(columns: tuple[tuple[str, str, str], ...]) -> str:
    """Return a table: a row a figure, a column a stored result's variant."""
    data = [(head, name, load(name)[variant]) for head, name, variant in columns]
    links = [f"[{head}](results/{name}.json)" for head, name, _ in data]
    lines = ["| figure | " + " | ".join(links) + " |", "|---" * (len(data) + 1) + "|"]
    for label, key in ACCURACY_ROWS:
        cells = [_cell(figures, key) for _, _, figures in data]
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(figures: Result, key: str | None) -> str:
    if key is None:
        return of(figures)
    figure = figures.get(key)
    return "-" if figure is None or figure["worst"] is None else spread(figure)


def accuracy() -> str:
    """Return the table of docs/accuracy.md."""
    return _columns((
        ("12 ms", "campaign", "default"),
        ("12 ms, seeds 1000-1039", "verified", "default"),
        ("4 ms", "campaign-4ms", "default"),
        ("stop in contact", "stop-in-contact", "default"),
        ("the paper's rule", "campaign", "rule"),
        ("true future known", "oracle", "oracle"),
    ))  # fmt: skip


def without() -> str:
    """Return the table of what is lost without prediction or classes."""
    return _columns(tuple((name, "without", name) for name in
                          ("default", "no-classes", "no-prediction")))  # fmt: skip


TABLES: dict[str, Callable[[], str]] = {
    "world-sizes": world_results.sizes,
    "world": lambda: world_results.rows(load, is_stored),
    "world-identified": lambda: world_results.identified(load, is_stored),
    "plant-floor": lambda: world_results.floor(load, is_stored),
    "mujoco": lambda: world_results.second(load),
    "shift": lambda: shift_results.table(load, is_stored),
    "contact": lambda: contact_results.table(load, is_stored),
    "lag": lambda: lag_results.by_lag(load, is_stored),
    "lag-curve": lambda: lag_results.by_curve(load, is_stored),
    "cycles-touch": lambda: lag_results.by_cycle(load, is_stored),
    "families": lambda: lag_results.by_family(load, is_stored),
    "faults": lambda: fault_results.campaigns(load),
    "no-force": lambda: fault_results.no_force(load),
    "catalogue": lambda: fault_results.catalogue(load),
    "floods": lambda: fault_results.floods(load),
    "peers": lambda: peer_results.table(load),
    "commission-steps": lambda: commission_results.steps(load, is_stored),
    "commission-mountings": lambda: commission_results.mountings(load, is_stored),
    "contact-growing": lambda: contact_results.growing(load, is_stored),
    "readme": readme,
    "demo": output,
    "accuracy": accuracy,
    "without": without,
    "step": lambda: bench_results.step(load),
    "turnaround": lambda: bench_results.turnaround(load),
    "cpu": lambda: bench_results.by_part(load),
    "start": lambda: bench_results.by_start(load),
    "shortfall": lambda: bench_results.by_shortfall(load),
}


def main() -> int:
    """Measure one result, or store an output that was measured in a clean clone."""
    parser = argparse.ArgumentParser(prog="python -m docs.make.results", description=__doc__)
    parser.add_argument("name", choices=COMMANDS)
    parser.add_argument("--raw", type=Path, help="JSON that the command printed")
    parser.add_argument("--commit", help="commit that made it, with --raw")
    args = parser.parse_args()
    if args.raw is not None:
        store(args.name, json.loads(args.raw.read_bytes()), args.commit)
        return 0
    if _git("status", "--porcelain", "--untracked-files=no"):
        print("the tree has changes: commit them first, a result names its commit", file=sys.stderr)
        return 2
    program, *words = shlex.split(COMMANDS[args.name][0])
    if "SEED" in words:
        print("several runs at several loads: pass them with --raw", file=sys.stderr)
        return 2
    own = ["-m", "linemate.simulators.harness.main"] if program == "linemate-sim" else []
    command = [sys.executable, *own, *words]
    # The words are constants of this file.
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, cwd=ROOT)  # noqa: S603
    store(args.name, json.loads(done.stdout), _git("rev-parse", "HEAD"))
    return 0


def _git(*words: str) -> str:
    command = [shutil.which("git") or "git", *words]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT)  # noqa: S603
    return done.stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
