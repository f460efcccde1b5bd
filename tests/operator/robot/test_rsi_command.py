"""``linemate rsi``: lint from the command line, and files ready to copy."""

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from linemate.daemon.command_line import NO, OK, USAGE
from linemate.daemon.operator import main as operator
from linemate.daemon.operator.robot.rsi_command import KUKA, VERSIONS
from linemate.protocol.rsi.ethernet_config import parse_config

CONTEXTS = sorted([*KUKA.glob("*/*.rsix"), *KUKA.glob("*/*.rsi.xml")])


def test_a_good_file_is_good(capsys: pytest.CaptureFixture[str]) -> None:
    file = KUKA / "kss-8.5" / "linemate_ethernet.xml"
    assert operator.main(["rsi", "lint", str(file)]) == OK
    assert capsys.readouterr().out == f"{file}: good\n"


def test_a_finding_has_file_and_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "rsi.xml"
    file.write_text((KUKA / "kss-8.5" / "linemate_ethernet.xml").read_text().replace("A3", "A2"))
    assert operator.main(["rsi", "lint", str(file)]) == NO
    assert re.match(rf"{file}:\d+: AK\.A2: given twice", capsys.readouterr().out)
    assert operator.main(["rsi", "lint", str(file), "--json"]) == NO
    (found,) = json.loads(capsys.readouterr().out)
    assert found["line"] > 1


def test_a_task_says_what_the_arm_needs(capsys: pytest.CaptureFixture[str]) -> None:
    file = KUKA / "kss-8.5" / "linemate_ethernet.xml"
    wheel = Path(operator.__file__).parents[1] / "data" / "wheel.yaml"
    assert operator.main(["rsi", "lint", str(file), "--task", str(wheel)]) == NO
    assert "RECEIVE EK.E1" in capsys.readouterr().out


def test_a_configuration_brings_constants_corrections_and_task(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (KUKA / "kss-8.5" / "linemate_e1_ethernet.xml").read_text()
    file, config = tmp_path / "rsi.xml", tmp_path / "linemated.yaml"
    file.write_text(text)
    config.write_text("task: wheel.yaml\nrsi: {config: rsi.xml, corrections: relative}\n")
    assert operator.main(["rsi", "lint", str(file), "--config", str(config)]) == NO
    assert "repeats the last increment" in capsys.readouterr().out
    config.write_text("task: wheel.yaml\n")
    assert operator.main(["rsi", "lint", str(file), "--config", str(config)]) == OK
    config.write_text("task: [1]\n")
    assert operator.main(["rsi", "lint", str(file), "--config", str(config)]) == USAGE


def test_a_file_that_is_not_there_is_a_usage_error(tmp_path: Path) -> None:
    assert operator.main(["rsi", "lint", str(tmp_path / "none.xml")]) == USAGE


@pytest.mark.parametrize("version", VERSIONS)
def test_files_are_copied_once(version: str, tmp_path: Path) -> None:
    folder = tmp_path / "krc"
    assert operator.main(["rsi", "files", version, str(folder)]) == OK
    assert {file.name for file in folder.iterdir()} >= {"linemate.src", "linemate.dat"}
    assert operator.main(["rsi", "files", version, str(folder)]) == NO


@pytest.mark.parametrize("file", CONTEXTS, ids=lambda file: f"{file.parent.name}/{file.name}")
def test_a_context_is_wired_to_the_channels_of_its_ethernet_config(file: Path) -> None:
    first = 1 if file.name.endswith(".rsi.xml") else 0  # RSI 3 counts from 1
    name = file.name.partition(".")[0]
    config = parse_config((file.parent / f"{name}_ethernet.xml").read_bytes())
    wired: dict[str, dict[int, tuple[str, int]]] = {}
    parameters: dict[str, dict[str, str]] = {}
    for found in ET.parse(file).iter():
        if not found.tag.upper().endswith("RSIOBJECT"):
            continue
        given = {key.upper(): value for key, value in found.attrib.items()}
        inputs = {}
        for part in found.iter():
            keys = {key.upper(): value for key, value in part.attrib.items()}
            if "INIDX" in keys:
                inputs[int(keys["INIDX"]) - first] = keys["OUTOBJID"], int(keys["OUTIDX"]) - first
            if "PARAMVALUE" in keys:
                parameters.setdefault(given["OBJID"], {})[keys["NAME"]] = keys["PARAMVALUE"]
        wired[given["OBJID"]] = inputs
    assert parameters["Ethernet_1"]["ConfigFile"] == f"{name}_ethernet.xml"
    assert int(parameters["Ethernet_1"]["Precision"]) >= 6
    channels = {one.tag: one.index for one in config.receive}
    axes = [wired["AxisCorr_1"][i] for i in range(6)]
    assert axes == [("Ethernet_1", (channels[f"AK.A{i}"] or 0) - 1) for i in range(1, 7)]
    if "EK.E1" in channels:
        assert wired["AxisCorrExt_1"] == {0: ("Ethernet_1", (channels["EK.E1"] or 0) - 1)}
    assert wired["Map2DigOut_1"] == {0: ("Ethernet_1", (channels["DiO"] or 0) - 1)}
    (signals,) = [one.index for one in config.send if one.tag == "DiL"]
    assert wired["Ethernet_1"] == {(signals or 0) - 1: ("DigIn_1", 0)}


@pytest.mark.parametrize("version", VERSIONS)
def test_a_program_bounds_each_axis_before_it_switches_rsi_on(version: str) -> None:
    lines = (KUKA / version / "linemate.src").read_text().splitlines()
    text = "\n".join(line.partition(";")[0] for line in lines)  # without comments
    begins = "RSI_PROCESS_ON" if version == "iiqka-os2" else "RSI_ON"
    assert text.index("LINEMATE_LIMITS(") < text.index(begins) < text.index("RSI_MOVECORR")
    for axis in (*(f"A{i}" for i in range(1, 7)), "E1"):
        assert text.count(f'"LowerLim{axis}"') == text.count(f'"UpperLim{axis}"') == 1
    words = text.split()
    assert words.count("IF") == words.count("ENDIF")
    assert words.count("DEF") == words.count("END")
    assert words.count("DEFFCT") == words.count("ENDFCT")
    data = (KUKA / version / "linemate.dat").read_text()
    assert "DRIVES_TO_REST=FALSE" in data
    assert f'CONTEXT[]="linemate{".rsi" if version == "kss-8.2" else ""}"' in data
