import itertools
import math
from typing import Any

import msgpack
import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from linemate.protocol.sensors.camera_codec import (
    MAX_DATAGRAM_BYTES,
    MAX_GAP,
    QUATERNION_TOLERANCE,
    REFUSALS,
    CameraDecoder,
    CameraError,
    CameraMessage,
    decode,
    encode,
)
from linemate.protocol.sensors.clock_offset import SLICES, ClockOffset

MS = 1_000_000
S = 1_000_000_000
PERIOD_NS = 25 * MS
EXPOSED_NS = 90 * MS
"""From exposure to sending."""
DIAGONAL = (0, 6, 11, 15, 18, 20)

FIELDS: dict[str, Any] = {
    "v": 1,
    "src": "cam0",
    "seq": 7,
    "t_exp": 1_000_000,
    "t_tx": 2_000_000,
    "frame": "camera",
    "obj": "hub",
    "p": [0.1, -0.2, 1.5],
    "q": [1.0, 0.0, 0.0, 0.0],
}
COVARIANCE = [1e-6 if index in DIAGONAL else 0.0 for index in range(21)]


def pack(**changes: Any) -> bytes:
    return bytes(msgpack.packb({**FIELDS, **changes}))


def message(seq: int, **changes: Any) -> bytes:
    """A message of a sender whose clock is ``t_tx`` and who sends each 25 ms."""
    t_tx = changes.get("t_tx", seq * PERIOD_NS)
    return pack(**{"seq": seq, "t_exp": t_tx - EXPOSED_NS, "t_tx": t_tx, **changes})


def refused(decoder: CameraDecoder, data: bytes, stamp_ns: int) -> str:
    with pytest.raises(CameraError) as caught:
        decoder.feed(data, stamp_ns)
    return caught.value.reason


# --- one message ----------------------------------------------------------------------------


def test_a_message_of_any_msgpack_library_is_read() -> None:
    got = decode(pack(cov=COVARIANCE, quality=80, reset=3, n_in=12, extra={"deep": [None]}))
    assert got == CameraMessage(
        v=1,
        src="cam0",
        seq=7,
        t_exp=1_000_000,
        t_tx=2_000_000,
        frame="camera",
        obj="hub",
        p=(0.1, -0.2, 1.5),
        q=(1.0, 0.0, 0.0, 0.0),
        cov=tuple(COVARIANCE),
        quality=80,
        reset=3,
    )


def test_optional_keys_may_be_left_out_and_whole_numbers_are_floats_too() -> None:
    got = decode(pack(p=[0, 1, 2], q=[1, 0, 0, 0]))
    assert (got.cov, got.quality, got.reset) == (None, -1, 0)
    assert got.p == (0.0, 1.0, 2.0)


@pytest.mark.parametrize("key", FIELDS)
def test_every_required_key_is_required(key: str) -> None:
    fields = {name: value for name, value in FIELDS.items() if name != key}
    with pytest.raises(CameraError, match=f"`{key}`"):
        decode(msgpack.packb(fields))


@pytest.mark.parametrize(
    "changes",
    [
        {"v": 2},
        {"v": 0},
        {"v": "1"},
        {"v": True},
        {"src": 3},
        {"src": ""},
        {"src": "x" * 65},
        {"seq": -1},
        {"seq": 1.5},
        {"seq": True},
        {"t_exp": "0"},
        {"t_tx": None},
        {"p": [0.0, 0.0]},
        {"p": [0.0, 0.0, 0.0, 0.0]},
        {"p": [0.0, "0", 0.0]},
        {"q": [1.0, 0.0, 0.0]},
        {"q": [1.0 + 2 * QUATERNION_TOLERANCE, 0.0, 0.0, 0.0]},
        {"q": [1.0 - 2 * QUATERNION_TOLERANCE, 0.0, 0.0, 0.0]},
        {"q": [0.0, 0.0, 0.0, 0.0]},
        {"q": [1e200, 0.0, 0.0, 0.0]},
        {"cov": COVARIANCE[:20]},
        {"cov": [*COVARIANCE, 1.0]},
        {"quality": -2},
        {"quality": 101},
        {"reset": -1},
    ],
)
def test_what_the_table_does_not_allow_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(CameraError) as caught:
        decode(pack(**changes))
    assert caught.value.reason == "malformed"
    assert caught.value.data == pack(**changes)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(("key", "length"), [("p", 3), ("q", 4), ("cov", 21)])
