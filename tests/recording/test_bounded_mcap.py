"""MCAP files that are damaged or made to harm: read within bounds, and refused with a reason."""

import contextlib
import io
import json
import os
import struct
import subprocess
import sys
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
import zstandard
from cell import TASK
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, Header, Message, Metadata

from linemate.daemon.operator import main as tool
from linemate.daemon.recording import bounded_mcap
from linemate.daemon.recording.bounded_mcap import MAGIC, MIB, Damage, records
from linemate.daemon.recording.step_items import metadata_of

BOMB_BYTES = 96 * 1024
MEMORY_MIB = 256
CPU_S = 5.0
UNPACKED = 3_000_000_000


def built(*parts: Any) -> bytes:
    builder = RecordBuilder()
    for part in parts:
        part.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def head() -> bytes:
    """The beginning of a recording of ours."""
    texts = metadata_of({"config": "task: wheel.yaml\n", "task": TASK.text, "urdf": TASK.urdf})
    return MAGIC + built(Header("", "linemate"), Metadata("linemate", dict(texts)))


def chunk(data: bytes, size: int, compression: str = "zstd", crc: int = 0) -> bytes:
    return built(Chunk(compression, data, 0, 0, crc, size))


@cache
def compressed(size: int, unit: bytes = bytes(MIB), *, states_size: bool = True) -> bytes:
    packer = zstandard.ZstdCompressor().compressobj(size=size if states_size else -1)
    parts = [packer.compress(unit) for _ in range(size // len(unit))]
    return b"".join([*parts, packer.compress(unit[: size % len(unit)]), packer.flush()])


def one_chunk() -> bytes:
    return head() + chunk(compressed(UNPACKED), UNPACKED)


def one_chunk_of_unstated_size() -> bytes:
    return head() + chunk(compressed(UNPACKED, states_size=False), UNPACKED)


def one_chunk_that_claims_to_be_small() -> bytes:
    return head() + chunk(compressed(UNPACKED), 65_536)


def many_chunks() -> bytes:
    size = 15 * MIB
    part = chunk(compressed(size), size)
    return head() + part * (BOMB_BYTES // len(part))


def many_small_messages() -> bytes:
    message = built(Message(7, 0, b"", 0, 0)) * 5000
    size = len(message) * 5
    part = chunk(compressed(size, message), size)
    channel = built(Channel(id=7, topic="/x", message_encoding="json", metadata={}, schema_id=0))
    return head() + channel + part * (BOMB_BYTES // len(part))


def lz4_chunk() -> bytes:
    size = 25_000_000
    return head() + chunk(lz4.frame.compress(bytes(size)), size, "lz4")


BOMBS = (
    one_chunk,
    one_chunk_of_unstated_size,
    one_chunk_that_claims_to_be_small,
    many_chunks,
    many_small_messages,
    lz4_chunk,
)


@dataclass(frozen=True)
class Ended:
    """A command that ended, and what it took: processor time [s], memory [MiB]."""

    code: int
    output: str
    cpu_s: float
    memory_mib: float


def ran(*words: Any) -> Ended:
    """Run the operator's tool as a process of its own."""
    command = [sys.executable, "-m", "linemate.daemon.operator.main", *map(str, words)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process:
        assert process.stdout is not None
        peaks = [0.0]
        looking = threading.Thread(target=_watch_memory, args=(process.pid, peaks))
        looking.start()
        output = process.stdout.read().decode()
        _, status, usage = os.wait4(process.pid, 0)
        looking.join()
        process.returncode = os.waitstatus_to_exitcode(status)
    return Ended(process.returncode, output, usage.ru_utime + usage.ru_stime, peaks[-1])


def _watch_memory(pid: int, peaks: list[float]) -> None:
    """Append the peak of a process [MiB] until it ends.

    Its ``ru_maxrss`` would count what this process had when it was forked.
    """
    status = Path(f"/proc/{pid}/status")
    with contextlib.suppress(OSError, ValueError):
        while True:
            words = status.read_text().split()
            peaks.append(int(words[words.index("VmHWM:") + 1]) / 1024.0)
            time.sleep(0.002)


@pytest.mark.row
@pytest.mark.parametrize("bomb", BOMBS)
@pytest.mark.parametrize("command", ["replay", "export", "identify", "view"])
def test_a_bomb_is_refused_within_256_mib_and_5_s(
    command: str, bomb: Callable[[], bytes], tmp_path: Path
) -> None:
    path = tmp_path / "bomb.mcap"
    path.write_bytes(bomb())
    ended = ran(command, path, *(["--no-browser"] if command == "view" else []))
    assert ended.code == 1
    assert "damaged: " in ended.output
    assert "of an unknown number of steps were read" in ended.output
    # Processor time: what a busy machine adds is not the file's doing.
    assert ended.cpu_s < CPU_S
    assert 10.0 < ended.memory_mib < MEMORY_MIB


DEEP = "[" * 200_000
WAYS: tuple[tuple[str, ...], ...] = (
    ("replay",),
    ("export", "--out", "csv"),
    ("export", "--foxglove", "channels.mcap"),
    ("identify", "--out", "identified.yaml"),
    ("view", "--no-browser"),
)


@pytest.mark.parametrize("way", WAYS, ids=" ".join)
@pytest.mark.parametrize("content", [DEEP, "7"], ids=["deep", "number"])
@pytest.mark.parametrize("place", ["layout", "/linemate/parameters", "/linemate/timing"])
def test_json_that_no_recorder_wrote_is_refused_without_a_trace(
    way: tuple[str, ...], content: str, place: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """A command that does not read the place finds a recording without an end."""
    texts = metadata_of({"config": "task: wheel.yaml\n", "task": TASK.text, "urdf": TASK.urdf})
    data = MAGIC + built(
        Header("", "linemate"),
        Metadata("linemate", {**texts, **({"layout": content} if place == "layout" else {})}),
        Channel(id=7, topic=place, message_encoding="json", metadata={}, schema_id=0),
        Message(7, 0, content.encode(), 0, 0),
    )
    monkeypatch.chdir(tmp_path)
    Path("harm.mcap").write_bytes(data)
    assert tool.main([way[0], "harm.mcap", *way[1:]]) == 1


def read(data: bytes, skipped: list[str] | None = None) -> list[Any]:
    return list(records(io.BytesIO(data), {}, skipped))


def good() -> bytes:
    """Three chunks with a message each, then the end and statistics."""
    from mcap.writer import CompressionType, Writer

    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=1, compression=CompressionType.ZSTD)
    writer.start(profile="", library="")
    schema = writer.register_schema("s", "", b"")
    channel = writer.register_channel("/a", "json", schema)
    for k in range(3):
        writer.add_message(channel, k, json.dumps({"k": k}).encode(), k)
    writer.finish()  # type: ignore[no-untyped-call]
    return stream.getvalue()


def messages(found: list[Any]) -> list[int]:
    return [record.log_time for record in found if isinstance(record, Message)]


def test_a_good_file_is_read_without_damage() -> None:
    found = read(good())
    assert messages(found) == [0, 1, 2]
    assert not any(isinstance(record, Damage) for record in found)


def chunks_at(data: bytes) -> Iterator[tuple[int, int]]:
    """Where the chunks of a file begin, and how long they are."""
    at = len(MAGIC)
    while at + 9 <= len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == 6:
            yield at, 9 + length
        at += 9 + length


def test_any_flipped_byte_of_a_chunk_is_damage_or_changes_no_message() -> None:
    data = good()
    at, length = list(chunks_at(data))[1]
    for place in range(at, at + length):
        bad = bytearray(data)
        bad[place] ^= 0xFF
        found = read(bytes(bad))
        damage = [record for record in found if isinstance(record, Damage)]
        assert damage or messages(found) == [0, 1, 2], place
        if damage and place > at + 9:
            assert damage[0].counts == {"/a": 3}


def test_a_file_cut_anywhere_is_damage() -> None:
    data = good()
    for length in range(len(data) - len(MAGIC)):
        found = read(data[:length])
        assert isinstance(found[-1], Damage)
        assert found[-1].counts is None


def test_damaged_chunks_are_passed_over_where_that_is_asked_for() -> None:
    data = bytearray(good())
    at, length = list(chunks_at(bytes(data)))[1]
    data[at + length - 2] ^= 0xFF
    skipped: list[str] = []
    assert messages(read(bytes(data), skipped)) == [0, 2]
    assert len(skipped) == 1


def test_a_chunk_that_is_missing_is_damage() -> None:
    data = good()
    at, length = list(chunks_at(data))[2]
    found = read(data[:at] + data[at + length :])
    assert messages(found) == [0, 1]
    assert isinstance(found[-1], Damage)
    assert found[-1].reason == "1 messages are missing"


def test_a_record_that_claims_more_than_its_limit_is_not_read() -> None:
    class Watched(io.BytesIO):
        asked = 0

        def read(self, size: int | None = -1, /) -> bytes:
            self.asked = max(self.asked, size or 0)
            return super().read(size)

    stream = Watched(MAGIC + struct.pack("<BQ", 1, 2**40) + bytes(100))
    (found,) = records(stream)
    assert str(2**40) in found.reason
    assert stream.asked <= bounded_mcap.LARGEST_RECORD


def test_a_wrong_checksum_of_the_data_is_damage() -> None:
    data = good()
    at = data.index(struct.pack("<BQ", 15, 4))
    right = zlib.crc32(data[:at])
    for crc, is_damaged in ((right, False), (right ^ 1, True)):
        changed = data[: at + 9] + struct.pack("<I", crc) + data[at + 13 :]
        assert isinstance(read(changed)[-1], Damage) is is_damaged
