"""Keys, liveliness tokens and attachments of ``rmw_zenoh``, by which ROS 2 nodes find each other.

https://github.com/ros2/rmw_zenoh, docs/design.md, as of Jazzy.

Invariants:
    * Pure: no socket, no clock.
    * One node a session, with the number 0. Its endpoints count from 1.
"""

import struct
from dataclasses import dataclass
from typing import Final, NamedTuple

PUBLISHER: Final = "MP"
SUBSCRIPTION: Final = "MS"
GID_BYTES: Final = 16
QOS_DEPTH: Final = 10
# Reliability and durability are the defaults (reliable, volatile); keep the last QOS_DEPTH.
QOS: Final = f"::,{QOS_DEPTH}:,:,:,,"

_ADMIN: Final = "@ros2_lv"
_NODE: Final = "NN"
_ATTACHMENT: Final = struct.Struct(f"<qqB{GID_BYTES}s")


class Topic(NamedTuple):
    """Topic with its message type.

    Attributes:
        name: absolute, such as ``/tf``.
        kind: package, folder and message, as in ``tf2_msgs/msg/TFMessage``.
        type_hash: ``RIHS01_...`` of the type's description (REP 2016).
    """

    name: str
    kind: str
    type_hash: str


class Attachment(NamedTuple):
    """What a publisher sends with a message: its number, its time [ns], its own id."""

    sequence: int
    stamp_ns: int
    gid: bytes


@dataclass(frozen=True, slots=True)
class Node:
    """Node of a ROS 2 domain, without a namespace.

    Attributes:
        session: id of the zenoh session.
    """

    domain: int
    session: str
    name: str

    def token(self) -> str:
        """Return the liveliness token of the node."""
        return f"{self._head(0)}/{_NODE}/%/%/{self.name}"

    def endpoint_token(self, number: int, kind: str, topic: Topic) -> str:
        """Return the liveliness token of a publisher or a subscription.

        Args:
            number: of the endpoint, from 1.
            kind: whether it sends or receives, PUBLISHER or SUBSCRIPTION.
        """
        name = topic.name.replace("/", "%")
        typed = f"{dds_type(topic.kind)}/{topic.type_hash}/{QOS}"
        return f"{self._head(number)}/{kind}/%/%/{self.name}/{name}/{typed}"

    def topic_key(self, topic: Topic) -> str:
        """Return the key of a topic's messages."""
        name = topic.name.strip("/")
        return f"{self.domain}/{name}/{dds_type(topic.kind)}/{topic.type_hash}"

    def _head(self, number: int) -> str:
        return f"{_ADMIN}/{self.domain}/{self.session}/0/{number}"


def dds_type(kind: str) -> str:
    """Return a message type as DDS names it."""
    package, folder, name = kind.split("/")
    return f"{package}::{folder}::dds_::{name}_"


def encode_attachment(attachment: Attachment) -> bytes:
    """Encode an attachment."""
    sequence, stamp_ns, gid = attachment
    return _ATTACHMENT.pack(sequence, stamp_ns, GID_BYTES, gid)


def decode_attachment(data: bytes) -> Attachment:
    """Decode an attachment.

    Raises:
        ValueError: the bytes are none.
    """
    if len(data) != _ATTACHMENT.size:
        raise ValueError(f"attachment of {len(data)} bytes, expected {_ATTACHMENT.size}")
    sequence, stamp_ns, size, gid = _ATTACHMENT.unpack(data)
    if size != GID_BYTES:
        raise ValueError(f"publisher id of {size} bytes, expected {GID_BYTES}")
    return Attachment(sequence, stamp_ns, gid)
