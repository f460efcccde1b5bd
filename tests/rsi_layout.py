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
