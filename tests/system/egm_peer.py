"""A public EGM client as a process: it holds the robot, then moves it. Not a test.

The client's code is unchanged. Here it is only bound to the loopback, and made to print what it
saw. Both clients register a file ``egm.proto``, so each needs a process of its own.
"""

import argparse
import json
import math
import socket
import sys
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

AMPLITUDE_DEG, PERIOD_S, RAIL_MM = 1.5, 4.0, 60.0

Send = Callable[[Any, Any, Any], bool]


def client(name: str) -> tuple[Any, Send]:
    """Return the client of a package and how it sends joints [deg], speeds and the rail [mm]."""
    egm: Any
    if name == "abbrobotegm":
        from ABBRobotEGM import EGM  # type: ignore[import-untyped]

        egm = EGM(0)
        return egm, lambda joints, speeds, rail: bool(
            egm.send_to_robot(joints, speed_ref=speeds, external_joints=rail)
        )
    from abb_robot_client.egm import EGM as PLAIN_EGM  # type: ignore[import-untyped]

    egm = PLAIN_EGM(0)
    return egm, lambda joints, speeds, rail: bool(
        egm.send_to_robot(joints, speed_ref=speeds, external_joints=rail)
    )


def drive(name: str, idle: int, motion: int) -> dict[str, Any]:
    """Answer so many messages while the robot stands, then so many in motion."""
    egm, send = client(name)
    egm.socket.close()
    egm.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    egm.socket.bind(("127.0.0.1", 0))
    print(egm.socket.getsockname()[1], flush=True)
    seen = SimpleNamespace(messages=0, sent=0, ready=0, farthest_deg=0.0, farthest_mm=0.0)
    start: Any = None
    rail: Any = None
    begun_s = time.monotonic()
    while seen.messages < idle + motion and time.monotonic() - begun_s < 120.0:
        got = egm.receive_from_robot(timeout=1.0)
        state = got[1]
        if state is None:
            continue
        seen.messages += 1
        if start is None:
            start, rail = state.joint_angles, state.external_axes
        seen.ready += bool(state.rapid_running and state.motors_on)
        phase = 2.0 * math.pi * max(0, seen.messages - idle) * 0.004 / PERIOD_S
        # A cosine begins at rest.
        way = 0.5 * (1.0 - math.cos(phase))
        speed = 0.5 * math.sin(phase) * 2.0 * math.pi / PERIOD_S if phase else 0.0
        joints, speeds = start.copy(), start * 0.0
        joints[0] += AMPLITUDE_DEG * way
        speeds[0] = AMPLITUDE_DEG * speed
        seen.sent += send(joints, speeds, rail + RAIL_MM * way)
        seen.farthest_deg = max(seen.farthest_deg, abs(state.joint_angles[0] - start[0]))
        seen.farthest_mm = max(seen.farthest_mm, abs(state.external_axes[0] - rail[0]))
    egm.close()
    return vars(seen)


def main() -> int:
    """Drive one client and print what it saw as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("client", choices=("abbrobotegm", "abb-robot-client"))
    parser.add_argument("--idle", type=int, default=1000)
    parser.add_argument("--motion", type=int, default=2000)
    args = parser.parse_args()
    print(json.dumps(drive(args.client, args.idle, args.motion)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
