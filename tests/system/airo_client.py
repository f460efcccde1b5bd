"""The compiled client of airo-fanuc as a process: it holds the robot, then moves it. Not a test."""

import argparse
import json
import math
import sys
import time
from collections.abc import Callable
from typing import Any

CYCLE_S = 0.008
AMPLITUDE_DEG = 1.5
READY_S, LOOK_S = 10.0, 0.02


def drive(address: str, port: int, idle: int, motion: int) -> dict[str, Any]:
    """Hold for so many cycles, then go there and back in so many."""
    from airo_fanuc import _core  # type: ignore[import-untyped]

    config = _core.RtCoreConfig()
    config.itp_s, config.sm_version = CYCLE_S, 3
    config.sched_fifo = config.mlock = False
    core = _core.StreamCore(address, port, config)
    assert core.start()
    assert core.wait_ready(READY_S)
    wait(core, lambda seen: seen["motion_possible"] and seen["tx_seq"] > 0, READY_S)
    start = list(core.get_snapshot()["q_cmd"])
    wait(core, lambda _: False, idle * CYCLE_S)
    length_s = motion * CYCLE_S
    count = max(2, motion)
    times, q, qd = [], [], []
    for k in range(count + 1):
        phase = 2.0 * math.pi * k / count
        # Half a degree squared cosine: it begins and ends at rest.
        way = 0.5 * math.radians(AMPLITUDE_DEG) * (1.0 - math.cos(phase))
        speed = 0.5 * math.radians(AMPLITUDE_DEG) * math.sin(phase) * 2.0 * math.pi / length_s
        times.append(round(k * length_s / count * 1e9))
        q.append([start[0] + way, *start[1:6]])
        qd.append([speed, *(0.0,) * 5])
    motion_id = core.submit_trajectory(times, q, qd)
    farthest = 0.0

    def look(seen: dict[str, Any]) -> bool:
        nonlocal farthest
        farthest = max(farthest, abs(seen["q_meas"][0] - start[0]))
        return False

    wait(core, look, length_s + 1.0)
    status = str(_core.MotionStatus(core.motion_status(motion_id)))
    seen = core.get_snapshot()
    core.stop()
    return {
        "farthest_deg": math.degrees(farthest),
        "motion": status,
        "fault": str(_core.FaultReason(int(seen["fault"]))),
        "tx_seq": seen["tx_seq"],
    }


def wait(core: Any, is_over: Callable[[dict[str, Any]], bool], longest_s: float) -> None:
    """Feed the client's supervisor until a condition holds, or for so long."""
    begun_s = time.monotonic()
    while time.monotonic() - begun_s < longest_s and not is_over(core.get_snapshot()):
        core.heartbeat()
        time.sleep(LOOK_S)


def main() -> int:
    """Drive and print what the client saw as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("address")
    parser.add_argument("port", type=int)
    parser.add_argument("--idle", type=int, default=1000)
    parser.add_argument("--motion", type=int, default=2000)
    args = parser.parse_args()
    print(json.dumps(drive(args.address, args.port, args.idle, args.motion)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
