"""What a daemon's status says, as Prometheus reads it.

Law of this file: pure; statuses in, text of the exposition format 0.0.4 out. A number that a status
does not have is left out, never made up. Names only ever come to it; units are in the names.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

HEALTH: Final = ("healthy", "degraded", "fault")
STATES: Final = ("init", "idle", "armed", "track", "contact", "retreat", "hold", "fault")
QUANTILES: Final = {"p50": "0.5", "p99": "0.99", "p999": "0.999", "max": "1"}
TIMES: Final = {
    "turnaround_us": "From a telegram's arrival to its reply",
    "wakeup_us": "By how much the clock woke late",
    "step_us": "Computing time of a step",
    "lead_us": "How long before its telegram a reply was ready",
}
NUMBERS: Final = (
    ("uptime_s", "uptime_seconds", "gauge", "Since the daemon started"),
    ("steps", "steps_total", "counter", "Steps made"),
    ("prepared", "replies_prepared_total", "counter", "Replies made before their telegram"),
    ("inline", "replies_inline_total", "counter", "Replies made when their telegram came"),
    ("replies_lost", "replies_lost_total", "counter", "Replies that the controller did not get"),
    ("late", "late_total", "counter", "Deadlines missed"),
    ("missing", "missing_total", "counter", "Telegrams that did not come"),
    ("incidents", "incidents_total", "counter", "Incidents kept"),
    ("faults", "faults_total", "counter", "Faults of the daemon's own in its cycle"),
    ("clock.late_wakes", "late_wakes_total", "counter", "Wakes later than a quarter cycle"),
    ("clock.relocks", "clock_relocks_total", "counter", "Times the clock lost the telegrams"),
    ("clock.period_ms", "period_milliseconds", "gauge", "Measured cycle of the controller"),
    ("recording.recording", "recording", "gauge", "A recording is being written"),
    ("recording.written", "recording_steps_total", "counter", "Steps recorded"),
    ("recording.dropped", "recording_dropped_total", "counter", "Steps not recorded"),
    ("recording.restarts", "recording_restarts_total", "counter", "Starts of a killed recorder"),
    ("commands.sessions", "command_sessions", "gauge", "Sessions of operators over UDP"),
    ("commands.connections", "command_connections", "gauge", "Connections to the local socket"),
)
"""Where in a status, the metric's name, its type and its help."""

COUNTED: Final = (
    ("telegrams", "telegrams_total", "kind", "Telegrams by what became of them"),
    ("dropped", "samples_dropped_total", "sensor", "Samples that found no room"),
    ("commands.counters", "commands_total", "event", "What came to the command port"),
)
"""Maps of counts: where, the metric's name, its label and its help."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One number.

    Attributes:
        name: of its metric, without the prefix.
    """

    name: str
    kind: str
    what: str
    labels: tuple[tuple[str, str], ...]
    value: float


def text(stations: Mapping[str, Mapping[str, Any] | None]) -> str:
    """Return the page.

    Args:
        stations: each one's status, None where nobody answered.
    """
    found: dict[str, list[str]] = {}
    for station, status in stations.items():
        for sample in samples(status):
            head = f"# HELP linemate_{sample.name} {sample.what}.\n"
            head += f"# TYPE linemate_{sample.name} {sample.kind}"
            labels = (("station", station), *sample.labels)
            listed = ",".join(f'{name}="{_escaped(value)}"' for name, value in labels)
            line = f"linemate_{sample.name}{{{listed}}} {sample.value:.12g}"
            found.setdefault(head, []).append(line)
    return "".join(f"{head}\n" + "\n".join(lines) + "\n" for head, lines in found.items())


def samples(status: Mapping[str, Any] | None) -> Iterator[Sample]:
    """Return the numbers of one station.

    Args:
        status: None where nobody answered.
    """
    yield Sample("up", "gauge", "The daemon answered", (), float(status is not None))
    if status is None:
        return
    yield from _one_of("health", "What the daemon thinks of itself", HEALTH, status.get("health"))
    yield from _one_of("state", "Operating state", STATES, status.get("state"))
    complaints = float(len(status.get("complaints", ())))
    yield Sample("complaints", "gauge", "What the daemon complains of", (), complaints)
    for path, name, kind, what in NUMBERS:
        yield from _number(name, kind, what, (), _at(status, path))
    for path, name, label, what in COUNTED:
        for key, value in _items(_at(status, path)):
            yield from _number(name, "counter", what, ((label, key),), value)
    for path, what in TIMES.items():
        name = path.removesuffix("_us") + "_seconds"
        for key, value in _items(_at(status, path)):
            labels = (("quantile", QUANTILES.get(key, key)),)
            yield from _number(name, "gauge", what, labels, _scaled(value, 1e-6))
    yield from _sensors(status)
    yield from _links(status)


def _sensors(status: Mapping[str, Any]) -> Iterator[Sample]:
    for sensor, told in _items(status.get("sensors")):
        label = (("sensor", sensor),)
        out = float(told.get("out") is not None)
        yield Sample("sensor_out", "gauge", "The sensor is not believed", label, out)
        refused, what = told.get("refused"), "Samples that were not believed"
        yield from _number("sensor_refused_total", "counter", what, label, refused)


def _links(status: Mapping[str, Any]) -> Iterator[Sample]:
    for link, told in _items(status.get("links")):
        label = (("link", link),)
        yield from _number("link_up", "gauge", "The link is open", label, told.get("up"))
        rate = told.get("rate_hz")
        yield from _number("link_rate_hertz", "gauge", "Samples or telegrams a second", label, rate)
        age = told.get("age_s")
        yield from _number("link_age_seconds", "gauge", "Age of the newest sample", label, age)
        for event, count in _items(told.get("counters")):
            labels = (*label, ("event", event))
            what = "What came over the link, and what became of it"
            yield from _number("link_events_total", "counter", what, labels, count)


def _one_of(name: str, what: str, all_of: Iterable[str], now: object) -> Iterator[Sample]:
    for one in all_of:
        yield Sample(name, "gauge", what, ((name, one),), float(one == now))


def _number(
    name: str, kind: str, what: str, labels: tuple[tuple[str, str], ...], value: object
) -> Iterator[Sample]:
    if isinstance(value, bool | int | float) and math.isfinite(value):
        yield Sample(name, kind, what, labels, float(value))


def _scaled(value: object, factor: float) -> object:
    return value * factor if isinstance(value, int | float) else None


def _at(status: Mapping[str, Any], path: str) -> Any:
    value: Any = status
    for part in path.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def _items(value: object) -> Iterable[tuple[str, Any]]:
    return value.items() if isinstance(value, Mapping) else ()


def _escaped(value: str) -> str:
    return str(value).replace("\\", "\\\\").replace("\n", "\\n").replace('"', '\\"')
