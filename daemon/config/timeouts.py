"""Check that the time-outs of a configuration can act in their order.

Invariants:
- Values of the wrong kind are passed over. ``documents.fill`` refuses them.
"""

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from linemate.daemon.config.documents import Complaint
from linemate.daemon.config.settings import EgmSettings, RsiSettings
from linemate.daemon.config.watch_settings import WatchSettings, timeout_error

_KNOWN = frozenset(field.name for field in fields(WatchSettings))
_NUMBERS = (int, float)
_CYCLES_MS = {"rsi": RsiSettings().cycle_ms, "egm": EgmSettings().cycle_ms}


def complaints(value: Any) -> Iterator[Complaint]:
    """Return the time-out that can never act.

    Args:
        value: plain values of a configuration file, with its overlays.
    """
    whole = value if isinstance(value, dict) else {}
    own, kind = _section(whole, "watch"), _section(whole, "controller").get("kind", "rsi")
    link = _section(whole, kind) if isinstance(kind, str) else {}
    given = {name: number for name, number in own.items() if name in _KNOWN}
    cycle_ms = link.get("cycle_ms", _CYCLES_MS["egm" if kind == "egm" else "rsi"])
    if any(type(number) not in _NUMBERS for number in (*given.values(), cycle_ms)):
        return
    error = timeout_error(WatchSettings(**given), 1e-3 * cycle_ms)
    if error is not None:
        name, what = error
        yield Complaint(("watch", name), what)


def _section(whole: dict[str, Any], name: str) -> dict[str, Any]:
    section = whole.get(name)
    return section if isinstance(section, dict) else {}
