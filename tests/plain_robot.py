"""A controller at rest on a real socket: asks every cycle, counts what is not answered in it."""

import select
import socket
import time
from collections.abc import Callable
from pathlib import Path

from linemate.protocol.rsi.codec import RobotTelegram, RsiCodec, parse_config
from linemate.simulators.harness.cell.cell_truth import shipped_task

ROOT = Path(__file__).resolve().parents[1]
CYCLE_S = 0.012
STEP = 12
SILENCE_S = 0.1


class PlainRobot:
    """Stands where the task begins, or wherever it is reported to, and tells its Delay."""

    def __init__(self, target: tuple[str, int]) -> None:
        self._codec = RsiCodec(parse_config((ROOT / "protocol/data/rsi_joints.xml").read_bytes()))
        self._link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._link.setblocking(False)
        self._link.connect(target)
        joints = shipped_task().file.arm.rest_joints
        self._joints = (joints[0], joints[1], joints[2], joints[3], joints[4], joints[5])
        self.ipoc = 1_000_000
        self.delay = 0
        self.stale = 0
        # The daemon has to hear that no program runs before one starts.
        time.sleep(SILENCE_S)

    def close(self) -> None:
        self._link.close()

    def cycles(self, count: int, at: Callable[[int], None] | None = None) -> list[float | None]:
        """Ask so often; how long each reply took [s], None where none came in its cycle.

        Args:
            at: called before each cycle with its number.
        """
        took: list[float | None] = []
        begun = time.monotonic()
        for k in range(count):
            if at is not None:
                at(k)
            self.ipoc += STEP
            sent = time.monotonic()
            self._link.send(self._codec.format_robot(self._telegram()))
            reply = self._reply(begun + (k + 1) * CYCLE_S)
            took.append(None if reply is None else reply - sent)
            self.delay += reply is None
            time.sleep(max(0.0, begun + (k + 1) * CYCLE_S - time.monotonic()))
            if time.monotonic() - begun > (k + 2) * CYCLE_S:
                # This process itself was delayed: its schedule slips, no one is charged.
                begun = time.monotonic() - (k + 1) * CYCLE_S
        return took

    def _telegram(self) -> RobotTelegram:
        return RobotTelegram(
            self.ipoc,
            joints=self._joints,
            external=(0.0,) * 6,
            tcp=(0.0,) * 6,
            delay=self.delay,
            channels={"DiL": 0},
        )

    def _reply(self, until: float) -> float | None:
        """When the reply to the newest telegram came; older ones are stale."""
        while (left := until - time.monotonic()) > 0.0:
            if not select.select([self._link], [], [], left)[0]:
                return None
            try:
                data = self._link.recv(2048)
            except OSError:
                continue
            if b"<IPOC>%d</IPOC>" % self.ipoc in data:
                return time.monotonic()
            self.stale += 1
        return None
