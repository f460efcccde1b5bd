import itertools
import math
import re
import struct
from collections.abc import Callable

import fastcrc
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from linemate.protocol.sensors.bota import ANSWER_TIMEOUT_NS, STATUS_OVERRANGE
from linemate.protocol.sensors.ft300 import FT300_START, FT300_STARTED, FT300_STOP
from linemate.protocol.sensors.wrench import (
    BAUD_RATES,
    DEVICES,
    BotaDecoder,
    BotaDevice,
    BotaHost,
    BotaSettings,
    Ft300Device,
    Ft300Host,
    Robotiq300Decoder,
    WrenchDecoder,
    WrenchDevice,
    WrenchError,
    WrenchHost,
    bota_frame,
    ft300_frame,
    make_decoder,
    make_device,
    make_host,
)
from linemate.protocol.sensors.wrench_stream import MAX_ATTEMPTS, SILENT_ATTEMPTS, SILENT_FRAMES
from linemate.protocol.stamped_samples import WrenchSample

BOTA_HEX = "aa 0200 0000803f 00000040 00004040 00008040 0000a040 0000c040 4d000000 0000c841 6359"
FT300_HEX = "204e 7b00 c800 2c01 a00f 8813 7017 a35a"

single = st.floats(-1e4, 1e4, width=32)
vectors = st.tuples(single, single, single)
FRAMES: dict[str, Callable[[int], bytes]] = {
    "bota": lambda k: bota_frame((k, -k, 0.5), (0.25, k, 3.0), device_us=4000 * k),
    "robotiq-ft300": lambda k: ft300_frame((k % 300, -1.5, 0.0), (0.25, 1.0, -k % 30)),
}


def stream(device: str, count: int) -> bytes:
    return b"".join(FRAMES[device](k) for k in range(count))


def fed(decoder: WrenchDecoder, *pieces: bytes) -> list[WrenchSample]:
    return [sample for piece in pieces for sample in decoder.feed(piece, 5)]


def test_the_checks_give_their_catalogue_values() -> None:
    assert fastcrc.crc16.ibm_sdlc(b"123456789") == 0x906E
    assert fastcrc.crc16.modbus(b"123456789") == 0x4B37


def test_a_bota_frame_is_read_byte_for_byte() -> None:
    samples = BotaDecoder().feed(bytes.fromhex(BOTA_HEX), 9)
    assert samples == [
        WrenchSample(9, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), STATUS_OVERRANGE, 77, 25.0)
    ]
    frame = bota_frame((1, 2, 3), (4, 5, 6), status=2, device_us=77, temperature=25.0)
    assert frame == bytes.fromhex(BOTA_HEX)


def test_an_ft300_frame_is_read_byte_for_byte() -> None:
    samples = Robotiq300Decoder().feed(bytes.fromhex(FT300_HEX), 9)
    assert samples == [WrenchSample(9, (1.23, 2.0, 3.0), (4.0, 5.0, 6.0))]
    assert ft300_frame((1.23, 2, 3), (4, 5, 6)) == bytes.fromhex(FT300_HEX)


@given(
    vectors, vectors, st.integers(0, 0xFFFF), st.integers(0, 2**40), st.floats(-40, 85, width=32)
)
def test_a_bota_wrench_survives_the_wire(
    force: tuple[float, float, float],
    torque: tuple[float, float, float],
    status: int,
    device_us: int,
    temperature: float,
) -> None:
    frame = bota_frame(force, torque, status=status, device_us=device_us, temperature=temperature)
    assert BotaDecoder().feed(frame, 3) == [
        WrenchSample(3, force, torque, status, device_us % 2**32, temperature)
    ]


