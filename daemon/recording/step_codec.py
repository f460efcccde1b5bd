"""Codec of recorded steps: inputs and outputs as bytes, bit for bit.

Invariants:
- A float keeps its 64 bits.
- Values stand in the order of ``LAYOUT``, which each recording holds for later versions.
- The horizon is recorded as a digest. A replay computes it again.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import msgpack
import numpy as np
from fastcrc import crc64

from linemate.daemon.core.inputs import Inputs, MotionOrder
from linemate.daemon.core.step_state import Outputs
from linemate.protocol.stamped_samples import (
    CameraSample,
    DistanceSample,
    RobotSample,
    WrenchSample,
)

VERSION = 1

_KINDS = (Inputs, Outputs, RobotSample, DistanceSample, CameraSample, WrenchSample)

# The values of each kind, in the order in which they are written.
LAYOUT: dict[str, tuple[str, ...]] = {kind.__name__: kind.__struct_fields__ for kind in _KINDS}

_VALUES: dict[type[Any], Callable[[Any], Any]] = {
    kind: attrgetter(*LAYOUT[kind.__name__]) for kind in _KINDS
}
_OF_INPUTS, _OF_OUTPUTS, _OF_ROBOT = _VALUES[Inputs], _VALUES[Outputs], _VALUES[RobotSample]
# Fields under their names in recordings of earlier versions.
_FORMER_NAMES = {"ipoc": "counter"}
_ROBOT = LAYOUT["Inputs"].index("robot")
_HORIZON = LAYOUT["Outputs"].index("horizon")
_OF_SAMPLES = tuple(
    (LAYOUT["Inputs"].index(name), _VALUES[kind])
    for name, kind in (
        ("distance", DistanceSample),
        ("camera", CameraSample),
        ("wrench", WrenchSample),
    )
)


class RecordingError(ValueError):
    """Bytes that are not a step."""


@dataclass(frozen=True, slots=True)
class StepRecord:
    """One recorded step.

    Attributes:
        counter: of the answered telegram, None without one.
        outputs: plain values by name; the horizon as a digest.
    """

    counter: int | None
    state: str
    inputs: Inputs
    outputs: dict[str, Any]


def encode(counter: int | None, state: str, inputs: Inputs, outputs: Outputs) -> bytes:
    """Encode one step as a msgpack array.

    Args:
        counter: of the answered telegram, None without one.
    """
    # A counter may be longer than msgpack's integers.
    is_plain = counter is None or -(2**63) <= counter < 2**64
    # Known objects are flattened here: msgpack calls back for each object that it meets.
    entered, results = list(_OF_INPUTS(inputs)), list(_OF_OUTPUTS(outputs))
    if inputs.robot is not None:
        entered[_ROBOT] = _OF_ROBOT(inputs.robot)
    for place, values in _OF_SAMPLES:
        entered[place] = [values(sample) for sample in entered[place]]
    if outputs.horizon is not None:
        results[_HORIZON] = digest(outputs.horizon)
    return _pack((VERSION, counter if is_plain else str(counter), state, entered, results))


def decode(data: bytes, layout: Mapping[str, tuple[str, ...]] = LAYOUT) -> StepRecord:
    """Decode one step.

    Args:
        data: bytes of ``encode``, of this or an earlier version.
        layout: field names of the recording.

    Raises:
        RecordingError: the bytes are not a step of that layout.
    """
    try:
        version, *rest = msgpack.unpackb(data, use_list=False)
    except (ValueError, TypeError, msgpack.UnpackException) as error:
        raise RecordingError(f"not a step: {type(error).__name__}: {error}") from error
    if version != VERSION:
        raise RecordingError(f"version {version!r} of a step is not known")
    try:
        counter, state, inputs, outputs = rest
        return StepRecord(
            counter=None if counter is None else int(counter),
            state=state,
            inputs=_inputs(inputs, layout),
            outputs=dict(zip(layout["Outputs"], outputs, strict=True)),
        )
    except (ValueError, TypeError, KeyError) as error:
        raise RecordingError(f"not a step: {type(error).__name__}: {error}") from error


def differences(record: StepRecord, outputs: Outputs) -> tuple[str, ...]:
    """Return the names of outputs that differ from the recorded ones in any bit.

    A name that only one of both has is among them.
    """
    replayed = dict(zip(LAYOUT["Outputs"], _VALUES[Outputs](outputs), strict=True))
    names = [*record.outputs, *(name for name in replayed if name not in record.outputs)]
    return tuple(
        name
        for name in names
        if name not in record.outputs
        or name not in replayed
        or _pack(record.outputs[name]) != _pack(replayed[name])
    )


def plain(outputs: Outputs) -> dict[str, Any]:
    """Return outputs by name as plain values, as a recording has them."""
    values = zip(LAYOUT["Outputs"], _VALUES[Outputs](outputs), strict=True)
    return {name: msgpack.unpackb(_pack(value), use_list=False) for name, value in values}


def digest(array: np.ndarray[Any, Any]) -> bytes:
    """Return 8 bytes that change with any bit of an array."""
    exact = np.ascontiguousarray(array, dtype=np.float64)
    # A checksum, not a signature: BLAKE2b takes ten times as long, half of the cost of recording.
    return crc64.xz(repr(exact.shape).encode() + exact.tobytes()).to_bytes(8, "big")


def _plain(value: object) -> object:
    """Convert a value that msgpack does not know."""
    values = _VALUES.get(type(value))
    if values is not None:
        return values(value)
    if isinstance(value, np.ndarray):
        return digest(value)
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} cannot be recorded")


# One packer for all: each allocates a buffer of 256 KiB, and ``packb`` one a call.
_PACKER = msgpack.Packer(default=_plain)


def _pack(value: object) -> bytes:
    try:
        packed: bytes = _PACKER.pack(value)
    except Exception:
        _PACKER.reset()  # it holds half a value
        raise
    return packed


def _inputs(values: tuple[Any, ...], layout: Mapping[str, tuple[str, ...]]) -> Inputs:
    fields = dict(zip(layout["Inputs"], values, strict=True))

    def samples(name: str, kind: type[Any]) -> tuple[Any, ...]:
        return tuple(_sample(kind, item, layout) for item in fields[name])

    robot = fields["robot"]
    return Inputs(
        **{
            **fields,
            "robot": None if robot is None else _sample(RobotSample, robot, layout),
            "distance": samples("distance", DistanceSample),
            "camera": samples("camera", CameraSample),
            "wrench": samples("wrench", WrenchSample),
            "order": MotionOrder(fields["order"]),
            "chunks": fields.get("chunks", ()),
        }
    )


def _sample(kind: type[Any], values: tuple[Any, ...], layout: Mapping[str, tuple[str, ...]]) -> Any:
    names = (_FORMER_NAMES.get(name, name) for name in layout[kind.__name__])
    return kind(**dict(zip(names, values, strict=True)))
