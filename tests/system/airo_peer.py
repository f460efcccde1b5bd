"""Our daemon against a FANUC controller that somebody else wrote: airo-fanuc's FakeCRXController.

Run as a script it exchanges many cycles and prints what was counted; it is not a test. The wire,
its checks and its clock are the package's. In motion the robot's mechanics and the sensors are our
plants', so that the whole task runs: the package's controller reports what our plant measures.
"""

import argparse
import json
import socket
import sys
import time
from collections import Counter, deque
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import numpy as np
import yaml

from linemate.protocol.exchange_controller import ControllerCounts, Judgement
from linemate.protocol.fanuc import packets
from linemate.protocol.fanuc.packets import PacketKind
from linemate.simulators.devices.fanuc.fanuc_controller import FanucConfig
from linemate.simulators.devices.limit_judge import LimitJudge
from linemate.simulators.devices.robot_plant import RobotPlant
from linemate.simulators.devices.rsi_controller import Applied, Seven
from linemate.simulators.harness import setup
from linemate.simulators.harness.cell import families
from linemate.simulators.harness.lockstep import Lockstep

CYCLE_S = 0.008
RELEASE_S = 14.5  # of the shipped task: when the tool releases the wheel [s]
REST_DEG = (0.0, -90.0, 90.0, 0.0, 0.0, 0.0)


def controller(version: int, **options: Any) -> Any:
    """Return the package's controller, which never tolerates a violation."""
    from airo_fanuc.testing import FakeCRXConfig, FakeCRXController  # type: ignore[import-untyped]

    return FakeCRXController(FakeCRXConfig(available_version=version), **options)


class CrxController:
    """The package's controller as one of our runs wants it, a cycle at a time."""

    def __init__(self, plant: RobotPlant, version: int) -> None:
        self.config = FanucConfig(cycle_s=CYCLE_S)
        self.judge = LimitJudge(CYCLE_S)
        self.counts = ControllerCounts()
        self.refusals: Counter[str] = Counter()
        self.messages: deque[str] = deque(maxlen=16)
        self.clamped = self.delay = 0
        self.peer = controller(version, initial_q_deg=_wire(plant.start))
        # The mechanics are our plant's.
        self.peer.plant._integrate_lag = lambda _dt: None
        self.peer.state.stream_motn_launched = True
        self._plant = plant
        self._setpoints = plant.start
        self._reply: packets.CommandPacket | None = None
        self._link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._link.bind(("127.0.0.1", 0))
        self._link.settimeout(2.0)
        self._link.connect(("127.0.0.1", self.peer.sm_port))
        self._link.send(packets.write_capability(packets.CapabilityPacket(version)))
        self.peer.tick()
        assert packets.read_capability(self._link.recv(2048)).available_version == version
        self._link.send(packets.write_short(PacketKind.START, version))

    @property
    def broken(self) -> str | None:
        return None

    @property
    def setpoints(self) -> Seven:
        return self._setpoints

    def begin(self) -> None:
        self.counts = ControllerCounts()

    def telegram(self) -> bytes:
        """Let the package judge the last command and send its status packet."""
        self._reply = None
        self.peer.plant.q_meas = np.array(_wire(self._plant.read().axes))
        self.peer.tick()  # raises at a violation
        self.counts.sent += 1
        return self._link.recv(2048)

    def on_reply(self, data: bytes, stamp_ns: int = 0, deadline_ns: int | None = None) -> Judgement:
        del stamp_ns, deadline_ns
        self._link.send(data)
        self._reply = packets.read_command(data)
        return Judgement.ACCEPTED

    def end_of_cycle(self) -> Applied:
        if self._reply is None:
            self.counts.lost += 1
        else:
            self.counts.answered += 1
            joints = self._reply.joints
            axes = (*np.radians(joints[:6]).tolist(), joints[6] * 1e-3)
            self._setpoints = cast(Seven, axes)
        # The package drives no outputs: the tool gets the signals by the task's own times.
        signals = 3 if self._plant.world.time_s > RELEASE_S else 1
        self.judge.judge(self._setpoints)
        outcome = Judgement.MISSING if self._reply is None else Judgement.ACCEPTED
        return Applied(
            self.counts.sent - 1, self.counts.sent, self._setpoints, signals, outcome, clamped=False
        )

    def close(self) -> None:
        self._link.close()
        self.peer.close()


def _wire(axes: tuple[float, ...]) -> list[float]:
    """Return J1..J9 [deg, mm] of A1..A6 [rad], E1 [m]."""
    return [*np.degrees(axes[:6]).tolist(), axes[6] * 1e3, 0.0, 0.0]


