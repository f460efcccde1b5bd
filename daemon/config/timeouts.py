"""Check that the time-outs of a configuration can act in their order.

Invariants:
- Values of the wrong kind are passed over. ``documents.fill`` refuses them.
"""

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from linemate.daemon.config.reading.complaints import Complaint
from linemate.daemon.config.settings import ControllerKind, EgmSettings, FanucSettings, RsiSettings
from linemate.daemon.config.watch_settings import WatchSettings, timeout_error

_KNOWN = frozenset(field.name for field in fields(WatchSettings))
_NUMBERS = (int, float)
_CYCLES_MS: dict[str, int] = {
    ControllerKind.RSI: RsiSettings().cycle_ms,
    ControllerKind.EGM: EgmSettings().cycle_ms,
    ControllerKind.FANUC: FanucSettings().cycle_ms,
}


def complaints(value: Any) -> Iterator[Complaint]:
    """Return the time-out that can never act.

    Args:
        value: plain values of a configuration file, with its overlays.
    """
    whole = value if isinstance(value, dict) else {}
    own = _section(whole, "watch")
    given = {name: number for name, number in own.items() if name in _KNOWN and number is not None}
    period_ms = cycle_ms(whole)
    if any(type(number) not in _NUMBERS for number in (*given.values(), period_ms)):
        return
    error = timeout_error(WatchSettings(**given), 1e-3 * period_ms)
    if error is not None:
        name, what = error
        yield Complaint(("watch", name), what)


def cycle_ms(whole: dict[str, Any]) -> Any:
    """Return the period in the section of the controller's family [ms], as it is written.

    Args:
        whole: plain values of a configuration file.
    """
    kind = str(_section(whole, "controller").get("kind", ControllerKind.RSI))
    written = _section(whole, kind).get("cycle_ms")
    return _CYCLES_MS.get(kind, _CYCLES_MS[ControllerKind.RSI]) if written is None else written


def _section(whole: dict[str, Any], name: str) -> dict[str, Any]:
    section = whole.get(name)
    return section if isinstance(section, dict) else {}
