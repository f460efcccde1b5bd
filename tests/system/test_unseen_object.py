"""An object that the camera does not show in time: the tool comes to rest gently, and waits."""

import numpy as np
import pytest

from linemate.daemon.cycle.step_log import LogEntry
from linemate.simulators.harness import lockstep, setup
from linemate.simulators.judge.judge import RunEvidence

FREE_N = 60.0  # on a tool that hangs free; a programme that stood at once shook it with 390 N
RETREAT_N = 150.0  # the retreat's own acceleration; with a jump of the plan it was 475 N
GENTLE_N = 180.0  # and that of a tool that comes to rest at the same time
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


@pytest.mark.parametrize("at_s", [1.0, 1.6, 2.3, 2.75])
def test_a_retreat_on_the_way_to_that_gate_comes_to_rest_gently(at_s: float) -> None:
    # The clock stood at once, and the free tool was shaken with 298 to 335 N.
    overload = f"{{at_s: {at_s}, link: force_torque, kind: offset, duration_s: 0.1, value: 600}}"
    covered = "scenario.camera.effects.occlusions=[{begin_s: -9, end_s: 9}]"
    evidence, entries = run_of(covered, f"scenario.faults=[{overload}]")
    assert any(entry.state == "retreat" for entry in entries)
    rows = evidence.rows
    assert np.nanmax(np.linalg.norm(rows.force[rows.t > at_s - 0.3], axis=1)) < GENTLE_N


def test_a_retreat_from_that_gate_does_not_shake_the_tool_either() -> None:
    # A force of 600 N for 0.1 s, just after the clock has begun to stand at 2.8 s.
    overload = "{at_s: 3.0, link: force_torque, kind: offset, duration_s: 0.1, value: 600}"
    covered = "scenario.camera.effects.occlusions=[{begin_s: -9, end_s: 9}]"
    evidence, entries = run_of(covered, f"scenario.faults=[{overload}]")
    assert any(entry.state == "retreat" for entry in entries)
    rows = evidence.rows
    assert np.nanmax(np.linalg.norm(rows.force[rows.t > 2.5], axis=1)) < RETREAT_N
