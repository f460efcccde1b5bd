"""Addresses of peers, with and without a port."""

import pytest

from linemate.protocol.numeric_peer import parse_peer


def test_addresses_are_read_with_and_without_a_port() -> None:
    assert parse_peer("10.0.0.1") == ("10.0.0.1", None)
    assert parse_peer("10.0.0.1:7") == ("10.0.0.1", 7)
    assert parse_peer("::1") == ("::1", None)
    assert parse_peer("[0:0::1]:7") == ("::1", 7)


@pytest.mark.parametrize("text", ["camera", "10.0.0.1:0", "10.0.0.1:65536", "[::1", "[::1]7"])
def test_what_is_no_numeric_address_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"address|port|ADDRESS"):
        parse_peer(text)
