"""Play a trace to a daemon over its real links, and measure every reply.

Messages of its socket, JSON: out ``{"can": , "force_torque": }``; in ``{"robot": , "camera": ,
"echo": }`` begins the play; in ``{"measure": CYCLES, "file": }``; out ``{"measured": }``.

Invariants:
    A process of its own with light imports.
    It sleeps to the next instant, sends, and reads kernel stamps; it never polls.
    Each cycle goes to the daemon and, half a cycle later, to an echo program.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import select
import socket
import struct
import time
import tty
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from linemate.protocol.rsi.codec import RobotTelegram, RsiCodec, parse_config
from linemate.protocol.sensors.distance import DistanceEncoder
from linemate.protocol.sensors.slcan import CanFrame
from linemate.simulators.devices.sensing.camera_sender import CameraSender
from linemate.simulators.devices.sensing.can_sensor import CanSensor
from linemate.simulators.devices.sensing.force_torque import ForceTorqueSensor
from linemate.simulators.devices.sensing.slcan_adapter import SlcanAdapter
from linemate.simulators.lab.bench.bench_trace import StationTrace

SO_TIMESTAMPNS: Final = 35
TIMESPEC: Final = struct.Struct("@ll")
ANCILLARY: Final = socket.CMSG_SPACE(TIMESPEC.size)
FIRST_IPOC: Final = 100_000_000
SETTLE_NS: Final = 1_500_000_000
"""Of a pass that does not count: the daemon finds the object and is armed again."""

RESTART_NS: Final = 500_000_000
"""Silence before the controller's program begins again: shorter, its start would be no proof."""

SLIP_AFTER: Final = 0.25
FORGOTTEN: Final = 64
"""Telegrams that a reply may lag behind before it counts as lost."""

Address = tuple[str, int]

Action = tuple[int, Callable[[int], object]]
"""After the begin of a pass [ns], and the action, which gets the begin of that pass [ns]."""


class Ear:
    """A datagram socket whose arrivals the kernel stamps."""

    def __init__(self, target: Address) -> None:
        self.target = target
        self.endpoint = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.endpoint.setblocking(False)
        self.endpoint.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self.endpoint.bind(("127.0.0.1", 0))

    def arrivals(self) -> Iterator[tuple[bytes, int]]:
        """What has come: bytes, and the kernel's stamp on the wall clock [ns]."""
        while True:
            try:
                data, ancillary, _, _ = self.endpoint.recvmsg(2048, ANCILLARY)
            except BlockingIOError:
                return
            for _, kind, stamp in ancillary:
                if kind == SO_TIMESTAMPNS:
                    seconds, nanoseconds = TIMESPEC.unpack(stamp)
                    yield data, seconds * 1_000_000_000 + nanoseconds


class EchoRequest:
    """Who is asked once a cycle, and how long it took."""

    def __init__(self, target: Address) -> None:
        self._ear = Ear(target)
        self._waiting: dict[int, tuple[int, int]] = {}
        self.sent_ns: array[int] = array("q")
        self.took_ns: array[int] = array("q")

    def ask(self, data: bytes, ipoc: int, *, counted: bool) -> None:
        """Send one telegram.

        Args:
            counted: its reply is to be measured.
        """
        index = -1
        if counted:
            index = len(self.sent_ns)
            self.sent_ns.append(time.monotonic_ns())
            self.took_ns.append(-1)
        if len(self._waiting) > FORGOTTEN:
            self._waiting.pop(next(iter(self._waiting)))
        self._waiting[ipoc] = (time.time_ns(), index)
        self._ear.endpoint.sendto(data, self._ear.target)

    def read_replies(self) -> bytes | None:
        """Read the replies that have arrived, and return the last."""
        data = None
        for data, stamp_ns in self._ear.arrivals():
            begin = data.find(b"<IPOC>") + 6
            sent = self._waiting.pop(int(data[begin : data.find(b"<", begin)]), None)
            if sent is not None and sent[1] >= 0:
                self.took_ns[sent[1]] = max(1, stamp_ns - sent[0])
        return data

    def clear(self) -> None:
        """Reset the counts."""
        self._waiting.clear()
        self.sent_ns, self.took_ns = array("q"), array("q")


class PlayerPort:
    """The device's end of a pty that is open on both sides from the begin."""

    def __init__(self, answer: Callable[[bytes], bytes]) -> None:
        self._answer = answer
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)

    def serve(self) -> None:
        """Answer what the host wrote."""
        with suppress(BlockingIOError):
            self.write(self._answer(os.read(self._master, 4096)))

    def write(self, data: bytes) -> None:
        """Send; what does not fit is lost, as on a line without a reader."""
        if data:
            with suppress(BlockingIOError):
                os.write(self._master, data)


