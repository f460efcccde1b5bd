"""rsipi in motion: its EchoServer between the daemon's cycle and our plant. Not a test.

The package writes each telegram and judges each reply, unchanged. In motion it reports what our
plant measures, so that the whole task runs. Its numbers have two digits: 0.01 degree.
"""

import argparse
import json
import math
import os
from contextlib import closing
from dataclasses import replace
from typing import Any

from linemate.daemon.config.files import PROTOCOL_DATA
from linemate.protocol.exchange_controller import Judgement
from linemate.protocol.rsi.codec import RsiCodec, parse_config
from linemate.protocol.rsi.rsi_link import RsiLink
from linemate.simulators.devices.rsi_controller import ControllerConfig, RsiController
from linemate.simulators.harness import setup
from linemate.simulators.harness.lockstep import Lockstep
from tests.system.airo_peer import cycle_with

FILE = PROTOCOL_DATA / "rsi_joints_setpoints.xml"  # its names AKorr and EKorr are rsipi's
CYCLE_MS = 12


def echo_server() -> Any:
    """Return rsipi's controller on the loopback; it leaves its log in ./logs."""
    from RSIPI.rsi_echo_server import EchoServer

    class Loopback(EchoServer):  # type: ignore[misc] -- no types there
        """On any port, where the original takes 0.0.0.0:50000."""

        server_address = property(lambda _: ("127.0.0.1", 0), lambda *_: None)

    return Loopback(str(FILE), delay_ms=CYCLE_MS, mode="absolute")


class EchoController(RsiController):
    """Our emulated controller with rsipi's reading and writing.

    Attributes:
        accepted: replies that rsipi took.
        farthest_deg: largest correction of A1..A6 that rsipi read [deg].
    """

    def __init__(self, run: Lockstep) -> None:
        config = ControllerConfig(cycle_s=1e-3 * CYCLE_MS)
        plant = run._plant
        super().__init__(parse_config(FILE.read_bytes()), plant.read, plant.start, config)
        self.server = echo_server()
        self.accepted, self.farthest_deg = 0, 0.0

    def telegram(self) -> bytes | None:
        """Let rsipi write the telegram."""
        data = super().telegram()
        if data is None:
            return None
        read, server = self.codec.parse_robot(data), self.server
        for name, values in (("AIPos", read.joints), ("ASPos", read.joint_setpoints)):
            server.state[name].update(
                {f"A{n}": math.degrees(q) for n, q in enumerate(values or (), 1)}
            )
        server.state["EIPos"]["E1"] = 1e3 * (read.external or (0.0,))[0]
        server.ipoc_value = server.last_sent_ipoc = read.ipoc
        text: str = server.generate_message()
        return text.encode()

    def on_reply(self, data: bytes, stamp_ns: int = 0, deadline_ns: int | None = None) -> Judgement:
        """Let rsipi judge the reply, then our controller."""
        self.accepted += self.server.process_reply(data.decode()) is True
        angles = map(abs, self.server.last_corrections.get("AKorr", {}).values())
        self.farthest_deg = max(self.farthest_deg, *angles, 0.0)
        return super().on_reply(data, stamp_ns, deadline_ns)


def play(cycles: int) -> dict[str, Any]:
    """Exchange so many telegrams in the wheel's task, in virtual time."""
    made = setup.make("wheel")
    tool = replace(made.task.tool, fixed_after=4.0, released_after=1.0)
    made = replace(
        made,
        task=replace(made.task, tool=tool),
        scenario=replace(made.scenario, duration_s=1e-3 * CYCLE_MS * cycles),
    )
    run = Lockstep(made, 0)
    run.controller = peer = EchoController(run)
    run.cycle = cycle_with(run, RsiLink(RsiCodec(peer.codec.config), on_rail=True))
    with closing(peer.server.udp_socket):
        while peer.counts.sent < cycles and run.turn():
            pass
    return {
        "cycles": peer.counts.sent,
        "accepted": peer.accepted,
        "unanswered": peer.counts.lost,
        "refused": peer.server.faulty_packets,
        "farthest_deg": round(peer.farthest_deg, 2),
        "state": run.cycle.machine.state.value,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--cycles", type=int, default=3000)
    parser.add_argument("--folder", default=".", help="for its log")
    args = parser.parse_args()
    os.chdir(args.folder)
    print(json.dumps(play(args.cycles)))
