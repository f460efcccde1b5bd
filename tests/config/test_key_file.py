"""The command server's key file."""

import os
from pathlib import Path

import pytest
from command_ends import key_of

from linemate.daemon.config.files import UnreadableError
from linemate.daemon.config.key_file import read_keys
from linemate.daemon.transport.client import KeyFileError, read_key
from linemate.protocol.command.frame_codec import Role
from linemate.protocol.command.preshared_keys import key_line

ALICE = key_of("alice", Role.OPERATE, 1)
EVE = key_of("eve", Role.VIEW, 2)


def test_the_daemons_key_file_must_be_its_own(tmp_path: Path) -> None:
    path = tmp_path / "keys"
    path.write_text(key_line(ALICE) + "\n" + key_line(EVE) + "\n")
    path.chmod(0o400)
    assert read_keys(path) == (ALICE, EVE)
    path.chmod(0o440)
    with pytest.raises(UnreadableError, match="0440"):
        read_keys(path)
    path.chmod(0o600)
    path.write_text("alice operate x\nbob\n")
    with pytest.raises(UnreadableError, match=r":1: (.|\n)*:2: "):
        read_keys(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(UnreadableError):
        read_keys(path)
    with pytest.raises(UnreadableError, match="missing"):
        read_keys(tmp_path / "missing")
    os.mkfifo(tmp_path / "fifo", 0o600)
    with pytest.raises(UnreadableError, match="not a regular file"):
        read_keys(tmp_path / "fifo")
    with pytest.raises(UnreadableError):
        read_keys(tmp_path)


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a file away")
def test_a_key_file_of_another_user_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "keys"
    path.write_text(key_line(ALICE) + "\n")
    path.chmod(0o400)
    os.chown(path, 65534, -1)
    with pytest.raises(UnreadableError, match="owned by uid 65534, should be uid 0 or root"):
        read_keys(path)
    with pytest.raises(KeyFileError, match="owned by uid 65534"):
        read_key(path)
    os.chown(path, 0, -1)
    assert read_keys(path) == (ALICE,)
