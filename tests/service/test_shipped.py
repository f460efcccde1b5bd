"""What is installed with the program: its first configuration and its unit."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from linemate.daemon.config import config

SYSTEMD = Path(__file__).parents[2] / "systemd"


def test_the_shipped_configuration_is_good_where_its_directories_are(tmp_path: Path) -> None:
    text = (SYSTEMD / "linemated.yaml").read_text(encoding="utf-8")
    for directory in ("/run/linemate", "/var/lib/linemate", "/var/log/linemate"):
        assert directory in text
        text = text.replace(directory, str(tmp_path))
    path = tmp_path / "linemated.yaml"
    path.write_text(text, encoding="utf-8")
    station = config.load(path)
    assert station.task.file.name == "wheel"
    assert station.config.rsi.cycle_ms == 12


UNITS = ("linemated.service", "linemated@.service")


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze here")
@pytest.mark.parametrize("name", [*UNITS, "linemate-metrics.service", "linemate-bridge.service"])
def test_a_unit_is_understood_and_leaves_little_exposed(name: str, tmp_path: Path) -> None:
    text = (SYSTEMD / name).read_text(encoding="utf-8")
    unit = tmp_path / name
    unit.write_text(re.sub(r"/opt/linemate/bin/\w+", "/bin/true", text), encoding="utf-8")
    verified = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(unit).replace("@.", "@west.")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (verified.returncode, verified.stderr) == (0, "")
    judged = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--threshold=20", str(unit)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert judged.returncode == 0, judged.stdout


def test_the_template_is_the_unit_with_names_of_its_own() -> None:
    one, many = ((SYSTEMD / name).read_text(encoding="utf-8").partition("[Unit]") for name in UNITS)
    for own, shared in (
        (", cell %i", ""),
        ("/%i.yaml", "/linemated.yaml"),
        ("Directory=linemate-%i", "Directory=linemate"),
    ):
        assert own in many[2]
        many = (many[0], many[1], many[2].replace(own, shared))
    assert many[2] == one[2]
