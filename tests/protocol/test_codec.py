"""RSI telegrams: literal ones, refusals, and laws."""

import math
from importlib.resources import files

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsi_layout import CARTESIAN, KUKA_SDK, PLAIN, config, six

from linemate.protocol.rsi.codec import (
    MAX_TELEGRAM_BYTES,
    Element,
    PreparedReply,
    RobotTelegram,
    RsiCodec,
    RsiConfig,
    RsiError,
    SensorTelegram,
    parse_config,
)
from linemate.protocol.units import DEG

DATA = files("linemate.protocol") / "data"
JOINTS = parse_config((DATA / "rsi_joints.xml").read_bytes())
SETPOINTS = parse_config((DATA / "rsi_joints_setpoints.xml").read_bytes())


# The fuller form of older documents, with what a site may add.
FULL = config(
    """DEF_RIst DOUBLE INTERNAL
    DEF_RSol DOUBLE INTERNAL
    DEF_AIPos DOUBLE INTERNAL
    DEF_ASPos DOUBLE INTERNAL
    DEF_EIPos DOUBLE INTERNAL
    DEF_ESPos DOUBLE INTERNAL
    DEF_MACur DOUBLE INTERNAL
    DEF_MECur DOUBLE INTERNAL
    DEF_Delay LONG INTERNAL
    DEF_Tech.C1 DOUBLE INTERNAL
    DiL LONG 1
    Digout.o1 BOOL 2
    Digout.o2 BOOL 3
    Digout.o3 BOOL 4
    Source1 DOUBLE 5""",
    """DEF_EStr STRING INTERNAL
    RKorr.X DOUBLE 1 1
    RKorr.Y DOUBLE 2 1
    DEF_Tech.T2 DOUBLE INTERNAL 0
    DiO LONG 3 1""",
)
FULL_TELEGRAM = (
    f'<Rob Type="KUKA"><RIst {CARTESIAN}/><RSol {CARTESIAN}/><AIPos {six("A", "1.5")}/>'
    f"<ASPos {six('A')}/><EIPos {six('E', '180')}/><ESPos {six('E')}/><MACur {six('A', '7')}/>"
    f'<MECur {six("E")}/><Delay D="0"/><Tech C11="1.09" C12="2.08" C13="0" C14="0" C15="0" '
    'C16="0" C17="0" C18="0" C19="0" C110="10.00"/><DiL>0</DiL>'
    '<Digout o1="0" o2="1" o3="0.00"/><Source1>-3.25</Source1><IPOC>4208163634</IPOC></Rob>'
).encode()

# KUKA's shipped example of a reply, line breaks as in the file.
KUKA_REPLY = b"""<Sen Type="ImFree">
<EStr>KRCnexxt - RSI Object ST_ETHERNET</EStr>
<RKorr X="0.0000" Y="0.0000" Z="0.0000" A="0.0000" B="0.0000" C="0.0000" />
<Tech T21="1.09" T22="2.08" T23="3.07" T24="4.06" T25="5.05" T26="6.04" T27="7.03" T28="8.02" \
T29="9.01" T210="10.00" />
<DiO>125</DiO>
<IPOC>0000000000</IPOC>
</Sen>
"""

SDK_REPLY_CONFIG = config(
    "",
    "Stop BOOL 1 0\n"
    + "\n".join(f"AK.A{n} DOUBLE {n + 1} 1" for n in range(1, 7))
    + "\nEK.E1 DOUBLE 8 1\nGPIO.01 BOOL 9",
    SENTYPE="KROSHU",
)
SDK_REPLY = (
    f'<Sen Type="KROSHU"><Stop>0</Stop><AK {six("A", "0.000001")}/><EK E1="12.500000"/>'
    '<GPIO 01="1"/><IPOC>115859599</IPOC></Sen>'
).encode()

ANGLE = st.floats(-math.tau, math.tau)
METRES = st.floats(-100.0, 100.0)
SIX_ANGLES = st.tuples(*[ANGLE] * 6)
EXTERNAL = st.tuples(METRES, *[ANGLE] * 5)
POSE = st.tuples(METRES, METRES, METRES, ANGLE, ANGLE, ANGLE)
IPOC_TEXT = st.from_regex(rb"[0-9]{1,15}", fullmatch=True)


