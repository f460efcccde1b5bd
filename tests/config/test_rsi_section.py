"""RSI files that must not pass ``linemated --check``, and constants for elements of the site."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from linemate.daemon.config import config
from linemate.daemon.config.documents import FileError
from linemate.daemon.config.files import PROTOCOL_DATA
from linemate.protocol.rsi.codec import RsiCodec, RsiError, parse_config
from linemate.protocol.rsi.rsi_link import RsiLink

SHIPPED = (PROTOCOL_DATA / "rsi_joints.xml").read_text(encoding="utf-8")
DELAY = '<ELEMENT TAG="DEF_Delay" TYPE="LONG" INDX="INTERNAL"/>'
OVERRIDE = '<ELEMENT TAG="OvPro" TYPE="LONG" INDX="9" HOLDON="0"/>'
START = (0.0, -1.5, 1.5, 0.0, 0.5, 0.0, 0.0)

Lines = Callable[..., list[str]]


def with_receive(*elements: str) -> str:
    end = SHIPPED.rindex("    </ELEMENTS>")
    return SHIPPED[:end] + "\n".join(elements) + SHIPPED[end:]


@pytest.fixture
def lines_of(tmp_path: Path) -> Lines:
    """Return the errors of a configuration with an RSI file; none if it is good."""

    def check(xml: str, more: str = "") -> list[str]:
        (tmp_path / "rsi.xml").write_text(xml, encoding="utf-8")
        path = tmp_path / "linemated.yaml"
        path.write_text(f"task: wheel.yaml\nrsi: {{config: rsi.xml{more}}}\n", encoding="utf-8")
        try:
            config.load(path)
        except FileError as error:
            return [line.removeprefix(f"{path}:") for line in error.lines]
        return []

    return check


def test_the_shipped_files_are_good(lines_of: Lines) -> None:
    for name in ("rsi_joints.xml", "rsi_joints_setpoints.xml"):
        assert lines_of((PROTOCOL_DATA / name).read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("tag", ["AK.A4", "EK.E1"])
def test_an_absolute_correction_must_be_held(lines_of: Lines, tag: str) -> None:
    begin = SHIPPED.index(f'TAG="{tag}"')
    xml = SHIPPED[:begin] + SHIPPED[begin:].replace('HOLDON="1"', 'HOLDON="0"', 1)
    (line,) = lines_of(xml)
    assert line == (
        f'2:15: rsi.config: RECEIVE {tag}: HOLDON="0" with absolute corrections: a lost reply '
        'takes the whole correction back. Set HOLDON="1".'
    )


def test_an_increment_must_not_be_held(lines_of: Lines) -> None:
    (line,) = lines_of(SHIPPED, ", corrections: relative")
    assert "RECEIVE AK.A1, AK.A2" in line
    assert 'HOLDON="1" with relative corrections: a lost reply repeats the last increment' in line
    assert lines_of(SHIPPED.replace('HOLDON="1"', 'HOLDON="0"'), ", corrections: relative") == []


def test_a_controller_that_takes_no_replies_is_refused(lines_of: Lines) -> None:
    (line,) = lines_of(SHIPPED.replace("<ONLYSEND>FALSE", "<ONLYSEND>TRUE"))
    assert "ONLYSEND is TRUE" in line
    assert "Set ONLYSEND to FALSE" in line


def test_a_layout_without_delay_is_refused(lines_of: Lines) -> None:
    assert DELAY in SHIPPED
    (line,) = lines_of(SHIPPED.replace(DELAY, ""))
    assert "SEND has no DEF_Delay" in line
    assert DELAY in line


def test_two_corrections_on_one_output_are_refused_with_both(lines_of: Lines) -> None:
    (line,) = lines_of(SHIPPED.replace('INDX="4"', 'INDX="3"'))
    assert 'RECEIVE AK.A3, AK.A4: INDX="3" 2 times. One output of the ETHERNET object' in line


def test_every_fault_of_an_rsi_file_is_reported_at_once(lines_of: Lines) -> None:
    xml = with_receive(OVERRIDE).replace(DELAY, "").replace('INDX="1" HOLDON="1"', 'INDX="1"'
        ' HOLDON="0"')  # fmt: skip
    lines = lines_of(xml.replace("<ONLYSEND>FALSE", "<ONLYSEND>TRUE"))
    assert len(lines) == 4


def test_an_element_without_a_value_is_named(lines_of: Lines) -> None:
    (line,) = lines_of(with_receive(OVERRIDE, '<ELEMENT TAG="Stop" TYPE="BOOL" INDX="10"/>'))
    assert "RECEIVE OvPro, Stop: linemate has no value for it and would write 0" in line
    assert "rsi.constants: {OvPro: VALUE, Stop: VALUE}" in line
    both = with_receive(OVERRIDE, '<ELEMENT TAG="Stop" TYPE="BOOL" INDX="10"/>')
    assert lines_of(both, ", constants: {OvPro: 100, Stop: false}") == []


@pytest.mark.parametrize(
    ("kind", "value", "good"),
    [
        ("LONG", "100", True),
        ("LONG", "99.5", False),
        ("LONG", "true", False),
        ("DOUBLE", "99.5", True),
        ("DOUBLE", "'99.5'", False),
        ("BOOL", "true", True),
        ("BOOL", "1", True),
        ("BOOL", "2", False),
        ("STRING", "good", True),
        ("STRING", "3", False),
    ],
)
def test_a_constant_must_be_of_its_elements_type(
    lines_of: Lines, kind: str, value: str, good: bool
) -> None:
    xml = with_receive(OVERRIDE.replace("LONG", kind))
    lines = lines_of(xml, f", constants: {{OvPro: {value}}}")
    assert (lines == []) is good
    if not good:
        assert f"rsi.constants.OvPro: should be a {kind} as TYPE says" in lines[0]


def test_a_constant_for_what_is_not_there_or_is_written_anyway_is_refused(lines_of: Lines) -> None:
    (line,) = lines_of(SHIPPED, ", constants: {Ovpro: 100}")
    assert "rsi.constants.Ovpro: no element of RECEIVE" in line
    (line,) = lines_of(SHIPPED, ", constants: {AK.A1: 0.5}")
    assert "rsi.constants.AK.A1: linemate writes it in every reply" in line


def test_a_gate_needs_the_signal_that_it_waits_for(lines_of: Lines) -> None:
    xml = SHIPPED.replace('<ELEMENT TAG="DiL" TYPE="LONG" INDX="1"/>', "")
    lines = lines_of(xml)
    assert len(lines) == 2
    assert "waypoints[5] waits for screws_fixed, and the file has no SEND DiL" in lines[0]
    assert "tool.fixed_after" in lines[0]
    assert "waypoints[7] waits for wheel_released" in lines[1]


def test_a_constant_stands_in_every_reply() -> None:
    xml = with_receive(OVERRIDE, '<ELEMENT TAG="Say.it" TYPE="STRING" INDX="10"/>')
    constants = {"OvPro": 100, "Say.it": "a & b"}
    replies = RsiLink(RsiCodec(parse_config(xml.encode()), constants=constants))
    whole = replies.prepare(START, START, 0).with_counter(b"7")
    assert b'<OvPro>100</OvPro><Say it="a &amp; b"/><IPOC>7<' in whole
    assert replies.bare.with_counter(b"7") == (
        b'<Sen Type="ImFree"><OvPro>100</OvPro><Say it="a &amp; b"/><IPOC>7</IPOC></Sen>'
    )


def test_a_bare_reply_without_constants_is_the_counter_alone() -> None:
    replies = RsiLink(RsiCodec(parse_config(SHIPPED.encode())))
    assert replies.bare.with_counter(b"7") == b'<Sen Type="ImFree"><IPOC>7</IPOC></Sen>'


def test_a_constant_that_the_wire_cannot_carry_is_refused() -> None:
    rsi = parse_config(with_receive(OVERRIDE).encode())
    with pytest.raises(RsiError, match="OvPro"):
        RsiCodec(rsi, constants={"OvPro": "fast"})
    with pytest.raises(RsiError, match=r"AK\.A1"):
        RsiCodec(rsi, constants={"AK.A1": 1.0})


def test_the_process_refuses_to_check_and_to_start(tmp_path: Path) -> None:
    (tmp_path / "rsi.xml").write_text(with_receive(OVERRIDE), encoding="utf-8")
    path = tmp_path / "linemated.yaml"
    path.write_text("task: wheel.yaml\nrsi: {config: rsi.xml}\n", encoding="utf-8")
    for more in ([], ["--check"]):
        done = subprocess.run(
            [sys.executable, "-m", "linemate.daemon.service.main", "--config", str(path), *more],
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
        )
        assert done.returncode == 78
        assert "RECEIVE OvPro" in done.stderr
