"""What a bridge tells of a station: keys, messages, and what has changed since.

Law of this file: pure; what a daemon answered in, plain values out. Messages are maps of a version,
the station, the time, and what the daemon said, unchanged.
"""

from collections.abc import Iterator, Mapping
from typing import Any, Final

from linemate.daemon.operator import render

VERSION: Final = 1
PREFIX: Final = "linemate"
ASKABLE: Final = ("status", "params", "get")
"""What can be asked through a bridge: nothing that changes anything."""

PARAMETERS: Final = ("prefix", "names")
"""What a query may have with it."""

WATCHED: Final = ("state", "health", "because", "task")


def key(station: str, *parts: str) -> str:
    """Return a station's key."""
    return "/".join((PREFIX, station, *parts))


def message(station: str, time_s: float, data: Mapping[str, Any]) -> bytes:
    """Return a message as JSON.

    Args:
        time_s: wall clock of the bridge [s].
        data: what the daemon said.
    """
    told = {"version": VERSION, "station": station, "time_s": round(time_s, 3), "data": data}
    return render.as_json(told, indent=None).encode()


def event(what: str, before: object, after: object) -> dict[str, Any]:
    """Return one change."""
    return {"what": what, "from": before, "to": after}


def changes(
    before: Mapping[str, Any] | None, after: Mapping[str, Any] | None
) -> Iterator[dict[str, Any]]:
    """Return what has changed between two statuses.

    Args:
        before: None for a daemon that did not answer.
    """
    if (before is None) != (after is None):
        yield event("answers", before is not None, after is not None)
    if before is None or after is None:
        return
    for name in WATCHED:
        if before.get(name) != after.get(name):
            yield event(name, before.get(name), after.get(name))
    known, now = _links(before), _links(after)
    for link in sorted(known.keys() | now.keys()):
        if known.get(link) != now.get(link):
            yield event(f"link {link}", known.get(link), now.get(link))
    for sensor, out in _out(after).items():
        if _out(before).get(sensor) != out:
            yield event(f"sensor {sensor} out", _out(before).get(sensor), out)
    gone, come = _complaints(before), _complaints(after)
    for complaint in sorted(come - gone):
        yield event("complaint", None, complaint)
    for complaint in sorted(gone - come):
        yield event("complaint", complaint, None)


def _links(status: Mapping[str, Any]) -> dict[str, str]:
    """Each link with whether it is up; ages and rates change all the time and are no events."""
    links = status.get("links")
    told = links.items() if isinstance(links, Mapping) else ()
    return {str(name): "up" if link.get("up") else "down" for name, link in told}


def _out(status: Mapping[str, Any]) -> dict[str, Any]:
    """Each sensor with why it is not believed."""
    sensors = status.get("sensors")
    told = sensors.items() if isinstance(sensors, Mapping) else ()
    return {str(name): sensor.get("out") for name, sensor in told}


def _complaints(status: Mapping[str, Any]) -> set[str]:
    return {str(complaint) for complaint in status.get("complaints") or ()}


def asked(op: str, parameters: Mapping[str, str]) -> dict[str, Any]:
    """Return a daemon's parameters of an operation from those of a query.

    Args:
        parameters: ``prefix`` of params; ``names`` of get, separated by commas.

    Raises:
        ValueError: what is missing.
    """
    if op == "params":
        prefix = parameters.get("prefix", "")
        return {"prefix": prefix} if prefix else {}
    if op == "get":
        names = [name for name in parameters.get("names", "").split(",") if name]
        if not names:
            raise ValueError("names is missing, as in ?names=a,b")
        return {"names": names}
    return {}
