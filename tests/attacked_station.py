"""A daemon with every link and endpoint, its emulators, and what both counted."""

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
from daemon_process import DaemonProcess

from linemate.daemon.transport.client import Client, RefusedError
from linemate.protocol.command.frame_codec import Role
from linemate.protocol.command.preshared_keys import key_line, make_key
from linemate.protocol.exchange_controller import ControllerCounts
from linemate.simulators.devices.limit_judge import LIMITS
from linemate.simulators.devices.links.emulator import Emulator, EmulatorConfig, EmulatorResult
from linemate.simulators.devices.rsi_controller import ControllerConfig
from linemate.simulators.harness.cell.cell_truth import shipped_task
from linemate.simulators.harness.setup import shipped_control
from linemate.simulators.plants.scenario import Camera, Scenario

T = TypeVar("T")
LONGEST_S = 240.0
QUIET = Scenario(lead_in_s=1.0, camera=Camera(dropout_rate=0.0, blind_beyond=10.0))
TIMEOUT_S = 40.0
ON_ITS_WAY = 0.02
TEXT = """
task: wheel.yaml
rsi: {port: 0}
distance: {can: {interface: slcan, channel: FOLDER/can}}
camera: {port: 0}
force_torque: {url: FOLDER/ft}
command: {socket: c.sock, udp: {port: 0, keys: keys}}
watch:
  # A busy machine's own stalls shall not end what is looked at here.
  {healthy_cycles: 10, link_lost_s: 1.0, link_lost_in_contact_s: 1.0, missed_s: 0.6,
   missed_in_contact_s: 0.6, leak_s: 2.0, position_s: 2, wrench_s: 2}
"""


def robots_limits() -> str:
    """The emulated robot's limits for the daemon's file, as a site copies its own robot's."""
    rows = [
        f"{{lower: {robot.low}, upper: {robot.high}, speed: {robot.speed},"
        f" acceleration: {own.acceleration}, jerk: {own.jerk}}}"
        for robot, own in zip(LIMITS, shipped_control().limits, strict=True)
    ]
    return f"control: {{limits: [{', '.join(rows)}]}}\n"


@dataclass(frozen=True, slots=True)
class Glimpse:
    """What the controller counted up to an instant, and what the daemon says of itself."""

    counts: ControllerCounts
    row: int
    status: dict[str, Any]


def at(value: Any, *path: str) -> Any:
    """What stands at a path; 0 where nothing was counted."""
    for key in path:
        value = value.get(key, 0)
    return value


