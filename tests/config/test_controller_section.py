"""Configurations of a FANUC controller: what must fit between controller, arm and task."""

from collections.abc import Callable
from pathlib import Path

import pytest

from linemate.daemon.config import config
from linemate.daemon.config.documents import FileError
from linemate.daemon.config.settings import ControllerKind

Lines = Callable[[str], list[str]]
GOOD = "fanuc: {peer: 192.0.2.5, bind: 192.0.2.1, rail: true, signals_byte: 0}"


@pytest.fixture
def lines_of(tmp_path: Path) -> Lines:
    """Return the errors of a configuration with some sections; none if it is good."""

    def check(sections: str) -> list[str]:
        path = tmp_path / "linemated.yaml"
        path.write_text(f"task: wheel.yaml\ncontroller: {{kind: fanuc}}\n{sections}\n")
        try:
            config.load(path)
        except FileError as error:
            return [line.removeprefix(f"{path}:") for line in error.lines]
        return []

    return check


def test_a_good_section_says_where_the_controller_is_and_its_period(tmp_path: Path) -> None:
    path = tmp_path / "linemated.yaml"
    path.write_text(f"task: wheel.yaml\ncontroller: {{kind: fanuc}}\n{GOOD}\n")
    station = config.load(path)
    assert station.config.controller.kind is ControllerKind.FANUC
    assert station.cycle_s == 0.008
    assert (station.robot.bind, station.robot.port, station.robot.peer) == (
        "192.0.2.1",
        0,
        "192.0.2.5",
    )
    assert station.controller_file is None
    assert "rsi" not in station.texts


def test_without_an_address_the_kind_is_refused(lines_of: Lines) -> None:
    (line,) = lines_of("fanuc: {rail: true, signals_byte: 0}")
    assert line.startswith("2:20: controller.kind: fanuc needs the controller's address")


def test_a_rail_is_refused_unless_it_is_wanted(lines_of: Lines) -> None:
    (line,) = lines_of(GOOD.replace("rail: true, ", ""))
    assert "external axis J7. Set fanuc.rail: true" in line


def test_gates_need_signals_or_times(lines_of: Lines) -> None:
    lines = lines_of(GOOD.replace(", signals_byte: 0", ""))
    assert len(lines) == 2
    assert "waits for screws_fixed, and there are no signals" in lines[0]
    assert "tool.released_after" in lines[1]


def test_an_address_is_numeric(lines_of: Lines) -> None:
    (line,) = lines_of(GOOD.replace("192.0.2.5", "robot"))
    assert "fanuc.peer: 'robot' does not appear to be an IPv4 or IPv6 address" in line


def test_time_outs_are_compared_with_the_period_of_this_family(lines_of: Lines) -> None:
    assert lines_of(f"{GOOD}\nwatch: {{missed_s: 0.009}}") == []
    (line,) = lines_of(f"{GOOD}\nwatch: {{missed_s: 0.007}}")
    assert "shorter than a cycle of 0.008 s" in line


def test_a_section_of_another_family_than_the_default_needs_the_kind(tmp_path: Path) -> None:
    path = tmp_path / "linemated.yaml"
    path.write_text("task: wheel.yaml\negm: {port: 0}\n")
    with pytest.raises(FileError, match=r"egm: not used: controller\.kind is rsi") as caught:
        config.load(path)
    assert len(caught.value.lines) == 1


def test_a_controller_listens_on_a_port(lines_of: Lines) -> None:
    (line,) = lines_of(GOOD.replace("rail", "peer_port: 0, rail"))
    assert "fanuc.peer_port: should be greater than or equal to 1" in line
