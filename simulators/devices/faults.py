"""A scenario's timed faults: which are in force, which strike now.

Law of this file: pure; scenario time is an argument. The list is checked when it is read, so that
a misspelt fault is an error at the start and not a run without its fault.
"""

from collections.abc import Iterable, Iterator

from linemate.simulators.plants.scenario import Fault

KINDS: dict[str, tuple[str, ...]] = {
    "robot": ("silence", "deafness", "garbage"),
    "distance": ("silence", "delay", "garbage", "unplug"),
    "camera": ("silence", "delay", "garbage"),
    "force_torque": ("silence", "delay", "garbage", "unplug"),
}
"""What can happen to each link.

``silence``: nothing is sent for ``duration_s``. ``deafness``: replies are lost for ``duration_s``.
``delay``: what is sent within ``duration_s`` leaves ``value`` seconds later. ``garbage``: ``count``
pieces of junk of ``value`` bytes (64 if 0). ``unplug``: the port is gone for ``duration_s``.
"""

STRIKING = ("garbage", "unplug")
GARBAGE_BYTES = 64


class Faults:
    """The faults of one run."""

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        """Check the list.

        Args:
            faults: of a scenario.

        Raises:
            ValueError: a link or kind that there is not.
        """
        self._faults = tuple(sorted(faults, key=lambda fault: fault.at_s))
        self._struck = 0
        self._strikes = [fault for fault in self._faults if fault.kind in STRIKING]
        for fault in self._faults:
            _check(fault)

    def in_force(self, link: str, kind: str, time_s: float) -> Fault | None:
        """The fault of a kind that a link suffers at a time.

        Args:
            link: one of ``KINDS``.
            kind: one of its kinds.
            time_s: scenario time [s].

        Returns:
            The fault, None if there is none.
        """
        for fault in self._faults:
            if fault.at_s > time_s:
                return None
            if (fault.link, fault.kind) == (link, kind) and time_s < fault.at_s + fault.duration_s:
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


def _check(fault: Fault) -> None:
    kinds = KINDS.get(fault.link)
    if kinds is None:
        raise ValueError(f"fault at {fault.at_s} s: no link {fault.link!r}; {', '.join(KINDS)}")
    if fault.kind not in kinds:
        raise ValueError(
            f"fault at {fault.at_s} s: {fault.link} has no {fault.kind!r}; {', '.join(kinds)}"
        )
