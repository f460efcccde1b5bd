import math
import struct

import cantools
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from linemate.protocol.sensors.distance import (
    MAX_FRAME_BYTES,
    SHIPPED_DBC,
    DistanceDecoder,
    DistanceEncoder,
    DistanceError,
)
from linemate.protocol.sensors.distance_bits import find
from linemate.protocol.stamped_samples import DistanceSample

SITE_DBC = """VERSION ""
BS_:
BU_: S H
BO_ 100 Muxed: 5 S
 SG_ Which M : 0|8@1+ (1,0) [0|3] "" H
 SG_ Gap m2 : 8|32@1- (1,0) [-5|5] "mm" H
 SG_ Other m1 : 8|16@1+ (1,0) [0|0] "" H
BO_ 101 Encoder: 5 S
 SG_ Travel : 0|32@1- (0.5,-1000) [0|0] "mm" H
 SG_ Weight : 32|8@1+ (1,0) [0|0] "kg" H
SIG_VALTYPE_ 100 Gap : 1;
"""

LASER = DistanceDecoder()
TF03 = DistanceDecoder(message="TF03", signal="Distance")
TF02 = DistanceDecoder(message="TF02", signal="Distance")
GAP = DistanceDecoder(SITE_DBC, "Muxed", "Gap")
TRAVEL = DistanceDecoder(SITE_DBC, "Encoder", "Travel")
SHIPPED = [("CIA406_TPDO1", "Position"), ("TF03", "Distance"), ("TF02", "Distance")]


def test_a_cia406_frame_of_the_manual_is_read_in_tenths_of_a_millimetre() -> None:
    sample = LASER.decode(0x183, bytes.fromhex("a05b0000"), 7)
    assert sample == DistanceSample(7, 2.3456, None)


def test_a_tf03_frame_is_read_in_centimetres_with_its_strength() -> None:
    sample = TF03.decode(0x003, bytes.fromhex("7b0009030000"), 7)
    assert sample == DistanceSample(7, 1.23, 777.0)


def test_a_tf02_frame_is_big_endian_on_a_29_bit_identifier() -> None:
    data = bytes.fromhex("007b030900080000")
    assert TF02.decode(0x90002, data, 7, extended=True) == DistanceSample(7, 1.23, 777.0)
    assert TF02.decode(0x90002, data, 7) is None


def test_the_cycle_time_comes_from_the_dbc() -> None:
    assert TF03.period_s == 0.01
    assert DistanceDecoder(SITE_DBC, "Encoder", "Travel").period_s is None


def test_somebody_elses_frame_is_nothing_even_if_it_is_short() -> None:
    assert LASER.decode(0x184, b"", 7) is None
    assert LASER.decode(0x183, b"", 7, extended=True) is None


@pytest.mark.parametrize("length", [0, 1, 2, 3, 4, 5])
def test_a_short_frame_is_refused_with_its_bytes(length: int) -> None:
    with pytest.raises(DistanceError, match=f"{length} bytes instead of 6") as caught:
        TF03.decode(3, bytes(length), 7)
    assert caught.value.data == bytes(length)
    assert caught.value.can_id == 3


def test_a_longer_frame_is_read_as_far_as_the_dbc_goes() -> None:
    assert TF03.decode(3, bytes.fromhex("7b00090300001122"), 7) == TF03.decode(
        3, bytes.fromhex("7b0009030000"), 7
    )


def test_the_dbcs_range_ends_are_in_and_one_count_beyond_is_out() -> None:
    frame = struct.Struct("<HHH")
    at_end = TF03.decode(3, frame.pack(18000, 1, 0), 7)
    assert at_end is not None
    assert at_end.position == pytest.approx(180.0)
    with pytest.raises(DistanceError, match=r"outside 0\.\.180"):
        TF03.decode(3, frame.pack(18001, 1, 0), 7)
    with pytest.raises(DistanceError, match=r"outside 0\.\.500"):
        LASER.decode(0x183, b"\xff\xff\xff\xff", 7)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_float_signal_that_is_not_finite_is_refused_on_both_ends(bad: float) -> None:
    decoder = DistanceDecoder(SITE_DBC, "Muxed", "Gap")
    with pytest.raises(DistanceError):
        decoder.decode(100, b"\x02" + struct.pack("<f", bad), 7)
    with pytest.raises(DistanceError):
        DistanceEncoder(SITE_DBC, "Muxed", "Gap").encode(bad)


def test_a_multiplexed_frame_without_the_signal_is_nothing() -> None:
    decoder = DistanceDecoder(SITE_DBC, "Muxed", "Gap")
    assert decoder.decode(100, b"\x01\x00\x00\x00\x00", 7) is None
    frame = DistanceEncoder(SITE_DBC, "Muxed", "Gap").encode(0.002)
    assert frame == (100, b"\x02" + struct.pack("<f", 2.0))
    assert decoder.decode(*frame, 7) == DistanceSample(7, 0.002)


def test_a_sites_own_sensor_needs_no_code_and_its_unit_becomes_metres() -> None:
    decoder = DistanceDecoder(SITE_DBC, "Encoder", "Travel")
    sample = decoder.decode(101, struct.pack("<ib", 5000, 0), 7)
    assert sample == DistanceSample(7, 1.5)


