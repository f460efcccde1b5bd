"""Node of a ROS 2 domain over zenoh: publishers fed from a daemon, and a camera's subscription.

Invariants:
    * A process of its own that asks a daemon as a view does and can order nothing.
    * Camera poses go to the daemon's camera port, as those of any camera.
    * Nothing waits for a subscriber: zenoh drops what it cannot send.
"""

import os
import socket
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import zenoh

from linemate.daemon.operator.ros2 import ros2_keys as keys
from linemate.daemon.operator.ros2 import ros2_messages as messages
from linemate.daemon.recording.viewer_messages import BASE, POSES, root_link
from linemate.daemon.view.cell import AT_ORIGIN, Cell, read_cell
from linemate.daemon.view.channels.daemon_feed import Values, WallClock
from linemate.protocol.sensors.camera_codec import CameraError, encode

TCP: Final = "tcp_measured"
CAMERA: Final = "camera"
SENSOR: Final = "force_torque"
CDR: Final = "application/cdr"

# Topics of poses below the prefix: what they have.
POSE_TOPICS: Final = {"target": "target", "sensed": "sensed", "object": "part", "tcp": TCP}

Pose = Sequence[float]


@dataclass(slots=True)
class Publisher:
    """One topic that is published."""

    publisher: Any
    gid: bytes
    sequence: int = 0

    def publish(self, data: bytes) -> None:
        """Publish a message."""
        self.sequence += 1
        attachment = keys.Attachment(self.sequence, time.time_ns(), self.gid)
        self.publisher.put(data, encoding=CDR, attachment=keys.encode_attachment(attachment))

    def is_wanted(self) -> bool:
        """Return whether anyone has subscribed."""
        return bool(self.publisher.matching_status.matching)


@dataclass(slots=True)
class CameraInput:
    """Where camera poses go.

    Attributes:
        address: the daemon's camera port.
        reader: turns messages into the camera's.
    """

    address: tuple[str, int]
    reader: messages.CameraReader
    on_refusal: Callable[[str], None]
    _socket: socket.socket = field(
        default_factory=lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    )
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def forward(self, sample: "zenoh.Sample") -> None:
        """Send a pose to the daemon; one that is refused is reported."""
        with self._lock:
            try:
                attached = b"" if sample.attachment is None else sample.attachment.to_bytes()
                attachment = keys.decode_attachment(attached)
                data, now_ns = sample.payload.to_bytes(), time.monotonic_ns()
                datagram = encode(self.reader.read(data, attachment, now_ns))
                self._socket.sendto(datagram, self.address)
            except (ValueError, CameraError, OSError) as error:
                self.on_refusal(str(error))

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class Ros2Node:
    """The node: joints, transforms, poses and wrenches of one daemon.

    Args:
        prefix: first part of the topics' names, and the node's name.
        camera: where the poses of ``PREFIX/camera_pose`` go; None takes none.
    """

    def __init__(
        self, session: "zenoh.Session", domain: int, prefix: str, camera: CameraInput | None
    ) -> None:
        self._session = session
        self._node = keys.Node(domain, str(session.info.zid()), prefix)
        self._tokens: list[Any] = [session.liveliness().declare_token(self._node.token())]
        self._joints = self._publisher(f"/{prefix}/joint_states", messages.JOINTS)
        self._transforms = self._publisher("/tf", messages.TRANSFORMS)
        self._wrench = self._publisher(f"/{prefix}/wrench", messages.WRENCH)
        self._poses = {
            name: self._publisher(f"/{prefix}/{name}", messages.POSE) for name in POSE_TOPICS
        }
        self._cell, self._root = Cell(), BASE
        self._wrench_ns: int | None = None
        self._subscriber: Any = None
        if camera is not None:
            topic = messages.topic(f"/{prefix}/camera_pose", messages.CAMERA_POSE)
            self._declare(keys.SUBSCRIPTION, topic)
            self._subscriber = session.declare_subscriber(
                self._node.topic_key(topic), camera.forward
            )

    def is_sampled(self) -> bool:
        """Return whether a node has subscribed to the wrench."""
        return self._wrench.is_wanted()

    def begin(self, scene: Values) -> None:
        """Take the cell of a daemon that has begun to answer."""
        self._cell = read_cell(scene)
        self._root = root_link(str(scene.get("urdf", "")))

    def show(self, telemetry: Values, wall_ns: int) -> None:
        """Publish joints, transforms and poses of a step."""
        measured = telemetry.get("measured")
        poses = {name: telemetry[name] for name in POSES if telemetry.get(name) is not None}
        if measured is not None:
            self._joints.publish(messages.joint_state(wall_ns, measured))
            if self._cell.chain is not None:
                poses[TCP] = self._cell.chain.place([float(axis) for axis in measured])[1]
        for topic, name in POSE_TOPICS.items():
            if name in poses:
                self._poses[topic].publish(messages.pose_stamped(wall_ns, BASE, poses[name]))
        self._transforms.publish(messages.transforms(wall_ns, self._frames(poses)))

    def show_sensors(self, answer: Values, clock: WallClock) -> None:
        """Publish the wrench, if it is new."""
        stamp_ns = answer.get("wrench_ns")
        wall_ns = None if stamp_ns is None else clock.wall(stamp_ns)
        if wall_ns is None or stamp_ns == self._wrench_ns:
            return
        self._wrench_ns = stamp_ns
        self._wrench.publish(messages.wrench_stamped(wall_ns, SENSOR, answer["wrench"]))

    def close(self) -> None:
        """Leave the domain."""
        if self._subscriber is not None:
            self._subscriber.undeclare()
        for token in self._tokens:
            token.undeclare()

    def _frames(self, poses: dict[str, Pose]) -> dict[str, tuple[str, Pose]]:
        frames: dict[str, tuple[str, Pose]] = {}
        if self._root != BASE:
            frames[self._root] = (BASE, AT_ORIGIN)
        frames |= {POSES.get(name, name): (BASE, pose) for name, pose in poses.items()}
        if TCP in poses and self._cell.camera is not None:
            frames[CAMERA] = (TCP, self._cell.camera)
        return frames

    def _publisher(self, name: str, kind: str) -> Publisher:
        topic = messages.topic(name, kind)
        publisher = self._session.declare_publisher(
            self._node.topic_key(topic), congestion_control=zenoh.CongestionControl.DROP
        )
        self._declare(keys.PUBLISHER, topic)
        return Publisher(publisher, os.urandom(keys.GID_BYTES))

    def _declare(self, kind: str, topic: keys.Topic) -> None:
        token = self._node.endpoint_token(len(self._tokens), kind, topic)
        self._tokens.append(self._session.liveliness().declare_token(token))
