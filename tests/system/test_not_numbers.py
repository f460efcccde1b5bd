"""NaN, Inf, denormal and huge in every field of every message: no part is exempt."""

import math
import re
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest
from fastcrc import crc16

from linemate.daemon.cycle.sensing.samples import SensorQueues
from linemate.daemon.cycle.sensing.sensor_health import Conditions
from linemate.protocol.rsi.codec import (
    RobotTelegram,
    RsiCodec,
    RsiError,
    SensorTelegram,
    parse_config,
)
from linemate.protocol.sensors.camera_codec import CameraDecoder, CameraError
from linemate.protocol.sensors.distance import DistanceDecoder, DistanceError
from linemate.protocol.sensors.wrench import make_decoder

ROOT = Path(__file__).resolve().parents[2]
WILD = (math.nan, math.inf, -math.inf, -0.0, 5e-324, 2.2e-308, 1e308, -1e308)
WORDS = (
    b"nan",
    b"NaN",
    b"-nan",
    b"inf",
    b"-INF",
    b"Infinity",
    b"1e999",
    b"1e17",
    b"0x10",
    b"",
    b"-",
)
SIX = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)


@pytest.mark.parametrize("name", ["rsi_joints.xml", "rsi_joints_setpoints.xml"])
def test_no_field_of_either_telegram_takes_what_is_no_plain_number(name: str) -> None:
    codec = RsiCodec(parse_config((ROOT / "protocol/data" / name).read_bytes()))
    robot = codec.format_robot(
        RobotTelegram(
            12,
            joints=SIX,
            joint_setpoints=SIX,
            external=SIX,
            external_setpoints=SIX,
            tcp=SIX,
            tcp_setpoint=SIX,
            delay=0,
        )
    )
    reply = codec.format_sensor(SensorTelegram(12, joints=SIX, external=(0.1,)))
    ways: tuple[tuple[bytes, Callable[[bytes], Any]], ...] = (
        (robot, codec.parse_robot),
        (reply, codec.parse_sensor),
    )
    for whole, parse in ways:
        parse(whole)
        places = [m.span(1) for m in re.finditer(rb'(?<!Type)="([^"]+)"|>([^<]+)<', whole) if m[1]]
        places += [m.span(1) for m in re.finditer(rb">([^<>]+)</", whole)]
        assert len(places) >= 8
        for begin, end in places:
            for word in WORDS:
                with pytest.raises(RsiError):
                    parse(whole[:begin] + word + whole[end:])


def messages(wild: float) -> Iterator[tuple[str, dict[str, Any]]]:
    usual: dict[str, Any] = {
        "v": 1, "src": "c", "seq": 1, "t_exp": 10**9, "t_tx": 10**9, "frame": "camera",
        "obj": "hub", "p": [0.0, 0.0, 1.0], "q": [1.0, 0.0, 0.0, 0.0], "cov": [1e-6] * 21,
        "quality": 50, "reset": 0,
    }  # fmt: skip
    for name, value in usual.items():
        if isinstance(value, list):
            for n in range(len(value)):
                yield f"{name}[{n}]", {**usual, name: [*value[:n], wild, *value[n + 1 :]]}
        else:
            yield name, {**usual, name: wild}


@pytest.mark.parametrize("wild", WILD)
def test_no_field_of_a_pose_brings_what_is_not_finite_into_a_sample(wild: float) -> None:
    for where, message in messages(wild):
        decoder = CameraDecoder()
        try:
            sample = decoder.feed(msgpack.packb(message), 10**9)
        except CameraError:
            continue
        if sample is None:
            continue
        # A tiny or minus zero number is a number.
        values = (*sample.position, *sample.quaternion, *(sample.covariance or ()))
        assert all(map(math.isfinite, values)), where
        assert abs(math.hypot(*sample.quaternion) - 1.0) < 1e-6, where
        assert math.isfinite(wild), where


@pytest.mark.parametrize("wild", WILD)
def test_no_number_of_a_wrench_reaches_a_step_if_it_is_none(wild: float) -> None:
    as_float = struct.unpack("<f", struct.pack("<f", wild))[0] if abs(wild) < 1e38 else math.inf
    as_float = wild if not math.isfinite(wild) else as_float
    for n in range(7):
        fields = [1.0] * 7
        fields[n] = as_float
        payload = struct.pack("<H6fIf", 0, *fields[:6], 1000, fields[6])
        frame = b"\xaa" + payload + struct.pack("<H", crc16.ibm_sdlc(payload))
        decoder, queues = make_decoder("bota"), SensorQueues()
        for sample in decoder.feed(frame * 4, 10**9):
            queues.wrench.push(sample)
        for sample in queues.drain(Conditions(moving=True, deviation=1e-3), 500.0).wrench:
            assert all(map(math.isfinite, (*sample.force, *sample.torque)))
            assert max(map(abs, (*sample.force, *sample.torque))) <= 1e5


@pytest.mark.parametrize("data", [b"\xff" * 8, b"\x7f" * 8, b"\x80" + b"\0" * 7, b"\0" * 8])
def test_no_bytes_of_a_distance_are_anything_but_a_distance_or_refused(data: bytes) -> None:
    for message, signal, can_id in (("CIA406_TPDO1", "Position", None), ("TF03", "Distance", None)):
        decoder = DistanceDecoder(message=message, signal=signal, can_id=can_id)
        for length in range(9):
            try:
                sample = decoder.decode(decoder.can_id, data[:length], 1)
            except DistanceError:
                continue
            assert sample is None or (math.isfinite(sample.position) and sample.position >= 0.0)
