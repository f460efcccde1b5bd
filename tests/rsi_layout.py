"""A layout of telegrams for a test, from lists of elements."""

from linemate.protocol.rsi.codec import RsiConfig, parse_config


def config(send: str = "", receive: str = "", **settings_: str) -> RsiConfig:
    """A configuration from two lists of TAG TYPE INDX [HOLDON], one a line."""
    values = {"IP_NUMBER": "192.168.1.10", "PORT": "49152", "SENTYPE": "ImFree"} | settings_
    head = "".join(f"<{name}>{value}</{name}>" for name, value in values.items())

    def elements(lines: str) -> str:
        out = []
        for line in filter(None, map(str.strip, lines.splitlines())):
            tag, kind, index, *holdon = line.split()
            more = f' HOLDON="{holdon[0]}"' if holdon else ""
            out.append(f'<ELEMENT TAG="{tag}" TYPE="{kind}" INDX="{index}"{more}/>')
        return "".join(out)

    text = (
        f"<ROOT><CONFIG>{head}</CONFIG><SEND><ELEMENTS>{elements(send)}</ELEMENTS></SEND>"
        f"<RECEIVE><ELEMENTS>{elements(receive)}</ELEMENTS></RECEIVE></ROOT>"
    )
    return parse_config(text.encode("latin-1"))


def six(names: str, value: str = "0.00000") -> str:
    return " ".join(f'{names}{n}="{value}"' for n in range(1, 7))


CARTESIAN = 'X="0.00000" Y="0.00000" Z="0.00000" A="0.00000" B="0.00000" C="0.00000"'

# kss/test/test_message_builder.cc of KUKA's SDK.
KUKA_SDK = (
    f'<Rob Type="KUKA"><RIst {CARTESIAN}/><AIPos {six("A")}/><EIPos {six("E")}/>'
    '<Delay D="15"/><IPOC>0</IPOC></Rob>'
).encode()
PLAIN = config(
    """DEF_RIst DOUBLE INTERNAL
    DEF_AIPos DOUBLE INTERNAL
    DEF_EIPos DOUBLE INTERNAL
    DEF_Delay LONG INTERNAL"""
)
