"""What recording costs a 4 ms cycle, and how long its files are, in a run that leads the robot."""

import statistics
import time
from pathlib import Path

from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.recording.recorder import Recorder
from linemate.simulators.harness import lockstep, setup

CYCLE_S = 0.004
OVERRIDES = ("scenario.lead_in_s=1.5", "scenario.duration_s=3.0")
MOST_OF_A_TURN = 0.06
"""Of what step, plants and codecs take in the same run: 0.03 to 0.05 where it was measured, and at
4 ms 1.2 to 2 % of a cycle. A ratio holds on a slow machine as well."""

MOST_A_MINUTE = 10e6


BLOCK = 250
"""Steps that are recorded, then as many that are not, in turn: the machine's moods meet both."""


def test_recording_costs_the_cycle_little_and_its_files_stay_small(tmp_path: Path) -> None:
    made = setup.make("wheel", OVERRIDES, cycle_ms=1e3 * CYCLE_S)
    task = setup.shipped_task()
    texts = {"config": "task: wheel.yaml\n", "task": task.text, "urdf": task.urdf}
    recorder = Recorder(tmp_path, texts)
    assert recorder.start() is None
    took: list[float] = []
    turns: dict[bool, list[float]] = {True: [], False: []}
    ended: float | None = None  # what comes before the first step is no turn
    count = 0

    def keep(entry: LogEntry) -> None:
        # The cycle's own time: the writer has a process of its own.
        nonlocal ended, count
        is_recorded = (count // BLOCK) % 2 == 0
        count += 1
        began = time.thread_time()
        if ended is not None:
            turns[is_recorded].append(began - ended)
        if is_recorded:
            recorder.record((entry,))
        ended = time.thread_time()
        if is_recorded:
            took.append(ended - began)

    lockstep.run(made, 0, on_step=keep)
    recorder.close()
    status = recorder.status
    assert (status.dropped, status.failure) == (0, "")
    assert status.written == len(took) > 500
    minute = Path(status.file).stat().st_size / (len(took) * CYCLE_S) * 60.0
    cost, without = statistics.fmean(took), statistics.fmean(turns[False])
    aside = statistics.fmean(turns[True]) - without
    print(
        f"taking a step {1e6 * cost:.0f} us, {100.0 * cost / CYCLE_S:.2f} % of a cycle, "
        f"{cost / without:.3f} of a turn of {1e6 * without:.0f} us; interleaved, the turns next to "
        f"a recording take {1e6 * aside:+.0f} us; {minute / 1e6:.1f} MB a minute"
    )
    assert statistics.median(took) < MOST_OF_A_TURN * statistics.median(turns[False])
    assert minute < MOST_A_MINUTE