class CrxRun(Lockstep):
    """The wheel's assembly against the package's controller."""

    def __init__(self, version: int) -> None:
        made = setup.make("wheel", controller=families.FANUC)
        made = replace(made, scenario=replace(made.scenario, duration_s=21.0))
        tool = replace(made.task.tool, fixed_after=4.0, released_after=1.0)
        super().__init__(replace(made, task=replace(made.task, tool=tool)), 0)
        self.crx = CrxController(self._plant, version)
        self.controller = self.crx
        link = families.FanucLink(version, on_rail=True)
        self.cycle = cycle_with(self, link)

    def play(self, cycles: int) -> dict[str, Any]:
        """Exchange so many packets in the task."""
        first = np.array(self.crx.setpoints)
        way = np.zeros(7)
        for _ in range(cycles):
            if not self.turn():
                break
            way = np.maximum(way, np.abs(np.array(self.crx.setpoints) - first))
        counts = self.crx.counts
        return {
            "cycles": counts.sent,
            "unanswered": counts.lost,
            "refused": len(self.crx.peer.violations),
            "violations": self.crx.peer.violations[:3],
            "farthest_deg": round(float(np.degrees(way[:6]).max()), 2),
            "farthest_mm": round(float(1e3 * way[6]), 1),
            "state": self.cycle.machine.state.value,
        }


def cycle_with(run: Lockstep, link: Any) -> Any:
    """Return a cycle with another link, in the place of a run's own."""
    from linemate.daemon.cycle.cycle import Cycle
    from linemate.simulators.harness.sensor_links import SensorLinks

    cycle = Cycle(run.cycle.parameters, link)
    cycle.listen(0)
    mount = run._setup.task.conveyor.start_position
    run.links = SensorLinks(run.world, cycle, run._faults, mount)
    run._operator.__init__(cycle)  # type: ignore[misc]
    return cycle


def in_motion(cycles: int, version: int) -> dict[str, Any]:
    """Play the task for so many cycles, in virtual time over real datagrams."""
    run = CrxRun(version)
    try:
        return run.play(cycles)
    finally:
        run.crx.close()


def idle(cycles: int, version: int) -> dict[str, Any]:
    """Let the daemon's process answer so many packets in real time."""
    from daemon_process import DaemonProcess

    peer = controller(version, initial_q_deg=[*REST_DEG, 0.0, 0.0, 0.0])
    peer.state.stream_motn_launched = True
    text = f"""
task: wheel_timed.yaml
controller: {{kind: fanuc}}
fanuc: {{peer: 127.0.0.1, peer_port: {peer.sm_port}, version: {version}, rail: true}}
command: {{socket: c.sock}}
"""
    with TemporaryDirectory() as folder, closing(peer):
        timed_task(Path(folder) / "wheel_timed.yaml")
        peer.start_realtime()
        with DaemonProcess(Path(folder), text) as daemon:
            daemon.status_once(lambda status: status["links"]["robot"]["counters"].get("answered"))
            seen = peer.sm._commands_seen
            began = peer.sm._status_seq
            while peer.sm._status_seq - began < cycles:
                time.sleep(0.02)
            sent, got = peer.sm._status_seq - began, peer.sm._commands_seen - seen
            status = daemon.status()
            code, _ = daemon.end()
        counters = status["links"]["robot"]["counters"]
        return {
            "cycles": sent,
            "unanswered": max(0, sent - got - 1),  # the newest may be on its way
            "refused": len(peer.violations),
            "violations": peer.violations[:3],
            "state": status["state"],
            "unreadable": status["telegrams"]["unreadable"],
            "counters": {name: counters.get(name, 0) for name in ("answered", "unanswered")},
            "faults": status["faults"],
            "exit": code,
        }


def timed_task(path: Path) -> None:
    """Write the shipped task with times instead of the tool's signals."""
    from linemate.daemon.config.files import DAEMON_DATA

    task = yaml.safe_load((DAEMON_DATA / "wheel.yaml").read_text(encoding="utf-8"))
    task["tool"] |= {"fixed_after": 4.0, "released_after": 1.0}
    path.write_text(yaml.safe_dump(task, sort_keys=False), encoding="utf-8")


def main() -> int:
    """Exchange many cycles and print what was counted as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cycles", type=int, default=3000)
    parser.add_argument("--version", type=int, choices=(3, 4), default=3)
    args = parser.parse_args()
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    outcome = {
        "idle": idle(args.cycles, args.version),
        "motion": in_motion(args.cycles, args.version),
    }
    print(json.dumps(outcome, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
