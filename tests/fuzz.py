"""Fuzzing of every wire: ``python tests/fuzz.py [WIRE ...] [--inputs N] [--atheris SECONDS]``.

Any bytes give a value or the wire's own error, and nothing else; that is the
whole check. Inputs are whole messages that were cut, joined, flipped and overwritten, by seed.

With ``--atheris`` libFuzzer looks for them instead, guided by coverage, where it is installed. What
reaches a branch that nothing before did is kept in ``CORPUS``, and ``test_fuzz`` reads it again.
"""

import argparse
import contextlib
import gc
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FunctionType
from typing import Any

import msgspec

from linemate.protocol.command import frame_codec, payloads, requests
from linemate.protocol.egm import messages
from linemate.protocol.egm.egm_codec import EgmCodec
from linemate.protocol.errors import ProtocolError
from linemate.protocol.fanuc import classic_packets, packets
from linemate.protocol.fanuc.fanuc_link import FanucLink
from linemate.protocol.fanuc.packets import CapabilityPacket, CommandPacket, StatusPacket
from linemate.protocol.rsi import ethernet_config
from linemate.protocol.rsi.codec import RobotTelegram, RsiCodec, SensorTelegram, parse_config
from linemate.protocol.sensors import camera_codec, slcan
from linemate.protocol.sensors.bota import bota_frame
from linemate.protocol.sensors.camera_codec import CameraDecoder, CameraError, CameraMessage
from linemate.protocol.sensors.distance import DistanceDecoder, DistanceEncoder
from linemate.protocol.sensors.ft300 import ft300_frame
from linemate.protocol.sensors.wrench import make_decoder

DATA = Path(__file__).resolve().parents[1] / "protocol" / "data"
CORPUS = Path(__file__).parent / "data" / "fuzz_corpus.msgpack"
SIX = (0.1, -0.2, 0.3, -0.4, 0.5, -0.6)
INTERESTING = (
    b"nan", b"inf", b"1e999", b"-0", b"<!", b"&#0;", b"]]>", b"\x00", b"\xff" * 8, b"\x7f" * 8,
    b"\xc1", b"\xdf\xff\xff\xff\xff", b"\xdd\xff\xff\xff\xff", b"\xcb\x7f\xf8" + b"\0" * 6,
    b"99999999999999999999", b"\r", b"\xaa", b"\x20\x4e", b"<IPOC>", b'="',
)  # fmt: skip
EGM_WORDS = (
    b"\x0a\x00", b"\x12\xff\xff\x03", b"\x09" + b"\0" * 6 + b"\xf8\x7f", b"\x80" * 10 + b"\x01",
)  # fmt: skip
LONGEST = 4096


@dataclass(frozen=True)
class Wire:
    """One parser.

    Attributes:
        parse: takes bytes; raises ``ProtocolError`` or nothing.
        words: pieces that are put in.
    """

    examples: tuple[bytes, ...]
    parse: Callable[[bytes], Any]
    words: tuple[bytes, ...] = INTERESTING


def _rsi() -> tuple[Wire, Wire, Wire]:
    config = (DATA / "rsi_joints.xml").read_bytes()
    codec = RsiCodec(parse_config(config))
    robot = codec.format_robot(
        RobotTelegram(12, joints=SIX, external=SIX, tcp=SIX, delay=3, channels={"DiL": 1})
    )
    reply = codec.format_sensor(
        SensorTelegram(12, joints=SIX, external=(0.1,), channels={"DiO": 1})
    )
    return (
        Wire((robot, robot.replace(b" />", b"/>")), codec.parse_robot),
        Wire((reply,), codec.parse_sensor),
        Wire(
            (config, (DATA / "rsi_joints_setpoints.xml").read_bytes()), ethernet_config.parse_config
        ),
    )


def _egm() -> tuple[Wire, Wire]:
    codec = EgmCodec()
    position = messages.EgmPosition(SIX, (0.1,), SIX[:3], (1.0, 0.0, 0.0, 0.0), 10**15)
    states = (messages.MotorState.ON, messages.GuidanceState.RUNNING, messages.RapidState.RUNNING)
    robots = (
        messages.RobotMessage(
            12, 48, position, position, *states, True, 20.0, SIX, True, robotware, numbers
        )
        for robotware, numbers in ((6, ()), (7, (3.0,)))
    )
    correction = messages.CorrectionMessage(12, 48, SIX, (0.1,), SIX, (0.1,), (2.0,))
    words = INTERESTING + EGM_WORDS
    return (
        Wire(tuple(map(codec.format_robot, robots)), codec.parse_robot, words),
        Wire((codec.format_correction(correction),), codec.parse_correction, words),
    )


