"""Emulated controller on a UDP socket, in real time.

Invariants:
    One telegram a cycle on an absolute schedule, never two at once.
    A telegram delayed by less than a cycle is sent late; the schedule stays.
    After a longer delay the whole schedule slips. Both cases are counted.
    The kernel's receive stamp decides whether a reply is in time.
"""

import asyncio
import time
from dataclasses import dataclass
from typing import Protocol

from linemate.protocol.exchange_controller import Judgement
from linemate.simulators.devices.fanuc.fanuc_controller import FanucController
from linemate.simulators.devices.links.controllers import EmulatedController
from linemate.simulators.devices.links.endpoint import Address, Endpoint
from linemate.simulators.devices.rsi_controller import Applied
from linemate.simulators.devices.schedule import DeviceSchedule, Entry
from linemate.simulators.devices.turnaround import TurnAround

BUDGET = 32
GRACE_NS = 500_000
"""How long the plant's computing waits for the reply: on a small machine it would delay it."""

LATE_AFTER = 0.25
"""Share of a cycle after which a telegram counts as sent late."""

SLIP_AFTER = 0.75
"""Share of a cycle by which a telegram may go out late before the schedule slips."""


class Plant(Protocol):
    """What the controller moves; called twice a cycle."""

    def begin_cycle(self, at_ns: int) -> None:
        """A telegram has gone out, and its reply is there or takes its time.

        Args:
            at_ns: the instant at which its cycle began [ns].
        """

    def end_cycle(self, applied: Applied, turnaround_ns: int | None) -> None:
        """Called when a reply is judged, at the end of its cycle at the latest.

        Args:
            applied: what the controller applies during it.
            turnaround_ns: how long its good reply took [ns], None without one.
        """


@dataclass(slots=True)
class SendPace:
    """How well the schedule was kept.

    Attributes:
        slips: how often the schedule slipped.
        slipped_ns: by how much in all [ns].
        late: telegrams sent late, with the schedule kept.
        latest_ns: the latest telegram after its instant, slips apart [ns].
        unsent: telegrams the kernel would not take.
    """

    slips: int = 0
    slipped_ns: int = 0
    late: int = 0
    latest_ns: int = 0
    unsent: int = 0


