"""Judge a run: truth, daemon columns and controller counts give ``result.json``.

Errors: control (tcp - x_c), plan (x_c - x_f), prediction (x_f - truth) and total (tcp - truth).
Truth is the true hub at the programmed distance from tool to hub.

Invariants:
    Pure.
    Errors are against the emulator's truth; telegrams and limits are as the controller
        counted.
    Of the daemon only target, sensed and programmed pose are used.
"""

from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from linemate.simulators.devices.limit_judge import LIMITS, AxisLimit
from linemate.simulators.judge import poses
from linemate.simulators.judge.contact_figures import contact_figures
from linemate.simulators.judge.rows import (
    CLAMPED,
    FREE,
    PHASES,
    STATES,
    Bools,
    DaemonEvent,
    Floats,
    Rows,
)
from linemate.simulators.plants.conveyor_plan import AppliedEvent

APPROACH_S = 1.0
STOP_S = 1.3
RESTART_S = 2.0
SCREWS_S = 0.4
SETTLE_S = 0.5
LATEST_S = 3.0
CLEAR_M = 0.05
DERIVATIVES = ("speed", "acceleration", "jerk")

CONTROL_BAR_MM = 1.0
CONTROL_BAR_MRAD = 2.0
"""The paper's figure: control errors in approach, stop and contact stay below these."""

UNANSWERED = ("late", "lost", "refused")
"""Kinds of telegrams without a good reply in time."""

TROUBLE = frozenset({"hold", "retreat", "fault"})
"""States that end a motion."""

SCREWS_FIXED, WHEEL_RELEASED = 1, 2

ANGLE_QUANTUM = np.radians(0.5e-8)
LENGTH_QUANTUM = 0.5e-11
"""Half of the last decimal on the wire: degrees and mm with eight decimals [rad], [m]."""


@dataclass(frozen=True, slots=True)
class Telegrams:
    """Telegrams as the controller counted them."""

    sent: int
    answered: int
    late: int
    lost: int
    refused: int


@dataclass(frozen=True, slots=True)
class StateChange:
    """A change of the daemon's operating state, and why, as the daemon wrote it."""

    before: str
    after: str
    cause: str

    def __str__(self) -> str:
        return f"{self.before} -> {self.after}: {self.cause}"


@dataclass(frozen=True, slots=True)
class RunEvidence:
    """Evidence of a run.

    Attributes:
        cycle_s: the controller's cycle [s].
        events: stops and starts that took place.
        limits: of the seven axes, the emulator's own.
        collision: what hit what, None if nothing did.
        broken: why the controller broke off, None if it did not.
        variant: ablation, "default" if none.
        turnaround_us: p50, p99, p999, max at the controller; None in virtual time.
        tolerated: telegrams without a good reply after which the controller breaks off, in all;
            None if it counts them in a row only.
        changes: of the daemon's operating state, oldest first.
        refusal: why the last order was refused, None if none was.
        waiting: why the tool last waited before contact, None if it never did.
    """

    rows: Rows
    scenario: str
    seed: int
    cycle_s: float
    events: Sequence[AppliedEvent]
    telegrams: Telegrams
    limits: Sequence[AxisLimit] = LIMITS
    collision: str | None = None
    broken: str | None = None
    variant: str = "default"
    turnaround_us: Mapping[str, float] | None = None
    tolerated: int | None = 100
    changes: Sequence[StateChange] = ()
    refusal: str | None = None
    waiting: str | None = None


def judge(evidence: RunEvidence, *, strict: bool = False) -> dict[str, Any]:
    """Judge one run.

    Args:
        strict: one telegram without a good reply in time is too many.

    Returns:
        The dict of ``result.json`` (interfaces, section 7).
    """
    rows = evidence.rows
    outcome = _outcome(evidence)
    # What the run did not live to see was not missed.
    events = [e for e in evidence.events if len(rows) and e.onset_s < rows.t[-1]]
    spans = windows(rows, events, evidence.collision is not None)
    errors = {
        f"{name}_error": {window: _figures(*pair, mask) for window, mask in spans.items()}
        for name, pair in compute_errors(rows).items()
    }
    detection, alarms = detections(rows.events, events)
    result: dict[str, Any] = {
        "version": 1,
        "scenario": evidence.scenario,
        "variant": evidence.variant,
        "seed": evidence.seed,
        "cycle_ms": _round(evidence.cycle_s * 1e3),
        "assembled": outcome == "assembled",
        "outcome": outcome,
        "reason": _reason(evidence, outcome),
        "duration_s": _round(rows.t[-1]) if len(rows) else 0.0,
        "impact_s": _impact_time(rows),
        **errors,
        "detection": detection,
        "false_alarms": alarms,
        "contact_force_n": _force(rows),
        "contact": contact_figures(rows, _screws(rows)[0]),
        "telegrams": {
            **asdict(evidence.telegrams),
            "tolerated": 0 if strict else evidence.tolerated,
        },
        "step_us": percentiles(rows.step_us, {"p50": 50.0, "p99": 99.0, "max": 100.0}),
        "limits": violations(rows.setpoints, rows.answered, evidence.limits, evidence.cycle_s),
    }
    if evidence.turnaround_us is not None:
        result["turnaround_us"] = dict(evidence.turnaround_us)
    result["shortfalls"] = shortfalls(result)
    result["within_limits"] = not result["shortfalls"]
    return result


