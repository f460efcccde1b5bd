"""What recording costs a 4 ms cycle, and how long its files are, in a run that leads the robot."""

import statistics
import time
from pathlib import Path

from linemate.daemon.service.cycle import LogEntry
from linemate.daemon.service.recorder import Recorder
from linemate.simulators.harness import lockstep, setup

CYCLE_S = 0.004
OVERRIDES = ("scenario.lead_in_s=1.5", "scenario.duration_s=3.0")
MOST_OF_A_TURN = 0.12
"""Of what step, plants and codecs take in the same run: 0.04 where it was measured, and at 4 ms
1.1 to 1.6 % of a cycle. The ratio holds on a slow machine and under coverage as well."""

MOST_A_MINUTE = 10e6


def test_recording_costs_the_cycle_little_and_its_files_stay_small(tmp_path: Path) -> None:
    made = setup.make("wheel", OVERRIDES, cycle_ms=1e3 * CYCLE_S)
    task = setup.shipped_task()
    texts = {"config": "task: wheel.yaml\n", "task": task.text, "urdf": task.urdf}
    recorder = Recorder(tmp_path, texts)
    assert recorder.start() is None
    took: list[float] = []
    turns: list[float] = []
    ended = time.thread_time()

    def keep(entry: LogEntry) -> None:
        # The cycle's own time: what the writer's thread takes, it takes in the slack.
        nonlocal ended
        began = time.thread_time()
        turns.append(began - ended)
        recorder.take((entry,))
        ended = time.thread_time()
        took.append(ended - began)

    lockstep.run(made, 0, on_step=keep)
    recorder.close()
    status = recorder.status
    assert (status.dropped, status.failure) == (0, "")
    assert status.written == len(took) > 1000
    minute = Path(status.file).stat().st_size / (len(took) * CYCLE_S) * 60.0
    quick, median = statistics.quantiles(took, n=10)[0], statistics.median(took)
    print(
        f"take: p10 {1e6 * quick:.0f}, median {1e6 * median:.0f} us, "
        f"{median / statistics.median(turns):.3f} of a turn; {minute / 1e6:.1f} MB a minute"
    )
    assert median < MOST_OF_A_TURN * statistics.median(turns)
    assert minute < MOST_A_MINUTE
