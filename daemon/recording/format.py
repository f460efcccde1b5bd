"""Format of a recording: topics, metadata, items that are written and pieces that are read.

Invariants:
- Only the standard library is imported. The writer process and the operator's tool start with it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum, auto
from typing import Any, Final, NamedTuple

STEP: Final = "/linemate/step"
STATE: Final = "/linemate/state"
PARAMETERS: Final = "/linemate/parameters"
TIMING: Final = "/linemate/timing"
LOG: Final = "/log"
STATE_LOG: Final = "linemated.state"  # writer's name of operating state changes in LOG

ENCODING: Final = "msgpack"  # of STEP and STATE; all other topics are JSON
METADATA: Final = "linemate"  # name of the metadata record with the cell's texts
LAYOUT: Final = "layout"  # its key of the field names of each step


# Outputs of a step that telemetry and views show.
SHOWN_OUTPUTS: Final = (
    "phase", "task_time", "scenario", "scenario_state", "confidence", "speed", "contact", "held",
    "target", "sensed", "part", "command",
)  # fmt: skip


class UnreadableRecordingError(Exception):
    """A file that is not a recording; the message gives the path and the reason."""


# Raised by content that no recorder wrote; the last by JSON that is nested too deep.
BAD_CONTENT: Final = (ValueError, KeyError, TypeError, AttributeError, RecursionError)


class ItemKind(IntEnum):
    """Kind of an item; its payload is in the comment, plain values only."""

    STEP = auto()  # bytes of step_codec.encode
    STATE = auto()  # msgpack bytes: k, state, whether the step before led to another state
    PARAMETERS = auto()  # JSON bytes
    SHOWN = auto()  # fields of viewer_messages.StepView
    TIMING = auto()  # fields of CycleTimes
    LINE = auto()  # (text, level), and the writer's name if it is not the daemon
    NEXT_FILE = auto()  # None
    END = auto()  # None; ends the recording


class Item(NamedTuple):
    """Payload for the writer, with its monotonic time [ns]."""

    kind: ItemKind
    stamp_ns: int
    payload: Any = None


@dataclass(frozen=True, slots=True)
class CellTexts:
    """Texts of the cell by name: config, task, urdf, dbc, controller's family, program, layout."""

    texts: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class StateBefore:
    """State before step ``k``.

    ``data`` is of ``snapshot.encode``. ``is_new``: step ``k - 1`` led to another state.
    """

    k: int
    data: bytes
    is_new: bool = True


@dataclass(frozen=True, slots=True)
class ParametersInForce:
    """Parameters from step ``k`` on; ``settings`` as ``step_items.parameters_message`` gives them.

    Values are plain: sections ``tracking`` and ``control``, and ``cycle_s`` [s].
    """

    k: int
    settings: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class DamageReport:
    """Damage of a recording: nothing is read after it.

    Attributes:
        reason: damage of the file, with value and limit.
        read: number of steps before the damage.
        total: steps that the file should hold, None if its end is missing.
    """

    reason: str
    read: int = 0
    total: int | None = None

    def __str__(self) -> str:
        total = "an unknown number of" if self.total is None else str(self.total)
        return (
            f"damaged: {self.reason}. {self.read} of {total} steps were read. "
            "Keep what can be read with `linemate recover FILE`."
        )
