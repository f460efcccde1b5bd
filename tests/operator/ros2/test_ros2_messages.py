"""Messages in CDR, judged by another type store; and a camera's poses by the camera's decoder."""

import random

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is in the extra ros2")
from rosbags.typesys import Stores, get_typestore

from linemate.daemon.operator.ros2 import ros2_messages as messages
from linemate.daemon.operator.ros2.ros2_keys import Attachment
from linemate.protocol.sensors.camera_codec import CameraDecoder, encode

STORE = get_typestore(Stores.ROS2_HUMBLE)  # these messages are the same in every release
WALL_NS = 1_700_000_000_123_456_789
POSE = (1.0, -2.0, 3.5, 0.5, 0.1, 0.7, 0.5)
ONE, TWO = b"1" * 16, b"2" * 16


def test_joints_are_named_and_in_si() -> None:
    data = messages.joint_state(WALL_NS, (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 1.5))
    joints = STORE.deserialize_cdr(data, messages.JOINTS)
    assert joints.name == ["A1", "A2", "A3", "A4", "A5", "A6", "E1"]
    assert list(joints.position) == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 1.5]
    assert (joints.header.stamp.sec, joints.header.stamp.nanosec) == divmod(WALL_NS, 10**9)


def test_poses_transforms_and_wrenches_keep_every_bit() -> None:
    pose = STORE.deserialize_cdr(messages.pose_stamped(WALL_NS, "base", POSE), messages.POSE)
    where, turn = pose.pose.position, pose.pose.orientation
    assert (where.x, where.y, where.z, turn.w, turn.x, turn.y, turn.z) == POSE
    frames = {"tcp": ("base", POSE), "camera": ("tcp", POSE)}
    listed = STORE.deserialize_cdr(messages.transforms(WALL_NS, frames), messages.TRANSFORMS)
    named = {t.child_frame_id: (t.header.frame_id, t.transform) for t in listed.transforms}
    assert {child: parent for child, (parent, _) in named.items()} == {
        "tcp": "base",
        "camera": "tcp",
    }
    assert named["tcp"][1].rotation.y == POSE[5]
    data = messages.wrench_stamped(WALL_NS, "force_torque", (1, 2, 3, 4, 5, 1 / 3))
    wrench = STORE.deserialize_cdr(data, messages.WRENCH)
    assert (wrench.wrench.force.z, wrench.wrench.torque.z) == (3.0, 1 / 3)


def camera_pose(stamp_ns: int = WALL_NS, covariance: object = None, frame: str = "camera") -> bytes:
    """A PoseWithCovarianceStamped of another node."""
    kinds = STORE.types
    values = np.diag([1e-6] * 3 + [1e-7] * 3).ravel() if covariance is None else covariance
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    time = kinds["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    point = kinds["geometry_msgs/msg/Point"](x=0.1, y=0.2, z=0.7)
    turn = kinds["geometry_msgs/msg/Quaternion"](x=0.1, y=0.7, z=0.5, w=0.5)
    pose = kinds["geometry_msgs/msg/Pose"](position=point, orientation=turn)
    message = kinds[messages.CAMERA_POSE](
        header=kinds["std_msgs/msg/Header"](stamp=time, frame_id=frame),
        pose=kinds["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=values),
    )
    return bytes(STORE.serialize_cdr(message, messages.CAMERA_POSE))


def test_a_pose_reaches_the_cameras_decoder_with_its_exposure_and_covariance() -> None:
    reader, decoder = messages.CameraReader("hub"), CameraDecoder("camera", "hub")
    sent_ns = WALL_NS + 40_000_000
    datagram = encode(reader.read(camera_pose(), Attachment(3, sent_ns, ONE), 0))
    sample = decoder.feed(datagram, 5_000_000_000)
    assert sample.position == (0.1, 0.2, 0.7)
    assert sample.quaternion == (0.5, 0.1, 0.7, 0.5)
    # Exposed 40 ms before it was sent; the way here is not known.
    assert sample.exposure_ns == 5_000_000_000 - 40_000_000
    assert sample.covariance is not None
    assert [sample.covariance[at] for at in (0, 6, 11, 15, 18, 20)] == [1e-6] * 3 + [1e-7] * 3
    assert (sample.source, sample.sequence) == ("ros2", 3)


def test_a_covariance_of_zeros_is_not_known() -> None:
    reader = messages.CameraReader("hub")
    read = reader.read(camera_pose(covariance=np.zeros(36)), Attachment(1, WALL_NS, ONE), 0)
    assert read.cov is None


def test_one_publisher_is_the_camera_until_it_is_silent() -> None:
    reader, decoder = messages.CameraReader("hub"), CameraDecoder()
    second_ns = 1_000_000_000
    for k in range(3):
        sent_ns = WALL_NS + k * second_ns
        attachment = Attachment(100 + k, sent_ns, ONE)
        read = reader.read(camera_pose(sent_ns), attachment, k * second_ns)
        decoder.feed(encode(read), k * second_ns)
    with pytest.raises(ValueError, match="is not the camera"):
        reader.read(camera_pose(), Attachment(1, WALL_NS, TWO), 3 * second_ns)
    assert (reader.accepted, reader.refused) == (3, 1)
    late_ns = 2 * second_ns + messages.TAKEOVER_NS
    sent_ns = WALL_NS + late_ns
    taken = reader.read(camera_pose(sent_ns), Attachment(1, sent_ns, TWO), late_ns)
    assert taken.reset == 1
    # Its numbers begin again: the decoder takes them, because the tracker was restarted.
    assert decoder.feed(encode(taken), late_ns).sequence == 1


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "not a"),
        (camera_pose()[:-1], "not a"),
        (camera_pose() + b"\0" * 1024, "limit 1024"),
        (camera_pose(stamp_ns=0), "time of the exposure is missing"),
        (camera_pose(covariance=np.arange(36.0)), "not symmetric"),
    ],
    ids=["empty", "short", "long", "no time", "covariance"],
)
def test_what_is_no_pose_is_refused_and_counted(data: bytes, reason: str) -> None:
    reader = messages.CameraReader("hub")
    with pytest.raises(ValueError, match=reason):
        reader.read(data, Attachment(1, WALL_NS, ONE), 0)
    assert (reader.accepted, reader.refused) == (0, 1)


def test_a_damaged_message_is_read_or_refused() -> None:
    rng, whole = random.Random(5), camera_pose()
    read = 0
    for _ in range(3000):
        data = bytearray(whole)
        for _ in range(rng.randint(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        reader = messages.CameraReader("hub")
        try:
            reader.read(bytes(data), Attachment(1, WALL_NS, ONE), 0)
            read += 1
        except ValueError:
            assert reader.refused == 1
    assert 0 < read < 3000
