"""Status in full, and telemetry that fits into a datagram: plain values with stable keys.

``health`` is the overall judgement; ``complaints`` gives its reasons.
"""

import math
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from linemate.daemon.core.tracking.classifiers.distance.measured_noise import (
    AS_CONFIGURED,
    LEAST_NIS,
    MeasuredNoise,
)
from linemate.daemon.core.tracking.touch import tare
from linemate.daemon.cycle.clock.timer import CycleTimer
from linemate.daemon.cycle.clock.timing import Timing
from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.cycle.states import State
from linemate.daemon.cycle.watch import IN_CONTACT
from linemate.daemon.recording.format import SHOWN_OUTPUTS
from linemate.daemon.recording.recorder import RecorderStatus
from linemate.drivers.datagrams import Address
from linemate.drivers.link import LinkStatus

VERSION = 1
STALE_S = 1.0
RATED = {"robot": "answered"}  # counter of a link's rate, if not ``samples``
COVERED_M = 0.05  # distance of tool and part below which the tool covers the camera [m]

LAGS_S = 0.01  # of a robot more than identified, from which it is a complaint [s]

_CAMERA = frozenset({"camera"})


@dataclass(frozen=True, slots=True)
class LinkView:
    """A link's status, where it listens, and samples (or telegrams) a second."""

    status: LinkStatus
    address: Address | None
    rate_hz: float | None = None


@dataclass(slots=True)
class Rates:
    """Samples or telegrams a second of each link."""

    _counts: dict[str, int] = field(default_factory=dict)
    _rates: dict[str, float] = field(default_factory=dict)
    _updated_ns: int | None = None

    def update(self, links: Iterable[LinkStatus], now_ns: int) -> None:
        """Compute the rates since the last call."""
        counts = {link.name: link.counters[RATED.get(link.name, "samples")] for link in links}
        if self._updated_ns is not None and now_ns > self._updated_ns:
            span_s = (now_ns - self._updated_ns) / 1e9
            self._rates = {
                name: round((count - self._counts.get(name, 0)) / span_s, 2)
                for name, count in counts.items()
            }
        self._counts, self._updated_ns = counts, now_ns

    def of(self, name: str) -> float | None:
        """Return the rate of a link [Hz], None in the first second."""
        return self._rates.get(name)


@dataclass(frozen=True, slots=True)
class DaemonSnapshot:
    """Inputs of a status."""

    task: str
    now_ns: int
    began_ns: int
    cycle: Cycle
    links: tuple[LinkView, ...]
    timer: CycleTimer
    timing: Timing
    recorder: RecorderStatus | None
    commands: Mapping[str, Any]
    refusals: tuple[str, ...]
    counters: Mapping[str, int]


def status(snapshot: DaemonSnapshot) -> dict[str, Any]:
    """Return the whole status."""
    cycle = snapshot.cycle.status()
    links = {view.status.name: _link(view, snapshot.now_ns) for view in snapshot.links}
    complaints = tuple(_complaints(snapshot, cycle, links))
    faulty = snapshot.cycle.machine.state is State.FAULT or snapshot.cycle.machine.latched
    lock, lateness = snapshot.timer.lock, snapshot.timer.lateness
    measured_ns = lock.estimate.measured_ns
    return {
        "version": VERSION,
        "health": "fault" if faulty else "degraded" if complaints else "healthy",
        "complaints": complaints,
        "task": snapshot.task,
        "pid": os.getpid(),
        "uptime_s": round((snapshot.now_ns - snapshot.began_ns) / 1e9, 3),
        **cycle,
        "links": links,
        **snapshot.timing.summary(),
        "clock": {
            "locked": lock.is_locked,
            "period_ms": None if measured_ns is None else round(measured_ns * 1e-6, 5),
            "lead_ms": round(lock.lead_ns * 1e-6, 4),
            "relocks": lock.estimate.relocks,
            "skipped": lock.skipped,
            "wakes": lateness.wakes,
            "late_wakes": lateness.late,
            "worst_us": round(lateness.worst_ns / 1e3, 1),
        },
        "dead_time": dead_time(snapshot.cycle),
        "recording": None if snapshot.recorder is None else asdict(snapshot.recorder),
        "commands": dict(snapshot.commands),
        "host": snapshot.refusals,
        "faults": snapshot.counters.get("faults", 0),
    }


def dead_time(cycle: Cycle) -> dict[str, float] | None:
    """Return the drift of the dead times and its bounds [ms]; None if they are fixed or unknown."""
    model, last = cycle.parameters.controller.drift, cycle.last
    state = None if last is None or last.after is None else last.after.control.drift
    if model is None or state is None:
        return None
    least, most = model.bounds
    shown = {"drift_ms": state.drift, "least_ms": least, "most_ms": most}
    return {name: round(seconds * 1e3, 3) for name, seconds in shown.items()}


def _lag(cycle: Cycle) -> float:
    """Return by how much longer the robot's lag is than its servo models' [s]."""
    last = cycle.last
    return 0.0 if last is None or last.after is None else last.after.tracker.lead


