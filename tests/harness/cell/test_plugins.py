"""Entry points of other packages: found by name, usable wherever a variant is named."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from linemate.simulators.harness import main as command_line
from linemate.simulators.harness.cell import plugin_names, variants

SHORT = ("--set", "scenario.lead_in_s=1.5", "--set", "scenario.duration_s=0.6")
MODULE = """
from linemate import ConveyorEstimate

class Mine:
    def __init__(self, conveyor, settings):
        self.speed = conveyor.nominal_speed

    def predict_positions(self, estimate, times):
        return estimate.position + self.speed * times
"""
ENTRIES = "[linemate.predictors]\nmine = mine_of_ours:Mine\ndefault = mine_of_ours:Mine\n"


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A package of another project, as an installer leaves it."""
    (tmp_path / "mine_of_ours.py").write_text(MODULE, encoding="utf-8")
    info = tmp_path / "mine_of_ours-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine-of-ours\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRIES, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    sys.modules.pop("mine_of_ours", None)


@pytest.mark.usefixtures("package")
def test_an_installed_predictor_appears_among_the_variants_of_a_campaign(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert "mine" in variants.known()
    arguments = ["campaign", "--seeds", "1", "--workers", "1", "--variants", "default,mine"]
    assert command_line.main([*arguments, *SHORT]) == 0
    assert "runs: default 1, mine 1" in capsys.readouterr().out


@pytest.mark.usefixtures("package")
def test_a_shipped_variant_keeps_its_name() -> None:
    assert variants.change_of("default") is None
    assert variants.known().count("default") == 1


def test_without_the_package_its_name_is_no_variant(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        command_line.main(["campaign", "--variants", "mine"])
    assert ended.value.code == 2
    assert "no variant 'mine'" in capsys.readouterr().err


@pytest.mark.usefixtures("package")
def test_a_module_and_its_attribute_need_no_entry_point() -> None:
    assert plugin_names.is_plugin("mine_of_ours:Mine")
    assert not plugin_names.is_plugin("mine_of_ours:")
    assert variants.change_of("mine_of_ours:Mine") is not None


@pytest.mark.usefixtures("package")
def test_a_recording_of_a_run_needs_a_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command_line.main(["run", "--record", *SHORT]) == 2
    assert "--out DIR" in capsys.readouterr().err
    arguments = ["run", "--record", "--out", str(tmp_path), "--variant", "mine"]
    command_line.main([*arguments, *SHORT])
    assert (tmp_path / "run.mcap").stat().st_size > 10_000
