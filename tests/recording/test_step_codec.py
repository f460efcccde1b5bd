"""A step as bytes: what comes back is what went in, bit for bit."""

import struct
from dataclasses import replace

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from linemate.daemon.core.inputs import Inputs
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.recording import step_codec
from linemate.daemon.recording.step_codec import RecordingError, decode, differences, digest, encode
from linemate.protocol.stamped_samples import DistanceSample


def encoded(entry: LogEntry) -> bytes:
    return encode(entry.counter, entry.state, entry.inputs, entry.outputs)


def test_inputs_come_back_equal_and_of_their_own_types(entries: tuple[LogEntry, ...]) -> None:
    for entry in entries:
        record = decode(encoded(entry))
        assert record.inputs == entry.inputs
        assert type(record.inputs.order) is type(entry.inputs.order)
        assert record.counter == entry.counter
        assert record.state == "track"
        assert encode(record.counter, record.state, record.inputs, entry.outputs) == encoded(entry)


def test_outputs_of_the_same_step_show_no_difference(entries: tuple[LogEntry, ...]) -> None:
    for entry in entries:
        assert differences(decode(encoded(entry)), entry.outputs) == ()


def test_one_bit_of_one_command_or_of_the_horizon_shows(entries: tuple[LogEntry, ...]) -> None:
    entry = entries[-1]
    record = decode(encoded(entry))
    command = entry.outputs.command
    near = (float(np.nextafter(command[0], 9.0)), *command[1:])
    assert differences(record, structs.replace(entry.outputs, command=near)) == ("command",)
    assert entry.outputs.horizon is not None
    bent = entry.outputs.horizon.copy()
    bent[-1, -1] = np.nextafter(bent[-1, -1], 9.0)
    assert differences(record, structs.replace(entry.outputs, horizon=bent)) == ("horizon",)


def test_minus_zero_is_not_zero(entries: tuple[LogEntry, ...]) -> None:
    entry = entries[0]
    zero = structs.replace(entry.outputs, speed=0.0)
    record = decode(encode(1, "idle", entry.inputs, zero))
    assert differences(record, structs.replace(zero, speed=-0.0)) == ("speed",)


@given(st.floats(), st.integers(-(2**63), 2**64 - 1))
def test_any_float_and_any_stamp_come_back_exactly(number: float, stamp: int) -> None:
    inputs = Inputs(0, 5, None, (DistanceSample(stamp, number),))
    packed = step_codec._pack(inputs)
    again = step_codec._inputs(msgpack.unpackb(packed, use_list=False), step_codec.LAYOUT)
    (sample,) = again.distance
    assert struct.pack("<d", sample.position) == struct.pack("<d", number)
    assert sample.stamp_ns == stamp


def test_a_counter_longer_than_64_bits_survives(entries: tuple[LogEntry, ...]) -> None:
    data = encode(10**30, "idle", entries[0].inputs, entries[0].outputs)
    assert decode(data).counter == 10**30


def test_the_counter_is_read_under_its_former_name(entries: tuple[LogEntry, ...]) -> None:
    entry = next(entry for entry in entries if entry.inputs.robot is not None)
    names = step_codec.LAYOUT["RobotSample"]
    former = tuple("ipoc" if name == "counter" else name for name in names)
    assert former != names
    record = decode(encoded(entry), {**step_codec.LAYOUT, "RobotSample": former})
    assert record.inputs == entry.inputs


def test_a_later_field_is_missing_in_an_earlier_recording_and_shows(
    entries: tuple[LogEntry, ...],
) -> None:
    entry = entries[0]
    record = decode(encoded(entry))
    outputs = {name: value for name, value in record.outputs.items() if name != "ready"}
    assert differences(replace(record, outputs=outputs), entry.outputs) == ("ready",)


@given(st.binary(max_size=100))
def test_any_bytes_are_a_step_or_its_one_error(data: bytes) -> None:
    with pytest.raises(RecordingError):
        decode(data)


def test_a_digest_sees_shape_and_every_bit() -> None:
    array = np.arange(6.0).reshape(3, 2)
    assert digest(array) != digest(array.reshape(2, 3))
    assert digest(array) == digest(np.asfortranarray(array))
    assert digest(np.array([0.0])) != digest(np.array([-0.0]))


def test_what_does_not_belong_into_a_recording_is_refused() -> None:
    with pytest.raises(TypeError, match="complex"):
        step_codec._pack((1j,))
