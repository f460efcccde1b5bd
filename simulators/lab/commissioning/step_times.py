"""How long each step of ``linemate commission`` takes in the shipped cells, emulated.

    python -m linemate.simulators.lab.commissioning.step_times

It prints JSON: for each cell and step the length of its recordings, the processor time of the
measurement, and the outcome. Each step has the configuration as it is shipped, without the
overlays of the others. In the step ``force`` a tool hangs on the sensor.
"""

import json
import resource
import sys
import tempfile
from pathlib import Path
from typing import Any

from linemate.daemon.commissioning import walk
from linemate.daemon.commissioning.walk import StepName, StepOutcome
from linemate.daemon.recording.reader import read
from linemate.simulators.lab import commission_cell
from linemate.simulators.lab.commission_cell import EmulatedCell
from linemate.simulators.lab.commissioning import site_copy


def timed(name: str, step: StepName, folder: Path) -> dict[str, Any]:
    """Record and measure a step in a copy of a shipped cell."""
    site = site_copy.copied(name, folder)
    mass = site_copy.TOOL_MASS[name] if step is StepName.FORCE else 0.0
    cell = EmulatedCell(site, overrides=(f"scenario.effector.load.tool_mass={mass}",))
    words: list[object] = []
    recorded_s = 0.0
    if step in commission_cell.STEPS:
        files = commission_cell.recorded(cell, step, folder)
        recorded_s = sum(_length_s(path) for path in files)
        words = ["--from", *files]
    began_s = _of_children_s()
    record = site_copy.commission(site, step, *words)
    return {
        "cell": name,
        "step": step.value,
        "recordings": max(len(words) - 1, 0),
        "recorded_s": round(recorded_s, 1),
        "processor_s": round(_of_children_s() - began_s, 1),
        "measured": record.outcome is StepOutcome.MEASURED,
        "reason": record.reason,
    }


def _of_children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _length_s(path: Path) -> float:
    """Return how long a recording lasts [s]. The counter's unit differs between controllers."""
    stamps_ns = [step.inputs.stamp_ns for step in read(path).steps]
    return 1e-9 * (stamps_ns[-1] - stamps_ns[0])


def main() -> int:
    """Print what each step took."""
    rows = []
    for name in site_copy.TOOL_MASS:
        for step in walk.BY_NAME:
            with tempfile.TemporaryDirectory(prefix="linemate-") as folder:
                rows.append(timed(name, step, Path(folder)))
            print(rows[-1], file=sys.stderr, flush=True)
    print(json.dumps({"rows": rows}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
