"""A daemon's status in Prometheus' exposition format 0.0.4.

Invariants:
    * Pure: statuses in, text out. A number that a status does not have is left out.
    * Metric names are only added, never renamed. Their units are in the names, without prefixes.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

HEALTH: Final = ("healthy", "degraded", "fault")
STATES: Final = (
    "init", "idle", "armed", "track", "contact", "retreat", "hold", "fault", "home", "follow",
)  # fmt: skip
QUANTILES: Final = {"p50": "0.5", "p99": "0.99", "p999": "0.999", "max": "1"}
TIMES: Final = {
    "turnaround_us": "From a telegram's arrival to its reply",
    "wakeup_us": "Lateness of the sampling clock",
    "step_us": "Computing time of a step",
    "lead_us": "Time from a ready reply to its telegram",
}
# Path in a status, metric, type, help.
NUMBERS: Final = (
    ("uptime_s", "uptime_seconds", "gauge", "Since the daemon started"),
    ("steps", "steps_total", "counter", "Steps made"),
    ("prepared", "replies_prepared_total", "counter", "Replies made before their telegram"),
    ("inline", "replies_inline_total", "counter", "Replies made when their telegram came"),
    ("replies_lost", "replies_lost_total", "counter", "Replies that the controller did not get"),
    ("late", "late_total", "counter", "Deadlines missed"),
    ("missing", "missing_total", "counter", "Telegrams that did not come"),
    ("incidents", "incidents_total", "counter", "Incidents kept"),
    ("faults", "faults_total", "counter", "Internal faults in the cycle"),
    ("clock.late_wakes", "late_wakes_total", "counter", "Wakes later than a quarter cycle"),
    ("clock.relocks", "clock_relocks_total", "counter", "Losses of the phase lock to telegrams"),
    ("recording.recording", "recording", "gauge", "A recording is being written"),
    ("recording.written", "recording_steps_total", "counter", "Steps recorded"),
    ("recording.dropped", "recording_dropped_total", "counter", "Steps not recorded"),
    ("recording.restarts", "recording_restarts_total", "counter", "Restarts of the recorder"),
    ("commands.sessions", "command_sessions", "gauge", "Sessions of operators over UDP"),
    ("commands.connections", "command_connections", "gauge", "Connections to the local socket"),
)
# Maps of counts: path in a status, metric, label, help.
COUNTED: Final = (
    ("telegrams", "telegrams_total", "kind", "Telegrams by outcome"),
    ("dropped", "samples_dropped_total", "sensor", "Samples dropped by a full queue"),
    ("commands.counters", "commands_total", "event", "Requests to the command server by outcome"),
)


@dataclass(frozen=True, slots=True)
class Sample:
    """One number of a metric.

    Attributes:
        name: Metric without the prefix ``linemate_``.
        what: Help text, without its full stop.
        labels: All but the station.
        end: Of the name of this number of a summary or a histogram.
    """

    name: str
    kind: str
    what: str
    labels: tuple[tuple[str, str], ...]
    value: float
    end: str = ""


def text(stations: Mapping[str, Mapping[str, Any] | None]) -> str:
    """Return the page of several stations; None stands for one that did not answer."""
    page: dict[str, list[str]] = {}
    for station, status in stations.items():
        for sample in samples(status):
            head = f"# HELP linemate_{sample.name} {sample.what}.\n"
            head += f"# TYPE linemate_{sample.name} {sample.kind}"
            labels = (("station", station), *sample.labels)
            listed = ",".join(f'{name}="{_escaped(value)}"' for name, value in labels)
            line = f"linemate_{sample.name}{sample.end}{{{listed}}} {sample.value:.12g}"
            page.setdefault(head, []).append(line)
    return "".join(f"{head}\n" + "\n".join(lines) + "\n" for head, lines in page.items())


def samples(status: Mapping[str, Any] | None) -> Iterator[Sample]:
    """Yield the numbers of one station; None stands for one that did not answer."""
    yield Sample("up", "gauge", "The daemon answered", (), float(status is not None))
    if status is None:
        return
    yield from _one_hot("health", "Overall health, one-hot", HEALTH, status.get("health"))
    yield from _one_hot("state", "Operating state, one-hot", STATES, status.get("state"))
    complaints = float(len(status.get("complaints", ())))
    yield Sample("complaints", "gauge", "Number of complaints", (), complaints)
    waiting = float(status.get("waiting") is not None)
    yield Sample("waiting", "gauge", "The tool waits before contact for a go", (), waiting)
    for path, name, kind, what in NUMBERS:
        yield from _number(name, kind, what, (), _at(status, path))
    for path, name, label, what in COUNTED:
        for key, value in _items(_at(status, path)):
            yield from _number(name, "counter", what, ((label, key),), value)
    period_s = _scaled(_at(status, "clock.period_ms"), 1e-3)
    yield from _number("period_seconds", "gauge", "Measured cycle of the controller", (), period_s)
    drift_s = _scaled(_at(status, "dead_time.drift_ms"), 1e-3)
    what = "How much later the axes answer than identified"
    yield from _number("dead_time_drift_seconds", "gauge", what, (), drift_s)
    for path, what in TIMES.items():
        yield from _times(status, path.removesuffix("_us"), what)
    yield from _sensors(status)
    yield from _links(status)


def _times(status: Mapping[str, Any], name: str, what: str) -> Iterator[Sample]:
    """Yield a summary with the quantiles since the start, and a histogram of the same durations."""
    histogram = _at(status, f"histograms.{name}")
    count, total = _at(status, f"histograms.{name}.count"), _at(status, f"histograms.{name}.sum_s")
    summary = f"{name}_seconds"
    for key, value in _items(_at(status, f"{name}_us")):
        labels = (("quantile", QUANTILES.get(key, key)),)
        yield from _number(summary, "summary", what, labels, _scaled(value, 1e-6))
    if not isinstance(histogram, Mapping):
        return
    ends = (("_sum", total), ("_count", count))
    for end, value in ends:
        yield from _number(summary, "summary", what, (), value, end)
    family, text = f"{name}_time_seconds", f"{what}, as a histogram"
    edges = _at(status, "histograms.edges_s") or ()
    for edge, below in zip(edges, histogram.get("buckets", ()), strict=False):
        # Durations are whole nanoseconds: what is below an edge is at most 1 ns less.
        labels = (("le", f"{edge - 1e-9:.9g}"),)
        yield from _number(family, "histogram", text, labels, below, "_bucket")
    yield from _number(family, "histogram", text, (("le", "+Inf"),), count, "_bucket")
    for end, value in ends:
        yield from _number(family, "histogram", text, (), value, end)


def _sensors(status: Mapping[str, Any]) -> Iterator[Sample]:
    for name, sensor in _items(status.get("sensors")):
        label = (("sensor", name),)
        excluded = float(sensor.get("out") is not None)
        yield Sample("sensor_out", "gauge", "The sensor is excluded", label, excluded)
        refused, what = sensor.get("refused"), "Samples rejected by the innovation gate"
        yield from _number("sensor_refused_total", "counter", what, label, refused)


def _links(status: Mapping[str, Any]) -> Iterator[Sample]:
    for name, link in _items(status.get("links")):
        label = (("link", name),)
        yield from _number("link_up", "gauge", "The link is open", label, link.get("up"))
        rate, age = link.get("rate_hz"), link.get("age_s")
        yield from _number("link_rate_hertz", "gauge", "Samples or telegrams a second", label, rate)
        yield from _number("link_age_seconds", "gauge", "Age of the newest sample", label, age)
        for event, count in _items(link.get("counters")):
            labels = (*label, ("event", event))
            what = "Samples or telegrams of the link by outcome"
            yield from _number("link_events_total", "counter", what, labels, count)


def _one_hot(name: str, what: str, values: Iterable[str], now: object) -> Iterator[Sample]:
    for value in values:
        yield Sample(name, "gauge", what, ((name, value),), float(value == now))


def _number(
    name: str,
    kind: str,
    what: str,
    labels: tuple[tuple[str, str], ...],
    value: object,
    end: str = "",
) -> Iterator[Sample]:
    if isinstance(value, bool | int | float) and math.isfinite(value):
        yield Sample(name, kind, what, labels, float(value), end)


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
