"""The client of fanuc-ucl as a process: it holds the robot, then moves it. Not a test."""

import argparse
import json
import math
import sys
import time
from typing import Any

CYCLE_S = 0.008
AMPLITUDE_DEG, PERIOD_S = 1.5, 4.0
START_S, LONGEST_S, LOOK_S = 10.0, 60.0, 0.05


def drive(address: str, idle: int, motion: int) -> dict[str, Any]:
    """Command so many cycles while the robot stands, then so many in motion.

    The client's thread answers each packet from its queue.
    """
    from fanuc_ucl import JointFormat, JointTemplate, stmo  # type: ignore[import-not-found]

    driver = stmo.StreamMotionDriver(address, 1, True)
    driver.connect()
    driver.start(START_S)
    limits = driver.fetch_movement_limits(0)
    states = driver.pull_states()
    start = list(states[-1].joints(JointFormat.FanucDeg, JointTemplate.SIX))[:6]
    commands = []
    for k in range(idle + motion):
        phase = 2.0 * math.pi * max(0, k - idle) * CYCLE_S / PERIOD_S
        # A cosine begins at rest.
        wanted = [start[0] + 0.5 * AMPLITUDE_DEG * (1.0 - math.cos(phase)), *start[1:]]
        commands.append(
            stmo.MotionCommandPacket.try_from_joints(
                JointFormat.FanucDeg, JointTemplate.SIX, wanted
            )
        )
    commands[-1].set_last_command(True)
    handle = driver.command_motion(commands)
    farthest, packets, begun_s = 0.0, 0, time.monotonic()
    while not handle.is_set() and time.monotonic() - begun_s < LONGEST_S:
        time.sleep(LOOK_S)
        for state in driver.pull_states():
            joints = state.joints(JointFormat.FanucDeg, JointTemplate.SIX)
            farthest = max(farthest, abs(joints[0] - start[0]))
            packets += 1
    stats = driver.stats()
    names = [name for name in dir(stats) if not name.startswith("_")]
    driver.stop()
    driver.disconnect()
    return {
        "done": handle.is_set(),
        "packets": packets,
        "farthest_deg": farthest,
        "stats": {name: getattr(stats, name) for name in names},
        "limits": json.loads(limits.as_json()),
    }


def main() -> int:
    """Drive and print what the client saw as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("address")
    parser.add_argument("--idle", type=int, default=1000)
    parser.add_argument("--motion", type=int, default=2000)
    args = parser.parse_args()
    print(json.dumps(drive(args.address, args.idle, args.motion)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