@st.composite
def robot_telegrams(draw: st.DrawFn) -> RobotTelegram:
    text = draw(IPOC_TEXT)
    return RobotTelegram(
        int(text),
        text,
        joints=draw(SIX_ANGLES),
        joint_setpoints=draw(SIX_ANGLES),
        external=draw(EXTERNAL),
        tcp=draw(POSE),
        tcp_setpoint=draw(POSE),
        delay=draw(st.integers(0, 1000)),
        channels={"DiL": draw(st.integers(-(2**31), 2**31 - 1))},
    )


@st.composite
def sensor_telegrams(draw: st.DrawFn) -> SensorTelegram:
    text = draw(IPOC_TEXT)
    return SensorTelegram(
        int(text),
        text,
        "ImFree",
        joints=draw(SIX_ANGLES),
        external=(draw(METRES),),
        channels={"DiO": draw(st.integers(-(2**31), 2**31 - 1))},
    )


ROUND_TRIP = RsiCodec(SETPOINTS)


# --- literal telegrams ---------------------------------------------------------------------


def test_the_sdks_own_telegram_is_read() -> None:
    telegram = RsiCodec(PLAIN).parse_robot(KUKA_SDK)
    assert telegram == RobotTelegram(
        0, b"0", joints=(0.0,) * 6, external=(0.0,) * 6, tcp=(0.0,) * 6, delay=15, channels={}
    )


def test_the_fuller_form_is_read_with_its_channels() -> None:
    telegram = RsiCodec(FULL, linear_external=("E1", "E3")).parse_robot(FULL_TELEGRAM)
    assert telegram.ipoc == 4208163634
    assert telegram.joints == pytest.approx((1.5 * DEG,) * 6)
    assert telegram.external == pytest.approx((0.18, math.pi, 0.18, math.pi, math.pi, math.pi))
    assert telegram.joint_setpoints == telegram.external_setpoints == (0.0,) * 6
    assert telegram.delay == 0
    assert telegram.channels["MACur.A6"] == 7.0
    assert telegram.channels["Tech.C12"] == 2.08
    assert telegram.channels["Tech.C110"] == 10.0
    assert telegram.channels["DiL"] == 0
    assert [telegram.channels[f"Digout.o{n}"] for n in (1, 2, 3)] == [False, True, False]
    assert telegram.channels["Source1"] == -3.25


def test_kukas_shipped_reply_is_read_and_its_zeros_are_kept() -> None:
    reply = RsiCodec(FULL).parse_sensor(KUKA_REPLY)
    assert reply.ipoc == 0
    assert reply.ipoc_text == b"0000000000"
    assert reply.sentype == "ImFree"
    assert reply.message == "KRCnexxt - RSI Object ST_ETHERNET"
    assert reply.channels["DiO"] == 125
    assert reply.channels["Tech.T29"] == 9.01
    assert reply.joints is None
    assert reply.external is None


def test_the_sdks_reply_with_a_name_that_xml_forbids_is_read() -> None:
    reply = RsiCodec(SDK_REPLY_CONFIG).parse_sensor(SDK_REPLY)
    assert reply.ipoc_text == b"115859599"
    assert reply.joints == pytest.approx((1e-6 * DEG,) * 6)
    assert reply.external == pytest.approx((0.0125,))
    assert reply.channels == {"Stop": False, "GPIO.01": True}


def test_the_shipped_layouts_are_written_as_the_controller_does() -> None:
    telegram = RobotTelegram(
        8,
        joints=(0.0, -math.pi / 2, math.pi / 2, 0.0, 0.0, 0.0),
        external=(1.2345, 0.0, 0.0, 0.0, 0.0, 0.0),
        tcp=(1.0, 0.0, 0.0, 0.0, 0.0, math.pi),
        delay=3,
        channels={"DiL": 2},
    )
    zero = "0.00000000"
    assert RsiCodec(JOINTS).format_robot(telegram).decode() == (
        f'<Rob Type="KUKA"><RIst X="1000.00000000" Y="{zero}" Z="{zero}" A="{zero}" B="{zero}" '
        f'C="180.00000000"/><AIPos A1="{zero}" A2="-90.00000000" A3="90.00000000" A4="{zero}" '
        f'A5="{zero}" A6="{zero}"/><EIPos E1="1234.50000000" E2="{zero}" E3="{zero}" E4="{zero}" '
        f'E5="{zero}" E6="{zero}"/><Delay D="3"/><DiL>2</DiL><IPOC>8</IPOC></Rob>'
    )


