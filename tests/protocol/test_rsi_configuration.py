"""The controller's configuration: what is read of it, and what is refused by name."""

from importlib.resources import files

import pytest
from rsi_layout import config

from linemate.protocol.rsi.codec import (
    Element,
    RobotTelegram,
    RsiCodec,
    RsiError,
    SensorTelegram,
    parse_config,
)
from linemate.protocol.units import DEG


def test_a_hand_edited_file_is_read_through_its_comments() -> None:
    text = (
        b"\xef\xbb\xbf<?xml version='1.0' encoding='UTF-8'?>\r\n<ROOT>\r\n <CONFIG>"
        b"<IP_NUMBER> 10.0.0.1 </IP_NUMBER> <!-- PC -- here, Gr\xfc\xdfe -->\r\n"
        b"<PORT>59152</PORT><PROTOCOL>UDP</PROTOCOL><SENTYPE>Im&amp;Free</SENTYPE>"
        b"<ONLYSEND>TRUE</ONLYSEND></CONFIG><SEND><ELEMENTS>"
        b"<!-- <ELEMENT TAG='DEF_RIst' TYPE='DOUBLE' INDX='INTERNAL'/> -->"
        b"<ELEMENT TAG='DiL' TYPE='long' INDX='64' UNIT='0'></ELEMENT>"
        b"<ELEMENT TAG='FREE' TYPE='LONG' INDX='3'/><ELEMENT TAG='FREE' TYPE='LONG' INDX='4'/>"
        b"</ELEMENTS></SEND><RECEIVE><ELEMENTS>"
        b"<ELEMENT TAG='Stop' TYPE='BOOL' INDX='1' HOLDON='0'/></ELEMENTS></RECEIVE></ROOT>\r\n"
    )
    parsed = parse_config(text)
    assert (parsed.ip, parsed.port, parsed.onlysend) == ("10.0.0.1", 59152, True)
    assert parsed.sentype == "Im&Free"
    assert parsed.send[0] == Element("DiL", "LONG", 64)
    assert parsed.receive == (Element("Stop", "BOOL", 1, holdon=False),)
    codec = RsiCodec(parsed)
    assert codec.format_sensor(SensorTelegram(1)) == (
        b'<Sen Type="Im&amp;Free"><Stop>0</Stop><IPOC>1</IPOC></Sen>'
    )
    assert codec.parse_sensor(codec.format_sensor(SensorTelegram(1))).sentype == "Im&Free"
    assert codec.format_robot(RobotTelegram(1)) == (
        b'<Rob Type="KUKA"><DiL>0</DiL><IPOC>1</IPOC></Rob>'
    )


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"PORT": "0"}, "PORT"),
        ({"PORT": "65536"}, "PORT"),
        ({"PORT": "4.9"}, "PORT"),
        ({"PORT": ""}, "PORT"),
        ({"IP_NUMBER": "somewhere"}, "IP_NUMBER"),
        ({"SENTYPE": ""}, "SENTYPE"),
        ({"SENTYPE": "\xe9"}, "SENTYPE"),
        ({"ONLYSEND": "MAYBE"}, "ONLYSEND"),
        ({"send": "DiL WORD 1"}, "DiL"),
        ({"send": "DiL LONG 65"}, "DiL/@INDX"),
        ({"send": "DiL LONG 0"}, "DiL/@INDX"),
        ({"send": "DiL LONG x"}, "DiL/@INDX"),
        ({"receive": "DiO LONG 1 2"}, "DiO/@HOLDON"),
        ({"send": "a.b.c LONG 1"}, "SEND/ELEMENT"),
        ({"send": "DiL LONG 1\nDiL LONG 2"}, "DiL"),
        ({"receive": "DiL LONG 1\nDiL LONG 2"}, "DiL"),
    ],
)
def test_a_bad_configuration_is_refused_by_name(changes: dict[str, str], named: str) -> None:
    with pytest.raises(RsiError) as caught:
        config(**changes)
    assert caught.value.element == named


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"<ROOT></ROOT>",
        b"<!DOCTYPE ROOT><ROOT></ROOT>",
        b" " * 300_000,
        b"<ROOT><CONFIG><PORT>1</PORT><PORT>2</PORT></CONFIG></ROOT>",
        b'<ROOT><SEND><ELEMENTS><ELEMENT TAG="a" Tag="b"/></ELEMENTS></SEND></ROOT>',
        b"<ROOT><SEND><ELEMENTS><ELEMENT/></ELEMENTS></SEND></ROOT>",
    ],
)
def test_what_is_no_configuration_is_refused(text: bytes) -> None:
    with pytest.raises(RsiError):
        parse_config(text)


