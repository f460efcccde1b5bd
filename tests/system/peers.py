"""Every installed peer at full length, one after another, as JSON: the table of docs/interop.md.

``python -m tests.system.peers`` takes five minutes. It is not a test.
"""

import contextlib
import json
import os
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # as pytest does

from tests.system import (
    airo_peer,
    rsipi_motion,
    test_airo_client,
    test_egm_clients,
    test_fanuc_ucl,
    test_rsipi,
    test_rsipi_motion,
)

CYCLES, IDLE, MOTION = 3000, 1000, 2000
DAEMON, CYCLE = "`linemated`, real time", "the daemon's cycle, virtual time"
EMULATOR = "emulator, real time"
Row = dict[str, Any]
Counts = dict[str, Any]


def of_emulator(facts: Any, cycles: int | None = None) -> Counts:
    """Return what our emulated controller counted of a client.

    Args:
        cycles: that the client wanted to answer; None: it answers from its start to its end.
    """
    telegrams = facts["telegrams"]
    sent = telegrams["sent"] if cycles is None else cycles
    refused = sum(facts["refusals"].values())
    return {"cycles": sent, "unanswered": sent - telegrams["answered"], "refused": refused}


def of_peer(outcome: Counts) -> Counts:
    """Return what another's controller counted of our daemon."""
    return {name: outcome[name] for name in ("cycles", "unanswered", "refused")}


def echo_server(folder: Path, cycle_ms: int, layout: str) -> Counts:
    """Let rsipi's controller ask the daemon's process in real time."""
    served, echoed = test_rsipi.serve(folder, cycle_ms, CYCLES, layout)
    return {
        "cycles": served["sent"],
        "unanswered": len(served["unanswered"]),
        "refused": served["faulty"] - served["late"] + len(served["wrong"]),
        "echo_unanswered": len(echoed["unanswered"]),
    }


def rsi_client(folder: Path) -> Counts:
    """Let rsipi's client of several processes move our emulated robot."""
    seen, facts = test_rsipi_motion.drive_client(folder, IDLE, MOTION)
    return of_emulator(facts, max(seen["cycles"], facts["telegrams"]["answered"]))


def rows() -> Iterator[tuple[str, str, str, bool, bool, str, Callable[[Path], Counts]]]:
    """Yield package, what of it, against, idle, motion, file, and the run in a folder."""
    file = "rsipi_peer.py"
    for cycle_ms, layout in ((4, "rsi_joints_setpoints.xml"), (12, "rsi_joints.xml")):
        yield (
            "rsipi", f"EchoServer, {cycle_ms} ms", DAEMON, True, False, file,
            lambda folder, c=cycle_ms, lay=layout: echo_server(folder, c, lay),
        )  # fmt: skip
    yield (
        "rsipi", "EchoServer, 12 ms", CYCLE, False, True, "rsipi_motion.py",
        lambda _: of_peer(rsipi_motion.play(CYCLES)),
    )  # fmt: skip
    yield "rsipi", "RSIClient, 12 ms", EMULATOR, True, True, "rsipi_client.py", rsi_client
    for number in (3, 4):
        what = f"FakeCRXController, version {number}"
        for against, play in ((DAEMON, airo_peer.idle), (CYCLE, airo_peer.in_motion)):
            yield (
                "airo-fanuc", what, against, against == DAEMON, against == CYCLE, "airo_peer.py",
                lambda _, play=play, n=number: of_peer(play(CYCLES, n)),
            )  # fmt: skip
    yield (
        "airo-fanuc", "compiled StreamCore, version 3", EMULATOR, True, True, "airo_client.py",
        lambda folder: of_emulator(test_airo_client.drive_client(folder, IDLE, MOTION)[1]),
    )  # fmt: skip
    for number in (1, 2):
        yield (
            "fanuc-ucl", f"StreamMotionDriver, version {number}", EMULATOR, True, True,
            "ucl_peer.py",
            lambda folder, n=number: of_emulator(
                test_fanuc_ucl.drive_client(folder, n, IDLE, MOTION)[1], CYCLES
            ),
        )  # fmt: skip
    for name in test_egm_clients.CLIENTS:
        yield (
            name, "EGM, 4 ms", EMULATOR, True, True, "egm_peer.py",
            lambda folder, n=name: of_emulator(
                test_egm_clients.drive_client(folder, n)[1], CYCLES
            ),
        )  # fmt: skip


def main() -> int:
    """Play every row and print the table as JSON."""
    table: list[Row] = []
    for package, what, against, idle, motion, file, play in rows():
        quiet = contextlib.redirect_stdout(sys.stderr)  # the packages print
        with TemporaryDirectory() as name, contextlib.chdir(name), quiet:
            counts = play(Path(name))
        table.append({
            "peer": f"{package} {version(package)}, {what}", "against": against, "idle": idle,
            "motion": motion, "file": file, "load_1min": round(os.getloadavg()[0], 2), **counts,
        })  # fmt: skip
        print(json.dumps(table[-1]), file=sys.stderr, flush=True)
    print(json.dumps({"rows": table}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