@pytest.mark.parametrize(
    ("shipped", "ak", "ek"), [(JOINTS, "AK", "EK"), (SETPOINTS, "AKorr", "EKorr")]
)
def test_the_shipped_replies_carry_what_is_configured_and_ipoc_last(
    shipped: RsiConfig, ak: str, ek: str
) -> None:
    reply = SensorTelegram(
        12, b"0012", joints=(DEG, 0.0, 0.0, 0.0, 0.0, -DEG), external=(0.001,), channels={"DiO": 3}
    )
    zero = "0.00000000"
    assert RsiCodec(shipped).format_sensor(reply).decode() == (
        f'<Sen Type="ImFree"><{ak} A1="1.00000000" A2="{zero}" A3="{zero}" A4="{zero}" '
        f'A5="{zero}" A6="-1.00000000"/><{ek} E1="1.00000000"/><DiO>3</DiO>'
        "<IPOC>0012</IPOC></Sen>"
    )


def test_the_shipped_files_are_for_loopback_and_hold_on() -> None:
    for shipped in (JOINTS, SETPOINTS):
        assert (shipped.ip, shipped.port, shipped.sentype) == ("127.0.0.1", 49152, "ImFree")
        assert not shipped.onlysend
        assert all(element.holdon for element in shipped.receive)
        assert Element("DiO", "LONG", 8) in shipped.receive
    assert "DEF_ASPos" in {element.tag for element in SETPOINTS.send}
    assert "DEF_ASPos" not in {element.tag for element in JOINTS.send}


# --- tolerance -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "rewrite",
    [
        lambda t: t.replace(b"Type=", b"TYPE="),
        lambda t: t.replace(b' Type="KUKA"', b""),
        lambda t: t.replace(b"<Rob", b"<rob").replace(b"</Rob", b"</rob"),
        lambda t: t.replace(b"><", b">\r\n<") + b"\r\n",
        lambda t: t + b"\0",
        lambda t: t + b"\r\n\0\0",
        lambda t: b'<?xml version="1.0"?>\r\n' + t,
        lambda t: t.replace(b"/>", b" />"),
        lambda t: t.replace(b'"', b"'"),
        lambda t: t.replace(b'="', b' = "'),
        lambda t: t.replace(b"<RIst", b'<New a="x"/><Deep><er>1</er></Deep><Say>&#1;</Say><RIst'),
        lambda t: t.replace(b"<RIst", b'<GPIO 01="0" 02="1"/><RIst'),
        lambda t: t.replace(b"<RIst", b"<Log>a</Log><Log>b</Log><None/><RIst"),
        lambda t: t.replace(b"<RIst", b'<RIst Q="nan"'),
        lambda t: t.replace(b"<IPOC>0", b"<IPOC> 0\r\n"),
        lambda t: t.replace(b'D="15"', b'D=" +15.00 "'),
        lambda t: t.replace(b"/><Delay", b">\r\n</EIPos><Delay"),
        lambda t: t.replace(b'"0.00000"', b'"-.0"'),
        lambda t: t.replace(b'"0.00000"', b'"0."'),
    ],
)
def test_what_differs_only_in_form_is_the_same_telegram(rewrite) -> None:
    codec = RsiCodec(PLAIN)
    expected = codec.parse_robot(KUKA_SDK)
    other = rewrite(KUKA_SDK)
    assert other != KUKA_SDK
    for _ in range(10):
        assert codec.parse_robot(other) == expected


def test_the_order_of_elements_and_attributes_is_free() -> None:
    codec = RsiCodec(PLAIN)
    text = (
        f'<Rob><IPOC>77</IPOC><Delay D="1"/><AIPos A6="6" A5="5" A4="4" A3="3" A2="2" A1="1"/>'
        f"<EIPos {six('E')}/><RIst {CARTESIAN}/></Rob>"
    ).encode()
    for _ in range(10):
        telegram = codec.parse_robot(text)
        assert telegram.ipoc == 77
        assert telegram.delay == 1
        assert telegram.joints == pytest.approx([n * DEG for n in range(1, 7)])
    assert codec.robot_reader.fast > 5


