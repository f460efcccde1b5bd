"""The controller on a real socket: its pace, and replies judged by their arrival."""

import asyncio
import contextlib
import math
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

from loops import run, until

from linemate import protocol
from linemate.drivers.udp.robot_udp import RobotLink
from linemate.protocol.rsi.codec import RsiCodec, SensorTelegram, parse_config
from linemate.simulators.devices.links.controller_udp import ControllerUdp
from linemate.simulators.devices.rsi_controller import (
    Applied,
    ControllerConfig,
    RobotReading,
    RsiController,
    Seven,
)
from linemate.simulators.devices.schedule import DeviceSchedule

RSI = parse_config((Path(next(iter(protocol.__path__))) / "data" / "rsi_joints.xml").read_bytes())
CODEC = RsiCodec(RSI)
START: Seven = (0.0, -math.pi / 2, math.pi / 2, 0.0, math.pi / 2, 0.0, 0.0)


def answer(data: bytes) -> bytes:
    telegram = CODEC.parse_robot(data)
    return CODEC.format_sensor(
        SensorTelegram(telegram.ipoc, telegram.ipoc_text, joints=(0.0,) * 6, external=(0.0,))
    )


class Plant:
    """Records its calls."""

    def __init__(self, on_begin: Callable[[int], None] = lambda at_ns: None) -> None:
        self.begun: list[int] = []
        self.ended: list[tuple[Applied, int | None]] = []
        self._on_begin = on_begin

    def begin_cycle(self, at_ns: int) -> None:
        self.begun.append(at_ns)
        self._on_begin(at_ns)

    def end_cycle(self, applied: Applied, turnaround_ns: int | None) -> None:
        self.ended.append((applied, turnaround_ns))


def _controller(cycle_s: float, timeout: int = 100) -> RsiController:
    config = ControllerConfig(cycle_s=cycle_s, timeout=timeout)
    return RsiController(RSI, lambda: RobotReading(START, (0.0,) * 6), START, config)


def _run(
    plant: Plant, controller: RsiController, cycles: int, reply: Callable[[bytes], bytes | None]
) -> ControllerUdp:
    async def main() -> ControllerUdp:
        schedule = DeviceSchedule()
        schedule.open()
        daemon = RobotLink(lambda data, *_, **__: reply(data), port=0)
        daemon.open()
        assert daemon.address is not None
        link = ControllerUdp(controller, plant, schedule, daemon.address)
        link.open()
        await until(lambda: len(plant.ended) >= cycles)
        link.close()
        schedule.close()
        daemon.close()
        return link

    return run(main())


def test_telegrams_go_out_on_an_absolute_schedule() -> None:
    plant = Plant()
    link = _run(plant, _controller(0.02), 20, answer)
    gaps = [b - a for a, b in zip(plant.begun, plant.begun[1:], strict=False)]
    assert all(gap >= 20_000_000 for gap in gaps)
    if link.pace.slips == 0:
        assert set(gaps) == {20_000_000}
    counts = link.controller.counts
    assert counts.answered >= 15
    assert all((turn is not None) == applied.answered for applied, turn in plant.ended)
    assert len(link.turnaround) >= 15


def _answer_from_a_thread(endpoint: socket.socket, stop: threading.Event) -> None:
    while not stop.is_set():
        with contextlib.suppress(TimeoutError):
            data, source = endpoint.recvfrom(4096)
            endpoint.sendto(answer(data), source)


def test_being_delayed_slips_the_schedule_and_never_floods() -> None:
    def stall(at_ns: int) -> None:
        if len(plant.begun) == 3:
            time.sleep(0.1)

    plant = Plant(stall)
    stop = threading.Event()

    async def main(target: tuple[str, int]) -> ControllerUdp:
        schedule = DeviceSchedule()
        schedule.open()
        link = ControllerUdp(_controller(0.02), plant, schedule, target)
        link.open()
        await until(lambda: len(plant.ended) >= 8)
        link.close()
        schedule.close()
        return link

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as endpoint:
        endpoint.bind(("127.0.0.1", 0))
        endpoint.settimeout(0.1)
        peer = threading.Thread(target=_answer_from_a_thread, args=(endpoint, stop))
        peer.start()
        try:
            link = run(main(endpoint.getsockname()))
        finally:
            stop.set()
            peer.join()
    assert link.pace.slips >= 1
    assert link.pace.slipped_ns >= 50_000_000
    gaps = [b - a for a, b in zip(plant.begun, plant.begun[1:], strict=False)]
    assert min(gaps) >= 20_000_000
    # The peer's reply waited in the socket while this process slept: it is not to blame.
    assert plant.ended[2][0].answered


def test_replies_that_come_after_the_next_telegram_are_late() -> None:
    waiting: list[bytes] = []

    def one_cycle_later(data: bytes) -> bytes | None:
        waiting.append(answer(data))
        return waiting[-2] if len(waiting) > 1 else None

    plant = Plant()
    link = _run(plant, _controller(0.02), 10, one_cycle_later)
    assert link.controller.counts.answered == 0
    assert link.controller.counts.late >= 5
    assert not any(applied.answered for applied, _ in plant.ended)


def test_a_broken_controller_sends_no_more_but_its_cycles_go_on() -> None:
    plant = Plant()
    link = _run(plant, _controller(0.01, timeout=2), 10, lambda data: None)
    assert link.controller.broken is not None
    assert link.controller.counts.sent == 3
    assert len(plant.ended) >= 10


def test_mute_and_deaf_are_counted_as_the_controller_would() -> None:
    plant = Plant()

    async def main() -> None:
        schedule = DeviceSchedule()
        schedule.open()
        daemon = RobotLink(lambda data, *_, **__: answer(data), port=0)
        daemon.open()
        assert daemon.address is not None
        link = ControllerUdp(_controller(0.01), plant, schedule, daemon.address)
        link.is_mute = True
        link.open()
        await until(lambda: len(plant.ended) >= 3)
        assert daemon.counters["received"] == 0
        link.is_mute, link.loses_replies = False, True
        await until(lambda: daemon.counters["received"] >= 3)
        assert link.controller.counts.answered == 0
        link.loses_replies = False
        await until(lambda: link.controller.counts.answered >= 1)
        link.close()
        schedule.close()
        daemon.close()

    run(main())


def test_a_burst_of_junk_does_not_stop_the_cycle() -> None:
    plant = Plant()

    async def main() -> None:
        schedule = DeviceSchedule()
        schedule.open()
        daemon = RobotLink(lambda data, *_, **__: answer(data), port=0)
        daemon.open()
        assert daemon.address is not None
        link = ControllerUdp(_controller(0.02), plant, schedule, daemon.address)
        link.open()
        assert link.address is not None
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            for _ in range(200):
                stranger.sendto(b"junk", link.address)
            await until(lambda: link.controller.refusals["malformed"] >= 150)
        await until(lambda: link.controller.counts.answered >= 3)
        link.close()
        schedule.close()
        daemon.close()
        await asyncio.sleep(0)

    run(main())