@pytest.mark.parametrize(
    ("send", "receive", "named"),
    [
        ("Delay.D LONG 1\nDEF_Delay LONG INTERNAL", "", "Delay.D"),
        ("AIPos.A7 DOUBLE 1\nDEF_AIPos DOUBLE INTERNAL", "", "AIPos.A7"),
        ("IPOC LONG 1", "", "IPOC"),
        ("a LONG 1\na.b LONG 2", "", "a"),
        ("", "AK.A1 LONG 1", "AK.A1"),
        ("", "AK.B1 DOUBLE 1", "AK.B1"),
        ("", "AK DOUBLE 1", "AK"),
        ("", "AK.A1 DOUBLE 1\nAKorr.A1 DOUBLE 2", "AK and AKorr"),
    ],
)
def test_a_configuration_that_makes_no_telegram_is_refused(
    send: str, receive: str, named: str
) -> None:
    with pytest.raises(RsiError) as caught:
        RsiCodec(config(send, receive))
    assert caught.value.element == named


def test_a_partly_configured_vector_may_be_absent_too() -> None:
    codec = RsiCodec(config("", "AK.A2 DOUBLE 1\nDiO LONG 2"))
    assert codec.parse_sensor(b"<Sen><DiO>1</DiO><IPOC>1</IPOC></Sen>").joints is None


def test_an_unknown_keyword_is_left_out_and_read_over() -> None:
    codec = RsiCodec(config("DEF_BMode LONG INTERNAL\nDEF_Tech.X1 DOUBLE INTERNAL\nDiL LONG 1"))
    data = b'<Rob Type="KUKA"><BMode>2</BMode><DiL>4</DiL><IPOC>9</IPOC></Rob>'
    assert codec.parse_robot(data) == RobotTelegram(9, b"9", channels={"DiL": 4})
    assert b"BMode" not in codec.format_robot(RobotTelegram(9))


def test_a_site_may_call_its_corrections_otherwise() -> None:
    other = config("", "AxisCorr.A1 DOUBLE 1\nTrack.E1 DOUBLE 2")
    codec = RsiCodec(other, joint_tags=("AxisCorr",), external_tags=("Track",))
    reply = SensorTelegram(1, joints=(DEG, 0, 0, 0, 0, 0), external=(0.002,))
    assert b'<AxisCorr A1="1.00000000"/><Track E1="2.00000000"/>' in codec.format_sensor(reply)
    with pytest.raises(RsiError, match="no element"):
        RsiCodec(other).format_sensor(reply)


def test_elements_of_one_group_are_brought_together() -> None:
    codec = RsiCodec(config("Digout.o1 BOOL 1\nDiL LONG 2\nDigout.o2 BOOL 3"))
    data = codec.format_robot(RobotTelegram(1, channels={"Digout.o2": True}))
    assert data == b'<Rob Type="KUKA"><Digout o1="0" o2="1"/><DiL>0</DiL><IPOC>1</IPOC></Rob>'
    apart = b'<Rob><Digout o1="0"/><DiL>0</DiL><Digout o2="1"/><IPOC>1</IPOC></Rob>'
    assert codec.parse_robot(apart).channels == {"Digout.o1": False, "Digout.o2": True, "DiL": 0}


@pytest.mark.parametrize(
    ("constants", "says"),
    [({"OvPro": 100}, "OvPro: not in RECEIVE"), ({"AK.A1": 1.0}, "every reply gives it a value")],
)
def test_a_constant_for_no_element_or_for_one_that_replies_set_is_refused(
    constants: dict[str, int | float], says: str
) -> None:
    xml = files("linemate.protocol").joinpath("data", "rsi_joints.xml").read_bytes()
    with pytest.raises(RsiError, match=says):
        RsiCodec(parse_config(xml), constants=constants)


def test_a_constant_is_in_every_reply_and_alone_in_a_bare_one() -> None:
    receive = "AK.A1 DOUBLE 1\nOvPro LONG 2\nSay.it STRING 3"
    codec = RsiCodec(config(receive=receive), constants={"OvPro": 100, "Say.it": "a & b"})
    constants = b'<OvPro>100</OvPro><Say it="a &amp; b"/>'
    reply = codec.format_sensor(SensorTelegram(7, joints=(0.0,) * 6))
    assert reply == (
        b'<Sen Type="ImFree"><AK A1="0.00000000"/>' + constants + b"<IPOC>7</IPOC></Sen>"
    )
    assert codec.bare_sensor().with_counter(b"7") == (
        b'<Sen Type="ImFree">' + constants + b"<IPOC>7</IPOC></Sen>"
    )
