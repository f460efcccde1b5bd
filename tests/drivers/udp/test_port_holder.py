"""Who has a UDP port that is taken."""

import errno
import os
import socket
from contextlib import closing
from pathlib import Path

import pytest

from linemate.drivers.udp import port_holder

TAKEN = OSError(errno.EADDRINUSE, "Address already in use")
HEADER = "  sl  local_address rem_address   st"


@pytest.mark.parametrize(
    ("family", "host"), [(socket.AF_INET, "127.0.0.1"), (socket.AF_INET6, "::1")]
)
def test_the_process_that_has_a_port_is_named(family: socket.AddressFamily, host: str) -> None:
    with closing(socket.socket(family, socket.SOCK_DGRAM)) as bound:
        try:
            bound.bind((host, 0))
        except OSError:
            pytest.skip(f"no {host} here")
        port = bound.getsockname()[1]
        assert port_holder.holder(port) == os.getpid()
        assert port_holder.describe_holder(TAKEN, port).startswith(f" (process {os.getpid()}, ")
    assert port_holder.holder(port) is None
    assert port_holder.describe_holder(TAKEN, port) == ""


def test_what_may_not_be_seen_is_no_answer(tmp_path: Path) -> None:
    assert port_holder.holder(50_000, tmp_path) is None
    (tmp_path / "net").mkdir()
    row = "1: 0100007F:C350 00000000:0000 07 00000000:00000000 00:00000000 00000000 0 0 4711 2"
    (tmp_path / "net/udp").write_text(f"{HEADER}\n   {row}\n")
    assert port_holder.holder(50_000, tmp_path) is None
    fds = tmp_path / "12" / "fd"
    fds.mkdir(parents=True)
    (tmp_path / "7" / "fd").mkdir(parents=True)
    (fds / "3").symlink_to("/dev/null")
    assert port_holder.holder(50_000, tmp_path) is None
    (fds / "4").symlink_to("socket:[4711]")
    assert port_holder.holder(50_000, tmp_path) == 12
    assert port_holder.holder(50_001, tmp_path) is None
    assert port_holder.describe_holder(TAKEN, 50_000, tmp_path) == " (process 12)"


@pytest.mark.parametrize("error", [OSError(errno.EADDRNOTAVAIL, "not here"), OverflowError(), None])
def test_no_process_is_named_for_a_port_that_fails_for_another_reason(
    error: BaseException | None,
) -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as bound:
        bound.bind(("127.0.0.1", 0))
        assert port_holder.describe_holder(error, bound.getsockname()[1]) == ""