@given(st.tuples(*[st.integers(-32768, 32767)] * 3), st.tuples(*[st.integers(-32768, 32767)] * 3))
def test_an_ft300_wrench_survives_the_wire_count_for_count(
    force: tuple[int, int, int], torque: tuple[int, int, int]
) -> None:
    frame = ft300_frame([f / 100 for f in force], [t / 1000 for t in torque])
    assert struct.unpack("<6h", frame[2:14]) == (*force, *torque)
    (sample,) = Robotiq300Decoder().feed(frame, 3)
    assert ft300_frame(sample.force, sample.torque) == frame


def test_an_ft300_frame_saturates_where_the_device_does() -> None:
    (sample,) = Robotiq300Decoder().feed(ft300_frame((1e6, -1e6, 0), (0, 1e6, -1e6)), 3)
    assert sample.force == (327.67, -327.68, 0.0)
    assert sample.torque == (0.0, 32.767, -32.768)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(7))
def test_a_frame_that_is_not_finite_is_dropped_whole_and_counted(bad: float, place: int) -> None:
    values = [1.0] * 7
    values[place] = bad
    frame = bota_frame(values[:3], values[3:6], temperature=values[6])
    decoder = BotaDecoder()
    samples = fed(decoder, FRAMES["bota"](1) + frame + FRAMES["bota"](2))
    assert [sample.force[0] for sample in samples] == [1.0, 2.0]
    assert decoder.counters() == {
        "frames": 2,
        "bad_crc": 0,
        "nonfinite": 1,
        "garbage_bytes": 0,
        "resyncs": 0,
    }


def test_infinities_of_both_signs_do_not_cancel() -> None:
    frame = bota_frame((math.inf, -math.inf, 0), (0, 0, 0))
    decoder = BotaDecoder()
    assert fed(decoder, frame) == []
    assert decoder.nonfinite == 1


@pytest.mark.parametrize(
    ("force", "torque"),
    [
        ((1, 2), (3, 4, 5)),
        ((1, 2, 3), (3, 4)),
        ((1e39, 0, 0), (0, 0, 0)),
        ((None, 0, 0), (0, 0, 0)),
    ],
)
def test_what_fits_no_bota_frame_is_refused(
    force: tuple[float, ...], torque: tuple[float, ...]
) -> None:
    with pytest.raises(WrenchError):
        bota_frame(force, torque)


@pytest.mark.parametrize("force", [(math.nan, 0, 0), (0, math.inf, 0), (1, 2), (1, 2, 3, 4)])
def test_what_fits_no_ft300_frame_is_refused(force: tuple[float, ...]) -> None:
    with pytest.raises(WrenchError):
        ft300_frame(force, (0, 0, 0))


@pytest.mark.parametrize("device", DEVICES)
def test_a_stream_cut_at_every_position_gives_the_same_samples(device: str) -> None:
    data = b"\xaa\x20\x4e\x00" + stream(device, 3) + b"\x20\xaa" + stream(device, 2)
    whole = make_decoder(device)
    expected = fed(whole, data)
    assert len(expected) == 5
    for cut in range(len(data) + 1):
        decoder = make_decoder(device)
        assert fed(decoder, data[:cut], data[cut:]) == expected
        assert decoder.counters() == whole.counters()


@pytest.mark.parametrize("device", DEVICES)
@given(data=st.data())
def test_pieces_of_any_size_give_what_the_whole_gives(device: str, data: st.DataObject) -> None:
    header = FRAMES[device](0)[:2]
    part = st.one_of(
        st.integers(0, 200).map(FRAMES[device]),
        st.binary(max_size=40),
        st.sampled_from([header, header[:1], header * 3]),
    )
    wire = b"".join(data.draw(st.lists(part, max_size=8)))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(wire)), max_size=12)))
    whole, pieces = make_decoder(device), make_decoder(device)
    bounds = [0, *cuts, len(wire)]
    expected = fed(whole, wire)
    assert fed(pieces, *[wire[a:b] for a, b in itertools.pairwise(bounds)]) == expected
    assert pieces.counters() == whole.counters()


