"""Users of the OPC UA server: files that are safe, and passwords that are right."""

from pathlib import Path

import pytest

from linemate.daemon.operator.plc.plc_users import read_users, role_of, user_line
from linemate.daemon.transport.client import KeyFileError
from linemate.protocol.command.frame_codec import Role

SALT = bytes(range(16))
LINE = user_line("plc", Role.OPERATE, "correct horse", SALT)


def written(folder: Path, text: str, mode: int = 0o600) -> Path:
    path = folder / "users"
    path.write_text(text)
    path.chmod(mode)
    return path


def test_a_user_has_the_role_of_the_line_with_the_right_password_alone(tmp_path: Path) -> None:
    users = read_users(written(tmp_path, f"# users\n\n{LINE}\n"))
    assert role_of(users, "plc", "correct horse") is Role.OPERATE
    assert role_of(users, "plc", "correct hors") is None
    assert role_of(users, "PLC", "correct horse") is None
    assert role_of({}, "", "") is None
    assert "correct" not in LINE


def test_a_file_that_others_may_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(KeyFileError, match="0644 lets others in"):
        read_users(written(tmp_path, LINE, 0o644))


@pytest.mark.parametrize(
    "text", ["", "plc operate", f"{LINE}\n{LINE}", LINE.replace("operate", "admin"), "a b c d"]
)
def test_a_file_without_good_users_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(KeyFileError):
        read_users(written(tmp_path, text))


@pytest.mark.parametrize(("name", "password"), [("two words", "x" * 8), ("", "x" * 8), ("a", "x")])
def test_a_bad_name_or_a_short_password_makes_no_line(name: str, password: str) -> None:
    with pytest.raises(ValueError, match=r"one word|characters"):
        user_line(name, Role.VIEW, password, SALT)
