"""Timed faults of a scenario: kinds, active intervals, single events.

``faulty_link`` applies faults to bytes, ``faulty_sensor`` to readings.

Invariants:
    Pure: scenario time is an argument.
    An unknown fault is an error when the list is read.
"""

from collections.abc import Iterable, Iterator, Mapping

from linemate.simulators.plants.scenario import Fault

MEANINGS: dict[str, str] = {
    "silence": "nothing gets through for duration_s",
    "deafness": "replies are lost for duration_s",
    "garbage": "count pieces of junk of value bytes (64 if 0) arrive at once",
    "unplug": "the port is gone for duration_s",
    "loss": "each piece is lost with probability value",
    "delay": "each piece comes value seconds later",
    "jitter": "each piece comes later by an exponential time of mean value seconds",
    "duplicate": "each piece comes twice with probability value",
    "reorder": "each piece is overtaken by the next one with probability value",
    "flip": "count bits of a piece are flipped with probability value",
    "truncate": "a piece is cut somewhere with probability value",
    "stuck": "the reading stays as it was when the fault began",
    "scale": "the reading is multiplied by value: a wrong unit or sign",
    "offset": "value is added to component number count of the reading (0: to all) [m or N]",
    "drift": "the same, growing by value a second",
    "nan": "with probability value a component is NaN, infinite, huge, denormal or -0",
    "clock_step": "the sensor's clock is value seconds ahead",
    "clock_rate": "the sensor's clock gains value seconds a second",
    "clock_frozen": "the sensor's clock stands",
    "ipoc_flip": "one bit of the telegram's counter is flipped with probability value",
    "restart": "the program ends and starts again duration_s later, from where the robot stands",
    "second": "another controller sends telegrams of its own for duration_s",
    "drives_off": "the axes stand braked for duration_s, then the program starts again",
    "ipoc_jump": "the counter goes on value cycles further on, or from 0 if value is 0; no restart",
    "readdress": "telegrams come from another port for good, or another address if value is 1",
    "forged": "count telegrams in the controller's name, a counter of their own, within duration_s",
    "unreadable": "with probability value one value of a telegram is no number",
    "exponent": "with probability value a telegram's numbers are written with exponents",
    "frame": "the pose is given in a frame that is turned by 90 degrees",
    "flipped": "the quaternion is the inverse one",
    "stall": "the daemon does nothing for duration_s",
    "pause": "the daemon's machine stands for duration_s, its clocks and all its processes",
    "set": "an operator sets harmless parameters, the count-th of a list",
    "wall_step": "the host's wall clock is stepped by value seconds",
    "crash": "the daemon ends and starts again duration_s later",
    "arm": "an operator's order",
    "start": "an operator's order",
    "stop": "an operator's order",
    "retreat": "an operator's order",
    "ack": "an operator's order",
}
"""What each kind does, and what ``value``, ``count`` and ``duration_s`` are to it."""

REAL: dict[str, tuple[str, ...]] = {
    "robot": ("silence", "deafness", "garbage"),
    "distance": ("silence", "delay", "garbage", "unplug"),
    "camera": ("silence", "delay", "garbage"),
    "force_torque": ("silence", "delay", "garbage", "unplug"),
}
"""What the emulators can do on real links."""

_PIECES = ("loss", "jitter", "duplicate", "flip", "truncate")
_READINGS = ("stuck", "scale", "offset", "drift")
_CLOCKS = ("clock_step", "clock_rate", "clock_frozen")

KINDS: dict[str, tuple[str, ...]] = {
    "robot": (
        *REAL["robot"],
        *_PIECES,
        "delay",
        "reorder",
        "ipoc_flip",
        "restart",
        "second",
        "drives_off",
        "ipoc_jump",
        "readdress",
        "forged",
        "unreadable",
        "exponent",
    ),
    "reply": ("silence", "loss", "delay", "jitter", "duplicate", "reorder", "truncate"),
    "distance": (*REAL["distance"], *_PIECES, *_READINGS),
    "camera": (
        *REAL["camera"],
        *_PIECES,
        "reorder",
        *_READINGS,
        "nan",
        *_CLOCKS,
        "frame",
        "flipped",
    ),
    "force_torque": (*REAL["force_torque"], *_PIECES, *_READINGS, "nan", *_CLOCKS),
    "daemon": ("stall", "crash", "wall_step", "pause"),
    "operator": ("arm", "start", "stop", "retreat", "ack", "set"),
}
"""What can happen to each link in virtual time. ``robot`` is the telegrams' way to the daemon,
``reply`` the way back. A reply has no ``flip``: a wrong digit in a well-formed reply is a command,
and only UDP's checksum detects it."""

STRIKING = frozenset(
    {
        "garbage",
        "unplug",
        "restart",
        "drives_off",
        "crash",
        "wall_step",
        "pause",
        "ipoc_jump",
        "readdress",
        "forged",
        *KINDS["operator"],
    }
)
GARBAGE_BYTES = 64


class Faults:
    """The faults of one run."""

    def __init__(
        self, faults: Iterable[Fault] = (), kinds: Mapping[str, tuple[str, ...]] = KINDS
    ) -> None:
        """Check the list.

        Args:
            kinds: what there is; ``REAL`` refuses what only virtual time can do.

        Raises:
            ValueError: a link or kind that there is not.
        """
        self._faults = tuple(sorted(faults, key=lambda fault: fault.at_s))
        self._struck = 0
        self._strikes = [fault for fault in self._faults if fault.kind in STRIKING]
        for fault in self._faults:
            _check(fault, kinds)

    def of(self, link: str) -> tuple[Fault, ...]:
        """All faults of a link, in the order of their beginning."""
        return tuple(fault for fault in self._faults if fault.link == link)

    def in_force(self, link: str, kind: str, time_s: float) -> Fault | None:
        """The fault of a kind that a link suffers at a time.

        Returns:
            The fault, None if there is none.
        """
        for fault in self._faults:
            if fault.at_s > time_s:
                return None
            if (fault.link, fault.kind) == (link, kind) and holds(fault, time_s):
                return fault
        return None

    def strike(self, time_s: float) -> Iterator[Fault]:
        """Faults that strike at an instant, each once.

        Args:
            time_s: scenario time reached [s].

        Yields:
            Faults whose time has come since the last call.
        """
        while self._struck < len(self._strikes) and self._strikes[self._struck].at_s <= time_s:
            self._struck += 1
            yield self._strikes[self._struck - 1]


def holds(fault: Fault, time_s: float) -> bool:
    """Whether a fault is in force at a scenario time [s]."""
    return fault.at_s <= time_s < fault.at_s + fault.duration_s


def _check(fault: Fault, kinds: Mapping[str, tuple[str, ...]]) -> None:
    known = kinds.get(fault.link)
    if known is None:
        raise ValueError(f"fault at {fault.at_s} s: no link {fault.link!r}; {', '.join(kinds)}")
    if fault.kind not in known:
        raise ValueError(
            f"fault at {fault.at_s} s: {fault.link} has no {fault.kind!r}; {', '.join(known)}"
        )
