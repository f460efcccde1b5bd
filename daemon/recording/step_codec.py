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
from linemate.daemon.core.step import Outputs
from linemate.protocol.samples import CameraSample, DistanceSample, RobotSample, WrenchSample

VERSION = 1

_KINDS = (Inputs, Outputs, RobotSample, DistanceSample, CameraSample, WrenchSample)

# The values of each kind, in the order in which they are written.
LAYOUT: dict[str, tuple[str, ...]] = {kind.__name__: kind.__struct_fields__ for kind in _KINDS}

_VALUES: dict[type[Any], Callable[[Any], Any]] = {
    kind: attrgetter(*LAYOUT[kind.__name__]) for kind in _KINDS
}


_OF_INPUTS, _OF_OUTPUTS, _OF_ROBOT = _VALUES[Inputs], _VALUES[Outputs], _VALUES[RobotSample]
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
    """Bytes that are no step."""


@dataclass(frozen=True, slots=True)
class StepRecord:
    """One step as it was recorded.

    Attributes:
        ipoc: of the telegram it answered, None if there was none.
        inputs: exactly what entered the step.
        outputs: the fields of ``Outputs`` by name, plain; the horizon as a digest.
    """

    ipoc: int | None
    state: str
    inputs: Inputs
    outputs: dict[str, Any]


def encode(ipoc: int | None, state: str, inputs: Inputs, outputs: Outputs) -> bytes:
    """Make bytes of one step.

    Args:
        ipoc: of the telegram it answered, None if there was none.

    Returns:
        A msgpack array.
    """
    # An IPOC is as long as its digits; msgpack's integers are not.
    counter = ipoc if ipoc is None or -(2**63) <= ipoc < 2**64 else str(ipoc)
    # What is known to be inside is taken apart here: msgpack asks back for each object it meets.
    entered, said = list(_OF_INPUTS(inputs)), list(_OF_OUTPUTS(outputs))
    if inputs.robot is not None:
        entered[_ROBOT] = _OF_ROBOT(inputs.robot)
    for place, values in _OF_SAMPLES:
        entered[place] = [values(sample) for sample in entered[place]]
    if outputs.horizon is not None:
        said[_HORIZON] = digest(outputs.horizon)
    return _pack((VERSION, counter, state, entered, said))


def decode(data: bytes, layout: Mapping[str, tuple[str, ...]] = LAYOUT) -> StepRecord:
    """Read one step.

    Args:
        data: what ``encode`` made, now or in an earlier version.
        layout: the fields as the recording's own layout tells them.

    Raises:
        RecordingError: the bytes are no step of that layout.
    """
    try:
        version, *rest = msgpack.unpackb(data, use_list=False)
    except (ValueError, TypeError, msgpack.UnpackException) as error:
        raise RecordingError(f"not a step: {type(error).__name__}: {error}") from error
    if version != VERSION:
        raise RecordingError(f"version {version!r} of a step is not known")
    try:
        ipoc, state, inputs, outputs = rest
        return StepRecord(
            ipoc=None if ipoc is None else int(ipoc),
            state=state,
            inputs=_inputs(inputs, layout),
            outputs=dict(zip(layout["Outputs"], outputs, strict=True)),
        )
    except (ValueError, TypeError, KeyError) as error:
        raise RecordingError(f"not a step: {type(error).__name__}: {error}") from error


def differences(record: StepRecord, outputs: Outputs) -> tuple[str, ...]:
    """Which fields of the outputs are not, bit for bit, the recorded ones.

    Args:
        outputs: of the same step, made again.

    Returns:
        Names of fields, those that only one of both has among them.
    """
    made = dict(zip(LAYOUT["Outputs"], _VALUES[Outputs](outputs), strict=True))
    names = [*record.outputs, *(name for name in made if name not in record.outputs)]
    return tuple(
        name
        for name in names
        if name not in record.outputs
        or name not in made
        or _pack(record.outputs[name]) != _pack(made[name])
    )


def plain(outputs: Outputs) -> dict[str, Any]:
    """Outputs by the name of their fields, as a recording tells them: plain values."""
    made = zip(LAYOUT["Outputs"], _VALUES[Outputs](outputs), strict=True)
    return {name: msgpack.unpackb(_pack(value), use_list=False) for name, value in made}


def digest(array: np.ndarray[Any, Any]) -> bytes:
    """What stands for an array in a recording: 8 bytes that change with any bit of it."""
    exact = np.ascontiguousarray(array, dtype=np.float64)
    # A checksum against change, not against malice; BLAKE2b took ten times as long, half of what
    # recording costs a cycle.
    return crc64.xz(repr(exact.shape).encode() + exact.tobytes()).to_bytes(8, "big")


def _plain(value: object) -> object:
    """What msgpack does not know by itself."""
    values = _VALUES.get(type(value))
    if values is not None:
        return values(value)
    if isinstance(value, np.ndarray):
        return digest(value)
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} does not belong into a recording")


# One for all: each brings a buffer of 256 KiB, which ``packb`` makes and throws away each time.
_PACKER = msgpack.Packer(default=_plain)


def _pack(value: object) -> bytes:
    try:
        packed: bytes = _PACKER.pack(value)
    except Exception:
        _PACKER.reset()  # half a value waits in it
        raise
    return packed


def _inputs(values: tuple[Any, ...], layout: Mapping[str, tuple[str, ...]]) -> Inputs:
    given = dict(zip(layout["Inputs"], values, strict=True))

    def samples(name: str, kind: type[Any]) -> tuple[Any, ...]:
        return tuple(_sample(kind, item, layout) for item in given[name])

    robot = given["robot"]
    return Inputs(
        **{
            **given,
            "robot": None if robot is None else _sample(RobotSample, robot, layout),
            "distance": samples("distance", DistanceSample),
            "camera": samples("camera", CameraSample),
            "wrench": samples("wrench", WrenchSample),
            "order": MotionOrder(given["order"]),
        }
    )


def _sample(kind: type[Any], values: tuple[Any, ...], layout: Mapping[str, tuple[str, ...]]) -> Any:
    return kind(**dict(zip(layout[kind.__name__], values, strict=True)))