def _fanuc() -> tuple[Wire, Wire, Wire]:
    joints = (*SIX, 100.0, 0.0, 0.0)
    links = {version: FanucLink(version, on_rail=True) for version in (3, 4)}
    statuses = tuple(
        packets.write_status(StatusPacket(version, 12, 9, 0, joints)) for version in links
    )

    def parse(data: bytes) -> object:
        link = links[4 if len(data) > 400 else 3]
        telegram = link.read(data, 1)
        assert all(abs(q) < 1e39 for q in telegram.robot.joints)
        pattern, echo = link.expect(telegram.counter, None, telegram.robot.joints, 0.05)
        assert echo == telegram.echo
        # What is expected is read, and it is not unready.
        assert pattern.matches(data) <= (telegram.unready is None)
        return telegram

    return (
        Wire(statuses, parse),
        Wire((packets.write_command(CommandPacket(3, 12, joints)),), packets.read_command),
        Wire((packets.write_capability(CapabilityPacket(3, 8, 1, 3)),), packets.read_capability),
    )


def _fanuc_classic() -> tuple[Wire, Wire]:
    joints = (*SIX, 100.0, 0.0, 0.0)
    commands = tuple(
        classic_packets.write_command(CommandPacket(version, 12, joints)) for version in (1, 2)
    )
    status = classic_packets.write_status(StatusPacket(2, 12, 9, 0, joints))
    return (
        Wire((status,), classic_packets.read_status),
        Wire(commands, classic_packets.read_command),
    )


def _camera() -> Wire:
    message = CameraMessage(
        v=1, src="c", seq=1, t_exp=10**9, t_tx=10**9, frame="camera", obj="hub",
        p=(0.0, 0.1, 1.0), q=(1.0, 0.0, 0.0, 0.0), cov=(1e-6,) * 21, quality=50, reset=0,
    )  # fmt: skip
    decoder = CameraDecoder()

    def parse(data: bytes) -> object:
        message = camera_codec.decode(data)
        with contextlib.suppress(CameraError):  # the same image twice, or one too old
            sample = decoder.feed(data, 1_100_000_000)
            assert sample is None or abs(sum(v * v for v in sample.quaternion) - 1.0) < 1e-3
        return message, decoder.counters()

    return Wire((camera_codec.encode(message),), parse)


def _distance() -> Wire:
    encoder, decoder = DistanceEncoder(), DistanceDecoder()
    can_id, payload = encoder.encode(1.0)

    def parse(data: bytes) -> object:
        sample = decoder.decode(can_id if data[:1] != b"\x01" else data[0], data[1:], 1)
        assert sample is None or 0.0 <= sample.position <= 1e6
        return sample

    return Wire((b"\0" + payload,), parse)


def _stream(device: str, frame: bytes) -> Wire:
    decoder = make_decoder(device)

    def parse(data: bytes) -> object:
        samples = decoder.feed(data, 1)
        for sample in samples:
            assert all(abs(v) < 1e39 for v in (*sample.force, *sample.torque))
        return samples, decoder.counters()

    return Wire((frame, frame * 3), parse)


def _command() -> tuple[Wire, Wire, Wire]:
    request = requests.encode_request("set", {"values": {"watch.missed_s": 0.03}}, 1000)
    body = frame_codec.frame_body(frame_codec.FrameType.REQUEST, 1, 2, 3, request)
    result = payloads.encode_result({"state": "idle", "steps": 3})
    reply = payloads.encode_reply(payloads.Reply(ok=True, t=1, r=result))
    return (
        Wire((body + bytes(16),), frame_codec.cut_frame),
        Wire((request, requests.encode_request("status", {}, 1)), requests.decode_request),
        Wire((reply, result), payloads.decode_reply),
    )


def wires() -> dict[str, Wire]:
    """Every wire by name."""
    robot, reply, config = _rsi()
    egm_robot, egm_sensor = _egm()
    status, command, capability = _fanuc()
    classic_status, classic_command = _fanuc_classic()
    frame, request, answer = _command()
    return {
        "robot": robot,
        "reply": reply,
        "config": config,
        "egm_robot": egm_robot,
        "egm_sensor": egm_sensor,
        "fanuc_status": status,
        "fanuc_classic_status": classic_status,
        "fanuc_classic_command": classic_command,
        "fanuc_command": command,
        "fanuc_capability": capability,
        "camera": _camera(),
        "distance": _distance(),
        "bota": _stream("bota", bota_frame((1.0, 2.0, 3.0), (0.1, 0.2, 0.3))),
        "ft300": _stream("robotiq-ft300", ft300_frame((1.0, 2.0, 3.0), (0.1, 0.2, 0.3))),
        "frame": frame,
        "request": request,
        "answer": answer,
        "slcan": Wire((b"t1834AABBCCDD", b"T00000183281234"), slcan.parse_frame),
    }


