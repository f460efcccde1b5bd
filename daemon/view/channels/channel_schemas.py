"""Protobuf messages of our own, for values that have no standard message.

Invariants:
    * Units are SI. A value that is not known is NaN, so that a plot has a gap there.
    * Fields are only added. Their numbers are their places in ``FIELDS``.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any, Final

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

PACKAGE: Final = "linemate"
_FILE: Final = "linemate/channels.proto"
_TIME: Final = "google.protobuf.Timestamp"
_NUMBER, _TEXT, _COUNT, _FLAG = "double", "string", "int64", "bool"

# Fields of each message after ``timestamp``: name and type.
FIELDS: Final[dict[str, tuple[tuple[str, str], ...]]] = {
    "Vector": (("x", _NUMBER), ("y", _NUMBER), ("z", _NUMBER)),
    # Force [N] and torque [Nm] in the sensor's frame.
    "Wrench": (("frame_id", _TEXT), ("force", "Vector"), ("torque", "Vector")),
    # Reading of the distance sensor at the conveyor [m], and its signal strength.
    "Distance": (("position", _NUMBER), ("strength", _NUMBER)),
    # Class in force, also as its number among the classes; log odds; speed [m/s].
    "Conveyor": (
        ("scenario", _TEXT),
        ("scenario_number", _COUNT),
        ("tentative", _FLAG),
        ("confidence", _NUMBER),
        ("speed", _NUMBER),
    ),
    # Operating state, also as its number; phase and clock of the task [s].
    "TaskState": (
        ("state", _TEXT),
        ("state_number", _COUNT),
        ("phase", _TEXT),
        ("task_time", _NUMBER),
        ("contact", _FLAG),
        ("held", _TEXT),
    ),
    # Distances [m]: tcp to committed pose, committed to sensed pose, tcp to hub.
    "Errors": (("control", _NUMBER), ("plan", _NUMBER), ("gap", _NUMBER)),
    # Of one cycle [s]: telegram to reply, computing time, ready reply to telegram, lateness.
    "CycleDurations": (
        ("turnaround", _NUMBER),
        ("step", _NUMBER),
        ("lead", _NUMBER),
        ("woken_late", _NUMBER),
    ),
}

_TYPES: Final = {
    _NUMBER: descriptor_pb2.FieldDescriptorProto.TYPE_DOUBLE,
    _TEXT: descriptor_pb2.FieldDescriptorProto.TYPE_STRING,
    _COUNT: descriptor_pb2.FieldDescriptorProto.TYPE_INT64,
    _FLAG: descriptor_pb2.FieldDescriptorProto.TYPE_BOOL,
}


def encode_own(name: str, wall_ns: int, values: Mapping[str, Any]) -> bytes:
    """Encode a message.

    Args:
        wall_ns: time since the epoch [ns].
        values: by field; a vector is a map of x, y and z. A number that is None is NaN.

    Raises:
        ValueError, TypeError: a value does not fit its field.
    """
    numbers = {field for field, kind in FIELDS[name] if kind == _NUMBER}
    known = {field: value for field, value in values.items() if value is not None}
    seconds, nanoseconds = divmod(wall_ns, 1_000_000_000)
    known["timestamp"] = {"seconds": seconds, "nanos": nanoseconds}
    message = _message(name)(**{**dict.fromkeys(numbers, float("nan")), **known})
    encoded: bytes = message.SerializeToString()
    return encoded


@cache
def descriptor_set() -> bytes:
    """Return the file descriptors of all own messages, as MCAP wants them for protobuf."""
    time = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(time)
    files = descriptor_pb2.FileDescriptorSet(file=[time, _file()])
    encoded: bytes = files.SerializeToString(deterministic=True)
    return encoded


@cache
def _message(name: str) -> Any:
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(descriptor_set()).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{PACKAGE}.{name}"))


def _file() -> Any:
    """Return the descriptor of the file that FIELDS describes."""
    file = descriptor_pb2.FileDescriptorProto(
        name=_FILE, package=PACKAGE, syntax="proto3", dependency=[timestamp_pb2.DESCRIPTOR.name]
    )
    for name, fields in FIELDS.items():
        message = file.message_type.add(name=name)
        whole = fields if name == "Vector" else (("timestamp", _TIME), *fields)
        for number, (field, kind) in enumerate(whole, 1):
            entry = message.field.add(
                name=field, number=number, label=descriptor_pb2.FieldDescriptorProto.LABEL_OPTIONAL
            )
            if kind in _TYPES:
                entry.type = _TYPES[kind]
            else:
                entry.type = descriptor_pb2.FieldDescriptorProto.TYPE_MESSAGE
                entry.type_name = f".{kind}" if kind == _TIME else f".{PACKAGE}.{kind}"
    return file
