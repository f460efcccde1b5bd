"""Own protobuf messages: read by a decoder that knows their descriptors alone."""

import io
import math
from typing import Any

import pytest

pytest.importorskip("google.protobuf", reason="protobuf is in the extra foxglove")
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from linemate.daemon.view.channels import channel_schemas


def decoded(name: str, data: bytes) -> Any:
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(channel_schemas.descriptor_set()).file:
        pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(f"linemate.{name}"))
    return kind.FromString(data)


def test_a_message_comes_back_with_its_time_and_every_bit() -> None:
    force, torque = {"x": 0.1, "y": -1e-300, "z": 3.0}, {"x": 0.0, "y": 1 / 3, "z": -0.2}
    values = {"frame_id": "s", "force": force, "torque": torque}
    wrench = decoded(
        "Wrench", channel_schemas.encode_own("Wrench", 1_700_000_000_123_456_789, values)
    )
    assert (wrench.timestamp.seconds, wrench.timestamp.nanos) == (1_700_000_000, 123_456_789)
    assert {axis: getattr(wrench.force, axis) for axis in "xyz"} == force
    assert {axis: getattr(wrench.torque, axis) for axis in "xyz"} == torque
    assert wrench.frame_id == "s"


def test_a_number_that_is_not_known_is_a_gap_in_a_plot() -> None:
    errors = decoded("Errors", channel_schemas.encode_own("Errors", 0, {"plan": 0.5, "gap": None}))
    assert errors.plan == 0.5
    assert math.isnan(errors.control)
    assert math.isnan(errors.gap)


@pytest.mark.parametrize(
    "values", [{"plan": "far"}, {"plam": 0.5}, {"plan": [1.0]}], ids=["kind", "name", "shape"]
)
def test_a_value_that_does_not_fit_is_an_error(values: dict[str, Any]) -> None:
    with pytest.raises((ValueError, TypeError)):
        channel_schemas.encode_own("Errors", 0, values)


def test_the_descriptors_are_complete_and_always_the_same() -> None:
    data = channel_schemas.descriptor_set()
    channel_schemas.descriptor_set.cache_clear()
    assert channel_schemas.descriptor_set() == data
    files = descriptor_pb2.FileDescriptorSet.FromString(data).file
    names = {file.name for file in files}
    assert all(set(file.dependency) <= names for file in files)
    assert io.BytesIO(data).getbuffer().nbytes < 4096
