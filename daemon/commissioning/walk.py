"""Steps of commissioning in their order, and how far a site has come.

Invariants:
- Pure: the state is plain values, a file's text in and out. Unknown steps in it are kept out.
- A step that is repeated makes the steps that build on it due again.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

from linemate.daemon.identification.outcome import Estimate, ReportLine

VERSION = 1
MOST_LINES = 200  # of figures kept of a step
MOST_TEXT = 400  # characters of one text


class StepName(StrEnum):
    """A step, by the name that the command line has for it."""

    LINKS = "links"
    SIGNS = "signs"
    LIMITS = "limits"
    SERVOS = "servos"
    FORCE = "force"
    CAMERA = "camera"
    CONVEYOR = "conveyor"
    OBJECT = "object"
    DRY_RUN = "dry-run"
    PAGE = "page"


class StepOutcome(StrEnum):
    """Outcome of a step."""

    DUE = "due"
    MEASURED = "measured"
    REFUSED = "refused"
    SKIPPED = "skipped"


@dataclass(frozen=True, slots=True)
class WalkStep:
    """One step.

    Attributes:
        do: what the engineer does while the daemon records.
        record_s: usual length of the recording [s], 0 for a step without one.
        needs: steps on whose results it builds.
    """

    name: StepName
    about: str
    do: str
    record_s: float = 0.0
    needs: tuple[StepName, ...] = ()


STEPS: tuple[WalkStep, ...] = (
    WalkStep(
        StepName.LINKS,
        "rate, gaps, age, noise and stamps of each device",
        "Start the controller's programme, let the robot stand, show the object to the camera.",
        10.0,
    ),
    WalkStep(
        StepName.SIGNS,
        "sign and size of each axis' motion for a command",
        "Run the task that this step writes: order home, arm and start. The linear axis moves by "
        "30 mm on the way home. Then each other axis turns by 0.2 degrees and back.",
        75.0,
        (StepName.LINKS,),
    ),
    WalkStep(
        StepName.LIMITS,
        "limits of the axes and margins along the task",
        "Nothing moves: the task runs once through the kinematics.",
    ),
    WalkStep(
        StepName.FORCE,
        "frame, sign and bias of the force-torque sensor; mass and centre of gravity",
        "Drive the tool with its part through 10 postures that tilt it to all sides. "
        "Stand 2 s in each.",
        90.0,
        (StepName.LINKS,),
    ),
    WalkStep(
        StepName.CAMERA,
        "camera in the tool, its delay",
        "Drive the tool through 18 postures before an object that stands still. Turn it about "
        "all axes. Stand 2 s in each.",
        120.0,
        (StepName.LINKS,),
    ),
    WalkStep(
        StepName.CONVEYOR,
        "direction, scale, ripple, speed and ramps of the conveyor",
        "Stand. Let the object pass before the camera and stop the conveyor three times.",
        90.0,
        (StepName.CAMERA,),
    ),
    WalkStep(
        StepName.SERVOS,
        "servos, windup and tool modes",
        "Run the exercise that this step writes, with the conveyor at rest.",
        60.0,
        (StepName.SIGNS, StepName.LIMITS),
    ),
    WalkStep(
        StepName.OBJECT,
        "nominal pose of the object, its swings and its sway",
        "Stand. Let the object swing before the camera for 30 s, the conveyor at rest.",
        60.0,
        (StepName.CAMERA, StepName.CONVEYOR),
    ),
    WalkStep(
        StepName.DRY_RUN,
        "predicted and seen errors next to the line, without contact",
        "Run the task to its last waypoint before contact, then order retreat.",
        60.0,
        (StepName.SERVOS, StepName.CAMERA, StepName.CONVEYOR),
    ),
    WalkStep(
        StepName.PAGE,
        "a page with everything that was measured, to be signed",
        "Nothing moves: the page is written.",
    ),
)
BY_NAME: Mapping[StepName, WalkStep] = {step.name: step for step in STEPS}


@dataclass(frozen=True, slots=True)
class StepRecordOfSite:
    """What is kept of a step.

    Attributes:
        when: date and time of the result, as text.
        figures: plain lines: name, unit, value, deviation, basis, or the reason of a refusal.
        overlay: name of the overlay file, None without one.
        recordings: names of the recordings that it rests on.
        reason: why it was refused or skipped.
        took_s: from the begin of the step to its result, with what the engineer did [s].
    """

    outcome: StepOutcome = StepOutcome.DUE
    when: str = ""
    figures: tuple[Mapping[str, Any], ...] = ()
    overlay: str | None = None
    recordings: tuple[str, ...] = ()
    reason: str = ""
    took_s: float = 0.0


@dataclass(frozen=True, slots=True)
class SiteState:
    """How far a site has come."""

    steps: Mapping[StepName, StepRecordOfSite] = field(default_factory=dict)

    def of(self, name: StepName) -> StepRecordOfSite:
        """Return what is kept of a step."""
        return self.steps.get(name, StepRecordOfSite())

    def overlays(self, but: StepName | None = None) -> tuple[str, ...]:
        """Return the names of the overlay files in the order of the steps.

        Args:
            but: a step whose overlay is left out.
        """
        names = (self.of(step.name).overlay for step in STEPS if step.name is not but)
        return tuple(name for name in names if name is not None)

    def next_due(self) -> WalkStep | None:
        """Return the first step that is due, None if all are done."""
        done = {StepOutcome.MEASURED, StepOutcome.SKIPPED}
        return next((step for step in STEPS if self.of(step.name).outcome not in done), None)

    def missing(self, name: StepName) -> tuple[StepName, ...]:
        """Return the steps that a step builds on and that have no result."""
        return tuple(
            need
            for need in BY_NAME[name].needs
            if self.of(need).outcome is not StepOutcome.MEASURED
        )

    def with_result(self, name: StepName, result: StepRecordOfSite) -> "SiteState":
        """Return the state after a step; what builds on it is due again."""
        steps = {**self.steps, name: result}
        for later in STEPS:
            old = steps.get(later.name)
            if name in later.needs and old is not None and old.outcome is StepOutcome.MEASURED:
                reason = f"{name} was measured again"
                steps[later.name] = replace(old, outcome=StepOutcome.DUE, reason=reason)
        return SiteState(steps)


def plain_figures(lines: Sequence[ReportLine]) -> tuple[Mapping[str, Any], ...]:
    """Return report lines as plain values, in the units that are shown."""
    figures: list[Mapping[str, Any]] = []
    for line in lines[:MOST_LINES]:
        shown: dict[str, Any] = {"name": line.name, "unit": line.unit}
        if isinstance(line.outcome, Estimate):
            shown |= {
                "value": line.outcome.value * line.scale,
                "deviation": line.outcome.deviation * line.scale,
                "basis": line.outcome.basis,
                "in_overlay": line.in_overlay,
            }
        else:
            shown["refused"] = line.outcome.reason
        figures.append(shown)
    return tuple(figures)


def as_text(state: SiteState) -> str:
    """Return the state as the text of its file."""
    steps = {
        name.value: {
            "outcome": record.outcome.value,
            "when": record.when,
            "figures": [dict(figure) for figure in record.figures],
            "overlay": record.overlay,
            "recordings": list(record.recordings),
            "reason": record.reason,
            "took_s": round(record.took_s, 1),
        }
        for name, record in state.steps.items()
    }
    return json.dumps({"version": VERSION, "steps": steps}, indent=1) + "\n"


def from_text(text: str) -> SiteState:
    """Return the state in the text of its file.

    Raises:
        ValueError: it is none; the message says what is wrong.
    """
    try:
        whole = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"not JSON: {error}") from error
    steps = whole.get("steps") if isinstance(whole, dict) else None
    if not isinstance(steps, dict) or whole.get("version") != VERSION:
        raise ValueError(f"not a state of version {VERSION} with a mapping of steps")
    known = {name.value: name for name in StepName}
    return SiteState(
        {known[name]: _record(name, value) for name, value in steps.items() if name in known}
    )


def _record(name: str, value: Any) -> StepRecordOfSite:
    if not isinstance(value, dict) or value.get("outcome") not in list(StepOutcome):
        raise ValueError(f"steps.{name}: no outcome")
    figures, overlay = value.get("figures", []), value.get("overlay")
    if not isinstance(figures, list) or not all(isinstance(each, dict) for each in figures):
        raise ValueError(f"steps.{name}.figures should be a list of mappings")
    if overlay is not None and (not isinstance(overlay, str) or "/" in overlay):
        raise ValueError(f"steps.{name}.overlay should be a file's name")
    return StepRecordOfSite(
        StepOutcome(value["outcome"]),
        str(value.get("when", ""))[:MOST_TEXT],
        tuple(figures[:MOST_LINES]),
        overlay,
        tuple(str(each)[:MOST_TEXT] for each in value.get("recordings", ())),
        str(value.get("reason", ""))[:MOST_TEXT],
        _seconds(name, value.get("took_s", 0.0)),
    )


def _seconds(name: str, value: Any) -> float:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not is_number or not 0.0 <= value < math.inf:
        raise ValueError(f"steps.{name}.took_s should be a time in seconds")
    return float(value)
