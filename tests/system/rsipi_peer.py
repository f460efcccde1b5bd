"""The controller emulator of the package rsipi as a process, and a plain echo next to it.

Rsipi's code judges, unchanged; here it is only bound to the loopback, ended
after so many cycles, and made to say what it counted. It leaves its log in ./logs. Not a test:
``test_rsipi`` starts it.
"""

import argparse
import json
import re
import socket
import sys
import time
from pathlib import Path
from typing import Any

IPOC = re.compile(rb"<IPOC>(\d+)</IPOC>")
LATE = re.compile(r"no reply in time")


def control(config: str, cycle_ms: int, cycles: int, joints: list[float]) -> dict[str, Any]:
    """Be the controller for so many cycles; what it counted.

    Cycles without a good reply come with the monotonic times of their beginning and end, for it
    does not count all of them: not those at either end, nor a silence that it takes for a restart.
    """
    from RSIPI.rsi_echo_server import EchoServer

    class Controller(EchoServer):  # type: ignore[misc] -- no types there
        """On the loopback and any port, where the original takes 0.0.0.0:50000."""

        server_address = property(lambda _: ("127.0.0.1", 0), lambda *_: None)

        def __init__(self) -> None:
            self.sent = self.accepted = self.late = 0
            self.sent_s = 0.0
            self.unanswered: list[tuple[float, float]] = []
            self.wrong: list[str] = []
            super().__init__(config, delay_ms=cycle_ms, mode="absolute", timeout_packets=cycles)
            for pose in (self.state["AIPos"], self.base_pose["AIPos"]):
                pose.update({f"A{i + 1}": joint for i, joint in enumerate(joints)})

        def receive_and_process(self) -> bool | None:
            accepted: bool | None = super().receive_and_process()
            self.accepted += accepted is True
            if self.sent and not accepted:
                self.unanswered.append((self.sent_s, time.monotonic()))
            return accepted

        def _register_faulty_packet(self, reason: str, count: int = 1) -> None:
            if LATE.match(reason):
                self.late += count
            else:
                self.wrong.append(reason)
            super()._register_faulty_packet(reason, count)

        def send_once(self) -> None:
            self.running = self.sent < cycles
            if self.running:
                self.sent += 1
                self.sent_s = time.monotonic()
                super().send_once()

    controller = Controller()
    began_s = time.monotonic()
    controller.send_message()
    controller.udp_socket.close()
    return {
        "sent": controller.sent,
        "accepted": controller.accepted,
        "late": controller.late,
        "unanswered": controller.unanswered,
        "wrong": controller.wrong,
        "faulty": controller.faulty_packets,
        "joints": list(controller.state["AIPos"].values()),
        "linear_axis": controller.state["EIPos"]["E1"],
        "corrected": sorted(controller.last_corrections),
        "period_ms": 1e3 * (time.monotonic() - began_s) / max(1, controller.sent),
    }


def echo() -> None:
    """Answer each telegram with its IPOC and no more, until it is ended."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 0))
        print(port.getsockname()[1], flush=True)
        while True:
            data, source = port.recvfrom(4096)
            counter = IPOC.search(data)
            if counter is not None:
                port.sendto(b'<Sen Type="ImFree">' + counter.group() + b"</Sen>", source)


def main() -> int:
    """Parse arguments and play one of the parts."""
    parser = argparse.ArgumentParser()
    parser.add_argument("part", choices=("controller", "echo"))
    parser.add_argument("--config")
    parser.add_argument("--cycle-ms", type=int)
    parser.add_argument("--cycles", type=int)
    parser.add_argument("--joints", type=float, nargs=6)
    parser.add_argument("--result", type=Path)
    args = parser.parse_args()
    if args.part == "echo":
        echo()
    else:
        counted = control(args.config, args.cycle_ms, args.cycles, args.joints)
        args.result.write_text(json.dumps(counted), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
