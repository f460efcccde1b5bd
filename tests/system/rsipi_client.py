"""rsipi's client as a process: it holds the emulated robot, then moves it. Not a test."""

import json
import math
import sys
import threading
import time
from typing import Any

AMPLITUDE_DEG, AMPLITUDE_MM, PERIOD_S = 0.75, 10.0, 4.0


def drive(config: str, idle: int, motion: int, cycle_ms: int) -> dict[str, Any]:
    """Answer so many telegrams at rest, then so many in motion."""
    from RSIPI.rsi_client import RSIClient

    client = RSIClient(config, rsi_mode="absolute", cycle_time=1e-3 * cycle_ms)
    threading.Thread(target=client.start, daemon=True).start()
    assert client.wait_for_connection(20.0)
    while not (first := client.current_ipoc()):
        time.sleep(0.01)
    cycles, farthest_deg, reported = 0, 0.0, 0.0
    while cycles < idle + motion:
        cycles = (client.current_ipoc() - first) // cycle_ms
        phase = 2.0 * math.pi * max(0, cycles - idle) * 1e-3 * cycle_ms / PERIOD_S
        share = 1.0 - math.cos(phase)
        farthest_deg = max(farthest_deg, AMPLITUDE_DEG * share)
        published = client.publish_corrections(
            {"AKorr": {"A1": AMPLITUDE_DEG * share}, "EKorr": {"E1": AMPLITUDE_MM * share}}
        )
        client.wait_correction_applied(published, 0.1)
        reported = max(reported, abs(client.send_variables["AIPos"]["A1"]))
    client.stop()
    return {"cycles": cycles, "sent_deg": farthest_deg, "moved_deg": reported}


if __name__ == "__main__":
    print(json.dumps(drive(sys.argv[1], *map(int, sys.argv[2:5]))))