class PlayedRobot:
    """An ideal robot: it is where the last reply sent it; its tool's signals are the trace's."""

    def __init__(self, trace: StationTrace) -> None:
        xml = files("linemate.protocol").joinpath("data", "rsi_joints.xml").read_bytes()
        self._codec = RsiCodec(parse_config(xml))
        self._trace = trace
        self._start, _ = trace.axes(0)
        self._axes = self._start

    def rest(self) -> None:
        """Stand where the trace begins; a new session counts corrections from there."""
        self._axes = self._start

    def follow(self, reply: bytes | None) -> None:
        """Go where a reply says.

        Args:
            reply: absolute corrections, or None to stay.
        """
        if reply is None:
            return
        reply_values = self._codec.parse_sensor(reply)
        offsets = (*(reply_values.joints or (0.0,) * 6), *(reply_values.external or (0.0,))[:1])
        self._axes = tuple(a + b for a, b in zip(self._start, offsets, strict=True))

    def telegram(self, ipoc: int, at_ns: int) -> bytes:
        """Say where it is.

        Args:
            at_ns: after the trace's begin [ns].
        """
        _, signals = self._trace.axes(at_ns)
        return self._codec.format_robot(
            RobotTelegram(
                ipoc=ipoc,
                joints=self._axes[:6],  # type: ignore[arg-type]
                external=(self._axes[6], 0.0, 0.0, 0.0, 0.0, 0.0),
                tcp=(0.0,) * 6,
                delay=0,
                channels={"DiL": signals},
            )
        )


