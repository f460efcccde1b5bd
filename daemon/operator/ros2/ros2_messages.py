"""ROS 2 messages in CDR: joints, transforms, poses and wrenches out, camera poses in.

Invariants:
    * Pure. ``rosbags`` encodes and decodes, with the message definitions of Jazzy.
    * A camera pose that does not fit is a ValueError. Its values are judged by the daemon.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from rosbags.typesys import Stores, get_typestore

from linemate.daemon.operator.ros2.ros2_keys import Attachment, Topic
from linemate.protocol.sensors.camera_codec import CameraMessage
from linemate.protocol.stamped_samples import AXES

JOINTS: Final = "sensor_msgs/msg/JointState"
TRANSFORMS: Final = "tf2_msgs/msg/TFMessage"
POSE: Final = "geometry_msgs/msg/PoseStamped"
WRENCH: Final = "geometry_msgs/msg/WrenchStamped"
CAMERA_POSE: Final = "geometry_msgs/msg/PoseWithCovarianceStamped"

SOURCE: Final = "ros2"  # name of the camera in the daemon
MAX_MESSAGE: Final = 1024  # a camera pose has 360 bytes and the name of its frame
TAKEOVER_NS: Final = 5_000_000_000  # silence after which another publisher is the camera

Pose = Sequence[float]  # position [m], quaternion w first

_STORE: Final = get_typestore(Stores.ROS2_JAZZY)
_UPPER: Final = np.triu_indices(6)


def topic(name: str, kind: str) -> Topic:
    """Return a topic with the hash of its message type."""
    return Topic(name, kind, _STORE.hash_rihs01(kind))


def joint_state(wall_ns: int, axes: Sequence[float]) -> bytes:
    """Encode axes: A1..A6 [rad], E1 [m]."""
    none = np.array([], dtype=np.float64)
    values = np.array(axes, dtype=np.float64)
    names = list(AXES[: len(values)])
    return _encode(
        JOINTS, header=_header(wall_ns, ""), name=names, position=values, velocity=none, effort=none
    )


def transforms(wall_ns: int, frames: Mapping[str, tuple[str, Pose]]) -> bytes:
    """Encode transforms: parent and pose of each frame by its name."""
    listed = [
        _make(
            "geometry_msgs/msg/TransformStamped",
            header=_header(wall_ns, parent),
            child_frame_id=child,
            transform=_make(
                "geometry_msgs/msg/Transform",
                translation=_vector(pose[:3]),
                rotation=_quaternion(pose[3:]),
            ),
        )
        for child, (parent, pose) in frames.items()
    ]
    return _encode(TRANSFORMS, transforms=listed)


def pose_stamped(wall_ns: int, frame: str, pose: Pose) -> bytes:
    """Encode a pose."""
    x, y, z = (float(value) for value in pose[:3])
    point = _make("geometry_msgs/msg/Point", x=x, y=y, z=z)
    whole = _make("geometry_msgs/msg/Pose", position=point, orientation=_quaternion(pose[3:]))
    return _encode(POSE, header=_header(wall_ns, frame), pose=whole)


def wrench_stamped(wall_ns: int, frame: str, wrench: Sequence[float]) -> bytes:
    """Encode force [N] and torque [Nm]."""
    force, torque = _vector(wrench[:3]), _vector(wrench[3:])
    whole = _make("geometry_msgs/msg/Wrench", force=force, torque=torque)
    return _encode(WRENCH, header=_header(wall_ns, frame), wrench=whole)


class CameraReader:
    """Turns poses of one publisher into the camera's messages.

    The first publisher is the camera. Another one is refused until the first is silent for
    TAKEOVER_NS, as the camera's port does it with senders.

    Attributes:
        accepted, refused: number of messages since the bridge began.
    """

    def __init__(self, name: str) -> None:
        self.accepted = 0
        self.refused = 0
        self._object = name
        self._gid = b""
        self._newest_ns = 0
        self._resets = 0

    def read(self, data: bytes, attachment: Attachment, now_ns: int) -> CameraMessage:
        """Return the camera's message of a ``PoseWithCovarianceStamped``.

        Args:
            now_ns: monotonic time of its arrival [ns].

        Raises:
            ValueError: it is no such message, has no time, or another publisher is the camera.
        """
        try:
            self._check(data, attachment.gid, now_ns)
            message = self._message(_decode(CAMERA_POSE, data), attachment)
        except ValueError:
            self.refused += 1
            raise
        if attachment.gid != self._gid:
            self._resets += bool(self._gid)
            self._gid = attachment.gid
        self._newest_ns = now_ns
        self.accepted += 1
        return message

    def _check(self, data: bytes, gid: bytes, now_ns: int) -> None:
        if len(data) > MAX_MESSAGE:
            raise ValueError(f"message of {len(data)} bytes, limit {MAX_MESSAGE}")
        is_other = self._gid not in {b"", gid}
        if is_other and now_ns - self._newest_ns < TAKEOVER_NS:
            raise ValueError(f"publisher {gid.hex()} is not the camera, which is {self._gid.hex()}")

    def _message(self, value: Any, attachment: Attachment) -> CameraMessage:
        stamp, pose = value.header.stamp, value.pose.pose
        if stamp.sec <= 0:
            raise ValueError(f"header.stamp is {stamp.sec} s: the time of the exposure is missing")
        where, turn = pose.position, pose.orientation
        is_other = self._gid not in {b"", attachment.gid}
        return CameraMessage(
            v=1,
            src=SOURCE,
            seq=max(attachment.sequence, 0),
            t_exp=stamp.sec * 1_000_000_000 + stamp.nanosec,
            t_tx=attachment.stamp_ns,
            frame=value.header.frame_id,
            obj=self._object,
            p=(where.x, where.y, where.z),
            q=(turn.w, turn.x, turn.y, turn.z),
            cov=_covariance(value.pose.covariance),
            reset=self._resets + is_other,
        )


def _covariance(values: Any) -> tuple[float, ...] | None:
    """Return the upper triangle of a covariance, None if it is zero, as ROS has it if unknown.

    Raises:
        ValueError: it is not symmetric.
    """
    whole = np.asarray(values, dtype=np.float64).reshape(6, 6)
    if not whole.any():
        return None
    if not np.allclose(whole, whole.T, rtol=1e-6, atol=0.0, equal_nan=True):
        raise ValueError("covariance is not symmetric")
    return tuple(float(value) for value in whole[_UPPER])


def _make(kind: str, **fields: Any) -> Any:
    return _STORE.types[kind](**fields)


def _encode(kind: str, **fields: Any) -> bytes:
    return bytes(_STORE.serialize_cdr(_make(kind, **fields), kind))


def _decode(kind: str, data: bytes) -> Any:
    try:
        return _STORE.deserialize_cdr(data, kind)
    except Exception as error:  # the package raises a dozen kinds for bytes that are no message
        raise ValueError(f"not a {kind}: {type(error).__name__}: {error}") from error


def _header(wall_ns: int, frame: str) -> Any:
    seconds, nanoseconds = divmod(max(wall_ns, 0), 1_000_000_000)
    stamp = _make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return _make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def _vector(values: Sequence[float]) -> Any:
    x, y, z = (float(value) for value in values)
    return _make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _quaternion(values: Sequence[float]) -> Any:
    w, x, y, z = (float(value) for value in values)
    return _make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