def test_ipoc_is_kept_digit_for_digit() -> None:
    codec = RsiCodec(PLAIN)
    for digits in (b"0000000123", b"18446744073709551615", b"00000000000000000000"):
        telegram = codec.parse_robot(KUKA_SDK.replace(b"<IPOC>0", b"<IPOC>" + digits))
        assert telegram.ipoc_text == digits
        assert telegram.ipoc == int(digits)
        reply = SensorTelegram(telegram.ipoc, telegram.ipoc_text)
        assert b"<IPOC>" + digits + b"</IPOC>" in codec.format_sensor(reply)


def test_a_text_with_entities_is_read_as_meant() -> None:
    codec = RsiCodec(config("Say STRING 1\nOk BOOL 2"))
    data = b"<Rob><Say>a &lt;b&gt; &amp;&quot;&apos;&nbsp;</Say><Ok>TRUE</Ok><IPOC>1</IPOC></Rob>"
    assert codec.parse_robot(data).channels == {"Say": "a <b> &\"'&nbsp;", "Ok": True}
    hollow = b"<Rob><Say/><Ok>false</Ok><IPOC>1</IPOC></Rob>"
    assert codec.parse_robot(hollow).channels == {"Say": "", "Ok": False}


# --- refusals ------------------------------------------------------------------------------


def refusal(data: bytes, codec: RsiCodec | None = None) -> RsiError:
    with pytest.raises(RsiError) as caught:
        (codec or RsiCodec(PLAIN)).parse_robot(data)
    return caught.value


def test_document_types_and_long_datagrams_are_refused_unparsed() -> None:
    codec = RsiCodec(PLAIN)
    for data in (
        b'<!DOCTYPE a [<!ENTITY b "c">]>' + KUKA_SDK,
        KUKA_SDK.replace(b"<RIst", b"<!-- x --><RIst"),
        KUKA_SDK.replace(b"<RIst", b"<![CDATA[x]]><RIst"),
        KUKA_SDK + b" " * MAX_TELEGRAM_BYTES,
        b"<Rob>" * 8500,
    ):
        error = refusal(data, codec)
        assert error.evidence == data[:256]
    assert codec.robot_reader.tolerant == 0
    assert codec.parse_robot(KUKA_SDK + b" " * (MAX_TELEGRAM_BYTES - len(KUKA_SDK))).delay == 15


@pytest.mark.parametrize(
    "text", [b"-1.71e-06", b"1.71E-6", b"2e+02", b"2e2", b"-0e-300", b"5.e-1", b".5e1"]
)
def test_a_number_may_have_an_exponent(text: bytes) -> None:
    codec = RsiCodec(PLAIN)
    for _ in range(6):  # the tolerant way first, the fast one once it knows the shape
        telegram = codec.parse_robot(KUKA_SDK.replace(b'A4="0.00000"', b'A4="%s"' % text))
        assert telegram.joints is not None
        assert telegram.joints[3] == pytest.approx(math.radians(float(text)), abs=0.0)


def test_small_numbers_with_exponents_take_the_fast_way() -> None:
    codec = RsiCodec(PLAIN)
    codec.parse_robot(KUKA_SDK.replace(b'A4="0.00000"', b'A4="-1.71e-06"'))
    assert (codec.robot_reader.fast, codec.robot_reader.tolerant) == (1, 0)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (b'A1="0.00000"', b'A1="nan"', b"0"),
        (b"AIPos", b"AxPos", b"0"),
        (b"<RIst", b"x<RIst", b"0"),
        (b"<RIst", b"<RIst<", b"0"),
        (b"<IPOC>0</IPOC>", b"<IPOC>0042</IPOC><Oops", b"0042"),
        (b"<IPOC>0</IPOC>", b"<IPOC>0</IPOC><IPOC>0</IPOC>", None),
        (b"<IPOC>0</IPOC>", b"<IPOC>18446744073709551616</IPOC>", None),
        (b"</Rob>", b"<!x></Rob>", None),
        (b"</Rob>", b" " * 3000 + b"</Rob>", None),
    ],
)
def test_a_refusal_has_the_counter_where_it_can_be_read(
    old: bytes, new: bytes, text: bytes | None
) -> None:
    damaged = KUKA_SDK.replace(old, new).replace(b'D="15"', b'D="oops"')
    assert refusal(damaged, RsiCodec(PLAIN)).ipoc_text == text


