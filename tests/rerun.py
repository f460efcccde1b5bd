"""A command server that plays a recorded run: a view's daemon without a robot."""

import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from command_ends import open_port, served

from linemate.daemon.recording import viewer_messages
from linemate.daemon.recording.format import SHOWN_OUTPUTS
from linemate.daemon.recording.reader import Recording, read
from linemate.daemon.service.command_server import CommandPort

GOLDEN = Path(__file__).parent / "system" / "golden" / "wheel.mcap"
LINEMATE = (sys.executable, "-m", "linemate.daemon.operator.main")
LINK = {"up": True, "rate_hz": 83.3, "age_s": 0.004, "reason": "", "counters": {}}


@cache
def recording() -> Recording:
    return read(GOLDEN)


class Rerun:
    """The golden run as telemetry, as if it ran now. It begins again after its end.

    A test on a loaded host may miss a moment of the first round.

    Attributes:
        pace: seconds of it in one second; 0 stands still.
        status: what is answered to that.
    """

    def __init__(self, pace: float = 1.0, from_s: float = 0.0) -> None:
        self.pace = pace
        self.from_s = from_s
        self.asked: list[str] = []
        self.status: dict[str, Any] = {
            "health": "healthy", "complaints": [], "because": "", "late": 0, "missing": 0,
            "turnaround_us": {"p99": 420.0}, "links": {"robot": LINK, "camera": LINK},
        }  # fmt: skip
        self._began = time.monotonic()
        self._steps = recording().steps

    def handle(self, op: str, params: Mapping[str, Any], role: str, who: str) -> Mapping[str, Any]:
        del params, role, who
        self.asked.append(op)
        if op == "scene":
            return viewer_messages.scene(recording().texts, 0.012)
        if op == "sensors":
            return self.sensors()
        return self.status if op == "status" else {"refused": f"no {op} here"}

    def sensors(self) -> dict[str, Any]:
        shown: dict[str, Any] = {}
        for step in self._steps[max(0, self._at() - 40) : self._at() + 1]:
            for wrench in step.inputs.wrench:
                shown["wrench"] = (*wrench.force, *wrench.torque)
                shown["wrench_ns"] = wrench.stamp_ns
            for distance in step.inputs.distance:
                shown["distance"], shown["distance_ns"] = distance.position, distance.stamp_ns
            for seen in step.inputs.camera:
                shown["camera"] = (*seen.position, *seen.quaternion)
                shown["camera_ns"], shown["camera_frame"] = seen.exposure_ns, seen.frame
        return shown

    def _at(self) -> int:
        """The step that runs now."""
        first, last = (self._steps[at].inputs.stamp_ns * 1e-9 for at in (0, -1))
        passed_s = self.pace * (time.monotonic() - self._began)
        at_s = self.from_s + passed_s % (last - first - self.from_s)
        return min(len(self._steps) - 1, int(at_s / 0.012))

    def telemetry(self) -> dict[str, Any]:
        step = self._steps[self._at()]
        robot = step.inputs.robot
        telemetry = {name: step.outputs[name] for name in SHOWN_OUTPUTS}
        telemetry |= {"state": step.state, "k": step.inputs.k, "stamp_ns": step.inputs.stamp_ns}
        telemetry |= {"cycle_ms": 12.0, "turnaround_us": 400, "ages_ms": {"camera": 20.0}}
        if robot is not None:
            telemetry["measured"] = (*robot.joints, robot.external[0])
            telemetry["measured_ns"] = robot.stamp_ns
        return telemetry


@contextmanager
def rerun(folder: Path, rerunning: Rerun) -> Iterator[CommandPort]:
    """Serve a rerun at a socket in a folder."""
    with open_port(folder, (), rerunning.handle, rerunning.telemetry) as port, served(port):
        yield port


@contextmanager
def viewing(*words: str | Path) -> Iterator[str]:
    """``linemate view`` as a process of its own; its address."""
    process = subprocess.Popen(
        [*LINEMATE, "view", "--no-browser", *map(str, words)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.stdout is not None
    try:
        address = process.stdout.readline().strip()
        assert address.startswith("http://127.0.0.1:"), address + process.stdout.read()
        yield address
    finally:
        process.terminate()
        assert process.wait(20.0) == 0
        process.stdout.close()