def test_a_number_that_is_not_finite_is_refused_wherever_it_stands(
    key: str, length: int, bad: float
) -> None:
    values = {"p": [0.0] * 3, "q": [1.0, 0.0, 0.0, 0.0], "cov": COVARIANCE}[key]
    for place in range(length):
        broken = [*values[:place], bad, *values[place + 1 :]]
        with pytest.raises(CameraError):
            decode(pack(**{key: broken}))


def test_infinities_of_both_signs_do_not_cancel_and_huge_finite_numbers_are_finite() -> None:
    with pytest.raises(CameraError):
        decode(pack(p=[math.inf, -math.inf, 0.0]))
    assert decode(pack(p=[1.7e308, 1.7e308, 0.0])).p[0] == 1.7e308


@pytest.mark.parametrize("place", DIAGONAL)
@pytest.mark.parametrize("variance", [0.0, -1e-9])
def test_a_variance_that_is_not_positive_is_refused(place: int, variance: float) -> None:
    with pytest.raises(CameraError, match="not positive"):
        decode(pack(cov=[*COVARIANCE[:place], variance, *COVARIANCE[place + 1 :]]))


def test_a_quaternion_within_the_tolerance_comes_out_of_unit_length() -> None:
    data = message(1, q=[1.0 + 0.9 * QUATERNION_TOLERANCE, 0.0, 0.0, 0.0])
    assert CameraDecoder().feed(data, S).quaternion == (1.0, 0.0, 0.0, 0.0)


def test_a_message_is_under_1200_bytes_on_both_ends() -> None:
    length = len(pack(pad=b"x" * 300))
    fits = pack(pad=b"x" * (300 + MAX_DATAGRAM_BYTES - length))
    assert len(fits) == 1199
    assert decode(fits).seq == 7
    with pytest.raises(CameraError, match="over 1199"):
        decode(pack(pad=b"x" * (301 + MAX_DATAGRAM_BYTES - length)))
    with pytest.raises(CameraError, match="over 1199"):
        encode(msgspec.structs.replace(decode(pack()), obj="x" * 1200))


def test_the_encoder_leaves_out_what_says_nothing() -> None:
    assert msgpack.unpackb(encode(decode(pack()))) == FIELDS
    assert set(msgpack.unpackb(encode(decode(pack(quality=5, reset=1))))) == {
        *FIELDS,
        "quality",
        "reset",
    }


def test_the_encoder_refuses_what_msgpack_cannot_carry() -> None:
    with pytest.raises(CameraError):
        encode(msgspec.structs.replace(decode(pack()), seq=2**64))


finite = st.floats(-1e6, 1e6)
variance = st.floats(1e-12, 1e3)
names = st.text(min_size=1, max_size=20)


@st.composite
def messages(draw: st.DrawFn) -> CameraMessage:
    cov = [draw(variance) if i in DIAGONAL else draw(finite) for i in range(21)]
    angle = draw(st.floats(-4, 4))
    return CameraMessage(
        v=1,
        src=draw(names),
        seq=draw(st.integers(0, 2**64 - 1)),
        t_exp=draw(st.integers(-(2**63), 2**64 - 1)),
        t_tx=draw(st.integers(-(2**63), 2**64 - 1)),
        frame=draw(names),
        obj=draw(names),
        p=draw(st.tuples(finite, finite, finite)),
        q=(math.cos(angle), 0.0, math.sin(angle), 0.0),
        cov=draw(st.sampled_from([None, tuple(cov)])),
        quality=draw(st.integers(-1, 100)),
        reset=draw(st.integers(0, 255)),
    )


@given(messages())
def test_a_message_survives_the_wire(sent: CameraMessage) -> None:
    assert decode(encode(sent)) == sent


@given(messages(), st.integers(0, 2**40))
def test_a_decoder_takes_any_message_and_keeps_its_stamps_in_order(
    sent: CameraMessage, stamp_ns: int
) -> None:
    decoder = CameraDecoder()
    try:
        sample = decoder.feed(encode(sent), stamp_ns)
    except CameraError as error:
        assert error.reason == "stale"  # noqa: PT017 - only this reason is possible here
        return
    assert stamp_ns - S <= sample.exposure_ns <= stamp_ns
    assert math.isclose(math.hypot(*sample.quaternion), 1.0, rel_tol=1e-12)