def test_node_and_measuring_step_can_differ_from_the_dbcs() -> None:
    decoder = DistanceDecoder(can_id=0x185, step=1e-3)
    assert decoder.decode(0x183, bytes(4), 7) is None
    assert decoder.decode(0x185, struct.pack("<I", 1234), 7) == DistanceSample(7, 1.234)
    assert DistanceEncoder(can_id=0x185, step=1e-3).encode(1.234) == (
        0x185,
        struct.pack("<I", 1234),
    )


def test_a_measuring_step_keeps_the_sign_of_the_dbcs() -> None:
    dbc = SHIPPED_DBC.read_text(encoding="latin-1")
    dbc = dbc.replace("(0.0001,0) [0|500]", "(-0.0001,0) [-500|0]")
    for step, expected in ((None, -0.1234), (1e-3, -1.234)):
        sample = DistanceDecoder(dbc, step=step).decode(0x183, struct.pack("<I", 1234), 7)
        assert sample is not None
        assert sample.position == pytest.approx(expected)


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ({"dbc": "no/such/file.dbc"}, "cannot read the DBC"),
        ({"dbc": SHIPPED_DBC.parent}, "cannot read the DBC"),
        ({"dbc": "not\na dbc"}, "not a DBC"),
        ({"dbc": "with\0nul"}, "not a DBC"),
        ({"message": "TF04"}, "no message 'TF04'; it has CIA406_TPDO1, TF02, TF03"),
        ({"signal": "Range"}, "no signal 'Range'; it has Position"),
        ({"strength": "Echo"}, "no signal 'Echo'"),
        ({"dbc": SITE_DBC, "message": "Encoder", "signal": "Weight"}, "in 'kg'"),
        ({"step": 0.0}, "a count is worth 0.0"),
        ({"step": math.nan}, "a count is worth nan"),
    ],
)
def test_a_wrong_description_is_refused_by_name(arguments: dict[str, object], what: str) -> None:
    with pytest.raises(DistanceError, match=what):
        DistanceDecoder(**arguments)  # type: ignore[arg-type]


def test_the_encoder_refuses_what_the_frame_cannot_carry() -> None:
    encoder = DistanceEncoder(message="TF03", signal="Distance")
    for position, strength in [(-0.02, 0.0), (180.02, 0.0), (1.0, -1.0), (1.0, 65536.0)]:
        with pytest.raises(DistanceError):
            encoder.encode(position, strength)


@given(st.sampled_from(SHIPPED), st.floats(0.0, 22.0), st.integers(0, 65535))
def test_a_distance_survives_the_wire_to_half_a_count(
    names: tuple[str, str], position: float, strength: int
) -> None:
    message, signal = names
    decoder = DistanceDecoder(message=message, signal=signal)
    encoder = DistanceEncoder(message=message, signal=signal)
    can_id, data = encoder.encode(position, strength)
    sample = decoder.decode(can_id, data, 11, encoder.extended)
    assert sample is not None
    half = 0.5e-4 if message == "CIA406_TPDO1" else 0.5e-2
    assert abs(sample.position - position) <= half * (1 + 1e-9)
    assert sample.strength in {None, float(strength)}
    assert encoder.encode(sample.position, sample.strength) == (can_id, data)


@given(st.integers(0, 4), st.binary(max_size=MAX_FRAME_BYTES + 8), st.integers(0, 2**63))
@example(3, b"\xff" * 8, 0)
def test_any_bytes_give_a_sane_sample_or_a_distance_error(
    which: int, data: bytes, stamp_ns: int
) -> None:
    decoder = (LASER, TF03, TF02, GAP, TRAVEL)[which]
    try:
        sample = decoder.decode(decoder.can_id, data, stamp_ns, decoder.extended)
    except DistanceError:
        return
    if sample is not None:
        assert math.isfinite(sample.position)
        assert sample.stamp_ns == stamp_ns


@given(
    st.integers(1, 8), st.booleans(), st.booleans(), st.integers(0, 63), st.integers(1, 32),
    st.binary(min_size=8, max_size=8), st.integers(-(2**33), 2**33),
)  # fmt: skip
@example(8, True, True, 7, 16, b"\xff" * 8, -1)
def test_bits_lie_where_cantools_finds_them(
    length: int, big: bool, signed: bool, start: int, size: int, data: bytes, count: int
) -> None:
    order, sign = (0 if big else 1), ("-" if signed else "+")
    dbc = f"""VERSION ""
BS_:
BU_: S H
BO_ 101 Encoder: {length} S
 SG_ Travel : {start}|{size}@{order}{sign} (1,0) [0|0] "m" H
"""
    try:
        message = cantools.database.load_string(dbc, database_format="dbc").messages[0]
    except cantools.database.errors.Error:
        return  # it does not fit its message
    bits = find(message, ["Travel"])
    assert bits is not None
    found = bits["Travel"]
    expected = message.decode(data[:length], scaling=False, decode_choices=False)
    assert {"Travel": found.read(data[:length])} == expected
    if found.fits(count):
        assert found.packed(count) == message.encode({"Travel": count}, scaling=False, strict=False)
    else:
        with pytest.raises(Exception):  # noqa: B017, PT011 -- whatever cantools says of it
            message.encode({"Travel": count}, scaling=False, strict=False)


def test_multiplexed_and_float_signals_are_not_plain() -> None:
    messages = cantools.database.load_string(SITE_DBC, database_format="dbc")
    assert find(messages.get_message_by_name("Muxed"), ["Gap"]) is None
    assert find(messages.get_message_by_name("Encoder"), ["Travel", "Weight"]) is not None
