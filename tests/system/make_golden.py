"""Makes the golden recording again: ``python tests/system/make_golden.py``.

To be run when a change of outputs is meant; the commit says why it is. Steps, states and
parameters only: what viewers are shown would double its size.
"""

import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.recording.format import ItemKind
from linemate.daemon.recording.step_file import StepFile
from linemate.daemon.recording.step_items import StepItems, metadata_of
from linemate.simulators.harness import lockstep, setup

GOLDEN = Path(__file__).parent / "golden" / "wheel.mcap"
OVERRIDES = ("scenario.lead_in_s=1.5", "scenario.duration_s=10.5")
KEPT = frozenset({ItemKind.STEP, ItemKind.STATE, ItemKind.PARAMETERS})


def make(path: Path) -> None:
    """Write the recording of a run in virtual time: approach, stop, impact, contact, restart."""
    made = setup.make("wheel", OVERRIDES)
    task = setup.shipped_task()
    texts = {"config": "task: wheel.yaml\n", "task": task.text, "urdf": task.urdf}
    file, feed = StepFile(path.open("wb"), metadata_of(texts), chunk_bytes=1 << 20), StepItems()

    def keep(entry: LogEntry) -> None:
        for item in feed.convert(entry):
            if item.kind in KEPT:
                file.write_item(item)

    lockstep.run(made, 0, on_step=keep)
    file.close()


if __name__ == "__main__":
    make(GOLDEN)
    print(f"{GOLDEN}: {GOLDEN.stat().st_size} bytes")
