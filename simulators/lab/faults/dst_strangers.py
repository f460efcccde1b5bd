"""Foreign datagrams at the robot's port in a fault run.

A second controller, telegrams forged in the first one's name, and the first one's own telegrams
from another address.
"""

import re
from collections import deque
from collections.abc import Callable

from linemate.drivers.datagrams import Address
from linemate.simulators.devices.links.robot_program import Controller
from linemate.simulators.plants.scenario import Fault

FIRST: Address = ("127.0.0.1", 50_000)
OTHER_PORT: Address = ("127.0.0.1", 50_010)
OTHER_ADDRESS: Address = ("127.0.0.2", 50_000)
SECOND: Address = ("127.0.0.1", 50_001)
SECOND_IPOC = 77_000
FORGED_AHEAD = 1000
"""Cycles by which a forged counter is ahead of the true one, if the fault does not say."""
_IPOC = re.compile(rb"(?<=<IPOC>)\d+(?=</IPOC>)")
_MOTION = (b"<AK", b"<EK")
"""How a reply's corrections begin."""

Send = Callable[[float, bytes, Address], None]
"""Sends bytes at a scenario time [s] from an address."""


class Strangers:
    """Sends what the controller itself would not, and knows what that may be answered with.

    Attributes:
        source: where the controller's own telegrams come from.
    """

    def __init__(
        self, make_second: Callable[[], Controller], cycle_s: float, ipoc_step: int
    ) -> None:
        """Begin without datagrams.

        Args:
            make_second: gives a second controller, whose robot stands still.
            ipoc_step: what a counter grows by each cycle.
        """
        self.source = FIRST
        self._make_second, self._cycle_s, self._step = make_second, cycle_s, ipoc_step
        self._second: Controller | None = None
        self._forged: deque[bytes] = deque(maxlen=64)

    def second(self, now_s: float, *, is_there: bool, send: Send) -> None:
        """Let a second controller that stands still ask for answers, or be silent."""
        if not is_there:
            self._second = None
            return
        if self._second is None:
            self._second = self._make_second()
        data = self._second.telegram()
        self._second.end_of_cycle()
        if data is not None:
            send(now_s + self._cycle_s / 3.0, data, SECOND)

    def forge(self, fault: Fault, telegram: bytes, send: Send) -> None:
        """Send copies of a telegram that count on their own, in the controller's name."""
        match = _IPOC.search(telegram)
        if match is None:
            return
        begin = int(match[0]) + (int(fault.value) or FORGED_AHEAD) * self._step
        for number in range(fault.count):
            ipoc = b"%d" % (begin + number * self._step)
            self._forged.append(ipoc)
            at_s = fault.at_s + fault.duration_s * (number + 1) / fault.count
            send(at_s, _IPOC.sub(ipoc, telegram, count=1), self.source)

    def readdress(self, fault: Fault) -> None:
        """Let the controller's telegrams come from elsewhere from now on."""
        self.source = OTHER_ADDRESS if fault.value else OTHER_PORT

    def passed(self, telegram: bytes) -> None:
        """Note a telegram of the controller's own: its counter is no longer a forged one."""
        match = _IPOC.search(telegram) if self._forged else None
        if match is not None and match[0] in self._forged:
            self._forged.remove(match[0])

    def moved_by(self, reply: bytes) -> str | None:
        """Return what is wrong with a reply that answers a forged telegram, None if nothing is."""
        match = _IPOC.search(reply) if self._forged else None
        if match is None or match[0] not in self._forged:
            return None
        if any(begin in reply for begin in _MOTION):
            return f"forged: telegram {match[0].decode()} was answered with a correction"
        return None