class Player:
    """The loop."""

    def __init__(self, trace: StationTrace, cycle_ns: int, control: socket.socket) -> None:
        self._cycle_ns = cycle_ns
        self._control = control
        self._adapter = SlcanAdapter()
        self._sensor = ForceTorqueSensor("bota")
        self._can = PlayerPort(self._adapter.feed)
        self._serial = PlayerPort(self._sensor.feed)
        self._arm = PlayedRobot(trace)
        self._cycles = trace.length_ns // cycle_ns
        self._actions = self._sorted(trace)
        self._camera_target: Address = ("127.0.0.1", 0)
        self._camera = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._camera.setblocking(False)
        self._left = 0
        self._file: Path | None = None
        self.slips = 0

    def run(self) -> None:
        """Report the ports, wait for the order to begin, play until the other end is closed."""
        self._send_message({"can": self._can.path, "force_torque": self._serial.path})
        self._serial.write(self._sensor.boot())
        order = self._order(patient=True)
        if order is None:
            return
        self._camera_target = (order["camera"][0], order["camera"][1])
        self._robot = EchoRequest((order["robot"][0], order["robot"][1]))
        self._echo = EchoRequest(("127.0.0.1", order["echo"]))
        gc.collect()
        gc.disable()
        begin_ns, played_ns = time.monotonic_ns() + 50_000_000, 0
        while True:
            after_ns = self._pass(begin_ns, played_ns)
            if after_ns is None:
                return
            played_ns += after_ns - begin_ns
            begin_ns = after_ns

    def _pass(self, begin_ns: int, played_ns: int) -> int | None:
        """Play the trace once.

        Args:
            begin_ns: the first telegram's instant [ns].
            played_ns: how much was played before, for the sensors' own clocks [ns].

        Returns:
            When to begin again; None if that was the last time.
        """
        cycle_ns, actions, coming = self._cycle_ns, self._actions, 0
        due_ns = begin_ns
        self._arm.rest()
        for number in range(self._cycles):
            due_ns = self._sleep(due_ns)
            self._arm.follow(self._robot.read_replies())
            self._echo.read_replies()
            counting = self._left > 0 and number * cycle_ns >= SETTLE_NS
            ipoc = FIRST_IPOC + 4 * number
            telegram = self._arm.telegram(ipoc, number * cycle_ns)
            self._robot.ask(telegram, ipoc, counted=counting)
            # Sensors speak between the reply and the echo, so that neither is disturbed by them.
            self._sleep(due_ns + cycle_ns // 4)
            until_ns = (number + 1) * cycle_ns
            while coming < len(actions) and actions[coming][0] < until_ns:
                actions[coming][1](played_ns)
                coming += 1
            self._can.serve()
            self._serial.serve()
            self._sleep(due_ns + cycle_ns // 2)
            self._echo.ask(telegram, ipoc, counted=counting)
            self._count(counting)
            if not self._listen():
                return None
            due_ns += cycle_ns
        return due_ns + RESTART_NS

    def _count(self, counting: bool) -> None:
        if not counting:
            return
        self._left -= 1
        if self._left == 0:
            self._sleep(time.monotonic_ns() + self._cycle_ns // 4)
            self._arm.follow(self._robot.read_replies())
            self._echo.read_replies()
            self._leave()

    def _leave(self) -> None:
        """Leave the times in a file: three columns of equal length."""
        if self._file is not None:
            columns = (self._robot.sent_ns, self._robot.took_ns, self._echo.took_ns)
            self._file.write_bytes(b"".join(column.tobytes() for column in columns))
        self._send_message({"measured": len(self._robot.sent_ns), "slips": self.slips})
        self.slips = 0

    def _listen(self) -> bool:
        """Take an order if there is one; False if the other end is closed."""
        if not select.select([self._control], [], [], 0)[0]:
            return True
        order = self._order(patient=False)
        if order is None:
            return False
        self._left, self._file = order["measure"], Path(order["file"])
        self._robot.clear()
        self._echo.clear()
        self.slips = 0
        return True

    def _order(self, *, patient: bool) -> dict[str, Any] | None:
        while patient and not select.select([self._control], [], [], 0.002)[0]:
            self._can.serve()
            self._serial.serve()
        data = self._control.recv(4096)
        return json.loads(data) if data else None

    def _send_message(self, message: dict[str, Any]) -> None:
        self._control.send(json.dumps(message).encode())

    def _sleep(self, due_ns: int) -> int:
        """Sleep until an instant; if this process is delayed, that instant moves."""
        now_ns = time.monotonic_ns()
        if now_ns < due_ns:
            time.sleep((due_ns - now_ns) * 1e-9)
            now_ns = time.monotonic_ns()
        if now_ns - due_ns > SLIP_AFTER * self._cycle_ns:
            self.slips += 1
            return now_ns
        return due_ns

    def _sorted(self, trace: StationTrace) -> list[Action]:
        """Everything the sensors say, as bytes, in the order of its instants."""
        emissions = [*self._distances(trace), *self._poses(trace), *self._wrenches(trace)]
        return sorted(emissions, key=lambda action: action[0])

    def _distances(self, trace: StationTrace) -> Iterator[Action]:
        sensor = CanSensor(DistanceEncoder())
        for at_ns, reading in trace.thinned(self._cycle_ns):
            frame = sensor.frame(reading)
            if frame is not None:
                yield at_ns, partial(self._say_distance, frame)

    def _say_distance(self, frame: CanFrame, _played_ns: int) -> None:
        self._can.write(self._adapter.forward(frame))

    def _poses(self, trace: StationTrace) -> Iterator[Action]:
        sender = CameraSender(clock_offset_ns=FIRST_IPOC)
        for at_ns, *pose in trace.camera:
            yield at_ns, partial(self._say_pose, sender, at_ns, *pose)

    def _say_pose(
        self,
        sender: CameraSender,
        at_ns: int,
        exposure_ns: int,
        position: Sequence[float],
        quaternion: Sequence[float],
        covariance: Sequence[float] | None,
        played_ns: int,
    ) -> None:
        data = sender.datagram(
            position,
            quaternion,
            covariance,
            exposure_ns=exposure_ns + played_ns,
            sent_ns=at_ns + played_ns,
        )
        self._camera.sendto(data, self._camera_target)

    def _wrenches(self, trace: StationTrace) -> Iterator[Action]:
        for at_ns, force, torque in trace.wrench:
            yield at_ns, partial(self._say_wrench, at_ns, force, torque)

    def _say_wrench(
        self, at_ns: int, force: Sequence[float], torque: Sequence[float], played_ns: int
    ) -> None:
        self._serial.write(self._sensor.frame(force, torque, (at_ns + played_ns) // 1000))


def main(argv: Sequence[str] | None = None) -> int:
    """Play."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--trace", type=Path, required=True)
    parser.add_argument("--cycle-us", type=int, required=True)
    parser.add_argument("--control-fd", type=int, required=True)
    args = parser.parse_args(argv)
    with socket.socket(fileno=args.control_fd) as control:
        Player(StationTrace.read(args.trace), args.cycle_us * 1000, control).run()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
