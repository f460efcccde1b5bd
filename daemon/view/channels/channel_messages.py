"""Messages of the standard channels, from telemetry or from recorded steps and samples.

Invariants:
    * Pure: plain values in, bytes out. ``foxglove-sdk`` encodes the standard messages.
    * Errors are those of the view (``frames.Framer``). Nothing is computed twice.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, Final, NamedTuple

from foxglove import messages

from linemate.daemon.core.tracking.conveyor import Motion
from linemate.daemon.cycle.states import State
from linemate.daemon.recording.viewer_messages import BASE, POSES
from linemate.daemon.view.cell import Cell
from linemate.daemon.view.channels import channel_schemas
from linemate.daemon.view.frames import Framer, Moment
from linemate.protocol.stamped_samples import AXES

LAYOUT_FILE: Final = Path(__file__).parent / "data" / "linemate-foxglove.json"
TCP_MEASURED: Final = "tcp_measured"
CAMERA: Final = "camera"
SENSOR: Final = "force_torque"  # frame of the wrench
SHOWN_NS: Final = 20_000_000  # between two scenes and two sets of transforms [ns]
HUB_RADIUS: Final = 0.05  # of the sphere that stands for the object [m]

_NO_TURN: Final = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
_MM: Final = 1e-3

# Name of each topic's schema.
TOPICS: Final[dict[str, str]] = {
    "/joints": "foxglove.JointStates",
    "/joints_commanded": "foxglove.JointStates",
    "/tf": "foxglove.FrameTransforms",
    "/scene": "foxglove.SceneUpdate",
    **{f"/pose/{name}": "foxglove.PoseInFrame" for name in POSES},
    "/pose/measured": "foxglove.PoseInFrame",
    "/camera/pose": "foxglove.PoseInFrame",
    "/log": "foxglove.Log",
    "/wrench": "linemate.Wrench",
    "/distance": "linemate.Distance",
    "/conveyor": "linemate.Conveyor",
    "/state": "linemate.TaskState",
    "/errors": "linemate.Errors",
    "/cycle": "linemate.CycleDurations",
}


class ChannelMessage(NamedTuple):
    """Message of one topic, with its time since the epoch [ns]."""

    topic: str
    wall_ns: int
    data: bytes


def descriptor(schema: str) -> bytes:
    """Return the file descriptors of a schema, as MCAP and Foxglove want them."""
    package, _, name = schema.partition(".")
    if package == channel_schemas.PACKAGE:
        return channel_schemas.descriptor_set()
    data: bytes = getattr(messages, name).get_schema().data
    return data


@dataclass(slots=True)
class StandardChannels:
    """Makes the messages of one cell.

    Attributes:
        cell: texts that were read; its chain gives the measured tcp.
        root: first link of the URDF, whose frame is base.
        camera_frame: frame of the newest camera pose.
    """

    cell: Cell
    root: str = BASE
    camera_frame: str = CAMERA
    _framer: Framer = field(init=False)
    _shown_ns: int | None = None

    def __post_init__(self) -> None:
        self._framer = Framer(self.cell)

    def moment(self, moment: Moment, wall_ns: int) -> Iterator[ChannelMessage]:
        """Yield joints, poses, transforms, scene, conveyor, state and errors of a step.

        Args:
            moment: telemetry, or the same of a recorded step.
            wall_ns: time of the step since the epoch [ns].
        """
        frame = self._framer.frame(moment)
        if frame is None:
            return
        tcp = self._measured_tcp(moment)
        yield from _joints("/joints_commanded", wall_ns, moment.get("command"))
        yield from _joints("/joints", wall_ns, moment.get("measured"))
        yield from _conveyor(moment, wall_ns)
        yield from _task_state(moment, wall_ns)
        errors = {name.removesuffix("_mm"): _MM * value for name, value in frame["errors"].items()}
        yield _own("/errors", wall_ns, errors)
        known = {name: moment[name] for name in POSES if moment.get(name) is not None}
        for name, pose in known.items():
            yield _pose(f"/pose/{name}", wall_ns, BASE, pose)
        if tcp is not None:
            yield _pose("/pose/measured", wall_ns, BASE, tcp)
        if self._shown_ns is None or not 0 <= wall_ns - self._shown_ns < SHOWN_NS:
            self._shown_ns = wall_ns
            yield self._transforms(wall_ns, known, tcp)
            yield _scene(wall_ns, frame.get("arm", ()), known.get("part"))

    def wrench(
        self, wall_ns: int, force: Sequence[float], torque: Sequence[float]
    ) -> ChannelMessage:
        """Return a reading of the force-torque sensor [N, Nm]."""
        values = {"frame_id": SENSOR, "force": _vector(force), "torque": _vector(torque)}
        return _own("/wrench", wall_ns, values)

    def distance(
        self, wall_ns: int, position: float, strength: float | None = None
    ) -> ChannelMessage:
        """Return a reading of the distance sensor [m]."""
        return _own("/distance", wall_ns, {"position": position, "strength": strength})

    def camera(self, wall_ns: int, frame: str, pose: Sequence[float]) -> ChannelMessage:
        """Return a pose of an object.

        Args:
            wall_ns: time of the exposure since the epoch [ns].
            pose: position [m] and quaternion, w first.
        """
        self.camera_frame = frame
        return _pose("/camera/pose", wall_ns, frame, pose)

    def durations(self, wall_ns: int, durations_ns: Mapping[str, float | None]) -> ChannelMessage:
        """Return the durations of a cycle, given in ns by the fields of CycleDurations."""
        seconds = {
            name: None if value is None else 1e-9 * value for name, value in durations_ns.items()
        }
        return _own("/cycle", wall_ns, seconds)

    def line(self, wall_ns: int, text: str, level: int, name: str) -> ChannelMessage:
        """Return a line of the log; ``level`` as in ``viewer_messages``."""
        levels = messages.LogLevel
        known = (levels.Unknown, levels.Debug, levels.Info, levels.Warning, levels.Error)
        kind = known[level] if 0 <= level < len(known) else levels.Fatal
        log = messages.Log(timestamp=_time(wall_ns), level=kind, message=text, name=name)
        return ChannelMessage("/log", wall_ns, log.encode())

    def _measured_tcp(self, moment: Moment) -> Sequence[float] | None:
        axes, chain = moment.get("measured"), self.cell.chain
        if axes is None or chain is None or not all(map(math.isfinite, axes)):
            return None
        return chain.place([float(axis) for axis in axes])[1]

    def _transforms(
        self, wall_ns: int, known: Mapping[str, Sequence[float]], tcp: Sequence[float] | None
    ) -> ChannelMessage:
        transforms = [_transform(wall_ns, BASE, self.root, _NO_TURN)]
        transforms += [_transform(wall_ns, BASE, POSES[name], known[name]) for name in known]
        if tcp is not None:
            transforms.append(_transform(wall_ns, BASE, TCP_MEASURED, tcp))
            if self.cell.camera is not None:
                camera = self.cell.camera
                transforms.append(_transform(wall_ns, TCP_MEASURED, self.camera_frame, camera))
        data = messages.FrameTransforms(transforms=transforms).encode()
        return ChannelMessage("/tf", wall_ns, data)


def _conveyor(moment: Moment, wall_ns: int) -> Iterator[ChannelMessage]:
    if moment.get("scenario") is None:
        return
    values = {
        "scenario": moment["scenario"],
        "scenario_number": _number(Motion, moment["scenario"]),
        "tentative": moment.get("scenario_state") == "tentative",
        "confidence": moment.get("confidence"),
        "speed": moment.get("speed"),
    }
    yield _own("/conveyor", wall_ns, values)


def _task_state(moment: Moment, wall_ns: int) -> Iterator[ChannelMessage]:
    if moment.get("state") is None:
        return
    values = {name: moment.get(name) for name in ("state", "phase", "task_time", "contact", "held")}
    values["state_number"] = _number(State, moment["state"])
    yield _own("/state", wall_ns, values)


def _number(kinds: type[Enum], name: str) -> int:
    """Return the place of a name among its kinds, -1 for another one."""
    names = [kind.value for kind in kinds]
    return names.index(name) if name in names else -1


def _own(topic: str, wall_ns: int, values: Mapping[str, Any]) -> ChannelMessage:
    name = TOPICS[topic].partition(".")[2]
    return ChannelMessage(topic, wall_ns, channel_schemas.encode_own(name, wall_ns, values))


def _joints(topic: str, wall_ns: int, axes: Sequence[float] | None) -> Iterator[ChannelMessage]:
    if axes is None:
        return
    named = zip(AXES, axes, strict=False)
    joints = [messages.JointState(name=name, position=float(value)) for name, value in named]
    data = messages.JointStates(timestamp=_time(wall_ns), joints=joints).encode()
    yield ChannelMessage(topic, wall_ns, data)


def _pose(topic: str, wall_ns: int, frame: str, pose: Sequence[float]) -> ChannelMessage:
    placed = messages.Pose(position=_point(pose[:3]), orientation=_quaternion(pose[3:]))
    message = messages.PoseInFrame(timestamp=_time(wall_ns), frame_id=frame, pose=placed)
    return ChannelMessage(topic, wall_ns, message.encode())


def _transform(
    wall_ns: int, parent: str, child: str, pose: Sequence[float]
) -> messages.FrameTransform:
    return messages.FrameTransform(
        timestamp=_time(wall_ns),
        parent_frame_id=parent,
        child_frame_id=child,
        translation=_point(pose[:3]),
        rotation=_quaternion(pose[3:]),
    )


def _scene(
    wall_ns: int, arm: Sequence[Sequence[float]], part: Sequence[float] | None
) -> ChannelMessage:
    """Return the arm as a line through its joints, and a sphere at the object's hub."""
    corners = [messages.Point3(x=x, y=y, z=z) for x, y, z in arm]
    line = messages.LinePrimitive(
        type=messages.LinePrimitiveLineType.LineStrip,
        thickness=0.06,
        points=corners,
        color=messages.Color(r=0.9, g=0.45, b=0.1, a=1.0),
    )
    spheres = []
    if part is not None:
        size = messages.Vector3(x=2.0 * HUB_RADIUS, y=2.0 * HUB_RADIUS, z=2.0 * HUB_RADIUS)
        hub = messages.Pose(position=_point(part[:3]), orientation=_quaternion(part[3:]))
        colour = messages.Color(r=0.2, g=0.5, b=0.9, a=0.8)
        spheres.append(messages.SpherePrimitive(pose=hub, size=size, color=colour))
    time = _time(wall_ns)
    entity = messages.SceneEntity(
        timestamp=time, frame_id=BASE, id="cell", lines=[line] if corners else [], spheres=spheres
    )
    return ChannelMessage("/scene", wall_ns, messages.SceneUpdate(entities=[entity]).encode())


def _time(wall_ns: int) -> messages.Timestamp:
    seconds, nanoseconds = divmod(max(wall_ns, 0), 1_000_000_000)
    return messages.Timestamp(sec=seconds, nsec=nanoseconds)


def _vector(values: Sequence[float]) -> dict[str, float]:
    return {axis: float(value) for axis, value in zip("xyz", values, strict=True)}


def _point(values: Sequence[float]) -> messages.Vector3:
    return messages.Vector3(**_vector(values))


def _quaternion(values: Sequence[float]) -> messages.Quaternion:
    w, x, y, z = (float(value) for value in values)
    return messages.Quaternion(x=x, y=y, z=z, w=w)
