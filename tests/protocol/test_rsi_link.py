"""A command as a reply: what the configuration has elements for, and nothing else."""

from linemate.protocol.rsi.codec import RsiCodec, parse_config
from linemate.protocol.rsi.rsi_link import RsiLink

AXES = tuple(f"AK.A{n}" for n in range(1, 7))
START = (0.0, -1.5, 1.5, 0.0, 0.5, 0.0, 0.0)
THERE = (0.0, -1.5, 1.5, 0.0, 0.5, 0.0, 0.25)


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
    assert replies(*AXES).without_setpoint(2) == replies(*AXES).bare
