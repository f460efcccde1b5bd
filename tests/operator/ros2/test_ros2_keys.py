"""Keys, tokens and attachments: those of a foreign implementation of rmw_zenoh."""

import pytest

pytest.importorskip("rosbags", reason="rosbags is in the extra ros2")
pytest.importorskip("zenoh_ros2_sdk", reason="zenoh-ros2-sdk is in the extra dev")
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import attachment as sdk_attachment
from zenoh_ros2_sdk import entity, keyexpr, qos
from zenoh_ros2_sdk.utils import ros2_to_dds_type

from linemate.daemon.operator.ros2 import ros2_keys as keys
from linemate.daemon.operator.ros2 import ros2_messages as messages

KINDS = (messages.JOINTS, messages.TRANSFORMS, messages.POSE, messages.WRENCH, messages.CAMERA_POSE)
NODE = keys.Node(7, "a1b2c3", "linemate")


@pytest.mark.parametrize("kind", KINDS)
def test_keys_and_tokens_are_those_of_a_foreign_implementation(kind: str) -> None:
    topic = messages.topic("/linemate/x", kind)
    name = ros2_to_dds_type(kind)
    assert keys.dds_type(kind) == name
    assert NODE.topic_key(topic) == keyexpr.topic_keyexpr(7, "/linemate/x", name, topic.type_hash)
    node = entity.NodeEntity(7, "a1b2c3", 0, "linemate")
    assert NODE.token() == keyexpr.node_liveliness_keyexpr(node)
    for number, kind_of in ((1, keys.PUBLISHER), (2, keys.SUBSCRIPTION)):
        endpoint = entity.EndpointEntity(
            node, number, entity.EntityKind(kind_of), topic.name, name, topic.type_hash, keys.QOS
        )
        expected = keyexpr.endpoint_liveliness_keyexpr(endpoint)
        assert NODE.endpoint_token(number, kind_of, topic) == expected


def test_the_quality_of_service_is_reliable_volatile_and_keeps_ten() -> None:
    profile = qos.QosProfile.decode(keys.QOS)
    assert profile == qos.QosProfile(history_depth=10)
    assert profile.reliability is qos.QosReliability.RELIABLE
    assert profile.durability is qos.QosDurability.VOLATILE


def test_the_hash_of_a_type_is_the_one_that_ros_publishes() -> None:
    # As seen on the wire of Jazzy.
    joints = "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
    assert messages.topic("/joint_states", messages.JOINTS).type_hash == joints


@pytest.mark.parametrize("kind", KINDS)
def test_the_hash_of_a_type_is_that_of_a_foreign_implementation(kind: str) -> None:
    from zenoh_ros2_sdk.utils import compute_type_hash_from_msg

    store = get_typestore(Stores.ROS2_JAZZY)
    definition, *others = store.generate_msgdef(kind, ros_version=2)[0].split("=" * 80 + "\n")
    parts = dict(part.removeprefix("MSG: ").split("\n", 1) for part in others)
    full = {name.replace("/", "/msg/") if "/msg/" not in name else name: text
            for name, text in parts.items()}  # fmt: skip
    expected = compute_type_hash_from_msg(kind, definition, full)
    assert messages.topic("/x", kind).type_hash == expected


def test_an_attachment_comes_back_here_and_there() -> None:
    attachment = keys.Attachment(5, 1_700_000_000_123_456_789, bytes(range(16)))
    data = keys.encode_attachment(attachment)
    assert keys.decode_attachment(data) == attachment
    other = sdk_attachment.Attachment.from_bytes(data)
    assert (other.sequence_id, other.timestamp_ns, other.gid) == attachment
    assert other.to_bytes() == data


@pytest.mark.parametrize("data", [b"", b"\0" * 32, b"\0" * 34, b"\0" * 16 + b"\x0f" + b"\0" * 16])
def test_what_is_no_attachment_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match="expected"):
        keys.decode_attachment(data)
