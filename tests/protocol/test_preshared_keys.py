"""The key file: every line that is wrong is named, and no key is ever shown."""

import base64
import contextlib
import stat

import pytest
from command_ends import key_of, secret_of
from hypothesis import given
from hypothesis import strategies as st

from linemate.protocol.command.frame_codec import CommandError, Role
from linemate.protocol.command.preshared_keys import (
    MAX_KEYS,
    key_line,
    make_key,
    parse_keys,
    session_keys,
    unsafe_file,
)

GOOD = base64.b64encode(secret_of(1)).decode()
OTHER = base64.b64encode(secret_of(2)).decode()


def test_a_file_of_keys_is_read_with_comments_and_blank_lines() -> None:
    keys = parse_keys(f"# who may\n\nalice operate {GOOD}\r\n  bob\tview {OTHER}\n")
    assert [(key.name, key.role) for key in keys] == [("alice", Role.OPERATE), ("bob", Role.VIEW)]
    assert keys[0].secret == secret_of(1)
    assert keys[0].id != keys[1].id
    assert all(1 <= key.id <= 65535 for key in keys)


def test_a_key_is_read_back_from_its_own_line() -> None:
    key = key_of("x.y-z_1", Role.VIEW, 7)
    assert parse_keys(key_line(key)) == (key,)


def test_a_key_keeps_its_id_in_another_place_and_under_another_name() -> None:
    first = parse_keys(f"a view {OTHER}\nalice operate {GOOD}")
    assert first[1].id == parse_keys(f"eve view {GOOD}")[0].id


def test_every_wrong_line_is_named_at_once() -> None:
    text = "\n".join(
        [
            f"alice operate {GOOD}",
            "bob view",
            f"bob root {OTHER}",
            "bob view notbase64!",
            f"bob view {OTHER[:-8]}",
            f"al/ice view {OTHER}",
            f"alice view {OTHER}",
            f"twin view {GOOD}",
            f"zero view {base64.b64encode(bytes(32)).decode()}",
        ]
    )
    with pytest.raises(CommandError) as caught:
        parse_keys(text, "keys")
    lines = caught.value.detail.splitlines()
    assert [line.split(":")[1] for line in lines] == ["2", "3", "4", "5", "6", "7", "8", "9"]
    assert "twice" in lines[5]
    assert "has the key of 'alice'" in lines[6]
    assert "not random" in lines[7]


def test_two_keys_with_one_id_are_refused() -> None:
    seen: dict[int, bytes] = {}
    for seed in range(2000):
        secret = bytes(range(28)) + seed.to_bytes(4, "big")
        other = seen.setdefault(make_key("k", Role.VIEW, secret).id, secret)
        if other != secret:
            break
    else:
        pytest.fail("no two keys of 2000 have one id")
    lines = [key_line(make_key(name, Role.VIEW, s)) for name, s in (("a", other), ("b", secret))]
    with pytest.raises(CommandError, match="one id"):
        parse_keys("\n".join(lines))


def test_too_many_keys_are_refused() -> None:
    text = "\n".join(key_line(key_of(f"k{i}", seed=i)) for i in range(MAX_KEYS + 1))
    with pytest.raises(CommandError):
        parse_keys(text)


def test_a_key_is_never_shown() -> None:
    key = key_of()
    assert GOOD not in repr(key)
    assert repr(key.secret) not in repr(key)
    with pytest.raises(CommandError) as caught:
        parse_keys(f"alice operate {GOOD}\nalice2 operate {GOOD} {GOOD}\nx {GOOD} y")
    assert GOOD[:8] not in str(caught.value)


@given(st.text(max_size=200))
def test_any_text_gives_keys_or_the_one_error(text: str) -> None:
    with contextlib.suppress(CommandError):
        assert isinstance(parse_keys(text), tuple)


@pytest.mark.parametrize(
    ("mode", "safe"),
    [
        (stat.S_IFREG | 0o400, True),
        (stat.S_IFREG | 0o600, True),
        (stat.S_IFREG | 0o640, False),
        (stat.S_IFREG | 0o604, False),
        (stat.S_IFREG | 0o610, False),
        (stat.S_IFDIR | 0o700, False),
        (stat.S_IFIFO | 0o600, False),
    ],
)
def test_a_file_that_others_can_read_may_not_hold_keys(mode: int, safe: bool) -> None:
    assert (unsafe_file(mode, 7, 7) is None) is safe


@pytest.mark.parametrize(("owner", "safe"), [(7, True), (0, True), (8, False), (65534, False)])
def test_a_key_file_belongs_to_its_reader_or_to_root(owner: int, safe: bool) -> None:
    wrong = unsafe_file(stat.S_IFREG | 0o400, owner, 7)
    assert (wrong is None) is safe
    assert safe or f"uid {owner}" in str(wrong)


def test_a_session_has_other_keys_for_each_direction_session_cookie_and_key() -> None:
    def tags(seed: int, session: int, proof: bytes) -> list[bytes]:
        keys = session_keys(key_of(seed=seed), session, proof)
        return [keys.to_server.tag(b"x"), keys.to_client.tag(b"x")]

    every = tags(1, 1, bytes(16)) + tags(2, 1, bytes(16))
    every += tags(1, 2, bytes(16)) + tags(1, 1, b"p" * 16)
    assert len(set(every)) == 8
