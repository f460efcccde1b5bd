"""Numeric address of a peer, with or without a port, as a configuration writes it."""

import ipaddress

Peer = tuple[str, int | None]  # numeric address; port, None for any


def parse_peer(text: str) -> Peer:
    """Read ``ADDRESS``, ``ADDRESS:PORT`` or ``[ADDRESS]:PORT``.

    Raises:
        ValueError: the address is not numeric, or the port no port.
    """
    host, port = text, ""
    if text.startswith("["):
        host, bracket, rest = text[1:].partition("]")
        if not bracket or (rest and not rest.startswith(":")):
            raise ValueError(f"{text!r} is not ADDRESS, ADDRESS:PORT or [ADDRESS]:PORT")
        port = rest[1:]
    elif text.count(":") == 1:
        host, _, port = text.partition(":")
    address = str(ipaddress.ip_address(host))
    if not port:
        return address, None
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError(f"port {port!r} of {text!r} is not within 1 .. 65535")
    return address, int(port)