def shortfalls(result: Mapping[str, Any]) -> list[str]:
    """Return everything that keeps a run from being assembled within limits, in words.

    The limits: assembled, no setpoint beyond an axis limit, no more telegrams without a good
    reply in time than the controller tolerates, and a control error below 1 mm and 2 mrad in
    approach, stop and contact.
    """
    return [
        *_not_assembled(result),
        *_inaccurate(result),
        *_beyond_axis_limits(result),
        *_unanswered(result),
    ]


def unanswered(telegrams: Mapping[str, Any]) -> int:
    """Return how many telegrams got no good reply in time."""
    return sum(int(telegrams.get(kind) or 0) for kind in UNANSWERED)


def _not_assembled(result: Mapping[str, Any]) -> Iterator[str]:
    if not result["assembled"]:
        yield f"the wheel was not assembled: {result['outcome']}"


def _inaccurate(result: Mapping[str, Any]) -> Iterator[str]:
    for name in ("approach", "stop", "contact"):
        span = result["control_error"].get(name)
        if span is None:
            continue
        for key, bar, unit in (
            ("max_mm", CONTROL_BAR_MM, "mm"),
            ("max_mrad", CONTROL_BAR_MRAD, "mrad"),
        ):
            if not span[key] < bar:
                yield f"control error in {name} {span[key]:.2f} {unit}, limit {bar:g} {unit}"


def _beyond_axis_limits(result: Mapping[str, Any]) -> Iterator[str]:
    count = result["limits"]["violations"]
    if count:
        yield f"{count} setpoints beyond the axis limits, limit 0"


def _unanswered(result: Mapping[str, Any]) -> Iterator[str]:
    telegrams = result["telegrams"]
    count, tolerated = unanswered(telegrams), telegrams.get("tolerated")
    if tolerated is not None and count > tolerated:
        yield f"{count} telegrams without a good reply in time, limit {tolerated}"


# Errors


def compute_errors(rows: Rows) -> dict[str, tuple[Floats, Floats]]:
    """The four errors of each row.

    Returns:
        For control, plan, prediction and total: distance [m] and angle [rad], (n,) each,
        NaN where the daemon had no such pose.
    """
    tcp = rows.judged_tcp()
    aim = poses.compose(rows.hub, poses.relative(rows.part, rows.sensed))
    return {
        "control": poses.distance(rows.target, tcp),
        "plan": poses.distance(rows.sensed, rows.target),
        "prediction": poses.distance(aim, rows.sensed),
        "total": poses.distance(aim, tcp),
    }


def _figures(distance: Floats, angle: Floats, mask: Bools) -> dict[str, float] | None:
    """Maximum and root mean square over a window; None if nothing is known in it."""
    known = mask & np.isfinite(distance) & np.isfinite(angle)
    if not known.any():
        return None
    mm, mrad = distance[known] * 1e3, angle[known] * 1e3
    return {
        "max_mm": _round(mm.max()),
        "rms_mm": _round(np.sqrt(np.mean(mm**2))),
        "max_mrad": _round(mrad.max()),
        "rms_mrad": _round(np.sqrt(np.mean(mrad**2))),
    }


# Windows


def windows(rows: Rows, events: Sequence[AppliedEvent], collided: bool = False) -> dict[str, Bools]:
    """Which rows belong to which window (interfaces, section 7), by the truth alone.

    ``quiet`` is extra: contact after the screws, away from stops and starts.
    """
    t = rows.t
    clamped = rows.contact == CLAMPED
    impact = int(np.argmax(clamped)) if clamped.any() else None
    if impact is None and collided:
        impact = len(t) - 1
    stop, restart, busy = (np.zeros(len(t), np.bool_) for _ in range(3))
    for event in events:
        window, length = (stop, STOP_S) if event.kind == "stop" else (restart, RESTART_S)
        window |= (t >= event.onset_s) & (t <= event.onset_s + length)
        busy |= (t >= event.onset_s) & (t <= event.settled_s + SETTLE_S)
    fixing, before = _screws(rows)
    return {
        "approach": _before_impact(t, impact),
        "stop": stop,
        "impact": _at_impact(t, impact),
        "contact": clamped & ~fixing,
        "restart": restart,
        "quiet": clamped & ~fixing & ~before & ~busy,
    }


