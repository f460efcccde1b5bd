"""Motion of the conveyor from coarse readings with outliers."""

import numpy as np
import pytest

from linemate.daemon.identification.conveyor_motion import conveyor


def test_the_conveyor_is_read_through_outliers_and_steps() -> None:
    t = np.arange(0.0, 3.0, 0.012)
    readings = np.round(0.106 * t + 2.5e-4 * np.random.default_rng(0).normal(size=len(t)), 3)
    readings[50] += 0.08
    asked = np.array([0.01, 0.6, 1.5, 2.9, 5.0])
    position, speed, known = conveyor(np.column_stack((t, readings)), asked)
    assert known.tolist() == [True, True, True, True, False]
    assert position[1:4] == pytest.approx(0.106 * asked[1:4], abs=6e-4)
    assert speed[1:3] == pytest.approx(0.106, abs=0.01)
