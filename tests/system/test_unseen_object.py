"""An object that the camera does not show in time: the tool comes to rest gently, and waits."""

import numpy as np
import pytest

from linemate.daemon.cycle.step_log import LogEntry
from linemate.simulators.harness import lockstep, setup
from linemate.simulators.judge.judge import RunEvidence

FREE_N = 60.0  # on a tool that hangs free; a programme that stood at once shook it with 390 N
CORNER = 0.015  # speed of the plan from one step to the next [m/s]; the line has 0.106 m/s


def run_of(*overrides: str) -> tuple[RunEvidence, list[LogEntry]]:
    entries: list[LogEntry] = []
    made = setup.make("wheel", (*overrides, "scenario.duration_s=5.5"))
    return lockstep.run(made, 0, on_step=entries.append), entries


@pytest.mark.parametrize(
    ("camera", "is_seen"),
    [
        ("camera.delay_s=0.4", False),  # older than what the daemon keeps: each pose is refused
        ("camera.effects.occlusions=[{begin_s: -9, end_s: 3.0}]", True),
        ("camera.effects.occlusions=[{begin_s: -9, end_s: 3.6}]", True),
    ],
)
def test_a_tool_that_waits_for_the_first_image_is_not_shaken(camera: str, is_seen: bool) -> None:
    evidence, entries = run_of(f"scenario.{camera}")
    rows = evidence.rows
    waits = rows.t < 5.0
    assert np.nanmax(np.linalg.norm(rows.force[waits], axis=1)) < FREE_N
    assert bool(np.isfinite(rows.part[-1]).all()) is is_seen
    for entry in entries:
        if entry.after is not None:
            speeds = np.diff(entry.after.tracker.poses[:, :3], axis=0) / 0.012
            assert np.abs(np.diff(speeds, axis=0)).max() < CORNER
