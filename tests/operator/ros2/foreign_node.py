"""A ROS 2 node made with zenoh-ros2-sdk: ``foreign_node.py PORT listen|publish``."""

import json
import logging
import math
import os
import sys
import threading
import time
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber
from zenoh_ros2_sdk.session import ZenohSession

KINDS = {
    "joints": ("/linemate/joint_states", "sensor_msgs/msg/JointState"),
    "frames": ("/tf", "tf2_msgs/msg/TFMessage"),
    "pose": ("/linemate/target", "geometry_msgs/msg/PoseStamped"),
    "wrench": ("/linemate/wrench", "geometry_msgs/msg/WrenchStamped"),
}
CAMERA = ("/linemate/camera_pose", "geometry_msgs/msg/PoseWithCovarianceStamped")


def session(port: int) -> ZenohSession:
    """The node's session. Its definitions come from rosbags: the SDK would download them."""
    made = ZenohSession.get_instance("127.0.0.1", port)
    made.store = get_typestore(Stores.ROS2_JAZZY)
    for _, kind in (*KINDS.values(), CAMERA):
        made._registered_types[kind] = kind
    return made


def plain(name: str, message: Any) -> Any:
    if name == "joints":
        return list(message.name)
    if name == "frames":
        return [transform.child_frame_id for transform in message.transforms]
    if name == "pose":
        turn = message.pose.orientation
        length = math.hypot(turn.w, turn.x, turn.y, turn.z)
        return [message.header.frame_id, length]
    force = message.wrench.force
    return [message.header.frame_id, force.x, force.y, force.z]


def listen(port: int) -> dict[str, Any]:
    store, seen, done = session(port).store, {}, threading.Event()

    def hear(name: str) -> Any:
        def take(message: Any) -> None:
            seen[name] = plain(name, message)
            if len(seen) == len(KINDS):
                done.set()

        return take

    for name, (topic, kind) in KINDS.items():
        type_hash = store.hash_rihs01(kind)
        ROS2Subscriber(
            topic, kind, hear(name), router_port=port, type_hash=type_hash, msg_definition=""
        )
    done.wait(30.0)
    replies = session(port).session.liveliness().get("@ros2_lv/7/*/*/*/NN/**")
    nodes = {str(reply.ok.key_expr).rpartition("/")[2] for reply in replies}
    return {**seen, "nodes": sorted(node for node in nodes if not node.startswith("zenoh_"))}


def publish(port: int) -> dict[str, Any]:
    store = session(port).store
    topic, kind = CAMERA
    publisher = ROS2Publisher(
        topic, kind, router_port=port, type_hash=store.hash_rihs01(kind), msg_definition=""
    )
    time.sleep(1.0)
    kinds = store.types
    point = kinds["geometry_msgs/msg/Point"](x=0.1, y=0.2, z=0.7)
    turn = kinds["geometry_msgs/msg/Quaternion"](x=0.1, y=0.7, z=0.5, w=0.5)
    pose = kinds["geometry_msgs/msg/Pose"](position=point, orientation=turn)
    covariance = np.diag([1e-6] * 3 + [1e-7] * 3).ravel()
    whole = kinds["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=covariance)
    for _ in range(5):
        seconds, rest_ns = divmod(time.time_ns() - 40_000_000, 10**9)
        stamp = kinds["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest_ns)
        publisher.publish(header=kinds["std_msgs/msg/Header"](stamp, "camera"), pose=whole)
        time.sleep(0.04)
    time.sleep(0.5)
    return {"sent": 5}


if __name__ == "__main__":
    logging.disable(logging.INFO)
    print(json.dumps({"listen": listen, "publish": publish}[sys.argv[2]](int(sys.argv[1]))))
    sys.stdout.flush()
    os._exit(0)  # the SDK's subscribers keep the interpreter from ending