@pytest.mark.parametrize(
    ("old", "new", "element"),
    [
        (b"AIPos", b"AxPos", "AIPos.A1"),
        (b' A3="0.00000"', b"", "AIPos.A3"),
        (b'<Delay D="15"/>', b"", "Delay.D"),
        (b'<Delay D="15"/>', b'<Delay D="15"/><Delay D="15"/>', "Delay.D"),
        (b'D="15"', b'D="15" D="15"', "Delay.D"),
        (b'D="15"', b'D="1.5"', "Delay.D"),
        (b'D="15"', b'D="99999999999"', "Delay.D"),
        (b'D="15"', b'D="4294967296"', "Delay.D"),
        (b'D="15"', b'D=""', "Delay.D"),
        (b'A1="0.00000"', b'A1="nan"', "AIPos.A1"),
        (b'A1="0.00000"', b'A1="inf"', "AIPos.A1"),
        (b'A1="0.00000"', b'A1="1e999"', "AIPos.A1"),
        (b'A1="0.00000"', b'A1="1e17"', "AIPos.A1"),
        (b'A1="0.00000"', b'A1="1e"', "AIPos.A1"),
        (b'A1="0.00000"', b'A1="e3"', "AIPos.A1"),
        (b'A1="0.00000"', b'A1="1,5"', "AIPos.A1"),
        (b'A1="0.00000"', b'A1="0x1"', "AIPos.A1"),
        (b'A1="0.00000"', b'A1="1_0"', "AIPos.A1"),
        (b'A1="0.00000"', b'A1="."', "AIPos.A1"),
        (b'A1="0.00000"', b'A1="' + b"9" * 400 + b'"', "AIPos.A1"),
        (b"<IPOC>0</IPOC>", b"", "IPOC"),
        (b"<IPOC>0</IPOC>", b"<IPOC>0</IPOC><IPOC>0</IPOC>", "IPOC"),
        (b"<IPOC>0</IPOC>", b"<IPOC>-1</IPOC>", "IPOC"),
        (b"<IPOC>0</IPOC>", b"<IPOC/>", "IPOC"),
        (b"<IPOC>0</IPOC>", b"<IPOC><b/>0</IPOC>", "IPOC"),
        (b"<IPOC>0</IPOC>", b"<IPOC>18446744073709551616</IPOC>", "IPOC"),
        (b"<IPOC>0</IPOC>", "<IPOC>٣</IPOC>".encode(), "IPOC"),
        (b"<Rob", b"<Robot", None),
        (b"</Rob>", b"</rob>", None),
        (b"</Rob>", b"", None),
        (b"</Rob>", b"</Rob><Rob></Rob>", None),
        (b"</Rob>", b"</Rob>x", None),
        (b"</Rob>", b"</Rob></Rob>", None),
        (b"<RIst", b"x<RIst", None),
        (b"<RIst", b"<RIst<", None),
        (b"<RIst", b"<a>" * 9 + b"</a>" * 9 + b"<RIst", None),
        (b'Type="KUKA"', b'Type="KU<KA"', None),
    ],
)
def test_a_bad_telegram_is_refused_by_name(old: bytes, new: bytes, element: str | None) -> None:
    warm = RsiCodec(PLAIN)
    warm.parse_robot(KUKA_SDK)
    error = refusal(KUKA_SDK.replace(old, new), warm)
    assert error.element == element
    assert element is None or element in str(error)


def test_a_telegram_that_lacks_something_still_says_which_it_was() -> None:
    assert refusal(b"<rob><IPOC>0042</IPOC></rob>").ipoc_text == b"0042"
    assert refusal(KUKA_SDK.replace(b"<IPOC>0</IPOC>", b"")).ipoc_text is None


