"""Items of a step: what a recording must hold so that each step can be replayed.

Invariants:
- Items are plain values. The writer needs nothing of daemon.core to write them.
- Steps, states and parameters are exact. The other items are for people.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

import msgpack

from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.step_state import StepState
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.recording import snapshot, step_codec, viewer_messages
from linemate.daemon.recording.format import LAYOUT, Item, ItemKind

VIEW_NS: Final = 20_000_000  # between two steps that viewers get [ns]
STATE_NS: Final = 60_000_000_000  # between two states [ns], so that a replay may begin there


def metadata_of(texts: Mapping[str, str]) -> dict[str, str]:
    """Return the metadata of a recording: texts of the cell, and field names."""
    return {**texts, LAYOUT: json.dumps(step_codec.LAYOUT)}


@dataclass(slots=True)
class StepItems:
    """Conversion of log entries to items."""

    _after: StepState | None = None
    _parameters: Parameters | None = None
    _state: str = ""
    _view_ns: int | None = None
    _state_ns: int = 0
    _change: tuple[Parameters, str, Mapping[str, Any]] | None = None

    def begin_file(self) -> None:
        """Begin a file, which must be complete in itself."""
        self._after = self._parameters = self._view_ns = None

    def drop_step(self) -> None:
        """Note a step that is not recorded: the next one needs its state."""
        self._after = None

    def note_change(self, parameters: Parameters, who: str, changed: Mapping[str, Any]) -> None:
        """Note who set parameters, for the first step that uses them."""
        self._change = (parameters, who, changed)

    def convert(self, entry: LogEntry) -> Iterator[Item]:
        """Yield the items of a step in the order of writing.

        Raises:
            TypeError, ValueError, OverflowError: the step cannot be encoded.
        """
        inputs, outputs = entry.inputs, entry.outputs
        stamp_ns = inputs.stamp_ns
        data = step_codec.encode(entry.counter, entry.state, inputs, outputs)
        if entry.parameters is not None and entry.parameters is not self._parameters:
            change = self._change_message(inputs.k, entry.parameters)
            yield Item(ItemKind.PARAMETERS, stamp_ns, viewer_messages.as_json(change))
            self._parameters = entry.parameters
        is_new = entry.before is not self._after
        if entry.before is not None and (is_new or stamp_ns - self._state_ns >= STATE_NS):
            self._state_ns = stamp_ns
            yield _state_item(stamp_ns, inputs.k, entry.before, is_new=is_new)
        self._after = entry.after
        yield Item(ItemKind.STEP, stamp_ns, data)
        if self._state != entry.state:
            yield Item(ItemKind.LINE, stamp_ns, (f"state: {entry.state}", viewer_messages.INFO))
            self._state = entry.state
        for what, how in outputs.events:
            yield Item(ItemKind.LINE, stamp_ns, (f"conveyor: {what} {how}", viewer_messages.INFO))
        if self._view_ns is None or not 0 <= stamp_ns - self._view_ns < VIEW_NS:
            self._view_ns = stamp_ns
            view = viewer_messages.step_view(inputs, outputs)
            yield Item(ItemKind.SHOWN, stamp_ns, (view.measured, view.commanded, view.poses))

    def _change_message(self, k: int, parameters: Parameters) -> dict[str, Any]:
        if self._change is not None and self._change[0] is parameters:
            return parameters_message(k, *self._change)
        return parameters_message(k, parameters)


def _state_item(stamp_ns: int, k: int, state: StepState, *, is_new: bool) -> Item:
    """Return the state before step ``k``, or a warning if it cannot be encoded."""
    try:
        return Item(ItemKind.STATE, stamp_ns, msgpack.packb([k, snapshot.encode(state), is_new]))
    except snapshot.SnapshotError as error:
        text = f"steps from {k} on cannot be replayed: {error}"
        return Item(ItemKind.LINE, stamp_ns, (text, viewer_messages.WARNING))


def parameters_message(
    k: int, parameters: Parameters, who: str = "", changed: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the recorded message of parameters.

    Args:
        k: first step that uses them.
        who: who set them, empty for those from the start.
        changed: old and new value by name.
    """
    settings = {
        "cycle_s": parameters.cycle_s,
        "tracking": asdict(parameters.tracker.settings),
        "control": asdict(parameters.settings),
    }
    return {"k": k, "who": who, "changed": dict(changed or {}), "settings": settings}