class Station:
    """The emulators in a thread of their own, next to a daemon in a process of its own."""

    def __init__(self, daemon: DaemonProcess, scenario: Scenario = QUIET) -> None:
        self.daemon = daemon
        self._loop = asyncio.new_event_loop()
        self._stop = asyncio.Event()
        self._running: asyncio.Future[EmulatorResult] | None = None
        self._thread = threading.Thread(target=self._loop.run_forever)
        self.emulator = Emulator(
            EmulatorConfig(
                scenario=replace(scenario, duration_s=LONGEST_S),
                controller=ControllerConfig(timeout=100_000),
                robot_target=daemon.robot(),
                camera_target=tuple(daemon.listening["camera"]),
                can_link=daemon.folder / "can",
                serial_link=daemon.folder / "ft",
                distance_mount=shipped_task().file.conveyor.start_position,
                wait_answered=3,
            )
        )

    def __enter__(self) -> Self:
        self._thread.start()
        self._running = asyncio.run_coroutine_threadsafe(  # type: ignore[assignment]
            self.emulator.run(self._stop), self._loop
        )
        try:
            self.cycles(1)
            self.status_once(
                lambda s: (
                    s["state"] == "idle"
                    and all(one["age_s"] is not None for one in s["links"].values())
                )
            )
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)
        assert self._running is not None
        try:
            self._running.result(TIMEOUT_S)  # type: ignore[call-arg]
        finally:
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join()
            self._loop.close()

    def do(self, action: Callable[..., T], *args: object) -> T:
        """Call something in the emulators' own thread."""

        async def call() -> T:
            return action(*args)

        return asyncio.run_coroutine_threadsafe(call(), self._loop).result(TIMEOUT_S)

    def until(self, condition: Callable[[], bool]) -> None:
        """Wait until something holds in the emulators."""
        end = time.monotonic() + TIMEOUT_S
        while not self.do(condition):
            assert self._running is None or not self._running.done(), self._running
            assert time.monotonic() < end, "it did not happen in time"
            time.sleep(0.005)

    def cycles(self, count: int) -> None:
        """Wait for so many of the controller's cycles to pass."""
        wanted = self.rows() + count
        self.until(lambda: len(self.emulator.truth) >= wanted)

    def rows(self) -> int:
        """Cycles written down so far."""
        return self.do(lambda: len(self.emulator.truth))

    def glimpse(self) -> Glimpse:
        """Everything as of now; the status last, so that it is not older than the counts."""
        counts, row = self.do(
            lambda: (replace(self.emulator.link.controller.counts), len(self.emulator.truth))
        )
        return Glimpse(counts, row, self.daemon.status())

    def status_once(self, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """The daemon's first status that meets a condition."""
        return self.daemon.status_once(condition, TIMEOUT_S)

    def shown(self, *path: str) -> Any:
        """What ``linemate status --json`` shows at a path; 0 where nothing was counted."""
        return at(self.daemon.status_by_tool()[1], *path)

    def until_counted(self, action: Callable[[], object], *path: str) -> None:
        """Do something, once or again, until a count of the daemon's has risen."""
        before = at(self.daemon.status(), *path)
        end = time.monotonic() + TIMEOUT_S
        while at(self.daemon.status(), *path) == before:
            assert time.monotonic() < end, f"{path} stays at {before}"
            self.do(action)
            self.cycles(3)

    def order(self, op: str, timeout_s: float = 4.5) -> str | None:
        """Give the daemon an order; why it is refused, or None."""
        with Client.local(self.daemon.listening["command"]["socket"]) as client:
            try:
                client.call(op, None, timeout_s)
            except RefusedError as refused:
                return str(refused)
        return None

    def travelled(self) -> float:
        """How far any setpoint has been from another [rad, m]."""
        setpoints = self.do(self.emulator.truth.columns)["setpoints"]
        return float(np.ptp(setpoints, axis=0).max())

    def set_going(self) -> str:
        """Arm and start until the robot is on its way; what was reported last if it never is."""
        end = time.monotonic() + TIMEOUT_S
        text = ""
        while self.travelled() < ON_ITS_WAY and time.monotonic() < end:
            status = self.daemon.status()
            order = {"idle": "arm", "armed": "start"}.get(status["state"])
            text = (order and self.order(order)) or f"{status['state']}, {status['because']}"
            if status["state"] not in {"init", "idle", "armed", "track"}:
                break
            self.cycles(1)
        return text

    @contextmanager
    def unharmed(self) -> Iterator[Glimpse]:
        """Whatever happens in here, telegrams are answered and the robot stays where it is."""
        before = self.glimpse()
        yield before
        self.cycles(20)
        after = self.glimpse()
        end = time.monotonic() + TIMEOUT_S
        while _unanswered(before, after) > 0:  # a busy machine's answers are on their way
            assert time.monotonic() < end, _difference(before, after)
            self.cycles(1)
            after = self.glimpse()
        assert after.counts.answered > before.counts.answered
        assert after.counts.duplicate == before.counts.duplicate
        assert after.status["faults"] == 0
        assert after.status["links"]["robot"]["counters"].get("callback_errors", 0) == 0
        assert after.status["commands"]["counters"].get("handler_errors", 0) == 0
        judge = self.emulator.link.controller.judge
        assert judge.violations == 0, judge.evidence
        columns = self.do(self.emulator.truth.columns)
        np.testing.assert_array_equal(np.ptp(columns["setpoints"][: after.row], axis=0), 0.0)
        assert self.emulator.link.controller.broken is None


def _unanswered(before: Glimpse, after: Glimpse) -> int:
    """Telegrams without any answer, next to those that the daemon tells it never could answer.

    After a stall only the newest telegram of those that wait is worth an answer.
    """
    old, new = (one.status["links"]["robot"]["counters"] for one in (before, after))
    stale = new.get("stale", 0) - old.get("stale", 0)
    return after.counts.lost - before.counts.lost - stale


def _difference(before: Glimpse, after: Glimpse) -> str:
    """Both sides' counts side by side."""
    return "\n".join(
        f"{g.counts} {g.status['links']['robot']['counters']} {g.status['telegrams']}"
        for g in (before, after)
    )


@contextmanager
def serving(folder: Path) -> Iterator[DaemonProcess]:
    """A daemon with every link and endpoint."""
    keys = folder / "keys"
    keys.write_text(key_line(make_key("panel", Role.OPERATE, bytes(range(32)))))
    keys.chmod(0o400)
    text = TEXT.replace("FOLDER", str(folder)) + robots_limits()
    with DaemonProcess(folder, text) as daemon:
        yield daemon
