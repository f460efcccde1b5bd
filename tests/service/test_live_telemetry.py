"""What a live view is shown: the newest of everything, bounded, and small enough for a datagram."""

import json
import time

import numpy as np
import pytest

from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle.clock.timing import CycleTimes
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.service.live_telemetry import (
    EVENTS,
    HORIZON_POINTS,
    LONGEST_EVENT,
    LiveTelemetry,
    points_in_base,
)
from linemate.protocol.command.frame_codec import PAYLOAD_BYTES
from linemate.protocol.command.payloads import encode_event, encode_result

WORST = {
    "state": "contact",
    "k": 2**40,
    "stamp_ns": 2**62,
    "phase": "approach",
    "task_time": 1.5,
    "scenario": "standing",
    "scenario_state": "confirmed",
    "confidence": -30.0000001,
    "speed": 0.1,
    "contact": False,
    "held": "the solution of the inverse kinematics is not within its limits",
    "target": (0.1,) * 7,
    "sensed": (0.1,) * 7,
    "part": (0.1,) * 7,
    "command": (0.1,) * 7,
}
"""What the telemetry says without an live, at its longest."""


def seen(entries: tuple[LogEntry, ...]) -> LiveTelemetry:
    live = LiveTelemetry(12.0)
    for entry in entries:
        times = CycleTimes(1, 0, None, None, 0, None, 350_000 + entry.inputs.k, True, "track")
        live.record([entry], [times])
    return live


def test_the_newest_of_everything_is_shown_as_plain_values(
    entries: tuple[LogEntry, ...], parameters: Parameters
) -> None:
    shown = seen(entries).snapshot(parameters.tracker.reference.nominal)
    last = entries[-1]
    assert last.inputs.robot is not None
    assert shown["measured"] == (*last.inputs.robot.joints, last.inputs.robot.external[0])
    assert shown["measured_ns"] == last.inputs.robot.stamp_ns
    assert shown["ages_ms"]["distance"] == 1.0
    assert shown["turnaround_us"] == 350
    assert json.loads(json.dumps(shown)) is not None


def test_the_newest_sample_of_each_sensor_is_shown_in_full(entries: tuple[LogEntry, ...]) -> None:
    assert LiveTelemetry(12.0).sensors() == {}
    shown = seen(entries).sensors()
    inputs = [entry.inputs for entry in entries]
    wrench, distance = inputs[-1].wrench[-1], inputs[-1].distance[-1]
    camera = next(one.camera[-1] for one in reversed(inputs) if one.camera)
    assert shown == {
        "wrench": (*wrench.force, *wrench.torque),
        "wrench_ns": wrench.stamp_ns,
        "distance": distance.position,
        "distance_ns": distance.stamp_ns,
        "camera": (*camera.position, *camera.quaternion),
        "camera_ns": camera.exposure_ns,
        "camera_frame": "camera",
    }
    assert len(encode_result(shown)) <= PAYLOAD_BYTES // 2


def test_foresight_begins_at_the_committed_pose_and_has_its_length(
    entries: tuple[LogEntry, ...], parameters: Parameters
) -> None:
    shown = seen(entries).snapshot(parameters.tracker.reference.nominal)
    outputs = entries[-1].outputs
    assert outputs.horizon is not None
    assert shown["foreseen"][0] == pytest.approx(outputs.target[:3], abs=1e-5)
    assert len(shown["foreseen"]) == HORIZON_POINTS
    assert shown["foreseen_ms"] == 12 * (len(outputs.horizon) - 1)


def test_a_horizon_shorter_than_what_is_shown_is_shown_whole() -> None:
    horizon = np.arange(18.0).reshape(3, 6)
    assert points_in_base(horizon, np.eye(3)) == horizon[:, :3].tolist()


def test_happenings_are_numbered_and_bounded(entries: tuple[LogEntry, ...]) -> None:
    live = seen(entries)
    for n in range(10):
        live.add_event(n, f"{n}: " + "x" * 100)
    events = live.snapshot(np.eye(3))["happened"]
    first = live.event_count - EVENTS + 1
    assert [number for number, _, _ in events] == list(range(first, live.event_count + 1))
    assert all(len(text) == LONGEST_EVENT for _, _, text in events)


def test_all_of_it_fits_into_one_datagram(
    entries: tuple[LogEntry, ...], parameters: Parameters
) -> None:
    live = seen(entries)
    for _ in range(EVENTS):
        live.add_event(2**62, "x" * 200)
    shown = live.snapshot(parameters.tracker.reference.nominal)
    assert set(shown) == {
        "happened", "cycle_ms", "turnaround_us", "measured", "measured_ns", "ages_ms",
        "foreseen", "foreseen_ms",
    }  # fmt: skip
    size = len(encode_event(2**40, encode_result(WORST | shown)))
    assert size <= PAYLOAD_BYTES, size


def test_taking_a_step_in_costs_microseconds(entries: tuple[LogEntry, ...]) -> None:
    live = LiveTelemetry(12.0)
    best = min(_taken_ns(live, entries) for _ in range(50))
    assert best / len(entries) < 50_000  # a hundredth of what a step takes here


def _taken_ns(live: LiveTelemetry, entries: tuple[LogEntry, ...]) -> int:
    began = time.perf_counter_ns()
    for entry in entries:
        live.record([entry])
    return time.perf_counter_ns() - began
