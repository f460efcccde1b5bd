"""What every parser makes of damaged messages and every writer of random values, word for word.

Of a refusal only its class is written, for its words may become better. See ``transcripts``.
"""

import random
from collections.abc import Callable, Iterator
from pathlib import Path

import fuzz
import pytest
from msgspec.structs import replace
from transcripts import Chance, Transcript

from linemate.protocol.errors import ProtocolError
from linemate.protocol.rsi.codec import RobotTelegram, RsiCodec, SensorTelegram, parse_config
from linemate.protocol.sensors import camera_codec, slcan
from linemate.protocol.sensors.bota import bota_frame
from linemate.protocol.sensors.camera_codec import CameraDecoder, CameraMessage
from linemate.protocol.sensors.distance import DistanceDecoder, DistanceEncoder
from linemate.protocol.sensors.ft300 import ft300_frame
from linemate.protocol.sensors.slcan import CommandDecoder, LineDecoder
from linemate.protocol.sensors.wrench import make_decoder, make_device, make_host

DATA = Path(__file__).resolve().parents[2] / "protocol" / "data"
MS = 1_000_000
MESSAGES = 1500


def answered(call: Callable[..., object], *args: object) -> object:
    """What a call returns, or the name of its own error."""
    try:
        return call(*args)
    except ProtocolError as error:
        return type(error).__name__
    except ValueError:  # of a writer that was given nonsense
        return "ValueError"


@pytest.mark.parametrize(
    ("wire", "digest"),
    [
        ("robot", "e6d3652258ed2717"),
        ("reply", "d923188e7a682cee"),
        ("config", "ab5ff65aacdd4e4a"),
        ("camera", "d6763bafb82a0a8a"),
        ("distance", "fab9c4e2b742ba24"),
        ("bota", "1317e755f72b8679"),
        ("ft300", "ae3adee0f89de4a3"),
        ("frame", "88aa6db73ac87b24"),
        ("request", "d6084da771d050ba"),
        ("answer", "38caa913b3751425"),
        ("slcan", "fc37151a33fb917e"),
    ],
)
def test_a_parser_makes_of_damaged_messages_what_it_always_did(wire: str, digest: str) -> None:
    transcript, parser = Transcript(), fuzz.wires()[wire]
    chance = random.Random(f"transcript/{wire}")
    for whole in parser.examples:
        transcript.say(answered(parser.parse, whole))
    for _ in range(MESSAGES):
        data = fuzz.mutated(chance, parser.examples)
        transcript.say(data, answered(parser.parse, data))
    assert transcript.digest == digest


LAYOUTS = ("rsi_joints.xml", "rsi_joints_setpoints.xml")
NUMBERS = (0.0, -0.0, 1e-9, -3e-8, 0.5, -1.25, 3.14159265358979, 170.0, -1e4, 9.99e8, 1e12, -1e13)


def _six(chance: Chance) -> tuple[float, ...]:
    return tuple(
        chance.between(-3.2, 3.2) if chance.happens(0.8) else chance.pick(NUMBERS)
        for _ in range(chance.pick((6, 6, 6, 6, 6, 6, 6, 1, 2)))
    )


def _channels(chance: Chance) -> dict[str, int | bool | float | str]:
    known = ("DiL", "DiO", "Digout.o1", "Stop", "Source1", "unknown")
    values = (0, 1, 255, -1, 2**31 - 1, 2**31, True, False, 0.5, "text", 1e300)
    return {chance.pick(known): chance.pick(values)} if chance.happens(0.5) else {}


@pytest.mark.parametrize(
    ("layout", "digest"),
    [("rsi_joints.xml", "738dc86318250e5a"), ("rsi_joints_setpoints.xml", "4991510bdce2cd3d")],
)
def test_telegrams_are_written_and_read_as_they_always_were(layout: str, digest: str) -> None:
    transcript = Transcript()
    codec = RsiCodec(parse_config((DATA / layout).read_bytes()))
    chance = Chance(f"telegrams/{layout}")
    for n in range(600):
        robot = RobotTelegram(
            chance.pick((n, 0, 4208163634, 10**17)),
            joints=_six(chance),  # type: ignore[arg-type]
            joint_setpoints=_six(chance) if chance.happens(0.9) else None,  # type: ignore[arg-type]
            external=_six(chance) if chance.happens(0.95) else None,  # type: ignore[arg-type]
            external_setpoints=_six(chance),  # type: ignore[arg-type]
            tcp=_six(chance),  # type: ignore[arg-type]
            tcp_setpoint=_six(chance),  # type: ignore[arg-type]
            delay=chance.pick((0, 3, None, 10**6)),
            channels=_channels(chance),
        )
        data = answered(codec.format_robot, robot)
        transcript.say(data)
        if isinstance(data, bytes):
            transcript.say(answered(codec.parse_robot, data))
        reply = SensorTelegram(
            chance.pick((n, 0, 4208163634)),
            sentype=chance.pick(("ImFree", "linemate", "", "a b", '"', "x" * 40)),
            joints=_six(chance) if chance.happens(0.95) else None,  # type: ignore[arg-type]
            external=_six(chance) if chance.happens(0.9) else None,  # type: ignore[arg-type]
            channels=_channels(chance),
            message=chance.pick((None, None, "on its way", "<&>", "")),
        )
        data = answered(codec.format_sensor, reply)
        transcript.say(data)
        if isinstance(data, bytes):
            transcript.say(codec.prepare_sensor(reply).with_counter(b"123"))
            transcript.say(answered(codec.parse_sensor, data))
    assert transcript.digest == digest