class ControllerUdp:
    """Drives a controller's cycles.

    Attributes:
        turnaround: how long good replies took.
        pace: how well the schedule was kept.
        is_mute: a fault keeps telegrams from leaving.
        loses_replies: a fault keeps replies from arriving.
    """

    def __init__(
        self,
        controller: EmulatedController,
        plant: Plant,
        schedule: DeviceSchedule,
        target: Address,
        bind: Address = ("127.0.0.1", 0),
    ) -> None:
        self.controller = controller
        self.turnaround = TurnAround()
        self.pace = SendPace()
        self.is_mute = False
        self.loses_replies = False
        self._plant = plant
        self._schedule = schedule
        self._target = target
        self._bind = bind
        self._cycle_ns = round(controller.config.cycle_s * 1e9)
        self._endpoint: Endpoint | None = None
        self._grace_ns = min(GRACE_NS, self._cycle_ns // 4)
        self._asked = controller if isinstance(controller, FanucController) else None
        self._due_ns = 0
        self._begun_ns = 0
        self._sent_ns = 0
        self._elapsed_ns: int | None = None
        self._grace: Entry | None = None
        self._is_open = False
        self._is_begun = True
        self._running = False

    @property
    def address(self) -> Address | None:
        """Where replies go, None while closed."""
        return None if self._endpoint is None else self._endpoint.address

    @property
    def due_ns(self) -> int:
        """When the next telegram goes out [ns]."""
        return self._due_ns

    def open(self, first_ns: int | None = None) -> None:
        """Bind, and send the first telegram at an instant.

        Args:
            first_ns: that instant [ns]; None: a cycle from now.

        Raises:
            OSError: if the address cannot be bound.
        """
        self._endpoint = Endpoint.bound(*self._bind)
        asyncio.get_running_loop().add_reader(self._endpoint.link, self._heard)
        self._due_ns = time.monotonic_ns() + self._cycle_ns if first_ns is None else first_ns
        self._running = True
        self._schedule.at(self._due_ns, self._tick)

    def begin_counting(self) -> None:
        """Forget what was counted so far; the schedule goes on."""
        self.controller.begin()
        self.turnaround.clear()
        self.pace = SendPace()

    def send_raw(self, data: bytes, target: Address | None = None) -> bool:
        """Send any datagram to the daemon, or to another address.

        Returns:
            Whether the kernel took it.
        """
        return self._endpoint is not None and self._endpoint.send(data, target or self._target)

    def stop(self) -> None:
        """Open no further cycle."""
        self._running = False

    def close(self) -> None:
        """Stop sending and receiving."""
        self._running = False
        if self._endpoint is not None:
            asyncio.get_running_loop().remove_reader(self._endpoint.link)
            self._endpoint.close()
            self._endpoint = None

    def _tick(self) -> None:
        if not self._running:
            return
        slipped = self._slip()
        self._drain()
        self._finish()
        if slipped:
            self.controller.judge.slip()
        if not self._running:
            return
        data = self.controller.telegram()
        self._is_open = True
        self._elapsed_ns = None
        self._sent_ns = time.monotonic_ns()
        if data is not None and not self.is_mute:
            self.pace.unsent += not self.send_raw(data)
        self._begun_ns, self._due_ns = self._due_ns, self._due_ns + self._cycle_ns
        self._is_begun = False
        self._grace = self._schedule.at(self._sent_ns + self._grace_ns, self._begin)
        self._schedule.at(self._due_ns, self._tick)

    def _begin(self) -> None:
        """Let the plant compute, once the daemon had the processor for its reply."""
        if not self._is_begun:
            self._is_begun = True
            if self._grace is not None:
                self._schedule.cancel(self._grace)  # a wake-up less
            self._plant.begin_cycle(self._begun_ns)

    def _slip(self) -> bool:
        """Shift the schedule if this process was delayed, and return whether it was."""
        late_ns = time.monotonic_ns() - self._due_ns
        slips = late_ns > SLIP_AFTER * self._cycle_ns
        if slips:
            self.pace.slips += 1
            self.pace.slipped_ns += late_ns
            self._due_ns += late_ns
        else:
            self.pace.late += late_ns > LATE_AFTER * self._cycle_ns
            self.pace.latest_ns = max(self.pace.latest_ns, late_ns)
        return slips

    def _heard(self) -> None:
        """Judge one datagram; the loop comes back for more."""
        self._schedule.together(self._judge_datagram)

    def _drain(self) -> None:
        """Judge what waits."""
        for _ in range(BUDGET):
            if not self._judge_datagram():
                return

    def _judge_datagram(self) -> bool:
        """Judge a datagram, if there is one; a good reply ends the cycle's uncertainty at once."""
        received = None if self._endpoint is None else self._endpoint.receive()
        if received is None:
            return False
        data, stamp_ns, source = received
        if self.loses_replies:
            return True
        judgement = self.controller.on_reply(data, stamp_ns, self._due_ns)
        if self._asked is not None:
            self._answer(self._asked, source)
        if judgement is Judgement.ACCEPTED:
            self._elapsed_ns = max(stamp_ns - self._sent_ns, 0)
            self.turnaround.add(self._elapsed_ns)
            self._begin()
        return True

    def _answer(self, asked: FanucController, source: Address) -> None:
        """Answer a client's requests; packets go to it from now on."""
        for data in asked.take_answers():
            self.send_raw(data, source)
        self._target = source

    def _finish(self) -> None:
        if self._is_open:
            self._is_open = False
            self._begin()
            self._plant.end_cycle(self.controller.end_of_cycle(), self._elapsed_ns)
