"""Overlays reach what the daemon believes, whole, and nothing else."""

from pathlib import Path

import pytest

from linemate.daemon.config.documents import FileError
from linemate.simulators.harness import identified_overlay as overlay
from linemate.simulators.harness import setup
from linemate.simulators.harness.cell.variants import SetupError


def test_values_and_lists_reach_the_settings_and_leave_the_rest() -> None:
    plain = setup.make("wheel")
    laid = {
        "tracking": {"distance": {"deviation": 0.0005}, "swing": []},
        "task": {"arm": {"camera_in_tcp": {"position": [0.1, 0.2, 0.3]}}},
    }
    made = setup.laid_over(plain, laid)
    assert made.tracking.distance.deviation == 0.0005
    assert made.tracking.distance.gate == plain.tracking.distance.gate
    assert made.tracking.swing == ()
    assert made.task.arm.camera_in_tcp.position == (0.1, 0.2, 0.3)
    assert made.control == plain.control
    assert made.scenario == plain.scenario


@pytest.mark.parametrize(
    ("laid", "what"),
    [
        ({"scenario": {"seed": 3}}, "no section scenario"),
        ({"tracking": {"distance": {"deviations": 1.0}}}, "no such key"),
        ({"control": {"servos": [{"frequency_hz": 1.0}]}}, "control.servos"),
        ({"tracking": {"distance": {"deviation": -1.0}}}, "greater than or equal to"),
    ],
)
def test_what_does_not_fit_is_refused(laid: dict[str, object], what: str) -> None:
    with pytest.raises(SetupError, match=what):
        setup.laid_over(setup.make("wheel"), laid)


def test_a_file_is_read_strictly(tmp_path: Path) -> None:
    path = tmp_path / "o.yaml"
    path.write_text("tracking: {distance: {deviation: 0.0004}}\n")
    assert overlay.load(path) == {"tracking": {"distance": {"deviation": 0.0004}}}
    path.write_text("scenario: {seed: 1}\n")
    with pytest.raises(FileError, match="unknown section"):
        overlay.load(path)
    with pytest.raises(FileError, match=r"none\.yaml"):
        overlay.load(tmp_path / "none.yaml")


def test_the_shipped_overlay_fits_the_default_cell_and_is_close_to_its_truth() -> None:
    made = setup.laid_over(setup.make("wheel"), overlay.load())
    for model, axis in zip(made.control.servos, made.scenario.robot.axes, strict=True):
        assert model.frequency_hz == pytest.approx(axis.frequency_hz, rel=0.01)
        assert model.frequency_hz != axis.frequency_hz
        assert model.dead_time == pytest.approx(axis.dead_time_s, abs=2e-4)
    swing = made.scenario.body.swings[0]
    assert made.tracking.swing[0].frequency_hz == pytest.approx(swing.frequency_hz, rel=0.005)
