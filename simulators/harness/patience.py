"""How many telegrams a daemon on an ordinary host may miss.

Law of this file: counts that last as long as the daemon's own do at 12 ms. Those are for a host
that loses a telegram now and then; one that is held up by whatever else it does loses time. 20 ms
are two telegrams at 12 ms and five at 4 ms, and as far for the car either way.
"""

from linemate.daemon.service.watch import WatchSettings

LONG_CYCLE_S = 0.012
MISSES = ("missed", "missed_in_contact", "leak_limit")


def patience(cycle_s: float) -> dict[str, int]:
    """What a configuration's ``watch`` should say for a controller's cycle [s]."""
    times = max(1, round(LONG_CYCLE_S / cycle_s))
    return {name: times * getattr(WatchSettings(), name) for name in MISSES}