@pytest.mark.parametrize("device", DEVICES)
@given(garbage=st.binary(max_size=120))
@example(garbage=b"\xaa" * 40)
@example(garbage=b"\x20\x4e" * 20 + b"\x20")
def test_no_frame_behind_garbage_is_lost(device: str, garbage: bytes) -> None:
    decoder = make_decoder(device)
    alone = make_decoder(device)
    longest = len(FRAMES[device](0))
    fed(alone, garbage + bytes(longest))
    assume(alone.frames == alone.nonfinite == 0)
    good = 5
    samples = fed(decoder, FRAMES[device](0) + garbage + stream(device, good), bytes(longest))
    assert samples[1:] == fed(make_decoder(device), stream(device, good))
    assert decoder.resyncs == (1 if garbage else 0)
    assert len(garbage) <= decoder.garbage_bytes <= len(garbage) + longest


@pytest.mark.parametrize("device", DEVICES)
def test_a_flipped_bit_is_refused_and_counted(device: str) -> None:
    size = len(FRAMES[device](0))
    data = stream(device, 3)
    expected = fed(make_decoder(device), data)
    for bit in range(size * 8):
        broken = bytearray(data)
        broken[size + bit // 8] ^= 1 << bit % 8
        decoder = make_decoder(device)
        assert fed(decoder, bytes(broken), bytes(size)) == [expected[0], expected[2]], bit
        assert decoder.resyncs == 1
        assert decoder.garbage_bytes >= size
        assert decoder.bad_crc >= 1 or bit < 16


@pytest.mark.parametrize("device", DEVICES)
def test_a_lost_byte_costs_one_frame(device: str) -> None:
    size = len(FRAMES[device](0))
    data = stream(device, 4)
    expected = fed(make_decoder(device), data)
    for missing in range(size, 2 * size):
        decoder = make_decoder(device)
        samples = fed(decoder, data[:missing] + data[missing + 1 :], bytes(size))
        assert samples == [expected[0], expected[2], expected[3]]


@pytest.mark.parametrize("device", DEVICES)
@given(pieces=st.lists(st.binary(max_size=200), max_size=6))
def test_any_bytes_give_finite_samples_and_every_byte_is_accounted_for(
    device: str, pieces: list[bytes]
) -> None:
    decoder = make_decoder(device)
    samples = fed(decoder, *pieces)
    assert all(math.isfinite(v) for s in samples for v in (*s.force, *s.torque))
    size = len(FRAMES[device](0))
    framed = (decoder.frames + decoder.nonfinite) * size
    kept = sum(map(len, pieces)) - framed - decoder.garbage_bytes
    assert 0 <= kept < size


def test_a_reopened_port_forgets_the_half_frame_and_keeps_the_counters() -> None:
    decoder = BotaDecoder()
    frame = FRAMES["bota"](1)
    fed(decoder, frame + frame[:20])
    decoder.reset()
    assert len(fed(decoder, frame)) == 1
    assert decoder.counters()["garbage_bytes"] == 0
    assert decoder.frames == 2


def test_a_device_is_named_or_refused_with_the_names_there_are() -> None:
    assert set(BAUD_RATES) == set(DEVICES)
    for make in (make_decoder, make_device, make_host):
        with pytest.raises(WrenchError, match="there are bota, robotiq-ft300"):
            make("ati")


# --- the start-up dialogues: both ends, each against the other -----------------------------


def talk(host: WrenchHost, device: WrenchDevice, size: int, until_ns: int = 10**10) -> bytes:
    """Run both ends over a line that hands over ``size`` bytes at a time."""
    now_ns, to_device, to_host, stream_bytes = 0, host.begin(0).send, device.boot(), b""
    while now_ns < until_ns and (to_device or to_host or not host.running):
        now_ns += 10_000_000
        to_host += device.feed(to_device[:size])
        to_device = to_device[size:]
        output = host.feed(to_host[:size], now_ns)
        to_host = to_host[size:]
        to_device += output.send + host.on_time(now_ns).send
        stream_bytes += output.stream
    return stream_bytes


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("size", [1, 2, 3, 7, 1000])
def test_both_ends_agree_and_the_first_frame_is_not_garbage(device: str, size: int) -> None:
    host, sensor = make_host(device), make_device(device)
    assert talk(host, sensor, size) == b""
    assert host.running
    assert host.failure is None
    assert sensor.streaming
    decoder = make_decoder(device)
    frames = stream(device, 2)
    got = host.feed(frames[:5], 0).stream + host.feed(frames[5:], 0).stream
    assert len(fed(decoder, got)) == 2
    assert decoder.garbage_bytes == 0


def test_bota_settings_arrive_at_the_device() -> None:
    settings = BotaSettings(
        sinc=64, baud_rate=115200, temperature_compensation=True, calibration=False, chop=True
    )
    host, sensor = BotaHost(settings), BotaDevice()
    talk(host, sensor, 4)
    assert sensor.settings == settings
    assert sensor.refused == 0


def test_the_bota_dialogue_is_the_makers() -> None:
    assert BotaSettings(sinc=512, skip_fir=False).commands() == (
        b"C",
        b"c,0,1,0,4",
        b"f,512,0,0,0",
        b"R",
    )
    sensor = BotaDevice()
    assert b"App Init" in sensor.boot()
    assert sensor.streaming
    assert sensor.feed(b"C") == b"r,0,C,0\r\n"
    assert not sensor.streaming
    assert sensor.feed(b"c,0,1,0,4") == b"r,0,c,0\r\n"
    assert sensor.feed(b"f,512,0,0,0") == b"r,0,f,0\r\n"
    assert sensor.feed(b"R") == b"r,0,R,0\r\n"
    assert sensor.streaming


def test_the_bota_host_reads_answers_among_old_frames() -> None:
    host = BotaHost()
    frames = stream("bota", 3)
    host.begin(0)
    assert host.feed(frames + b"r,0,C", 0).send == b""
    assert host.feed(b",0" + frames, 0).send == b"c,0,1,0,4"


def test_the_bota_host_begins_again_when_an_answer_is_overdue_and_gives_up_in_the_end() -> None:
    host, now_ns = BotaHost(), 0
    sent = [host.begin(now_ns).send]
    assert host.on_time(ANSWER_TIMEOUT_NS - 1).send == b""
    while host.failure is None:
        now_ns += ANSWER_TIMEOUT_NS
        sent.append(host.on_time(now_ns).send)
    assert sent == [b"C"] * MAX_ATTEMPTS + [b""]
    assert "no answer to 'C'" in host.failure
    assert host.feed(b"r,0,C,0", now_ns).send == b""
    assert host.begin(now_ns).send == b"C"
    assert host.failure is None


@pytest.mark.parametrize("device", DEVICES)
def test_a_device_that_streams_whatever_it_is_asked_is_taken_as_it_is(device: str) -> None:
    host, now_ns = make_host(device), 0
    host.begin(now_ns)
    for _ in range(SILENT_ATTEMPTS - 1):
        assert host.feed(stream(device, SILENT_FRAMES), now_ns).stream == b""
        now_ns += 10**9
        assert host.on_time(now_ns).send
    for _ in range(SILENT_FRAMES - 1):
        assert host.feed(stream(device, 1), now_ns).stream == b""
    assert not host.running
    assert host.feed(stream(device, 1), now_ns).stream == stream(device, 1)
    assert host.running
    assert host.on_time(now_ns + 10**10).send == b""


def test_a_late_answer_to_an_older_command_is_passed_over() -> None:
    host = BotaHost()
    host.begin(0)
    host.on_time(ANSWER_TIMEOUT_NS)
    assert host.feed(b"r,0,C,0\r\nr,0,C,0\r\n", 0).send == b"c,0,1,0,4"
    assert host.feed(b"r,0,c,0\r\n", 0).send == b"f,205,0,0,1"


def test_a_refused_command_ends_the_bota_dialogue_with_its_code() -> None:
    host = BotaHost()
    host.begin(0)
    host.feed(b"r,0,C,0", 0)
    host.feed(b"r,0,c,3", 0)
    assert host.failure == "bota: 'c,0,1,0,4' refused with code 3"


@pytest.mark.parametrize(
    "command",
    [b"c,0,1,1,4", b"c,0,1,0,5", b"c,2,1,0,4", b"f,50,0,0,0", b"f,513,0,0,0", b"f,64,2,0,0"],
)
def test_the_bota_device_refuses_settings_out_of_range_and_keeps_the_old(command: bytes) -> None:
    sensor = BotaDevice()
    sensor.feed(b"C")
    assert sensor.feed(command) == b"r,0,%s,1\r\n" % command[:1]
    sensor.feed(b"R")
    assert sensor.settings == BotaSettings()
    assert sensor.refused == 1


def test_the_bota_device_refuses_to_be_set_while_it_streams() -> None:
    sensor = BotaDevice()
    sensor.boot()
    assert sensor.feed(b"f,64,0,0,0") == b"r,0,f,1\r\n"
    assert sensor.settings.sinc == 205


@pytest.mark.parametrize(("sinc", "baud_rate"), [(50, 460800), (513, 460800), (64, 19200)])
def test_bota_settings_out_of_range_are_refused(sinc: int, baud_rate: int) -> None:
    with pytest.raises(WrenchError):
        BotaSettings(sinc=sinc, baud_rate=baud_rate)


def test_the_ft300_start_request_is_the_manuals() -> None:
    assert bytes.fromhex("09 10 01 9A 00 01 02 02 00 CD CA") == FT300_START
    sensor = Ft300Device()
    assert sensor.feed(FT300_STOP + FT300_START) == FT300_STARTED
    assert sensor.streaming
    assert sensor.feed(FT300_STOP[:-1]) == b""
    assert sensor.streaming
    assert sensor.feed(FT300_STOP) == b""
    assert not sensor.streaming
    assert sensor.refused == 0


def test_the_ft300_host_asks_again_and_gives_up_in_the_end() -> None:
    host, sent, now_ns = Ft300Host(), [], 0
    sent.append(host.begin(now_ns).send)
    while host.failure is None:
        now_ns += 10**9
        sent.append(host.on_time(now_ns).send)
    assert sent == [FT300_STOP + FT300_START] * 10 + [b""]
    assert host.feed(FT300_STARTED, now_ns).stream == b""
    assert not host.running


@pytest.mark.parametrize("device", DEVICES)
@given(pieces=st.lists(st.binary(max_size=60), max_size=6))
@example(pieces=[b"c,0,", b"1,0,4f,", b"64,0,0,0", b"m1,2,3\rR#"])
def test_neither_end_of_a_dialogue_falls_over_any_bytes(device: str, pieces: list[bytes]) -> None:
    host, sensor = make_host(device), make_device(device)
    host.begin(0)
    for index, piece in enumerate(pieces):
        output = host.feed(piece, index)
        assert len(output.stream) <= sum(map(len, pieces))
        answer = sensor.feed(piece)
        assert re.fullmatch(rb"(r,0,[A-Za-z],\d\r\n|[\x09-\x7f]*App Init\r\n)*", answer) or (
            answer.startswith(FT300_STARTED)
        )


@given(st.binary(max_size=200))
def test_the_bota_device_answers_the_same_however_its_input_is_cut(data: bytes) -> None:
    whole, single_bytes = BotaDevice(), BotaDevice()
    answers = b"".join(single_bytes.feed(data[i : i + 1]) for i in range(len(data)))
    assert answers == whole.feed(data)
    assert single_bytes.settings == whole.settings
    assert single_bytes.streaming == whole.streaming
