"""EgmRobot and EgmSensor by Google's protobuf runtime: a codec of its own.

The schema is described here as data, in a descriptor pool of its own. The two public clients
register a file of the same name, so neither of them can be imported next to another.
"""

from typing import Any

import pytest

pytest.importorskip("google.protobuf", reason="the test-only package protobuf is not installed")

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory  # type: ignore[import-untyped]

# Message: its fields as (number, name, type); "*" repeated, "!" required.
COMMON = {
    "EgmHeader": [(1, "seqno", "uint32"), (2, "tm", "uint32"), (3, "mtype", "uint32")],
    "EgmCartesian": [(n, name, "!double") for n, name in enumerate("xyz", 1)],
    "EgmQuaternion": [(n + 1, f"u{n}", "!double") for n in range(4)],
    "EgmClock": [(1, "sec", "!uint64"), (2, "usec", "!uint64")],
    "EgmPose": [(1, "pos", "EgmCartesian"), (2, "orient", "EgmQuaternion")],
    "EgmJoints": [(1, "joints", "*double")],
    "EgmState": [(1, "state", "!uint32")],
    "EgmPosition": [
        (1, "joints", "EgmJoints"),
        (2, "cartesian", "EgmPose"),
        (3, "externalJoints", "EgmJoints"),
        (4, "time", "EgmClock"),
    ],
    "EgmTestSignals": [(1, "signals", "*double")],
    "EgmSensor": [
        (1, "header", "EgmHeader"),
        (2, "planned", "EgmPosition"),
        (3, "speedRef", "EgmPosition"),
    ],
}
ROBOT = [
    (1, "header", "EgmHeader"),
    (2, "feedBack", "EgmPosition"),
    (3, "planned", "EgmPosition"),
    (4, "motorState", "EgmState"),
    (5, "mciState", "EgmState"),
    (6, "mciConvergenceMet", "bool"),
    (7, "testSignals", "EgmTestSignals"),
    (8, "rapidExecState", "EgmState"),
    (9, "measuredForce", "EgmMeasuredForce"),
    (10, "utilizationRate", "double"),
]
GENERATIONS: dict[int, dict[str, list[tuple[int, str, str]]]] = {
    6: {"EgmMeasuredForce": [(1, "force", "*double")], "EgmRobot": ROBOT},
    7: {
        "EgmMeasuredForce": [(1, "fcActive", "bool"), (2, "force", "*double")],
        "EgmRobot": [*ROBOT, (11, "moveIndex", "uint32")],
    },
}
_TYPE = descriptor_pb2.FieldDescriptorProto


def _classes(robotware: int) -> dict[str, Any]:
    package = f"witness{robotware}"
    file = descriptor_pb2.FileDescriptorProto(name=f"{package}.proto", package=package)
    for name, fields in (COMMON | GENERATIONS[robotware]).items():
        message = file.message_type.add(name=name)
        for number, field_name, text in fields:
            kind = text.lstrip("*!")
            field = message.field.add(name=field_name, number=number, label=_TYPE.LABEL_OPTIONAL)
            field.label = {"*": _TYPE.LABEL_REPEATED, "!": _TYPE.LABEL_REQUIRED}.get(
                text[0], _TYPE.LABEL_OPTIONAL
            )
            if kind.startswith("Egm"):
                field.type, field.type_name = _TYPE.TYPE_MESSAGE, f".{package}.{kind}"
            else:
                field.type = getattr(_TYPE, f"TYPE_{kind.upper()}")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {
        message.name: message_factory.GetMessageClass(
            pool.FindMessageTypeByName(f"{package}.{message.name}")
        )
        for message in file.message_type
    }


_CLASSES = {robotware: _classes(robotware) for robotware in GENERATIONS}


def robot_message(robotware: int = 6) -> Any:
    """Return an EgmRobot message with every field of joint mode, in the wire's units."""
    message = _CLASSES[robotware]["EgmRobot"]()
    message.header.seqno, message.header.tm, message.header.mtype = 4711, 123456, 2
    for position, offset in ((message.feedBack, 0.0), (message.planned, 0.5)):
        position.joints.joints.extend(offset + 10.0 * n for n in range(6))
        position.externalJoints.joints.append(1500.0 + offset)
        position.cartesian.pos.x = 100.0
        position.cartesian.pos.y, position.cartesian.pos.z = 200.0, 300.0
        orient = position.cartesian.orient
        orient.u0, orient.u1, orient.u2, orient.u3 = 1.0, 0.0, 0.0, 0.0
        position.time.sec, position.time.usec = 1_700_000_000, 250_000
    message.motorState.state, message.mciState.state = 1, 3
    message.mciConvergenceMet = True
    message.testSignals.signals.extend((1.0, 2.0))
    message.rapidExecState.state = 2
    message.measuredForce.force.extend((1.0, 2.0, 3.0, 0.1, 0.2, 0.3))
    message.utilizationRate = 42.0
    if robotware == 7:
        message.measuredForce.fcActive = True
        message.moveIndex = 3
    return message


def parse_robot(data: bytes, robotware: int = 6) -> Any:
    """Return an EgmRobot message read by the runtime."""
    return _CLASSES[robotware]["EgmRobot"].FromString(data)


def sensor_message() -> Any:
    """Return an EgmSensor message with setpoints and speeds, in the wire's units."""
    message = _CLASSES[6]["EgmSensor"]()
    message.header.seqno, message.header.tm, message.header.mtype = 7, 99, 3
    message.planned.joints.joints.extend((1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    message.planned.externalJoints.joints.append(250.0)
    message.speedRef.joints.joints.extend((0.1, 0.2, 0.3, 0.4, 0.5, 0.6))
    message.speedRef.externalJoints.joints.append(80.0)
    return message


def parse_sensor(data: bytes) -> Any:
    """Return an EgmSensor message read by the runtime."""
    return _CLASSES[6]["EgmSensor"].FromString(data)