@given(st.binary(max_size=MAX_DATAGRAM_BYTES + 5), st.integers(0, 2**63))
@example(b"\x81\xa1z" + b"\x91" * 1190, 0)
@example(b"\x81\xa1z" + b"\x81\xa1z" * 390, 0)
@example(b"\x81\xa1z\xdd\xff\xff\xff\xff", 0)
@example(b"\xdf\xff\xff\xff\xff", 0)
@example(b"\x81\xa1\xff\xa1\xff", 0)
@example(pack() + b"\x00", 0)
def test_any_bytes_give_a_message_or_a_camera_error(data: bytes, stamp_ns: int) -> None:
    decoder = CameraDecoder()
    try:
        sample = decoder.feed(data, stamp_ns)
    except CameraError:
        assert sum(decoder.refused.values()) == 1
    else:
        assert all(map(math.isfinite, sample.position))


@given(st.data())
def test_a_changed_datagram_gives_a_sane_message_or_a_camera_error(data: st.DataObject) -> None:
    datagram = bytearray(pack(cov=COVARIANCE, quality=9, reset=1))
    for _ in range(data.draw(st.integers(1, 4))):
        datagram[data.draw(st.integers(0, len(datagram) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(datagram)))
    for broken in (bytes(datagram), bytes(datagram[:cut])):
        try:
            got = decode(broken)
        except CameraError:
            continue
        assert all(map(math.isfinite, (*got.p, *got.q, *(got.cov or ()))))
        assert abs(math.hypot(*got.q) - 1) <= QUATERNION_TOLERANCE + 1e-12


# --- a camera over time ---------------------------------------------------------------------


def test_the_exposure_is_dated_by_the_fastest_message_of_the_window() -> None:
    decoder, offset_ns = CameraDecoder(), 5 * S
    transits_ms = [14, 12, 31, 10, 40, 11]
    for seq, transit_ms in enumerate(transits_ms):
        arrival_ns = seq * PERIOD_NS + offset_ns + transit_ms * MS
        sample = decoder.feed(message(seq), arrival_ns)
        fastest_ns = min(transits_ms[: seq + 1]) * MS
        assert sample.stamp_ns == arrival_ns
        assert sample.exposure_ns == seq * PERIOD_NS - EXPOSED_NS + offset_ns + fastest_ns
    assert decoder.offset_ns("cam0") == offset_ns + 10 * MS
    assert decoder.offset_ns("cam1") is None


def test_an_exposure_after_its_arrival_is_set_to_it_and_counted() -> None:
    decoder = CameraDecoder()
    sample = decoder.feed(message(0, t_exp=S), 3 * S)
    assert sample.exposure_ns == sample.stamp_ns == 3 * S
    assert decoder.clamped == 1


def test_an_exposure_too_long_ago_is_stale_whether_taken_or_sent_too_long_ago() -> None:
    decoder = CameraDecoder(max_age_s=0.5)
    assert refused(decoder, message(0, t_exp=-501 * MS), 3 * S) == "stale"
    assert decoder.feed(message(1, t_exp=PERIOD_NS - 500 * MS), 3 * S + PERIOD_NS).sequence == 1
    assert refused(decoder, message(2), 3 * S + 2 * PERIOD_NS + 411 * MS) == "stale"
    assert decoder.counters()["stale"] == 2


def test_one_datagram_with_a_wild_clock_does_not_spoil_the_window() -> None:
    decoder = CameraDecoder()
    decoder.feed(message(0), 3 * S)
    assert refused(decoder, message(1, t_tx=100 * S), 3 * S + PERIOD_NS) == "clock_jumps"
    sample = decoder.feed(message(2), 3 * S + 2 * PERIOD_NS)
    assert sample.exposure_ns == 3 * S + 2 * PERIOD_NS - EXPOSED_NS


def test_a_clock_set_forward_is_believed_after_three_messages() -> None:
    decoder = CameraDecoder()
    decoder.feed(message(0), 3 * S)
    for seq in (1, 2):
        data = message(seq, t_tx=100 * S + seq * PERIOD_NS)
        assert refused(decoder, data, 3 * S + seq * PERIOD_NS) == "clock_jumps"
    sample = decoder.feed(message(3, t_tx=100 * S), 4 * S)
    assert sample.exposure_ns == 4 * S - EXPOSED_NS


def test_a_clock_set_back_is_believed_after_three_messages() -> None:
    decoder = CameraDecoder()
    decoder.feed(message(400), 10 * S)
    outcomes: list[int | str] = []
    for seq in range(401, 440):
        arrival_ns = 10 * S + (seq - 400) * PERIOD_NS
        data = message(seq, t_tx=(seq - 400) * PERIOD_NS)
        try:
            outcomes.append(decoder.feed(data, arrival_ns).exposure_ns - arrival_ns)
        except CameraError as error:
            outcomes.append(error.reason)
    assert outcomes == ["stale", "stale"] + [-EXPOSED_NS] * 37


def test_delayed_messages_are_no_clock_set_back() -> None:
    decoder = CameraDecoder()
    decoder.feed(message(0), 3 * S)
    for seq in range(1, 6):
        assert refused(decoder, message(seq), 5 * S + seq * PERIOD_NS) == "stale"
    later = decoder.feed(message(80), 5 * S)
    assert later.exposure_ns == 5 * S - EXPOSED_NS


def test_one_message_with_an_old_time_of_sending_does_not_spoil_the_clock() -> None:
    decoder = CameraDecoder()
    decoder.feed(message(400), 10 * S)
    for seq in (401, 402, 404, 405, 407):
        wild = {"t_tx": 0} if seq != 404 else {}
        arrival_ns = 10 * S + (seq - 400) * PERIOD_NS
        if wild:
            assert refused(decoder, message(seq, **wild), arrival_ns) == "stale"
        else:
            assert decoder.feed(message(seq), arrival_ns).exposure_ns == arrival_ns - EXPOSED_NS


def test_missing_numbers_are_counted_as_gaps_and_messages() -> None:
    decoder = CameraDecoder()
    for seq in (0, 1, 4, 5, 7):
        decoder.feed(message(seq), 3 * S + seq * PERIOD_NS)
    assert (decoder.gaps, decoder.lost, decoder.accepted) == (2, 3, 5)


def test_a_wild_sequence_number_neither_floods_the_counter_nor_locks_the_camera_out() -> None:
    decoder = CameraDecoder()
    decoder.feed(message(0), 3 * S)
    decoder.feed(message(2**64 - 1, t_tx=PERIOD_NS), 3 * S + PERIOD_NS)
    assert decoder.lost == MAX_GAP
    reasons = [refused(decoder, message(k), 3 * S + k * PERIOD_NS) for k in (2, 3)]
    assert reasons == ["reordered", "reordered"]
    assert decoder.feed(message(4), 3 * S + 4 * PERIOD_NS).sequence == 4
    assert decoder.restarts == 1


def test_a_repeated_message_is_a_duplicate_and_an_older_one_is_reordered() -> None:
    decoder = CameraDecoder()
    for seq in (0, 1, 3):
        decoder.feed(message(seq), 3 * S + seq * PERIOD_NS)
    assert refused(decoder, message(3), 3 * S + 3 * PERIOD_NS) == "duplicates"
    assert refused(decoder, message(2), 3 * S + 3 * PERIOD_NS) == "reordered"
    assert refused(decoder, message(3, t_tx=4 * PERIOD_NS), 3 * S + 4 * PERIOD_NS) == "duplicates"
    assert decoder.feed(message(5), 3 * S + 5 * PERIOD_NS).sequence == 5


def test_stragglers_in_order_are_no_new_sender() -> None:
    decoder = CameraDecoder()
    decoder.feed(message(0), 3 * S)
    decoder.feed(message(9), 3 * S + 9 * PERIOD_NS)
    for seq in range(1, 9):
        assert refused(decoder, message(seq), 3 * S + 10 * PERIOD_NS) == "reordered"
    assert decoder.restarts == 0


def test_a_higher_reset_restarts_the_sequence_at_once() -> None:
    decoder = CameraDecoder()
    decoder.feed(message(50), 3 * S)
    sample = decoder.feed(message(0, t_tx=51 * PERIOD_NS, reset=1), 3 * S + PERIOD_NS)
    assert (sample.sequence, sample.reset) == (0, 1)
    assert (decoder.resets, decoder.gaps) == (1, 0)
    forward = decoder.feed(message(52, reset=2), 3 * S + 2 * PERIOD_NS)
    assert (forward.sequence, decoder.resets, decoder.gaps) == (52, 2, 0)
    assert refused(decoder, message(1, reset=1), 3 * S + 3 * PERIOD_NS) == "reordered"


def test_a_sender_that_rebooted_without_telling_is_believed_after_three_messages() -> None:
    decoder = CameraDecoder()
    decoder.feed(message(4000), 3 * S)
    back_ns = 20 * S
    reasons = [refused(decoder, message(k), back_ns + k * PERIOD_NS) for k in (0, 1)]
    sample = decoder.feed(message(2), back_ns + 2 * PERIOD_NS)
    assert reasons == ["reordered", "reordered"]
    assert sample.exposure_ns == sample.stamp_ns - EXPOSED_NS
    assert decoder.restarts == 1


def test_each_camera_has_a_state_of_its_own() -> None:
    decoder = CameraDecoder()
    for seq, src in itertools.product(range(3), ("left", "right")):
        decoder.feed(message(seq, src=src), 3 * S + seq * PERIOD_NS)
    assert decoder.accepted == 6
    assert decoder.offset_ns("left") == decoder.offset_ns("right") == 3 * S


def test_cameras_are_bounded_and_a_silent_one_is_dropped() -> None:
    decoder = CameraDecoder(max_sources=2, window_s=10.0)
    decoder.feed(message(0, src="a"), 3 * S)
    decoder.feed(message(0, src="b"), 4 * S)
    assert refused(decoder, message(0, src="c"), 12 * S) == "too_many_sources"
    decoder.feed(message(0, src="c"), 13 * S)
    assert decoder.offset_ns("a") is None
    assert decoder.offset_ns("b") is not None


def test_only_the_expected_camera_frame_and_object_are_taken() -> None:
    decoder = CameraDecoder("camera", "hub", "cam0")
    for key, other in (("frame", "base"), ("obj", "rim"), ("src", "cam1")):
        assert refused(decoder, message(0, **{key: other}), S) == "unexpected"
    assert decoder.feed(message(0), S).object_id == "hub"
    assert decoder.counters()["unexpected"] == 3


def test_of_two_objects_in_view_the_first_one_counts_until_it_is_gone() -> None:
    decoder = CameraDecoder("camera")
    stamps = [3 * S + seq * PERIOD_NS for seq in range(121)]
    for seq in range(0, 80, 2):
        assert decoder.feed(message(seq, obj="hub"), stamps[seq]).object_id == "hub"
        assert refused(decoder, message(seq + 1, obj="rim"), stamps[seq + 1]) == "unexpected"
    for seq in range(80, 118):  # until 1 s after the last hub
        assert refused(decoder, message(seq, obj="rim"), stamps[seq]) == "unexpected"
    assert decoder.feed(message(118, obj="rim"), stamps[118]).object_id == "rim"
    assert refused(decoder, message(119, obj="hub"), stamps[119]) == "unexpected"


@given(
    st.lists(
        st.tuples(
            st.integers(0, 12),
            st.integers(-2, 2),
            st.integers(0, 2),
            st.integers(0, 400),
            st.sampled_from(["a", "b", "c"]),
        ),
        max_size=40,
    )
)
def test_whatever_comes_is_given_out_or_counted_and_never_dated_wrongly(
    events: list[tuple[int, int, int, int, str]],
) -> None:
    decoder = CameraDecoder(max_sources=2)
    now_ns = 100 * S
    refusals = 0
    for seq, clock_s, reset, wait_ms, src in events:
        now_ns += wait_ms * MS
        data = message(seq, t_tx=now_ns + clock_s * S, reset=reset, src=src)
        try:
            sample = decoder.feed(data, now_ns)
        except CameraError as error:
            refusals += error.reason in REFUSALS
            continue
        assert now_ns - S <= sample.exposure_ns <= now_ns
    assert decoder.accepted + refusals == len(events)
    assert sum(decoder.refused.values()) == refusals


# --- the clock ------------------------------------------------------------------------------


@given(st.lists(st.tuples(st.integers(0, 3 * S), st.integers(-S, S)), min_size=1, max_size=60))
def test_the_offset_is_the_minimum_of_the_window_to_one_slice(steps: list[tuple[int, int]]) -> None:
    window_ns = 16 * S
    clock, now_ns, seen = ClockOffset(16.0), 0, []
    for wait_ns, transit_ns in steps:
        now_ns += wait_ns
        seen.append((now_ns, transit_ns))
        got = clock.learn(transit_ns, now_ns)
        surely = [t for at, t in seen if at > now_ns - window_ns + window_ns // SLICES]
        perhaps = [t for at, t in seen if at > now_ns - window_ns]
        assert min(perhaps) <= got <= min(surely)


def test_the_clocks_memory_is_bounded_and_can_be_cleared() -> None:
    clock = ClockOffset(1.0)
    for k in range(10_000):
        clock.learn(k, k * 10 * MS)
    assert len(clock._minima) <= SLICES
    clock.clear()
    assert clock.offset_ns is None
    assert clock.learn(-5, 0) == -5
