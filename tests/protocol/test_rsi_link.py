"""A command as a reply: what the configuration has elements for, and nothing else."""

import math

import pytest

from linemate.protocol.rsi.codec import RsiCodec, RsiError, parse_config
from linemate.protocol.rsi.rsi_link import RsiLink

AXES = tuple(f"AK.A{n}" for n in range(1, 7))
START = (0.0, -1.5, 1.5, 0.0, 0.5, 0.0, 0.0)
THERE = (0.0, -1.5, 1.5, 0.0, 0.5, 0.0, 0.25)


def link(*send: str, on_rail: bool = False) -> RsiLink:
    elements = "".join(f'<ELEMENT TAG="{tag}" TYPE="DOUBLE" INDX="INTERNAL"/>' for tag in send)
    xml = f"""<ROOT><CONFIG><IP_NUMBER>127.0.0.1</IP_NUMBER><PORT>49152</PORT>
        <SENTYPE>ImFree</SENTYPE><ONLYSEND>FALSE</ONLYSEND></CONFIG>
        <SEND><ELEMENTS>{elements}</ELEMENTS></SEND><RECEIVE><ELEMENTS/></RECEIVE></ROOT>"""
    return RsiLink(RsiCodec(parse_config(xml.encode())), on_rail=on_rail)


def six(letter: str, value: float) -> str:
    return " ".join(f'{letter}{n}="{value}"' for n in range(1, 7))


def telegram(*elements: str) -> bytes:
    return f'<Rob Type="KUKA">{"".join(elements)}<IPOC>7</IPOC></Rob>'.encode()


ACTUAL, PROGRAMMED = f"<AIPos {six('A', 90.0)}/>", f"<ASPos {six('A', 45.0)}/>"
RAIL, RAIL_PROGRAMMED = f"<EIPos {six('E', 500.0)}/>", f"<ESPos {six('E', 250.0)}/>"


def replies(*receive: str) -> RsiLink:
    elements = "".join(
        f'<ELEMENT TAG="{tag}" TYPE="DOUBLE" INDX="{n}" HOLDON="1"/>'
        for n, tag in enumerate(receive, start=1)
    )
    xml = f"""<ROOT><CONFIG><IP_NUMBER>127.0.0.1</IP_NUMBER><PORT>49152</PORT>
        <SENTYPE>ImFree</SENTYPE><ONLYSEND>FALSE</ONLYSEND></CONFIG>
        <SEND><ELEMENTS><ELEMENT TAG="DEF_AIPos" TYPE="DOUBLE" INDX="INTERNAL"/></ELEMENTS></SEND>
        <RECEIVE><ELEMENTS>{elements}</ELEMENTS></RECEIVE></ROOT>"""
    return RsiLink(RsiCodec(parse_config(xml.encode())))


def test_further_external_axes_of_a_site_stay_where_they_are() -> None:
    data = replies(*AXES, "EK.E1", "EK.E2", "EK.E4").prepare(THERE, START, 0).with_counter(b"7")
    assert b'<EK E1="250.00000000" E2="0.00000000" E4="0.00000000"/><IPOC>7<' in data


def test_an_arm_without_a_linear_axis_leaves_the_external_axes_of_a_site_where_they_are() -> None:
    data = replies(*AXES, "EK.E1", "EK.E2").prepare(THERE[:6], START[:6], 0).with_counter(b"7")
    assert b'<EK E1="0.00000000" E2="0.00000000"/><IPOC>7<' in data


def test_a_configuration_without_external_axes_takes_none() -> None:
    assert b"<EK" not in replies(*AXES).prepare(START, START, 0).with_counter(b"7")


def test_a_reply_without_corrections_tells_the_tool_what_to_do_and_nothing_else() -> None:
    with_signals = replies(*AXES, "DiO")
    data = with_signals.without_setpoint(2).with_counter(b"7")
    assert b"<DiO>2</DiO><IPOC>7</IPOC>" in data
    assert b"<AK" not in data
    assert with_signals.without_setpoint(0) == with_signals.bare
    cleared = with_signals.without_setpoint(0, writes_zero=True).with_counter(b"7")
    assert b"<DiO>0</DiO><IPOC>7</IPOC>" in cleared
    assert replies(*AXES).without_setpoint(2) == replies(*AXES).bare


def test_a_telegram_without_joints_is_refused_with_its_counter() -> None:
    with pytest.raises(RsiError, match="no AIPos") as caught:
        link().read(telegram(), 0)
    assert caught.value.counter == (7, b"7")


def test_bytes_that_are_no_telegram_have_no_counter() -> None:
    with pytest.raises(RsiError) as caught:
        link("DEF_AIPos").read(b"<Rob", 0)
    assert caught.value.counter is None


def test_an_arm_on_a_rail_needs_the_rail_in_the_telegram() -> None:
    with pytest.raises(RsiError, match="no EIPos"):
        link("DEF_AIPos", on_rail=True).read(telegram(ACTUAL), 0)


def test_the_programmed_position_has_the_axes_of_the_arm() -> None:
    joints = (math.pi / 4,) * 6
    both = link("DEF_AIPos", "DEF_ASPos").read(telegram(ACTUAL, PROGRAMMED), 0)
    assert both.programmed == pytest.approx(joints)
    assert link("DEF_AIPos").read(telegram(ACTUAL), 0).programmed is None
    tags = "DEF_AIPos", "DEF_ASPos", "DEF_EIPos"
    railed = link(*tags, on_rail=True).read(telegram(ACTUAL, PROGRAMMED, RAIL), 0)
    assert railed.programmed is None
    whole = telegram(ACTUAL, PROGRAMMED, RAIL, RAIL_PROGRAMMED)
    found = link(*tags, "DEF_ESPos", on_rail=True).read(whole, 0).programmed
    assert found is not None
    assert found[:6] == pytest.approx(joints)
    assert len(found) == 7


def test_the_next_telegram_is_expected_with_the_digits_of_its_counter() -> None:
    expected = link("DEF_AIPos").expect(8, None, (math.pi / 2,) * 6, 0.01)
    assert expected is not None
    pattern, echo = expected
    assert echo == b"8"
    assert pattern.matches(telegram(ACTUAL).replace(b">7<", b">8<"))
    assert not pattern.matches(telegram(ACTUAL))
    assert link().expect(8, None, (0.0,) * 6, 0.01) is None
