"""The demonstration on a busy desktop: a browser is started on its view during contact.

    .venv/bin/python tests/busy_desktop.py [--runs 10] [--first-seed 0] [--burners 0]

Each run is `linemate-sim demo --view` in real time. As soon as the state is contact, Chromium is
started on the page of the view, as a user would; it ends with the run. Prints a line a run and, for
each sensor, its longest silence in the daemon's contact. Exit code: 0 if every run ended with 0.
"""

import argparse
import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any

import browser

from linemate.simulators.judge import joined

DEMO = [sys.executable, "-m", "linemate.simulators.harness.main", "demo", "--view", "--json"]
FLAGS = [flag for flag in browser.FLAGS if not flag.startswith("--remote-debugging")]
SENSORS = ("distance", "camera", "wrench")


def main() -> int:
    """Run them all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--niceness", type=int, default=0, help="of the browser; 0 as a user's")
    parser.add_argument("--burners", type=int, default=0, help="busy processes next to the browser")
    args = parser.parse_args()
    program = browser.path()
    if program is None:
        print("no Chromium found; apt-get install chromium", file=sys.stderr)
        return 2
    good = 0
    for seed in range(args.first_seed, args.first_seed + args.runs):
        with tempfile.TemporaryDirectory(prefix="busy-") as folder:
            good += run(seed, Path(folder), program, args)
    print(f"{good} of {args.runs} ended with 0")
    return 0 if good == args.runs else 1


def run(seed: int, folder: Path, program: str, args: argparse.Namespace) -> bool:
    """Run one demonstration; whether it ended with 0."""
    out = folder / "out"
    command = [*DEMO, "--seed", str(seed), "--out", str(out)]
    others: list[subprocess.Popen[bytes]] = []
    url = ""
    with (
        subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        ) as demo,
        contextlib.ExitStack() as ends,
    ):
        assert demo.stderr is not None
        for line in demo.stderr:
            found = re.search(r"the view is at (\S+)", line)
            url = found[1] if found else url
            if " contact " in line and url and not others:
                words = [program, *FLAGS, f"--user-data-dir={folder / 'chromium'}", url]
                busy = [[sys.executable, "-c", "while True: pass"]] * args.burners
                for one in (words, *busy):
                    others.append(start(one, args.niceness))
                    ends.callback(end, others[-1])
        code = demo.wait()
    tell(seed, code, out, started=bool(others))
    return code == 0 and bool(others)


def start(words: list[str], niceness: int) -> subprocess.Popen[bytes]:
    """Start a program in a group of its own, with an ordinary priority."""
    return subprocess.Popen(
        words,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        preexec_fn=lambda: os.nice(niceness),  # noqa: PLW1509 - one call, no lock
    )


def end(process: subprocess.Popen[bytes]) -> None:
    """End it and its group."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def tell(seed: int, code: int, out: Path, *, started: bool) -> None:
    """Print a run's line."""
    if not (out / "result.json").exists():
        print(f"seed {seed}: exit {code}, no result", flush=True)
        return
    result: dict[str, Any] = json.loads((out / "result.json").read_text())
    silences = longest_silences(next(out.glob("*.mcap")))
    silence_text = ", ".join(f"{name} {1e3 * silences[name]:.0f} ms" for name in SENSORS)
    counts = result["telegrams"]
    late = counts["late"] + counts["lost"]
    print(
        f"seed {seed}: exit {code}, {result['outcome']}, "
        f"browser {'started' if started else 'NOT started'}, {late} late of {counts['sent']}; "
        f"longest silence in contact: {silence_text}",
        flush=True,
    )
    for text in (result["reason"], *result["shortfalls"], *result.get("notes", ())):
        if text:
            print(f"    {text}", flush=True)


def longest_silences(recording: Path) -> dict[str, float]:
    """Return each sensor's longest silence while the daemon was in contact [s]."""
    last: dict[str, int] = {}
    longest: dict[str, float] = defaultdict(float)
    for step in joined.read_steps(recording):
        for name in SENSORS:
            if getattr(step.inputs, name):
                last[name] = step.inputs.stamp_ns
            elif name in last and step.state == "contact":
                longest[name] = max(longest[name], (step.inputs.stamp_ns - last[name]) * 1e-9)
    return longest


if __name__ == "__main__":
    sys.exit(main())
