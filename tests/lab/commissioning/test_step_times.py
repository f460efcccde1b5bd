"""The table of step times: a recording lasts as long as its cycles do."""

from pathlib import Path

import pytest

from linemate.daemon.commissioning.walk import StepName
from linemate.daemon.recording.reader import read
from linemate.simulators.lab import commission_cell
from linemate.simulators.lab.commissioning import site_copy, step_times


@pytest.mark.row
def test_a_motion_of_the_daemon_is_as_long_as_its_steps(tmp_path: Path) -> None:
    cell = commission_cell.EmulatedCell(site_copy.copied("kr10", tmp_path))
    (file,) = commission_cell.recorded(cell, StepName.SIGNS, tmp_path)
    steps = len(read(file).steps)
    assert step_times._length_s(file) == pytest.approx(
        steps * cell.setup().scenario.cycle_s, rel=0.01
    )