def _before_impact(t: Floats, impact: int | None) -> Bools:
    if impact is None:
        return np.zeros(len(t), np.bool_)
    near: Bools = (t >= t[impact] - APPROACH_S) & (t < t[impact])
    return near


def _at_impact(t: Floats, impact: int | None) -> Bools:
    # The last row in free space: one later the clamp has already drawn tool and hub together.
    at = np.zeros(len(t), np.bool_)
    if impact is not None and impact > 0:
        at[impact - 1] = True
    return at


def _screws(rows: Rows) -> tuple[Bools, Bools]:
    """Rows in which the screws are being fixed, and rows before they are."""
    fixed = (rows.digital_in & SCREWS_FIXED) != 0
    if not fixed.any():
        return np.zeros(len(rows), np.bool_), np.ones(len(rows), np.bool_)
    at = rows.t[int(np.argmax(fixed))]
    return np.abs(rows.t - at) <= SCREWS_S, rows.t < at


def _impact_time(rows: Rows) -> float | None:
    clamped = rows.contact == CLAMPED
    return _round(rows.t[int(np.argmax(clamped))]) if clamped.any() else None


# Outcome


def _outcome(evidence: RunEvidence) -> str:
    """In one word how it ended; the first that applies."""
    rows = evidence.rows
    rules: tuple[tuple[str, Callable[[], bool]], ...] = (
        ("collision", lambda: evidence.collision is not None),
        ("fault", lambda: evidence.broken is not None or not len(rows)),
        ("fault", lambda: STATES[rows.state[-1]] == "fault"),
        ("assembled", lambda: _is_assembled(rows)),
        ("retreated", lambda: _has_retreated(rows)),
    )
    return next((name for name, applies in rules if applies()), "held")


def _is_assembled(rows: Rows) -> bool:
    """Screws fixed, wheel released, the tool off the hub."""
    signals = int(rows.digital_in[-1])
    done = bool(signals & SCREWS_FIXED) and bool(signals & WHEEL_RELEASED)
    gap = float(np.linalg.norm(rows.tcp[-1, :3] - rows.hub[-1, :3]))
    return done and bool((rows.contact == CLAMPED).any()) and gap > CLEAR_M


def _has_retreated(rows: Rows) -> bool:
    """The tool was on the hub and is off it again, or the daemon has withdrawn it."""
    withdrawn = (rows.contact == CLAMPED).any() and rows.contact[-1] == FREE
    retreat = (rows.phase == PHASES.index("retreat")) | (rows.state == STATES.index("retreat"))
    return bool(withdrawn or retreat.any())


def _reason(evidence: RunEvidence, outcome: str) -> str | None:
    """Return why a run did not assemble, in the words of the daemon's state table."""
    if outcome == "assembled":
        return None
    if evidence.collision is None and evidence.broken is not None:
        return evidence.broken
    last = _last_trouble(evidence.changes)
    reasons = [evidence.collision, None if last is None else str(last)]
    if outcome == "fault":
        # What led to the fault comes first, and then the fault itself.
        reasons += [str(c) for c in evidence.changes[-1:] if c.after == "fault" and c is not last]
    return "; ".join(filter(None, reasons)) or _why_nothing_happened(evidence)


def _why_nothing_happened(evidence: RunEvidence) -> str:
    """Return why a run without trouble did not assemble."""
    changes = evidence.changes
    if evidence.refusal is not None and not any(change.after == "track" for change in changes):
        return f"never started: {evidence.refusal}"
    if not changes:
        return "the daemon's state never changed. Check the robot link."
    ended = f"the run ended in {changes[-1].after}, entered by: {changes[-1]}"
    if evidence.waiting is not None:
        return f"{ended}; last waited before contact: {evidence.waiting}"
    return ended


def _last_trouble(changes: Sequence[StateChange]) -> StateChange | None:
    """Return what ended the last motion for good: the change into hold, retreat or fault."""
    moving = [n for n, change in enumerate(changes) if change.after in {"track", "contact"}]
    since = changes[moving[-1] + 1 :] if moving else changes
    return next((change for change in since if change.after in TROUBLE), None)


# Detection