def _poses(chance: Chance) -> Iterator[tuple[CameraMessage, int]]:
    """Some cameras that repeat, overtake, pause, begin again and lose their clocks."""
    now_ns, numbers = 10**12, dict.fromkeys("abcdefghijkl", 0)
    offsets = {src: round(chance.between(-1e12, 1e12)) for src in numbers}
    for _ in range(400):
        now_ns += chance.pick((1, 25, 25, 25, 25, 300, 1000, 5000, 31_000)) * MS
        src = chance.pick("aaaaaaaaabcdefghijkl") if chance.happens(0.3) else "a"
        if chance.happens(0.03):
            offsets[src] += round(chance.pick((-1, 1)) * chance.pick((40e6, 51e6, 1e9, 3.6e12)))
        numbers[src] += chance.pick((1, 1, 1, 1, 1, 0, 2, -1, -3, 50, -1000))
        numbers[src] = max(numbers[src], 0)
        sent_ns = now_ns + offsets[src] - chance.pick((0, 0, 1, 20, 200)) * MS
        exposed_ns = sent_ns - chance.pick((50, 50, 50, 0, -1, 400, 999, 1001, 5000)) * MS
        q = chance.pick(((1.0, 0.0, 0.0, 0.0), (0.6, 0.0, 0.8, 0.0), (0.9995, 0.0, 0.0, 0.0)))
        message = CameraMessage(
            v=chance.pick((1, 1, 1, 1, 1, 1, 1, 1, 1, 2)),
            src=src,
            seq=numbers[src],
            t_exp=max(exposed_ns, 0),
            t_tx=max(sent_ns, 0),
            frame=chance.pick(("camera",) * 9 + ("base",)),
            obj=chance.pick(("hub",) * 9 + ("door",)),
            p=(0.1, chance.pick((0.0, 0.0, 0.0, float("nan"), 1e3, 1e5)), 1.0),
            q=q,
            cov=chance.pick((None, (1e-6,) * 21, (-1e-6,) * 21)),
            quality=chance.pick((0, 50, 100)),
            reset=chance.pick((0, 0, 0, 0, 0, 0, 0, 1)),
        )
        yield message, now_ns


@pytest.mark.parametrize(
    ("part", "digest"), [(0, "f007132eadd06236"), (1, "16d77dda94b79530"), (2, "7b7923dc302e5e2a")]
)
def test_cameras_are_followed_as_they_always_were(part: int, digest: str) -> None:
    transcript = Transcript()
    expected = ((None, None, None), ("camera", "hub", None), ("camera", "hub", "a"))[part]
    for script in range(8):
        decoder = CameraDecoder(*expected)
        for message, now_ns in _poses(Chance(f"camera/{script}")):
            data = answered(camera_codec.encode, message)
            if not isinstance(data, bytes):
                transcript.say(data)
                continue
            transcript.say(answered(decoder.feed, data, now_ns))
            transcript.say(decoder.offset_ns(message.src))
        transcript.say(decoder.counters())
    assert transcript.digest == digest


def test_distances_are_written_and_read_as_they_always_were() -> None:
    transcript, chance = Transcript(), Chance("distance")
    kinds = (
        ("CIA406_TPDO1", "Position", None),
        ("TF03", "Distance", "Strength"),
        ("TF02", "Distance", None),
    )
    for message, signal, strength in kinds:
        encoder = DistanceEncoder(message=message, signal=signal, strength=strength)
        decoder = DistanceDecoder(message=message, signal=signal, strength=strength)
        for _ in range(200):
            metres = chance.pick((0.0, 180.0, 180.01, -0.01, 1e6, chance.between(0.0, 40.0)))
            power = chance.pick((0.0, 1.0, 65535.0, 65536.0, 333.4))
            frame = answered(encoder.encode, metres, power)
            transcript.say(frame)
            if isinstance(frame, tuple):
                for extended in (False, True):
                    transcript.say(decoder.decode(*frame, 7, extended=extended))
                for cut in (frame[1][:-1], frame[1] + b"\0", frame[1][::-1], frame[1] * 9):
                    transcript.say(answered(decoder.decode, frame[0], cut, 7))
    assert transcript.digest == "3c9b6d2e93909ea0"