def _distance_noise(cycle: Cycle) -> MeasuredNoise:
    """Return the distance sensor's noise as its readings show it."""
    last = cycle.last
    if last is None or last.after is None:
        return AS_CONFIGURED
    return last.after.tracker.distance_noise


def _weights(cycle: Cycle) -> tuple[float, float] | None:
    """Return the payload's weight by the sensor, and as known [N]; None if nothing shows it."""
    last = cycle.last
    if last is None or last.after is None:
        return None
    return tare.shown_weight(last.after.tracker.tare, cycle.parameters.tracker.settings.tactile)


def _is_at_a_bound(drift_ms: float, least_ms: float, most_ms: float) -> bool:
    """Return whether a drift may be larger than followed. One that may only grow begins at 0."""
    return drift_ms >= most_ms or (least_ms < 0.0 and drift_ms <= least_ms)


def covered(cycle: Cycle) -> frozenset[str]:
    """Return the sensors that the tool covers: the camera, near the part."""
    if cycle.machine.state in IN_CONTACT:
        return _CAMERA
    part = None if cycle.last is None else cycle.last.outputs.part
    if cycle.last is None or part is None:
        return frozenset()
    is_near = math.dist(cycle.last.outputs.target[:3], part[:3]) < COVERED_M
    return _CAMERA if is_near else frozenset()


def telemetry(cycle: Cycle) -> dict[str, Any]:
    """Return what subscribers get, at most 50 times a second."""
    shown: dict[str, Any] = {"state": cycle.machine.state.value, "k": cycle.steps}
    if cycle.last is not None:
        outputs = cycle.last.outputs
        shown["stamp_ns"] = outputs.stamp_ns
        shown |= {name: getattr(outputs, name) for name in SHOWN_OUTPUTS}
    return shown


def _link(view: LinkView, now_ns: int) -> dict[str, Any]:
    link = view.status
    newest_ns = link.last_sample_stamp_ns
    return {
        "up": link.up,
        "rate_hz": view.rate_hz,
        "since_s": round((now_ns - link.since_ns) / 1e9, 3),
        "age_s": None if newest_ns is None else round((now_ns - newest_ns) / 1e9, 4),
        "reason": link.reason,
        "address": view.address,
        "counters": dict(link.counters),
    }


def _complaints(
    snapshot: DaemonSnapshot, cycle: Mapping[str, Any], links: Mapping[str, Mapping[str, Any]]
) -> Iterator[str]:
    machine = snapshot.cycle.machine
    if machine.state is State.FAULT:
        yield f"fault: {snapshot.cycle.operating.cause}"
    hidden = covered(snapshot.cycle)
    for name, link in links.items():
        if not link["up"]:
            yield f"link {name} is down: {link['reason']}"
        elif name in hidden:
            continue
        elif link["age_s"] is None or link["age_s"] > STALE_S:
            yield f"link {name} is silent" + (link["reason"] and f": {link['reason']}")
    if cycle["link"] != "healthy" and links["robot"]["up"]:
        unproven = cycle["correction"]["unproven"]
        yield f"the robot link is {cycle['link']}" + (f": {unproven}" if unproven else "")
    refusal = snapshot.timer.lock.estimate.refusal
    if refusal:
        yield refusal
    drift = dead_time(snapshot.cycle)
    if drift is not None and _is_at_a_bound(**drift):
        yield (
            f"the dead time has drifted by {drift['drift_ms']} ms, limit {drift['least_ms']} to "
            f"{drift['most_ms']} ms. Identify the servos again, or widen control.drift."
        )
    yield from _differences(snapshot.cycle)
    if snapshot.recorder is not None and snapshot.recorder.failure:
        yield f"recording ended: {snapshot.recorder.failure}"
    if snapshot.counters.get("faults"):
        yield f"{snapshot.counters['faults']} faults in the cycle, see the log"


def _differences(cycle: Cycle) -> Iterator[str]:
    """Return what differs from the configuration, as the sensors show it."""
    lag_s = _lag(cycle)
    if abs(lag_s) > LAGS_S:
        kind = "more" if lag_s > 0.0 else "less"
        lag = f"{1e3 * abs(lag_s):.0f} ms {kind}"
        yield f"the robot lags by {lag} than its servo models: identify the servos"
    weights = _weights(cycle)
    if weights is not None and tare.is_misjudged(*weights):
        yield (
            f"the tool's payload weighs {weights[0]:.0f} N by the force-torque sensor, "
            f"{weights[1]:.0f} N by tracking.payload.mass. Weigh it, or zero the sensor without it."
        )
    noise = _distance_noise(cycle)
    if noise.inflation > 1.0:
        factor, limit = math.sqrt(noise.nis), math.sqrt(LEAST_NIS)
        yield (
            f"distance sensor noisier than configured: factor {factor:.1f}, limit {limit:.1f}. "
            "Identify tracking.distance.deviation, or check the sensor."
        )