def test_half_a_correction_is_refused_and_none_is_not() -> None:
    codec = RsiCodec(SDK_REPLY_CONFIG)
    with pytest.raises(RsiError, match=r"AK\.A4"):
        codec.parse_sensor(SDK_REPLY.replace(b' A4="0.000001"', b""))
    reply = codec.parse_sensor(b'<Sen Type="x"><EK E1="1"/><IPOC>5</IPOC></Sen>')
    assert reply.joints is None
    assert reply.external == pytest.approx((0.001,))
    assert reply.channels == {}
    assert reply.sentype == "x"
    assert codec.parse_sensor(b"<Sen><IPOC>5</IPOC></Sen>") == SensorTelegram(5, b"5")


@pytest.mark.parametrize(
    "change",
    [
        {"joints": (math.nan, 0, 0, 0, 0, 0)},
        {"joints": (math.inf, -math.inf, 0, 0, 0, 0)},
        {"joints": (1e15, 0, 0, 0, 0, 0)},
        {"joints": None},
        {"joints": (0.0,) * 5},
        {"external": None},
        {"external": ()},
        {"external": (math.nan,)},
        {"external": (0.0, 0.1)},
        {"channels": {"DiO": math.nan}},
        {"channels": {"DiO": math.inf}},
        {"channels": {"DiO": 1.5}},
        {"channels": {"DiO": 2**32}},
        {"channels": {"DiO": "1"}},
        {"channels": {"Dio": 1}},
        {"message": "not configured"},
        {"ipoc": -1},
        {"ipoc": 2**64},
        {"ipoc": 13},
        {"ipoc_text": b"12.0"},
        {"ipoc_text": b"0" * 19 + b"12"},
        {"sentype": "I" * MAX_TELEGRAM_BYTES},
        {"sentype": "Grüße"},
    ],
)
def test_what_the_wire_cannot_carry_is_not_written(change: dict[str, object]) -> None:
    good = {"ipoc": 12, "ipoc_text": b"12", "joints": (0.0,) * 6, "external": (0.0,)}
    codec = RsiCodec(JOINTS)
    assert codec.format_sensor(SensorTelegram(**good))
    with pytest.raises(RsiError):
        codec.format_sensor(SensorTelegram(**(good | change)))


def test_axes_that_are_not_configured_may_be_zero_but_not_lost() -> None:
    some = RsiCodec(config("", "AK.A2 DOUBLE 1\nAK.A1 DOUBLE 2\nEK.E2 DOUBLE 3"))
    reply = SensorTelegram(3, b"3", "ImFree", (0.1, -0.2, 0, 0, 0, 0), (0.0, 0.5, 0.0))
    data = some.format_sensor(reply)
    assert b'<AK A2="-11.45915590" A1="5.72957795"/><EK E2="28.64788976"/>' in data
    again = some.parse_sensor(data)
    assert again.joints == pytest.approx((0.1, -0.2, 0, 0, 0, 0))
    assert again.external == pytest.approx((0.0, 0.5))
    for lost in (
        SensorTelegram(3, joints=(0.0, 0.0, 0.1, 0, 0, 0), external=(0.0, 0.0)),
        SensorTelegram(3, joints=(0.0,) * 6, external=(0.1, 0.0)),
    ):
        with pytest.raises(RsiError, match="axes not in the configuration"):
            some.format_sensor(lost)


def test_a_correction_without_an_element_is_not_lost_in_silence() -> None:
    codec = RsiCodec(PLAIN)
    assert codec.format_sensor(SensorTelegram(1, joints=(0.0,) * 6, external=(0.0,)))
    for lost in (SensorTelegram(1, joints=(0.1,) + (0.0,) * 5), SensorTelegram(1, external=(0.1,))):
        with pytest.raises(RsiError, match="no element"):
            codec.format_sensor(lost)


def test_a_robots_telegram_must_have_what_is_configured() -> None:
    codec = RsiCodec(JOINTS)
    good = {"joints": (0.0,) * 6, "external": (0.0,) * 6, "tcp": (0.0,) * 6, "delay": 0}
    assert codec.format_robot(RobotTelegram(1, **good))
    for name in good:
        with pytest.raises(RsiError):
            codec.format_robot(RobotTelegram(1, **(good | {name: None})))
    with pytest.raises(RsiError):
        codec.format_robot(RobotTelegram(1, **(good | {"delay": 2**32})))