def mutated(
    chance: random.Random, examples: Sequence[bytes], words: Sequence[bytes] = INTERESTING
) -> bytes:
    """A message that somebody was at."""
    data = bytearray(chance.choice(examples))
    for _ in range(chance.choice((1, 1, 2, 4, 8))):
        at = chance.randrange(len(data) + 1)
        match chance.randrange(7):
            case 0:
                del data[at : at + chance.randint(1, 8)]
            case 1:
                data[at:at] = chance.choice(words)
            case 2 if data:
                data[at % len(data)] ^= 1 << chance.randrange(8)
            case 3:
                data[at : at + chance.randint(0, 8)] = chance.randbytes(chance.randint(0, 8))
            case 4:
                data[at:at] = chance.choice(examples)[: chance.randint(0, 64)]
            case 5:
                word = chance.choice(words)
                data[at : at + len(word)] = word
            case _:
                data = bytearray(chance.randbytes(chance.randint(0, 256)))
        if len(data) > LONGEST:
            del data[LONGEST:]
    return bytes(data)


def run(name: str, inputs: int, seed: int = 0) -> int:
    """Try so many inputs on one wire.

    Returns:
        How many of them were taken for a message.

    Raises:
        AssertionError: one gave something else than a value or the wire's own error.
    """
    wire, chance = wires()[name], random.Random(f"{seed}/{name}")
    taken = 0
    for n in range(inputs):
        data = mutated(chance, wire.examples, wire.words)
        try:
            wire.parse(data)
        except ProtocolError:
            continue
        except Exception as error:
            raise AssertionError(f"{name}, input {n} of seed {seed}: {data!r}") from error
        taken += 1
    return taken


def corpus() -> dict[str, list[bytes]]:
    """Return the kept inputs of each wire, found by coverage."""
    kept = msgspec.msgpack.decode(CORPUS.read_bytes(), type=dict[str, list[bytes]])
    return {name: kept.get(name, []) for name in wires()}


def explore(name: str, seconds: int) -> None:
    """Let libFuzzer look for inputs of one wire, and keep those that reach more branches.

    Raises:
        CalledProcessError: one gave something else than a value or the wire's own error.
    """
    with tempfile.TemporaryDirectory() as folder:
        found, least = Path(folder) / "found", Path(folder) / "least"
        least.mkdir()
        found.mkdir()
        for n, data in enumerate((*wires()[name].examples, *corpus()[name])):
            (found / f"{n}").write_bytes(data)
        for words in ([f"-max_total_time={seconds}", found], ["-merge=1", least, found]):
            command = [sys.executable, __file__, "--libfuzzer", name, *map(str, words)]
            subprocess.run(command, check=True, cwd=folder)
        inputs = sorted(file.read_bytes() for file in least.iterdir())
    CORPUS.write_bytes(msgspec.msgpack.encode(corpus() | {name: inputs}))
    print(f"{name}: {len(inputs)} inputs kept", flush=True)


def _with_libfuzzer(name: str, words: Sequence[str]) -> None:
    """Be libFuzzer's process; it ends with the process."""
    import atheris  # type: ignore[import-not-found]

    wire = wires()[name]

    def one(data: bytes) -> None:
        with contextlib.suppress(ProtocolError):
            wire.parse(data)

    ours = "linemate.protocol"
    for each in gc.get_objects():  # to instrument all of numpy would take minutes
        if isinstance(each, FunctionType) and (each.__module__ or "").startswith(ours):
            atheris.instrument_func(each)
    # A merge starts this command again, by a shell.
    command = f"{sys.executable} {__file__} --libfuzzer {name}"
    atheris.Setup([command, f"-max_len={LONGEST}", "-verbosity=0", *words], one)
    atheris.Fuzz()


def main(argv: Sequence[str] | None = None) -> int:
    """Fuzz; 1 at the first input that gave something else."""
    parser = argparse.ArgumentParser(prog="fuzz", description="Fuzzing of every wire.")
    parser.add_argument("wires", nargs="*", default=sorted(wires()), metavar="WIRE")
    parser.add_argument("--inputs", type=int, default=1_000_000, help="for each wire")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--atheris", type=int, metavar="SECONDS", help="with libFuzzer, a wire")
    words = list(sys.argv[1:] if argv is None else argv)
    if words[:1] == ["--libfuzzer"]:
        _with_libfuzzer(words[1], words[2:])
    args = parser.parse_args(words)
    if args.atheris:
        for name in args.wires:
            explore(name, args.atheris)
        return 0
    for name in args.wires:
        begun = time.monotonic()
        try:
            taken = run(name, args.inputs, args.seed)
        except AssertionError as error:
            print(f"{error}: {error.__cause__!r}", flush=True)
            return 1
        took_s = time.monotonic() - begun
        print(f"{name}: {args.inputs} inputs in {took_s:.0f} s, {taken} taken", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