def detections(
    reported: Sequence[DaemonEvent], events: Sequence[AppliedEvent]
) -> tuple[list[dict[str, Any]], dict[str, int]]:
    """Return latencies of the events in time, and the count of events without cause.

    Args:
        reported: the daemon's events, in order of time.
        events: stops and starts that took place.

    Returns:
        One entry an event (latencies after onset [s], None if missed), and false alarms.
    """
    entries, idle = attribute(reported, events)
    words = [event.what for event in idle]
    return entries, {what: words.count(what) for what in ("tentative", "confirmed")}


def attribute(
    reported: Sequence[DaemonEvent], events: Sequence[AppliedEvent]
) -> tuple[list[dict[str, Any]], list[DaemonEvent]]:
    """Attribute the reported events to the true ones; see ``detections``.

    Returns:
        One entry an event, and the reported events without cause.
    """
    entries: list[dict[str, Any]] = []
    justified: set[int] = set()
    times = [event.t for event in reported]
    for i, event in enumerate(events):
        end = max(event.settled_s, event.onset_s + LATEST_S)
        if i + 1 < len(events):
            end = min(end, events[i + 1].onset_s)
        span = range(bisect_left(times, event.onset_s), bisect_left(times, end))
        own = [j for j in span if reported[j].kind == event.kind]
        justified.update(own)
        perceived, confirmed = _latencies([reported[j] for j in own], event.onset_s)
        entries.append(
            {
                "event": event.kind,
                "onset_s": _round(event.onset_s),
                "perceived_s": perceived,
                "confirmed_s": confirmed,
            }
        )
    return entries, [event for j, event in enumerate(reported) if j not in justified]


def _latencies(own: Sequence[DaemonEvent], onset: float) -> tuple[float | None, float | None]:
    """The first confirmation, and the last perception before it that was not taken back."""
    perceived: float | None = None
    for event in own:
        if event.what == "tentative" and perceived is None:
            perceived = _round(event.t - onset)
        elif event.what == "cancelled":
            perceived = None
        elif event.what == "confirmed":
            confirmed = _round(event.t - onset)
            return (confirmed if perceived is None else perceived), confirmed
    return perceived, None


# Limits, forces, percentiles


def violations(
    setpoints: Floats, answered: Bools, limits: Sequence[AxisLimit], cycle_s: float
) -> dict[str, Any]:
    """Count applied setpoints whose finite differences are out of limits.

    In a cycle without a reply the controller holds by itself. That is no violation, and
    the robot counts as at rest after it (reliability, 2.0).

    Args:
        setpoints: (n, axes) [rad], [m].
        answered: rows in which a fresh reply was applied, (n,).

    Returns:
        The number of violations, and of each limit the largest share that was used.
    """
    low, high, *highest = np.array(
        [(b.low, b.high, b.speed, b.acceleration, b.jerk) for b in limits]
    ).T
    quantum = np.full(len(limits), ANGLE_QUANTUM)
    quantum[6:] = LENGTH_QUANTUM
    fresh = answered & np.isfinite(setpoints).all(axis=1)
    outside = (setpoints < low - quantum) | (setpoints > high + quantum)
    count, worst = int(outside[fresh].sum()), {}
    derivative = setpoints
    for order, (name, limit) in enumerate(zip(DERIVATIVES, highest, strict=True), start=1):
        derivative = _slope(derivative, cycle_s)
        derivative[~fresh] = 0.0
        allowed = limit * (1.0 + 1e-6) + 2.0**order * quantum / cycle_s**order
        count += int((np.abs(derivative) > allowed).sum())
        worst[name] = _round((np.abs(derivative) / limit).max()) if len(derivative) else 0.0
    return {"violations": count, "worst_share": worst}


def _slope(values: Floats, cycle_s: float) -> Floats:
    slope = np.zeros_like(values)
    slope[1:] = np.diff(values, axis=0) / cycle_s
    return slope


def _force(rows: Rows) -> dict[str, float] | None:
    """Contact force on the elastic mount while the tool is clamped [N]."""
    clamped = (rows.contact == CLAMPED) & np.isfinite(rows.force).all(axis=1)
    if not clamped.any():
        return None
    force = np.linalg.norm(rows.force[clamped], axis=1)
    return {"max": _round(force.max()), "rms": _round(np.sqrt(np.mean(force**2)))}


def percentiles(values: Floats, ranks: Mapping[str, float]) -> dict[str, float | None]:
    """Percentiles of what was measured; None for each if nothing was."""
    known = values[np.isfinite(values)]
    if not known.size:
        return dict.fromkeys(ranks)
    return {name: _round(np.percentile(known, rank)) for name, rank in ranks.items()}


def _round(value: float) -> float:
    """Six decimals: nanometres and nanoradians are beyond any claim."""
    return round(float(value), 6)