def test_decimals_are_a_setting_as_the_controllers_precision_is() -> None:
    telegram = RobotTelegram(1, joints=(1.0,) * 6, external=(0.0,) * 6, tcp=(0.0,) * 6, delay=0)
    assert b'A1="57.3"' in RsiCodec(PLAIN, decimals=1).format_robot(telegram)
    assert b'A1="57.2957795130823"' in RsiCodec(PLAIN, decimals=13).format_robot(telegram)
    for decimals in (0, 17):
        with pytest.raises(RsiError):
            RsiCodec(PLAIN, decimals=decimals)


def test_every_channel_type_is_written_and_read_back() -> None:
    tags = "B BOOL 1\nL LONG 2\nD DOUBLE 3\nS STRING 4\nG.b BOOL 5\nG.s STRING 6"
    codec = RsiCodec(config(tags, tags + "\nDEF_EStr STRING INTERNAL"))
    channels = {"B": True, "L": -7, "D": 0.25, "S": " a<b>&\"c' ", "G.b": False, "G.s": ""}
    robot = RobotTelegram(1, b"1", channels=channels)
    sensor = SensorTelegram(1, b"1", "ImFree", channels=channels, message="<&>")
    for _ in range(5):
        assert codec.parse_robot(codec.format_robot(robot)) == robot
        assert codec.parse_sensor(codec.format_sensor(sensor)) == sensor
    silent = SensorTelegram(1, b"1", "ImFree", channels=channels)
    assert b"EStr" not in codec.format_sensor(silent)
    assert codec.parse_sensor(codec.format_sensor(silent)) == silent
    for bad in ({"S": 1}, {"S": "é"}, {"S": "a\0"}, {"B": 2}, {"D": math.nan}, {"D": 1e12}):
        with pytest.raises(RsiError):
            codec.format_robot(RobotTelegram(1, channels=bad))
    with pytest.raises(RsiError):
        codec.format_sensor(SensorTelegram(1, message="a\nb"))


# --- laws ----------------------------------------------------------------------------------


@given(robot_telegrams())
def test_a_robots_telegram_comes_back_as_it_was_written(telegram: RobotTelegram) -> None:
    codec = ROUND_TRIP
    again = codec.parse_robot(codec.format_robot(telegram))
    assert (again.ipoc, again.ipoc_text) == (telegram.ipoc, telegram.ipoc_text)
    assert (again.delay, again.channels) == (telegram.delay, telegram.channels)
    for name in ("joints", "joint_setpoints", "external", "tcp", "tcp_setpoint"):
        # Half a unit of the eighth decimal of a degree or millimetre.
        assert getattr(again, name) == pytest.approx(getattr(telegram, name), rel=1e-15, abs=1e-10)


@given(sensor_telegrams())
def test_a_reply_comes_back_as_it_was_written(reply: SensorTelegram) -> None:
    codec = ROUND_TRIP
    again = codec.parse_sensor(codec.format_sensor(reply))
    assert (again.ipoc_text, again.sentype, again.channels) == (
        reply.ipoc_text,
        reply.sentype,
        reply.channels,
    )
    assert again.joints == pytest.approx(reply.joints, rel=1e-15, abs=1e-10)
    assert again.external == pytest.approx(reply.external, rel=1e-15, abs=1e-10)


@given(sensor_telegrams())
def test_a_prepared_reply_is_the_reply(reply: SensorTelegram) -> None:
    prepared = ROUND_TRIP.prepare_sensor(reply)
    assert isinstance(prepared, PreparedReply)
    assert prepared.with_counter(reply.ipoc_text) == ROUND_TRIP.format_sensor(reply)


@given(st.floats(allow_nan=True, allow_infinity=True), st.integers(0, 5))
def test_no_number_is_ever_written_that_is_not_plain(value: float, axis: int) -> None:
    joints = tuple(value if n == axis else 0.0 for n in range(6))
    try:
        data = ROUND_TRIP.format_sensor(SensorTelegram(1, joints=joints, external=(0.0,)))
    except RsiError:
        assert not abs(value) < 1e10
    else:
        body = data.split(b"<AKorr")[1].split(b"/>")[0]
        assert not set(body) - set(b' A123456="-.0789')