@pytest.mark.parametrize(
    ("device", "digest"), [("bota", "9a13e9e399aea0cc"), ("robotiq-ft300", "c78586c0e05c50b8")]
)
def test_wrenches_are_cut_from_any_stream_as_they_always_were(device: str, digest: str) -> None:
    transcript, chance = Transcript(), Chance(f"wrench/{device}")
    frame = bota_frame if device == "bota" else ft300_frame
    decoder = make_decoder(device)
    for n in range(1500):
        force, torque = ([chance.between(-300.0, 300.0) for _ in range(3)] for _ in range(2))
        data = bytearray(frame(force, torque))
        match int(chance.between(0, 12)):
            case 0:
                data[chance.pick(range(len(data)))] ^= 1 << chance.pick(range(8))
            case 1:
                del data[chance.pick(range(len(data)))]
            case 2:
                at = chance.pick(range(len(data)))
                data[at:at] = bytes(data[:2]) + b"\0\xaa\x20"
            case 3:
                data = data[: chance.pick(range(1, len(data)))]
            case 4:
                decoder.reset()
        for part in (data[:7], data[7:]) if chance.happens(0.3) else (data,):
            transcript.say(decoder.feed(bytes(part), n * 4 * MS), decoder.counters())
    assert transcript.digest == digest


@pytest.mark.parametrize(
    ("device", "digest"), [("bota", "2f7d51080a3f88fd"), ("robotiq-ft300", "6f79569fb0c3477c")]
)
def test_host_and_device_of_a_line_talk_as_they_always_did(device: str, digest: str) -> None:
    transcript = Transcript()
    for script in range(60):
        chance = Chance(f"dialogue/{device}/{script}")
        host, sensor, now_ns = make_host(device), make_device(device), 5_000 * MS
        boot = sensor.boot()
        output = host.begin(now_ns)
        transcript.say(boot, output)
        heard = boot if chance.happens(0.7) else b""
        for _ in range(40):
            now_ns += chance.pick((1, 10, 100, 500, 999, 1000, 1001, 2500)) * MS
            to_sensor = _damaged(chance, output.send)
            heard += _damaged(chance, sensor.feed(to_sensor))
            transcript.say(heard)
            output = host.feed(heard, now_ns) if chance.happens(0.8) else host.on_time(now_ns)
            heard = b""
            transcript.say(output)
            if chance.happens(0.03):
                heard = sensor.boot()
    assert transcript.digest == digest


def _damaged(chance: Chance, data: bytes) -> bytes:
    if not data or not chance.happens(0.15):
        return data
    at = chance.pick(range(len(data)))
    return chance.pick((b"", data[:at], data[at:], data[:at] + b"?" + data[at + 1 :], data + data))


def _lengthened(frame: slcan.CanFrame) -> slcan.CanFrame:
    return replace(frame, data=bytes(9))


def test_a_can_adapters_lines_are_cut_and_understood_as_they_always_were() -> None:
    transcript, chance = Transcript(), Chance("slcan")
    whole = "t1834AABBCCDD T00000183281234 r1230 O C S6 S9 V F Z1  z Z t7FF0 t8000 T1FFFFFFF0 L"
    whole += " T200000000 t1834AABBCCDD1234 M00000000 s0123 t1838AABBCCDDEEFF0011 t1839 t18g1AA"
    pieces = tuple(f"{line}\r".encode() for line in whole.split(" "))
    pieces += (b"\a", b"t", b"183", b"x" * 40, b"\n", b"4AABBCCDD\r")
    lines, commands = LineDecoder(), CommandDecoder()
    for _ in range(3000):
        data = chance.pick(pieces)
        if chance.happens(0.1):
            data = data[: chance.pick(range(len(data) + 1))]
        cut = lines.feed(data)
        transcript.say(cut, vars(lines) if hasattr(lines, "__dict__") else None)
        for line in cut:
            frame = answered(slcan.parse_frame, line)
            transcript.say(frame)
            if isinstance(frame, slcan.CanFrame):
                for stamp_ms in (None, 0, 59_999, 60_000):
                    transcript.say(answered(slcan.format_frame, frame, stamp_ms))
                transcript.say(answered(_lengthened, frame))
        transcript.say(commands.feed(data))
    assert transcript.digest == "e9ef44e7c62b4d6b"
