"""What a recording must hold of steps, so that each of them can be made again.

Law of this file: no clock, no file; steps in, items out, as plain values that need nothing of
the step to be written down. Steps, states and parameters are exact and make a replay; the rest
is for people.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Final

import msgpack

from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.step import State
from linemate.daemon.cycle.cycle import LogEntry
from linemate.daemon.recording import recording, snapshot, viewer_messages
from linemate.daemon.recording.step_file import LAYOUT, Item, Kind

SHOWN_NS: Final = 20_000_000
"""Between two steps that viewers are shown [ns]."""

STATE_NS: Final = 60_000_000_000
"""Between two states of a run that goes on, so that a replay may begin in the middle [ns]."""


def described(texts: Mapping[str, str]) -> dict[str, str]:
    """Return the texts of a recording with what tells how its steps are to be read."""
    return {"program": _PROGRAM, **texts, LAYOUT: json.dumps(recording.LAYOUT)}


def _version() -> str:
    try:
        return version("linemate")
    except PackageNotFoundError:
        return ""


_PROGRAM: Final = _version()


@dataclass(slots=True)
class Feed:
    """Makes items of steps: what a file must hold so that each of its steps can be made again.

    Attributes:
        unfit: steps that could not be made bytes of.
    """

    unfit: int = 0
    _after: State | None = None
    _parameters: Parameters | None = None
    _state: str = ""
    _shown_ns: int | None = None
    _state_ns: int = 0
    _why: tuple[Parameters, str, Mapping[str, Any]] | None = None

    def begin(self) -> None:
        """A new file begins: it must stand for itself."""
        self._after = self._parameters = self._shown_ns = None

    def lost(self) -> None:
        """A step was dropped: the next one cannot be made from the one before."""
        self._after = None

    def explain(self, parameters: Parameters, who: str, changed: Mapping[str, Any]) -> None:
        """Remember whose parameters these are, for the first step made with them."""
        self._why = (parameters, who, changed)

    def of(self, entry: LogEntry) -> Iterator[Item]:
        """Return the items of a step, in the order of writing.

        Raises:
            TypeError, ValueError, OverflowError: it cannot be made bytes of.
        """
        inputs, outputs = entry.inputs, entry.outputs
        stamp = inputs.stamp_ns
        data = recording.encode(entry.ipoc, entry.state, inputs, outputs)
        if entry.parameters is not None and entry.parameters is not self._parameters:
            change = parameters_message(*self._change(inputs.k, entry.parameters))
            yield Item(Kind.PARAMETERS, stamp, viewer_messages.as_json(change))
            self._parameters = entry.parameters
        anew = entry.before is not self._after
        if entry.before is not None and (anew or stamp - self._state_ns >= STATE_NS):
            self._state_ns = stamp
            yield _state(stamp, inputs.k, entry.before, anew=anew)
        self._after = entry.after
        yield Item(Kind.STEP, stamp, data)
        if self._state != entry.state:
            yield Item(Kind.LINE, stamp, (f"state: {entry.state}", viewer_messages.INFO))
            self._state = entry.state
        for what, how in outputs.events:
            yield Item(Kind.LINE, stamp, (f"conveyor: {what} {how}", viewer_messages.INFO))
        if self._shown_ns is None or not 0 <= stamp - self._shown_ns < SHOWN_NS:
            self._shown_ns = stamp
            seen = viewer_messages.glimpse(inputs, outputs)
            yield Item(Kind.SHOWN, stamp, (seen.measured, seen.commanded, seen.poses))

    def _change(self, k: int, parameters: Parameters) -> tuple[Any, ...]:
        if self._why is not None and self._why[0] is parameters:
            return k, *self._why
        return k, parameters, "", {}


def _state(stamp_ns: int, k: int, state: State, *, anew: bool) -> Item:
    """Return the item of the state before a step, or of why there is none."""
    try:
        return Item(Kind.STATE, stamp_ns, msgpack.packb([k, snapshot.encode(state), anew]))
    except snapshot.SnapshotError as error:
        told = f"steps from {k} on cannot be replayed: {error}"
        return Item(Kind.LINE, stamp_ns, (told, viewer_messages.WARNING))


def parameters_message(
    k: int, parameters: Parameters, who: str = "", changed: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return what is recorded of parameters that a step begins to be made with.

    Args:
        who: set them, empty for those from the start.
        changed: by name, the old and the new value.
    """
    settings = {
        "cycle_s": parameters.cycle_s,
        "tracking": asdict(parameters.tracker.settings),
        "control": asdict(parameters.settings),
    }
    return {"k": k, "who": who, "changed": dict(changed or {}), "settings": settings}
