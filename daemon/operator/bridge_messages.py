"""Keys and messages of the zenoh bridge, and the events between two statuses.

Invariants:
    * Pure: a daemon's answers in, plain values out.
    * A message is a map of version, station, time and the daemon's answer, which is unchanged.
"""

from collections.abc import Iterator, Mapping
from typing import Any, Final

from linemate.daemon.operator import render

VERSION: Final = 1
PREFIX: Final = "linemate"
ASKABLE: Final = ("status", "params", "get")  # operations that change nothing
PARAMETERS: Final = ("prefix", "names")  # of a query
WATCHED: Final = ("state", "health", "because", "task")

Status = Mapping[str, Any]


def key(station: str, *parts: str) -> str:
    """Return a station's key."""
    return "/".join((PREFIX, station, *parts))


def message(station: str, time_s: float, data: Status) -> bytes:
    """Return a daemon's answer as a JSON message.

    Args:
        station: Its name in the keys.
        time_s: System time of the bridge [s].
        data: The answer, or an event.
    """
    whole = {"version": VERSION, "station": station, "time_s": round(time_s, 3), "data": data}
    return render.as_json(whole, indent=None).encode()


def event(what: str, before: object, after: object) -> dict[str, Any]:
    """Return one change."""
    return {"what": what, "from": before, "to": after}


def changes(before: Status | None, after: Status | None) -> Iterator[dict[str, Any]]:
    """Yield the events between two statuses; None stands for a daemon that did not answer."""
    if (before is None) != (after is None):
        yield event("answers", before is not None, after is not None)
    if before is None or after is None:
        return
    for name in WATCHED:
        if before.get(name) != after.get(name):
            yield event(name, before.get(name), after.get(name))
    links_before, links = _links(before), _links(after)
    for link in sorted(links_before.keys() | links.keys()):
        if links_before.get(link) != links.get(link):
            yield event(f"link {link}", links_before.get(link), links.get(link))
    excluded_before = _excluded(before)
    for sensor, reason in _excluded(after).items():
        if excluded_before.get(sensor) != reason:
            yield event(f"sensor {sensor} out", excluded_before.get(sensor), reason)
    complaints_before, complaints = _complaints(before), _complaints(after)
    for complaint in sorted(complaints - complaints_before):
        yield event("complaint", None, complaint)
    for complaint in sorted(complaints_before - complaints):
        yield event("complaint", complaint, None)


def _links(status: Status) -> dict[str, str]:
    """Return whether each link is up. Ages and rates change all the time and are no events."""
    links = status.get("links")
    items = links.items() if isinstance(links, Mapping) else ()
    return {str(name): "up" if link.get("up") else "down" for name, link in items}


def _excluded(status: Status) -> dict[str, Any]:
    """Return why each sensor is excluded, None for one that is not."""
    sensors = status.get("sensors")
    items = sensors.items() if isinstance(sensors, Mapping) else ()
    return {str(name): sensor.get("out") for name, sensor in items}


def _complaints(status: Status) -> set[str]:
    return {str(complaint) for complaint in status.get("complaints") or ()}


def request(op: str, parameters: Mapping[str, str]) -> dict[str, Any]:
    """Return the parameters of a daemon's operation from those of a query.

    Args:
        parameters: ``prefix`` of params; ``names`` of get, separated by commas.

    Raises:
        ValueError: A parameter is missing.
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
