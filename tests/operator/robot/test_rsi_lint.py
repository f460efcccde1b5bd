"""What the lint of an EthernetConfig finds, and on which line."""

import re

import pytest

from linemate.daemon.config import task_file
from linemate.daemon.config.files import DAEMON_DATA, PROTOCOL_DATA
from linemate.daemon.config.settings import Corrections
from linemate.daemon.operator.robot import rsi_lint

GOOD = (PROTOCOL_DATA / "rsi_joints.xml").read_bytes()
WHEEL = task_file.load(DAEMON_DATA / "wheel.yaml").file


def line_of(word: str) -> int:
    """Line of the shipped file on which a word stands first."""
    return GOOD.decode()[: GOOD.decode().index(word)].count("\n") + 1


def test_the_shipped_files_are_good() -> None:
    for file in sorted(PROTOCOL_DATA.glob("**/*.xml")):
        if "rsi.xml" not in file.name:
            assert rsi_lint.lint(file.read_bytes()) == [], file


@pytest.mark.parametrize(
    ("before", "after", "at", "what"),
    [
        ("<ONLYSEND>FALSE", "<ONLYSEND>TRUE", "<ONLYSEND>", "takes no replies"),
        ("<PORT>49152", "<PORT>4915x", "<PORT>", "PORT: '4915x'"),
        ('INDX="3"', 'INDX="99"', "AK.A3", "AK.A3/@INDX: '99'"),
        ("AK.A2", "AK.A1", "AK.A2", "AK.A1: given twice in RECEIVE"),
        ("AK.A2", "AK.B2", "AK.A2", "AK.B2"),
        ("DEF_Delay", "DEF_Dlay", "<SEND>", "SEND has no DEF_Delay"),
        ("DEF_AIPos", "DEF_ASPos", "<SEND>", "the arm needs SEND DEF_AIPos"),
        ('TAG="DiO"', 'TAG="Speed"', 'TAG="DiO"', "would write 0"),
        ('TAG="DiO" TYPE="LONG"', 'TAG="DiO" TYPE="WORD"', 'TAG="DiO"', "TYPE must be one of"),
        ('TAG="DiL" TYPE', 'TAG="DiL" !TYPE', 'TAG="DiL"', "malformed"),
        ("FALSE</ONLYSEND>", "perhaps</ONLYSEND>", "<ONLYSEND>", "neither TRUE nor FALSE"),
    ],
)
def test_an_error_has_its_line(before: str, after: str, at: str, what: str) -> None:
    text = GOOD.decode()
    assert before in text
    (found,) = rsi_lint.lint(text.replace(before, after, 1).encode())
    assert what in found.what
    assert found.line == line_of(at)


def test_every_error_is_reported_in_the_order_of_the_lines() -> None:
    text = GOOD.decode().replace('HOLDON="1"', 'HOLDON="0"').replace("ONLYSEND>FALSE", "ONLYSEND>1")
    found = rsi_lint.lint(text.replace('TAG="DiO"', 'TAG="Speed"').encode())
    assert [one.line for one in found] == [
        line_of("<ONLYSEND>"),
        line_of("AK.A1"),
        line_of('"DiO"'),
    ]


def test_relative_corrections_want_the_other_hold_on() -> None:
    (found,) = rsi_lint.lint(GOOD, Corrections.RELATIVE)
    assert "repeats the last increment" in found.what


def test_a_constant_fills_an_element_and_a_wrong_one_is_named() -> None:
    text = GOOD.replace(b'TAG="DiO"', b'TAG="Speed"')
    assert rsi_lint.lint(text, constants={"Speed": 100}) == []
    (found,) = rsi_lint.lint(text, constants={"Speed": 0.5})
    assert found.what.startswith("Speed: should be a LONG")


def test_a_task_on_a_linear_axis_needs_its_position_correction_and_signals() -> None:
    bare = re.sub(rb'.*TAG="(?:EK.E1|DEF_EIPos|DiL)".*\n', b"", GOOD)
    assert rsi_lint.lint(bare) == []
    whats = [one.what for one in rsi_lint.lint(bare, task=WHEEL)]
    assert whats[0] == "the arm needs SEND DEF_EIPos, RECEIVE EK.E1"
    assert any("SEND DiL" in what for what in whats[1:])


def test_a_comment_moves_no_line() -> None:
    text = b"<!-- a\n b\n -->" + GOOD.replace(b"AK.A2", b"AK.A1")
    (found,) = rsi_lint.lint(text)
    assert found.line == line_of("AK.A2") + 2


def test_any_bytes_give_findings_and_no_exception() -> None:
    for data in (b"", b"\xff\xfe", b"<ROOT>", b"<!-- <ROOT>", GOOD[:500], GOOD * 3):
        assert rsi_lint.lint(data)
