"""A robot controller that stands where it was left: it asks every 12 ms and applies what it gets.

A program of its own, run inside the namespaces. One line of JSON a programme's
telegram on stdout: when, which programme, its IPOC, and where the reply sends the robot (A1..A6
rad, E1 m), null without a reply. After TIMEOUT telegrams in a row without one the programme ends,
as with KSS29002, and the next one begins where the robot stands, on a port and a counter of its
own.
"""

import json
import signal
import socket
import sys
import time
from pathlib import Path

from linemate.protocol.rsi.codec import RobotTelegram, RsiCodec, RsiError, parse_config

CYCLE_S = 0.012
TIMEOUT = 25
PAUSE_S = 0.1


def main(config: str, axes: list[float]) -> None:
    """Serve until SIGTERM.

    Args:
        axes: where the robot stands: A1..A6 [rad], E1 [m].
    """
    codec = RsiCodec(parse_config(Path(config).read_bytes()))
    programme = 0
    while True:
        programme += 1
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            link.connect(("127.0.0.1", 49152))
            axes = _programme(codec, link, axes, programme)
        time.sleep(PAUSE_S)


def _programme(
    codec: RsiCodec, link: socket.socket, axes: list[float], programme: int
) -> list[float]:
    start, ipoc, delay, missed = tuple(axes), 1_000_000 * programme, 0, 0
    at = time.monotonic()
    while missed < TIMEOUT:
        ipoc, at = ipoc + 12, at + CYCLE_S
        telegram = RobotTelegram(
            ipoc,
            joints=(axes[0], axes[1], axes[2], axes[3], axes[4], axes[5]),
            external=(axes[6], 0.0, 0.0, 0.0, 0.0, 0.0),
            tcp=(0.0,) * 6,
            delay=delay,
            channels={"DiL": 0},
        )
        sent_to = _ask(codec, link, codec.format_robot(telegram), ipoc, at)
        if sent_to is None:
            delay, missed = delay + 1, missed + 1
        else:
            missed = 0
            axes = [begun + more for begun, more in zip(start, sent_to, strict=True)]
        line = {"t": time.monotonic(), "programme": programme, "ipoc": ipoc}
        print(json.dumps(line | {"axes": axes if sent_to else None}), flush=True)
        time.sleep(max(0.0, at - time.monotonic()))
    return axes


def _ask(
    codec: RsiCodec, link: socket.socket, data: bytes, ipoc: int, until: float
) -> tuple[float, ...] | None:
    """The corrections that came in time, None without any."""
    try:
        link.send(data)
        while (left := until - time.monotonic()) > 0.0:
            link.settimeout(left)
            reply = codec.parse_sensor(link.recv(2048))
            if reply.ipoc == ipoc and reply.joints is not None and reply.external is not None:
                return (*reply.joints, reply.external[0])
    except (OSError, RsiError):
        # No one listens, or no one in time.
        return None
    return None


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    main(sys.argv[1], [float(value) for value in sys.argv[2:]])
